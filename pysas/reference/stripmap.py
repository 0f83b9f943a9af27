"""What the Fourier algorithms for straight stripmap tracks share: the checks of the track, the axes, the pulse's filter.

They see a monostatic sonar at evenly spaced positions on a line along x. A point at slant range r and along-track position
x0 then has, in (base-band frequency f, along-track wavenumber k_u), the spectrum P(f) sqrt(pi r/(j k)) (1 - (k_u/2k)^2)^(-3/4)
exp(-j r k_x - j k_u x0) with k = 2 pi (fc + f)/c and k_x = sqrt(4 k^2 - k_u^2) (R. Sathishkumar et al., Chirp Scale
Processing for Imaging Sonar, Eqs 1-6, with the along-track factor that is missing there). Images lie in the slant plane laid
flat at the sonar's own height: pixel (x, y) is at slant range |y - y_track|. No engine is imported here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.model.beam import FAN, Beam
from pysas.model.echoes import Echoes
from pysas.model.grid import Grid
from pysas.model.pulse import LFM

TOLERANCE = 0.01  # largest distance from the ideal track, wavelengths at fc: a phase of 4 pi/100 = 0.13 rad

Complex = npt.NDArray[np.complex128]


SIDES = ("+y", "-y")


@dataclass(frozen=True, eq=False)
class Strip:
    """A checked stripmap record and the axes of its transforms.

    Attributes
    ----------
    data : (ping, sample)
        View of the samples, pings in order of growing x.
    x0, spacing : float
        Position of the first of them and distance between pings, m.
    y0, z0, side : float
        Track in y and z, m; +1 where the sonar looks towards +y, -1 towards -y.
    notes : tuple of str
        That the side was assumed, where nothing tells it.
    start : float
        Time of sample 0, s.
    k_u : (n,)
        Along-track wavenumbers of an n-point FFT over pings, rad/m, n >= ping; within pi/spacing of those of the beam's axis.
    kept : (n,) bool
        Within the along-track processing bandwidth.
    cosine : float
        Of the largest angle from broadside that is processed; 0 where that reaches 90 degrees.
    """

    echoes: Echoes
    data: ComplexArray
    x0: float
    spacing: float
    y0: float
    z0: float
    side: float
    start: float
    k_u: FloatArray
    kept: npt.NDArray[np.bool_]
    cosine: float
    notes: tuple[str, ...] = ()

    @property
    def swath(self) -> tuple[float, float]:
        """First and last slant range of the record, m."""
        return self.echoes.swath

    @property
    def k0(self) -> float:
        """One-way wavenumber at fc, rad/m."""
        return 2 * np.pi * self.echoes.fc / self.echoes.speed

    def wavenumber(self, f: FloatArray) -> FloatArray:
        """One-way wavenumber k, rad/m, at base-band frequencies `f`, Hz."""
        return 2 * np.pi * (self.echoes.fc + f) / self.echoes.speed

    def spectrum(self, samples: int, threads: int) -> ComplexArray:
        """FFT over pings of the data, (len(k_u), max(samples, sample)); the columns beyond the record are left unset.

        Row m belongs to exp(-j k_u (x - x0)).
        """
        n = self.data.shape[1]
        work = np.empty((self.k_u.size, max(samples, n)), dtype=self.echoes.dtype)
        work[: len(self.data), :n] = self.data
        work[len(self.data) :, :n] = 0
        work[:, :n] = scipy.fft.fft(work[:, :n], axis=0, overwrite_x=True, workers=threads)
        return work

    def grid(self, ranges: FloatArray) -> Grid:
        """Plane with the pings' x and the slant `ranges`, m."""
        y = self.y0 + self.side * ranges
        return Grid.plane(self.x0 + self.spacing * np.arange(len(self.data)), y, z=self.z0)


