"""How an image's focus changes with the place of each ping: cost and gradient by the plain sum, for a few thousand pixels."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.reference.reading import Complex, delays, finer, read


def focus_gradient(
    echoes: Echoes, pixels: npt.ArrayLike, metric: str = "entropy", displacement: npt.ArrayLike | None = None
) -> tuple[float, FloatArray]:
    """Cost of an image and its gradient with respect to the displacement of every ping.

    Parameters
    ----------
    echoes : Echoes
        Compressed; its beam is not looked at: every ping counts at every pixel.
    pixels : (pixel, 3) array_like
        In m: one patch, normalised by itself.
    metric : "entropy" or "sharpness"
        -sum q ln q with q = |I|^2/sum |I|^2, or -ln(sum |I|^4/(sum |I|^2)^2): lower is sharper in both.
    displacement : (ping, 3) array_like, optional
        delta, m: what each ping's phase centres are taken to be off where the echoes have them. Default: 0.

    Returns
    -------
    cost : float
    gradient : (ping, 3) float64
        1/m.

    Raises
    ------
    ValueError, TypeError
        Raw or non-finite echoes, pings of different sound speeds, another metric, an argument of the wrong shape, an image of
        zeros.

    Notes
    -----
    I(x) = sum_p X_p(x) exp(-j k2 u_p(x).delta_p): X_p is what all channels of ping p contribute, sum s(tau)
    exp(2j pi fc tau), k2 = 4 pi fc/c, u_p the unit vector to x from the mean of the ping's phase centres at transmission. With
    F' = dF/d|I|^2, which is -(ln q + H)/sum |I|^2 for the entropy H and -2 |I|^2/sum |I|^4 + 2/sum |I|^2 for sharpness,
    dF/ddelta_p = sum_x 2 Re[-j k2 u_p F' conj(I) X_p exp(-j k2 u_p.delta_p)]. The envelope's own shift, of the order of
    bandwidth/fc of the phase's, is left out: it is what reading X_p anew is for. O(ping channel pixel) time, ping pixel memory.
    Minimum-entropy autofocus: T. J. Kragh 2006; sharpness: J. R. Fienup and J. J. Miller 2003.
    """
    if not isinstance(echoes, Echoes):
        raise TypeError(f"echoes={type(echoes).__name__}: expected pysas.Echoes")
    if not echoes.compressed:
        raise ValueError("echoes: compressed=False: expected range-compressed echoes (pysas.compress)")
    echoes = echoes.whole()
    finite = np.isfinite(echoes.traces).all(axis=(1, 2))
    if not finite.all():
        raise ValueError(f"echoes: non-finite sample at ping {int(np.argmin(finite))}: expected finite samples")
    points = _checks.reals("pixels", pixels, [("pixel", 3)], ("pixel",))
    _checks.choice("metric", metric, ("entropy", "sharpness"))
    delta = np.zeros((echoes.n_ping, 3))
    if displacement is not None:
        delta = _checks.reals("displacement", displacement, [(echoes.n_ping, 3)], ("ping",))
    k2 = 4 * np.pi * echoes.fc / echoes.speed
    centres = (echoes.tx + echoes.receivers.mean(axis=1)) / 2
    look = points - centres[:, None]
    look /= np.linalg.norm(look, axis=-1, keepdims=True)
    terms = _contributions(echoes, points) * np.exp(-1j * k2 * np.einsum("pxi,pi->px", look, delta))
    image = terms.sum(axis=0)
    power = np.abs(image) ** 2
    total = power.sum()
    if not total > 0:
        raise ValueError("pixels: the echoes are zero at all of them: expected pixels within the record")
    if metric == "entropy":
        q = power / total
        logarithm = np.log(np.where(q > 0, q, 1))
        cost = -np.sum(q * logarithm)
        slope = -(logarithm + cost) / total
    else:
        fourth = np.sum(power**2)
        cost = -np.log(fourth / total**2)
        slope = 2 / total - 2 * power / fourth
    turned = 2 * np.real(-1j * k2 * slope * image.conj() * terms)
    return float(cost), np.einsum("px,pxi->pi", turned, look)


def _contributions(echoes: Echoes, points: FloatArray) -> Complex:
    """(ping, pixel) sums of each ping's channels."""
    found = np.zeros((echoes.n_ping, len(points)), dtype=np.complex128)
    velocity = echoes.receiver_velocity
    for ping in range(echoes.n_ping):
        for channel in range(echoes.n_channel):
            speed = np.zeros(3) if velocity is None else velocity[ping, channel]
            tau = delays(points, echoes.tx[ping], echoes.receivers[ping, channel], speed, echoes.speed)
            place = (tau - echoes.start_time[ping]) * echoes.fs
            trace = read(finer(echoes.traces[ping, channel]), place) * np.exp(2j * np.pi * echoes.fc * tau)
            found[ping] += np.where((place >= 0) & (place <= echoes.n_sample - 1), trace, 0)
    return found
