"""What two pings say of each other: from correlations at several lags to delays, how sure they are, and surge."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from pysas._checks import ComplexArray, FloatArray
from pysas.model.echoes import Echoes
from pysas.motion.phase_centres import MOST_BESIDE, MOST_PAIRS, Rows, Side
from pysas.motion.surging import mean_square_sine, peak, surges

FIRST_REACH, REACH = 6, 3  # lags read on either side, samples: an arrival is looked for within FIRST_REACH/2, then within 1
_FINER = 8  # lags looked at per sample
LEAST = 0.3  # coherence of a window that counts, and of most pings
_FLOOR = 2e-3  # rad: phases are never better known
_TRIED, _DISTINCT = 16, 1.5  # pings between all of whose channels is looked; how much stronger a missed separation must be
_BESIDE = 0.2  # steps of the phase centres by which separations that count may lie farther from 0 than the nearest
_SEEN = 6.0  # standard deviations above noise's coherence at which two pings have seen the same


@dataclass(eq=False)
class Measured:
    """What each two consecutive pings say: rows of slant displacement (pair, slot, window), and of surge (pair,)."""

    value: FloatArray
    sigma: FloatArray  # 0: does not count
    looks: FloatArray
    apart: FloatArray
    arms: FloatArray
    surge: FloatArray
    surge_sigma: FloatArray
    ahead: FloatArray
    base: npt.NDArray[np.int64]  # (pair,) a slot of the nearest separation
    pairs: npt.NDArray[np.int64]  # (pair,) of channels that count
    coherence: FloatArray
    seen: npt.NDArray[np.bool_]
    slip: npt.NDArray[np.bool_]

    def rows(self) -> tuple[FloatArray, ...]:
        """Of slant displacement, as `correlating.gather` takes them."""
        return self.value, self.sigma, self.looks, self.apart, self.arms

    def surge_rows(self) -> tuple[FloatArray, ...]:
        """Surge as rows like the others: along the forward direction, between the phase centres of a nearest pair."""
        every = np.arange(len(self.base))
        apart, arms = self.apart[every, self.base][:, None], self.arms[every, self.base][:, None]
        return self.surge[:, None, None], self.surge_sigma[:, None, None], self.ahead[:, None], apart, arms


def measure(side: Side, size: float, first: bool, lags: int, tol: float, threads: int | None) -> Measured:
    """Rows of all pings of one side."""
    parts = []
    reach = FIRST_REACH if first else REACH
    slots = MOST_PAIRS + 2 * lags * MOST_BESIDE
    for low, high in side.batches(min(slots, (2 * lags + 1) * side.echoes.n_channel)):
        parts.append(_reduced(side, side.measure(low, high, size, reach, lags, tol, threads), reach, first))
    return Measured(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Measured)))


@dataclass(frozen=True)
class Sought:
    """Of a few pings, between all channels: the separation of phase centres (m) that coincide where the claimed advance brings
    others together, else 0; the largest mean square of coherence, and what it typically is at separations far from there."""

    missed: float
    strength: float
    typical: float

    @property
    def distinct(self) -> bool:
        """Whether pings saw the same from the same place: bright points alone correlate a little whatever the separation."""
        return self.strength > LEAST or self.strength > 2 * self.typical


def seek(side: Side, size: float, tol: float, threads: int | None) -> Sought:
    """Look for the separation at which pings have most in common."""
    tried = np.unique(np.linspace(0, side.echoes.n_ping - 2, _TRIED).astype(int))
    numbers = np.arange(1 - side.echoes.n_channel, side.echoes.n_channel)
    strength, place, count = np.zeros(len(numbers)), np.zeros(len(numbers)), np.zeros(len(numbers))
    fine, filters = _lags(True, FIRST_REACH, side.echoes)
    for ping in tried:
        rows = side.measure(ping, ping + 1, size, FIRST_REACH, side.echoes.n_channel - 1, tol, threads)
        for k, number in enumerate(numbers):
            of = rows.used[0] & (rows.order == number)
            if of.any():
                strength[k] += np.max(np.mean(np.abs(rows.products[0, of] @ filters) ** 2, axis=(0, 1)))
                place[k] += np.mean(rows.separation[0, of])
                count[k] += 1
    strength /= np.maximum(count, 1)
    often = 2 * count > len(tried)
    best = int(np.argmax(np.where(often, strength, 0)))
    far = often & (np.abs(numbers - numbers[best]) > 2)
    typical = float(np.median(strength[far])) if np.sum(far) > 2 else LEAST / 2
    near = float(np.max(strength[np.abs(numbers) <= 1]))
    there = abs(numbers[best]) > 1 and strength[best] > max(_DISTINCT * near, LEAST**2)
    return Sought(float(place[best] / count[best]) if there else 0.0, float(strength[best]), typical)


def _lags(first: bool, reach: int, echoes: Echoes) -> tuple[FloatArray, ComplexArray]:
    """Lags that are looked at, samples, and the filters to them."""
    most = reach / 2 if first else 1.0
    fine = np.arange(-round(most * _FINER), round(most * _FINER) + 1) / _FINER
    return fine, _interpolator(fine, reach, echoes.fs / echoes.fc)


def _reduced(side: Side, rows: Rows, reach: int, first: bool) -> Measured:
    """Delays, their standard deviations and surge from correlations at several lags."""
    echoes, base = side.echoes, rows.order == 0
    cycle = echoes.fs / echoes.fc  # samples of the carrier's period
    fine, filters = _lags(first, reach, echoes)
    height = np.zeros((len(rows.used), fine.size))
    for slot in np.flatnonzero(base):
        height += np.sum(np.abs(rows.products[:, slot] @ filters) ** 2 * rows.count[:, slot, :, None], axis=1)
    envelope = peak(height, fine)
    centred = rows.products[..., reach]
    # how well the envelope's peak is known, of all windows together, samples
    number = np.sum(rows.count[:, base], axis=(1, 2))
    mean = np.sum(np.abs(centred[:, base]) ** 2 * rows.count[:, base], axis=(1, 2)) / np.maximum(number, 1)
    phase_error = np.sqrt(np.clip(1 - mean, 1e-4, None) / (2 * np.maximum(number * mean, 1e-3)))
    envelope_error = phase_error * np.sqrt(12) / (2 * np.pi * echoes.occupied_bandwidth) * echoes.fs
    slip = np.abs(envelope) > np.maximum(0.6 * cycle, 4 * envelope_error)
    lag = np.where(first | slip, envelope, 0.0)
    product = np.einsum("pswm,mp->psw", rows.products, _interpolator(lag, reach, cycle))
    squared = np.minimum(np.abs(product) ** 2, 1.0)
    number = rows.count
    squared = np.where(number > 0, squared - (1 - squared) / np.maximum(number, 1), 0.0)
    wavelength = rows.speed[:, None] / echoes.fc
    # phases lie about that of all together: beside half a turn some windows would come to either end of it
    common = np.angle(np.sum(product[:, base] * rows.count[:, base], axis=(1, 2)))[:, None, None]
    phase = common + np.angle(product * np.exp(-1j * common))
    delay = lag[:, None, None] / echoes.fs - phase / (2 * np.pi * echoes.fc)
    # points beside boresight at the same range see less of a separation along it: the mean over the beam's power
    level = rows.looks[..., :2]
    short = mean_square_sine(side.elements, wavelength) / 2 / np.sum(level**2, axis=2).clip(1e-3)
    value = -rows.speed[:, None, None] / 2 * delay + short[:, None] * np.einsum("pwx,psx->psw", level, rows.apart[..., :2])
    # separations farther from 0 than the nearest are false where a bright point draws the beam's middle off boresight
    off = np.where(rows.used, np.abs(rows.separation), np.inf)
    near = off <= off.min(axis=1, keepdims=True) + _BESIDE * side.step
    good = (squared > LEAST**2) & near[..., None]
    noise = np.sqrt(np.clip(1 - squared, 0, None) / (2 * np.maximum(number * squared, 1e-9)) + _FLOOR**2)
    sigma = np.where(good, noise * wavelength[..., None] / (4 * np.pi), 0.0)
    whole = np.sum(number, axis=2)
    strength = np.sum(squared * number, axis=2) / np.maximum(whole, 1)
    share = np.sum(np.where(base, strength, 0), axis=1) / np.maximum(np.sum(base & (whole > 0), axis=1), 1)
    tests = np.sum((number > 0) & base[:, None], axis=(1, 2))
    floor = np.sum((number > 0) / np.maximum(number, 1) * base[:, None], axis=(1, 2)) / np.maximum(tests, 1)
    seen = (share > _SEEN * floor / np.sqrt(np.maximum(tests, 1))) & (np.sum(good & base[:, None], axis=(1, 2)) >= 2)
    sigma[~seen] = 0
    surge, surge_sigma = surges(rows.separation, strength, rows.used & (whole > 0), side.elements, side.step)
    return Measured(
        value, sigma, rows.looks, rows.apart, rows.arms, surge, np.where(seen, surge_sigma, 0.0), rows.ahead,
        np.argmax(rows.used & base, axis=1), np.sum(np.any(sigma > 0, axis=2), axis=1), np.sqrt(np.clip(share, 0, 1)), seen,
        slip & seen,
    )  # fmt: skip


def _interpolator(at: FloatArray, reach: int, cycle: float) -> ComplexArray:
    """(2 reach + 1, at) weights of lags -reach ... reach at fractional ones: a sinc under a Kaiser window, for what each lag's
    carrier, of a period of `cycle` samples, is first taken from, and then given again: between samples it aliases."""
    from_ = np.arange(-reach, reach + 1)[:, None]
    away = at[None, :] - from_
    inside = np.clip(1 - (away / (reach + 1)) ** 2, 0, None)
    return np.asarray(np.sinc(away) * np.i0(4.0 * np.sqrt(inside)) / np.i0(4.0) * np.exp(2j * np.pi * away / cycle))
