"""What micronavigation found: the corrections of a track, how sure they are, and what they cannot say."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.motion.moving import moved


@dataclass(frozen=True, eq=False, repr=False)
class Motion:
    """Corrections of a claimed track: what to add to it.

    Attributes
    ----------
    shift : (ping, 3)
        In the scene's coordinates, m.
    yaw : (ping,)
        Turn about z from +x towards +y, rad.
    surge, sway, heave : (ping,)
        The shift along the claimed forward direction, 90 degrees from it towards +90 degrees about z, and along z, m.
    sigma : (ping, 4)
        Standard deviations of the changes of surge, sway, heave (m) and yaw (rad) from the ping before; the first ping's repeat
        the second's. Multiplied, as `track_sigma` is, by residual[0] where that is above 1.
    track_sigma : (ping,)
        Standard deviation of the track along the line of sight to the swath's middle, a shift and a turn of the whole
        removed, m.
    coherence : (ping - 1,)
        Of each ping and its next at separation 0, noise's share removed.
    overlap : (ping - 1,)
        Phase centres of each ping that lie beside one of the next.
    residual : (2,)
        What echoes' rows and prior's rows leave over, over their standard deviations: about 1 where both tell the truth. Of the
        prior the largest of its parts.
    slips : list of int
        Pings from which to the next the phase of the windows and the envelope disagree by half a wavelength or more.
    unseen : list of int
        Pings from which to the next nothing was correlated: the prior joins them, or motion as before and after.
    found : bool
        Whether there was something to go by. False: all corrections are 0.
    why : str
        In words.
    pivot : (ping, 3)
        Places that `yaw` turns the array about, m.
    loss : (2,)
        dB that an image's peaks may lose, with the claimed track and with this one: 4.34 (4 pi fc/c sigma)^2 over an aperture;
        not a number where nothing was found.
    """

    shift: FloatArray
    yaw: FloatArray
    surge: FloatArray
    sway: FloatArray
    heave: FloatArray
    sigma: FloatArray
    track_sigma: FloatArray
    coherence: FloatArray
    overlap: FloatArray
    residual: FloatArray
    slips: list[int]
    unseen: list[int]
    found: bool
    why: str
    pivot: FloatArray
    loss: FloatArray

    def apply(self, echoes: Echoes, velocity: str = "follow") -> Echoes:
        """Echoes with the track corrected: transmitters, receivers, beam and velocity.

        Parameters
        ----------
        echoes : Echoes
            Of the track that was corrected, any side or channels of it, with as many pings.
        velocity : "follow" or "keep"
            Whether the velocity came from the claimed track and so changes with it, or was measured by itself.

        Returns
        -------
        Echoes
            The same samples; attrs["motion"] says by how much the track changed.

        Raises
        ------
        ValueError
            Another number of pings; echoes that this motion has corrected already.
        """
        if echoes.n_ping != len(self.yaw):
            raise ValueError(f"echoes: {echoes.n_ping} pings: expected {len(self.yaw)}, of the track that was corrected")
        if not self.found:
            return echoes
        said = f"micronavigation: {self._largest()}"
        if echoes.attrs.get("motion") == said:
            raise ValueError(f"echoes: corrected already ({said}): expected those of the track that was corrected")
        return moved(echoes, self.shift, self.yaw, velocity, self.pivot).replace(attrs={**echoes.attrs, "motion": said})

    def _largest(self) -> str:
        shift = 1e3 * float(np.max(np.linalg.norm(self.shift, axis=1)))
        return f"shifts of up to {shift:.3g} mm, turns of up to {1e3 * float(np.max(np.abs(self.yaw))):.3g} mrad"

    def __str__(self) -> str:
        pings = len(self.yaw)
        head = f"Motion: {pings} pings, {'found' if self.found else 'nothing found, track unchanged'}: {self.why}"
        if not self.found:
            return head
        surge, sway, heave, yaw = np.median(self.sigma, axis=0)
        lines = [
            head,
            f"  corrected  {self._largest()}",
            f"  sure to    {1e6 * surge:.3g}, {1e6 * sway:.3g}, {1e6 * heave:.3g} um of surge, sway and heave and "
            f"{1e6 * yaw:.3g} urad of yaw from ping to ping; {1e3 * float(np.max(self.track_sigma)):.3g} mm of slant range "
            "over the track, a shift and a turn of the whole removed",
            f"  coherence  {np.min(self.coherence):.2f} to {np.max(self.coherence):.2f}, median "
            f"{np.median(self.coherence):.2f}; {np.min(self.overlap):.3g} to {np.max(self.overlap):.3g} phase centres overlap",
            f"  residuals  {self.residual[0]:.3g} of the echoes, {self.residual[1]:.3g} of the prior, in standard deviations: "
            "well above 1 a prior is too sure, or the seabed elsewhere",
            "  not seen   where the whole track lies and its mean heading, which move the image and leave it sharp; pitch and "
            "roll",
            f"  image      peaks may lose {_decibels(self.loss[0])} with the claimed track, {_decibels(self.loss[1])} with "
            "this one",
        ]
        if self.unseen:
            joined = "nothing correlates from there to the next ping: joined by the prior, or by motion as before and after"
            lines.append(f"  unseen     {_listed(self.unseen)}: {joined}")
        if self.slips:
            lines.append(f"  slips      {_listed(self.slips)}: phase and envelope disagree from there to the next ping")
        return "\n".join(lines)

    __repr__ = __str__


def _decibels(loss: float) -> str:
    return f"{loss:.2g} dB" if loss < 4 else "4 dB and more"


def _listed(pings: list[int]) -> str:
    more = f" and {len(pings) - 12} more" if len(pings) > 12 else ""
    return f"ping{'s' * (len(pings) > 1)} {', '.join(map(str, pings[:12]))}{more}"
