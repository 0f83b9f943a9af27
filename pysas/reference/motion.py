"""Motion compensation: echoes of a perturbed track as those of a straight line, for a flat seabed seen at broadside.

What stays wrong is what depends on the angle from broadside, which back-projection has no need to neglect. It relies on
`phase_centres` for midpoints and delays.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM
from pysas.reference.phase_centres import Centres, delayed
from pysas.reference.stripmap import one_start


def motion_compensate(
    echoes: Echoes,
    line: npt.ArrayLike | None = None,
    *,
    seabed: float,
    order: int = 2,
    reference_range: float | None = None,
) -> Echoes:
    """Move the phase centres of a perturbed track onto a straight line along x.

    Parameters
    ----------
    echoes : Echoes
        Raw or range-compressed; every channel is compensated by its own phase centre.
    line : (2,) array_like, optional
        y and z of the line, m; default: the mean of the phase centres (the nearest line along x).
    seabed : float
        z of the flat seabed, m.
    order : 1 or 2
        1: one delay per trace, right at `reference_range`. 2: right at every range.
    reference_range : float, optional
        Slant range from the line, m; default: the middle of the record.

    Returns
    -------
    Echoes
        As many traces; tx and rx moved across the track by what their midpoint was off the line, velocity along x only.
        Spacing along x stays uneven: see `phase_centres`. `attrs` gains "displacement" (m): the largest that was compensated.

    Raises
    ------
    ValueError, TypeError
        An order other than 1 and 2, a start time that differs between pings, a non-finite sample (ping named), an argument
        outside its range.

    Notes
    -----
    A point of the seabed at slant range r from the line lies sqrt(r^2 - h^2) across it, h the line's height over the seabed;
    from a midpoint displaced by (dy, dz) it is at r + dr(r). Echoes are read 2 dr/c later and turned by exp(2j pi fc 2 dr/c):
    first order with dr at `reference_range`, second order with dr(r) (A. Moreira and Y. Huang 1994; D. Cook 2007). Raw
    samples are taken for the range of the pulse's centre. The side is that of the beam, else +y. A point seen at angle theta
    from broadside keeps a path error of about 2 |dr| (1 - cos theta). O(trace sample).
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    seabed = _checks.number("seabed", seabed)
    if order not in (1, 2):
        raise ValueError(f"order={order!r}: expected 1 or 2")
    start = one_start(echoes)
    r0 = sum(echoes.swath) / 2 if reference_range is None else _checks.number("reference_range", reference_range, positive=True)
    echoes = echoes.whole()
    finite = np.isfinite(echoes.traces).all(axis=(1, 2))
    if not finite.all():
        raise ValueError(f"echoes: non-finite sample at ping {int(np.argmin(finite))}: expected finite samples")
    centres = Centres.of(echoes)
    middle = centres.at(2 * r0 / echoes.speed)
    y0, z0 = middle[:, 1:].mean(axis=0) if line is None else _checks.reals("line", line, [(2,)])
    height = abs(seabed - z0)
    if r0 <= height:
        raise ValueError(f"reference_range={r0:g} m: expected more than the line's height over the seabed, {height:g} m")
    delay = echoes.pulse.duration / 2 if isinstance(echoes.pulse, LFM) and not echoes.compressed else 0.0
    tau = np.maximum(start - delay + np.arange(echoes.n_sample) / echoes.fs, 0.0)
    side = 1.0
    if echoes.beam is not None and echoes.beam.boresight.reshape(-1, 3)[:, 1].mean() < 0:
        side = -1.0
    # above the seabed there is nothing to be right about: the correction of the nadir is held
    r = np.maximum(echoes.speed / 2 * tau, height) if order == 2 else np.full(tau.size, r0)
    when = tau if order == 2 else np.full(tau.size, 2 * r0 / echoes.speed)
    across = y0 + side * np.sqrt(r**2 - height**2)
    traces = echoes.traces.reshape(-1, echoes.n_sample)
    data = np.empty(traces.shape, dtype=echoes.dtype)
    for i, trace in enumerate(traces):
        y, z = (centres.middle[i, axis] + centres.drift[i, axis] * when for axis in (1, 2))
        data[i] = delayed(echoes, trace, 2 / echoes.speed * (np.hypot(across - y, seabed - z) - r))
    shift = np.zeros(echoes.receivers.shape)
    shift[..., 1:] = (np.array([y0, z0]) - middle[:, 1:]).reshape(*shift.shape[:2], 2)
    # the transmitter of several channels has one place: baselines across the track end in the receivers
    tx = echoes.tx + shift.mean(axis=1)
    rx = echoes.receivers + 2 * shift - shift.mean(axis=1)[:, None]
    velocity = None
    if echoes.receiver_velocity is not None:
        velocity = echoes.receiver_velocity * np.array([1.0, 0.0, 0.0])
        rx = rx + echoes.receiver_velocity * np.array([0.0, 1.0, 1.0]) * (2 * r0 / echoes.speed)
        velocity = velocity.reshape(echoes.rx.shape)
    attrs = {**echoes.attrs, "displacement": float(np.max(np.linalg.norm(shift, axis=-1)))}
    return echoes.replace(
        data=data.reshape(echoes.data.shape), tx=tx, rx=rx.reshape(echoes.rx.shape), velocity=velocity, attrs=attrs
    )