def prepare(echoes: Echoes, along_bandwidth: float | None, name: str = "echoes", side: str | None = None) -> Strip:
    """Check that `echoes` are what a Fourier algorithm takes, and lay out its axes.

    Of a beam it takes the side and the middle of the along-track band: Fourier algorithms focus all that is recorded within
    that, as if the beam held it, and weigh nothing by its half-angle or taper.

    Parameters
    ----------
    echoes : Echoes
    along_bandwidth : float or None
        Two-sided, rad/m; None: all that the pings sample.
    name : str
        Argument to name in errors.
    side : {"+y", "-y"}, optional
        Where the sonar looks; default: where its beam does, or without one towards +y, which the notes then say.

    Raises
    ------
    ValueError
        More than one channel or moving receivers (see `phase_centres`), fewer than two pings, a ping farther than
        TOLERANCE wavelengths from an even straight line along x (it is named; see `motion_compensate`), a start time of
        its own, a sound speed of its own, or a non-finite sample.
    TypeError
        No Echoes.
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"{name}={type(echoes).__name__}: expected pysas.Echoes")
    if echoes.n_channel != 1 or echoes.velocity is not None:
        found = f"{echoes.n_channel} channels" if echoes.n_channel != 1 else "receivers with a velocity"
        raise ValueError(f"{name}: {found}: expected one stationary channel (pysas.reference.phase_centres makes it)")
    if echoes.n_ping < 2:
        raise ValueError(f"{name}: {echoes.n_ping} ping: expected at least two")
    if echoes.fs >= 2 * echoes.fc:
        raise ValueError(f"{name}: fs={echoes.fs:g} Hz: expected less than twice fc={echoes.fc:g} Hz, no frequency below zero")
    start = one_start(echoes, name)
    first, step = _even_line(echoes, name)
    echoes = echoes.whole()
    data = echoes.traces[:, 0]
    finite = np.isfinite(data).all(axis=1)
    if not finite.all():
        raise ValueError(f"{name}: non-finite sample at ping {int(np.argmin(finite))}: expected finite samples")
    if step < 0:
        data, first, step = data[::-1], first + np.array([(len(data) - 1) * step, 0, 0]), -step
    centre, sign = 0.0, 1.0
    if echoes.beam is not None:
        middle = beam_middle(echoes.beam)
        sign = -1.0 if middle[1] < 0 else 1.0
        centre = 4 * np.pi * echoes.fc / echoes.speed * float(middle[0])
    if side is not None:
        sign = 1.0 if _checks.choice("side", side, SIDES) == "+y" else -1.0
    assumed = side is None and echoes.beam is None
    notes = ("towards +y: no beam and no side= tells where the sonar looks",) if assumed else ()
    sampled = 2 * np.pi / step
    if along_bandwidth is None:
        band = sampled
    else:
        band = _checks.number("along_bandwidth", along_bandwidth, positive=True)
        if band > sampled * (1 + 1e-12):
            raise ValueError(f"along_bandwidth={band!r}: expected at most the {sampled:g} rad/m that {step:g} m sample")
    lowest = 4 * np.pi * (echoes.fc - min(echoes.fs, echoes.occupied_bandwidth) / 2) / echoes.speed
    sine = (abs(centre) + band / 2) / lowest if lowest > 0 else 1.0
    cosine = float(np.sqrt(max(1 - sine**2, 0.0)))
    # what the widest processed beam of the farthest range spreads must not wrap round onto the other end
    spread = len(data)
    if cosine > 0:
        spread = int(np.ceil(min(max(echoes.swath[1], 0.0) * sine / cosine / step, spread)))
    n = int(scipy.fft.next_fast_len(len(data) + spread))
    k_u = 2 * np.pi * np.fft.fftfreq(n, step)
    k_u = k_u + sampled * np.rint((centre - k_u) / sampled)
    kept = np.abs(k_u - centre) <= band / 2 * (1 + 1e-12)
    x0, y0, z0 = (float(v) for v in first)
    return Strip(echoes, data, x0, step, y0, z0, sign, start, k_u, kept, cosine, notes)


def beam_middle(beam: Beam) -> FloatArray:
    """(3,) mean direction, of length 1, of a beam's middle: boresight, or for a fan what of it lies across the fan's axis."""
    look = beam.boresights
    if beam.shape == FAN:
        look = look - np.sum(look * beam.axes, axis=-1, keepdims=True) * beam.axes
        look /= np.linalg.norm(look, axis=-1, keepdims=True)
    mean = look.mean(axis=0)
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-300))


def one_start(echoes: Echoes, name: str = "echoes") -> float:
    """The start time of all pings, s; raises where they differ by more than a hundredth of a period of fc."""
    start = echoes.start_time
    off = np.abs(start - start[0]) * echoes.fc
    if off.max() > TOLERANCE:
        ping = int(np.argmax(off > TOLERANCE))
        raise ValueError(f"{name}: t0={start[ping]:.9g} s at ping {ping}, {start[0]:.9g} s at ping 0: expected one start time")
    return float(start[0])


def _even_line(echoes: Echoes, name: str) -> tuple[FloatArray, float]:
    """First position (3,) and step along x of the least-squares even line along x through the track."""
    n = np.arange(echoes.n_ping) - (echoes.n_ping - 1) / 2
    middle = echoes.tx.mean(axis=0)
    step = float(n @ echoes.tx[:, 0] / (n @ n))
    wavelength = echoes.speed / echoes.fc
    ideal = middle + n[:, None] * np.array([step, 0.0, 0.0])
    if step == 0:
        raise ValueError(f"{name}: the track does not advance along x: expected evenly spaced pings along x")
    for what, position, wanted in (("tx", echoes.tx, ideal), ("rx", echoes.receivers[:, 0], echoes.tx)):
        off = np.linalg.norm(position - wanted, axis=1)
        if off.max() > TOLERANCE * wavelength:
            ping = int(np.argmax(off > TOLERANCE * wavelength))
            line = "an even straight line along x (motion_compensate, phase_centres)" if what == "tx" else "tx (phase_centres)"
            raise ValueError(
                f"{name}: {what} at ping {ping} is {off[ping]:.3g} m from {line}: expected at most "
                f"{TOLERANCE:g} wavelengths, {TOLERANCE * wavelength:.3g} m"
            )
    return ideal[0], step


def band(echoes: Echoes, range_bandwidth: float | None) -> float:
    """Two-sided range processing bandwidth, Hz; default: all that is sampled."""
    if range_bandwidth is None:
        return echoes.fs
    width = _checks.number("range_bandwidth", range_bandwidth, positive=True)
    if width > echoes.fs:
        raise ValueError(f"range_bandwidth={range_bandwidth!r}: expected at most fs={echoes.fs:g} Hz")
    return width


def reference(echoes: Echoes, reference_range: float | None) -> float:
    """The reference range, m; default: the middle of the record."""
    if reference_range is not None:
        return _checks.number("reference_range", reference_range, positive=True)
    return sum(echoes.swath) / 2


def matched_filter(echoes: Echoes, f: FloatArray, name: str = "echoes") -> Complex | None:
    """Matched filter at base-band frequencies `f`, Hz: an echo of amplitude A becomes a peak A. None for compressed data."""
    if echoes.compressed:
        return None
    pulse = echoes.pulse
    if pulse is None:
        raise ValueError(f"{name}: pulse=None: expected raw echoes with their pulse, or range-compressed echoes")
    if isinstance(pulse, LFM):
        offset = pulse.fc - echoes.fc
        turned = pulse.spectrum(f - offset) * np.exp(-1j * np.pi * offset * pulse.duration)
        return np.asarray(turned.conj() / pulse.energy)
    samples = np.asarray(pulse, dtype=np.complex128)
    spectrum = np.exp(-2j * np.pi * np.outer(f, np.arange(samples.size) / echoes.fs)) @ samples
    return np.asarray(spectrum.conj() / np.vdot(samples, samples).real)


def even_ranges(near: float, far: float, step: float) -> FloatArray:
    """Slant ranges from `near` to `far`, m."""
    count = int(np.floor((far - near) / step * (1 + 1e-12))) + 1
    return near + step * np.arange(count, dtype=np.float64)


def frequencies(samples: int, fs: float) -> FloatArray:
    """Base-band frequencies of an FFT over at least `samples` samples, in its order, Hz."""
    return np.asarray(scipy.fft.fftfreq(int(scipy.fft.next_fast_len(samples)), 1 / fs), dtype=np.float64)
