"""Pass-band samples to complex base-band: mixing, the filter that limits the band, and the rate it allows, in one pass.

Each trace is transformed, the bins about the carrier are taken, weighed by the filter's transfer function and transformed back
at the new rate: the filter is linear-phase and its delay is taken out exactly. Zero padding keeps the convolution linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.signal

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.signal import blocks

_ATTENUATION = 150.0  # dB by Kaiser's formula; found are 140 and more, and as little ripple within: 1e-7
_STOP = 2.2  # rate over the offset from fc at which the filter stops: half of rate/1.1, the default bandwidth of Echoes
_LEAST = 1.2  # rate over the kept band, at least; _LEAST/_STOP bands from fc the samples' own limits may lie
_USUAL = 1.4  # and where one of them is not given: the filter is some 70 periods of the band long
_SIMPLE = 1.25  # simpler ratios are taken up to so many times the rate that suffices
_STEPS = 10_000  # numbers that a ratio of rates may have, at most

Kind = np.dtype[Any]


@dataclass(frozen=True)
class _Filter:
    """What turns spectra of `size` padded samples at fs into spectra of `length` samples at the new rate."""

    size: int
    length: int
    source: npt.NDArray[np.intp]  # bins that are read: of real traces those from 0 to fs/2
    sign: FloatArray  # of their imaginary parts: of real traces the bins from -fs/2 to 0 are conjugates of others
    target: npt.NDArray[np.intp]
    transfer: FloatArray
    mixing: npt.NDArray[np.complex128]  # of each sample that is kept: the carrier's distance from the nearest bin


@_checks.usual_errors
def demodulate(
    samples: npt.ArrayLike,
    fs: float,
    fc: float,
    bandwidth: float | None = None,
    rate: float | None = None,
    t0: npt.ArrayLike = 0.0,
    carrier: float | None = None,
    iq: bool = False,
    out: ComplexArray | None = None,
    threads: int | None = None,
) -> tuple[ComplexArray, float]:
    """Complex base-band samples of a recording, as `Echoes` takes them with the same `fc` and `t0`, and their rate.

    A real echo A cos(2 pi fc t + phi) becomes A exp(1j phi), t being the time after transmission began: a point at travel
    time tau contributes p(t - tau) exp(-2j pi fc tau). The measured pulse goes the same way, with the time of its own first
    sample as `t0`.

    Parameters
    ----------
    samples : (sample,), (ping, sample) or (ping, channel, sample); with `iq` a last axis of 2 after these
        Real pass-band samples (integers or floats of any size, byte order and stride, mapped files included), or complex
        ones that another carrier was taken from.
    fs, fc : float
        Rate of the samples and demodulation frequency, Hz.
    bandwidth : float, optional
        Two-sided band about fc that is kept, Hz. Default: rate/1.4. One of `bandwidth` and `rate` must be given.
    rate : float, optional
        Rate of the result, Hz: at least 1.2 bandwidths, and in a ratio to fs of whole numbers up to 10000. Default: a simple
        ratio, of 1.4 to 1.75 bandwidths where fs is at least the former.
    t0 : float or (ping,)
        Time of sample 0 after transmission began, s; that of sample 0 of the result, too.
    carrier : float, optional
        Of complex samples: the frequency they were demodulated at, Hz: an analytic signal a(t) was stored as
        a(t) exp(-2j pi carrier t), t again being the time after transmission began. 0: the analytic signal itself.
    iq : bool
        The last axis of real `samples` holds I and Q of complex ones, I + jQ.
    out : complex64 or complex128 array, optional
        Filled and returned, a mapped file for instance: as many pings and channels, ceil(n rate/fs) samples a trace.
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS or all processors. The result is the same for any number.

    Returns
    -------
    samples : complex array
        Sample k is that of t0 + k/rate. complex64 for integers of up to 16 bits, float32 and complex64, else complex128.
    rate : float
        Hz.

    Raises
    ------
    ValueError
        fc or its band beyond the Nyquist rate or below 0 (of complex samples: fs/2 from `carrier`), a rate too low for the
        band or in no ratio to fs, non-finite samples (the first one is named), an `out` of another shape or in memory of the
        samples.
    TypeError
        An argument of the wrong type, complex samples without their `carrier`.

    Notes
    -----
    The filter is a linear-phase FIR of Kaiser's design (J. F. Kaiser 1974; `scipy.signal.firwin`): within 1e-7 of 1 over the
    band, below 1e-7 beyond a distance s from fc, falling from 1 to 0 between; s is rate/2.2, where the default `bandwidth` of
    `Echoes` ends, or that of 0 Hz or the Nyquist rate where these are nearer, which must be 0.545 bandwidths at least. The
    result is the filter's to 1e-7 of a trace's norm, in complex64 to 1e-6. A record counts as zero beyond its ends: samples
    less than 5/(s - bandwidth/2) seconds from an end lack what was not recorded. O(n log n) time a trace; the result and blocks
    of about 32 MB in memory.
    """
    given, form = _given(samples, carrier, iq)
    fs, fc = _checks.number("fs", fs, positive=True), _checks.number("fc", fc, positive=True)
    if bandwidth is None and rate is None:
        raise TypeError("bandwidth=None, rate=None: expected the band to keep or the rate to have, Hz")
    rate = None if rate is None else _checks.number("rate", rate, positive=True)
    kept = (rate or 0) / _USUAL if bandwidth is None else _checks.number("bandwidth", bandwidth, positive=True)
    real = given.dtype.kind != "c" and not iq
    offset = fc if real else fc - _checks.number("carrier", carrier, low=0.0)
    room = _require_band(fs, fc, offset, kept, form[-1], real)
    ratio = _sufficient(_USUAL * kept / fs) if rate is None else _ratio(fs, rate, kept)
    rate = fs * ratio.numerator / ratio.denominator if rate is None else rate
    workers = _checks.threads(threads)
    start = _start(t0, form)
    count = -(-form[-1] * ratio.numerator // ratio.denominator)
    if out is None:
        out = np.empty((*form[:-1], count), dtype=np.result_type(given.dtype, np.complex64))
    else:
        _checks.target(out, (*form[:-1], count), np.complex64, np.complex128, whose="the result's")
        _checks.apart(out, given, "samples")
    plan = _filter(form[-1], count, fs, offset, kept, room, ratio, real)
    _run(given, out, plan, real, iq, np.exp(-2j * np.pi * _turns(offset, start)), workers)
    return out, rate


def _given(samples: npt.ArrayLike, carrier: float | None, iq: bool) -> tuple[npt.NDArray[Any], tuple[int, ...]]:
    """The samples as an array, not copied, and their shape without an axis of I and Q."""
    given = _checks.array_like("samples", samples)
    if not isinstance(iq, bool | np.bool_):
        raise TypeError(f"iq={iq!r}: expected True or False")
    if given.dtype.kind not in ("iuf" if iq else "iufc") or np.result_type(given.dtype, np.complex64).itemsize > 16:
        expected = "real samples" if iq else "real or complex samples"
        raise TypeError(f"samples: expected {expected} of up to 64 bits, found dtype {given.dtype}")
    if iq and given.shape[-1:] != (2,):
        raise ValueError(f"samples: expected a last axis of 2, I and Q, found shape {given.shape}")
    form = given.shape[:-1] if iq else given.shape
    if not 1 <= len(form) <= 3 or given.size == 0:
        raise ValueError(f"samples: expected (sample,), (ping, sample) or (ping, channel, sample), found shape {form}")
    if (iq or given.dtype.kind == "c") == (carrier is None):
        expected = "expected None for real samples" if carrier is not None else "expected that of the complex samples, Hz"
        raise TypeError(f"carrier={carrier!r}: {expected}")
    return given, form


def _ratio(fs: float, rate: float, kept: float) -> Fraction:
    """Rate over fs in whole numbers."""
    ratio = Fraction(rate / fs).limit_denominator(_STEPS)
    if ratio.numerator > _STEPS or abs(float(ratio) - rate / fs) > 1e-12 * rate / fs:
        near = fs * float(min(max(ratio, Fraction(1, _STEPS)), Fraction(_STEPS)))
        raise ValueError(f"rate={rate:.12g} Hz: expected a ratio of whole numbers to fs {fs:g} Hz, such as {near:.12g} Hz")
    if rate < _LEAST * kept * (1 - 1e-12):
        raise ValueError(f"rate={rate:g} Hz: expected at least {_LEAST} x the band of {kept:g} Hz, {_LEAST * kept:g} Hz")
    return ratio


def _sufficient(least: float) -> Fraction:
    """A ratio of small whole numbers that is no less than `least` and not much more."""
    ratios = [Fraction(up, int(up / least)) if up >= least else Fraction(int(np.ceil(least))) for up in range(1, 9)]
    return next((ratio for ratio in ratios if ratio <= _SIMPLE * least), min(ratios))


def _require_band(fs: float, fc: float, offset: float, kept: float, n: int, real: bool) -> float:
    """Distance from fc to what the samples can hold, Hz: the band must fit into it, and n of them must tell it."""
    bottom = 0.0 if real else -fs / 2
    held = f"0 to {fs / 2:g} Hz" if real else f"{fc - offset - fs / 2:g} to {fc - offset + fs / 2:g} Hz"
    held += f", what {'real' if real else 'complex'} samples at fs {fs:g} Hz hold"
    if not bottom < offset < fs / 2:
        raise ValueError(f"fc={fc:g} Hz: expected a frequency in {held}")
    room = min(offset - bottom, fs / 2 - offset)
    flank = _LEAST / _STOP * kept
    if room < flank * (1 - 1e-12):
        band = f"{fc - kept / 2:g} to {fc + kept / 2:g} Hz are kept, and the filter's flanks reach {flank:g} Hz from fc"
        raise ValueError(f"bandwidth={kept:g} Hz: {band}: expected them in {held}")
    if kept * n < fs:
        raise ValueError(f"bandwidth={kept:g} Hz: expected more than a record of {n} samples resolves, {fs / n:g} Hz")
    return room


def _start(t0: npt.ArrayLike, form: tuple[int, ...]) -> FloatArray:
    """Time of sample 0 of every ping, s: one where they all have the same."""
    if _checks.array_like("t0", t0).ndim == 0:
        return np.full(1, _checks.number("t0", t0))
    if len(form) == 1:
        raise ValueError("t0: expected one number for (sample,) samples")
    return _checks.reals("t0", t0, [(form[0],)], ("ping",))


def _turns(frequency: float, t: FloatArray) -> FloatArray:
    """Turns of a carrier at times `t`, less whole ones."""
    return np.asarray(np.longdouble(frequency) * t.astype(np.longdouble) % 1, dtype=np.float64)


def _filter(n: int, count: int, fs: float, offset: float, kept: float, room: float, ratio: Fraction, real: bool) -> _Filter:
    """The filter for traces of n samples of which `count` come out, and the transforms that it needs."""
    rate = fs * float(ratio)
    stop = min(rate / _STOP, room)  # beyond lie the images of a sampled signal
    taps, beta = scipy.signal.kaiserord(_ATTENUATION, (stop - kept / 2) / (fs / 2))
    half = int(taps) // 2 + 1
    impulse = scipy.signal.firwin(2 * half + 1, (stop + kept / 2) / 2, window=("kaiser", beta), fs=fs)
    # the impulse response reaches `half` samples to either side: what it puts beyond a trace must not come in at the other end
    steps = scipy.fft.next_fast_len(-(-max(n + half, impulse.size) // ratio.denominator))
    size, length = steps * ratio.denominator, steps * ratio.numerator
    middle = int(np.rint(offset * size / fs))
    beside = offset - middle * fs / size  # what mixing by whole bins leaves, Hz
    padded = np.zeros(size, dtype=np.complex128)
    padded[: impulse.size] = impulse * np.exp(2j * np.pi * beside / fs * np.arange(-half, half + 1))
    transfer = scipy.fft.fft(np.roll(padded, -half)).real  # of a symmetric response, at frequencies about bin `middle`
    bins = np.arange(min(size, length)) - min(size, length) // 2
    source = (bins + middle) % size
    mirrored = real & (source > size // 2)
    return _Filter(
        size,
        length,
        np.where(mirrored, size - source, source),
        np.where(mirrored, -1.0, 1.0),
        bins % length,
        transfer[bins % size] * ((2 if real else 1) * length / size),
        np.exp(-2j * np.pi * beside / rate * np.arange(count)),
    )


def _run(
    given: npt.NDArray[Any],
    out: ComplexArray,
    plan: _Filter,
    real: bool,
    iq: bool,
    phases: npt.NDArray[np.complex128],
    workers: int,
) -> None:
    """Fill `out` block by block."""
    kind: Kind = np.result_type(given.dtype, out.dtype)  # complex, native
    part_kind: Kind = np.dtype(np.float32 if kind.itemsize == 8 else np.float64)
    lone = (1,) * (3 - out.ndim)  # a trace alone is a channel of a ping; traces of pings are one channel each
    view = given.reshape(lone + given.shape) if out.ndim != 2 else given[:, None]
    target = out.reshape(lone + out.shape) if out.ndim != 2 else out[:, None]
    rows = max(1, blocks.BYTES // (3 * max(plan.size * (1 if real else 2), 2 * plan.length) * kind.itemsize // 2))
    transfer, sign, mixing = plan.transfer.astype(part_kind), plan.sign.astype(part_kind), plan.mixing
    for block in blocks.batches(target.shape[0], target.shape[1], rows):
        work, scale = _padded(np.asarray(view[block]), plan.size, part_kind if real else kind, iq, block)
        if real:
            spectrum = scipy.fft.rfft(work, axis=-1, overwrite_x=True, workers=workers)
        else:
            spectrum = scipy.fft.fft(work, axis=-1, overwrite_x=True, workers=workers)
        taken = np.zeros((*work.shape[:2], plan.length), dtype=kind)
        chosen = spectrum[..., plan.source]
        chosen.imag *= sign
        taken[..., plan.target] = chosen * transfer
        trace = scipy.fft.ifft(taken, axis=-1, overwrite_x=True, workers=workers)[..., : mixing.size]
        phase = phases[block[0]] if phases.size > 1 else phases
        trace *= (phase[:, None] * mixing)[:, None].astype(kind)
        target[block] = trace if scale is None else trace * scale
        blocks.let_go(given, out)


def _padded(
    part: npt.NDArray[Any], size: int, kind: Kind, iq: bool, block: tuple[slice, slice]
) -> tuple[npt.NDArray[Any], npt.NDArray[Any] | None]:
    """A block's traces padded to `size` by zeros: integers as they are, floats near 1 and beside them what was divided by."""
    work = np.zeros((*part.shape[:2], size), dtype=kind)
    real = np.empty(0, kind).real.dtype
    scale: npt.NDArray[Any] | None = None
    factor: Any = real.type(1)
    if part.dtype.kind not in "iu":
        peaks = np.maximum(np.abs(part.real), np.abs(part.imag)).max(axis=(-2, -1) if iq else -1)
        if not np.isfinite(peaks).all():
            index = tuple(int(i) for i in np.argwhere(~np.isfinite(part))[0])
            where = f"ping {index[0] + block[0].start}, channel {index[1] + block[1].start}, sample {index[2]}"
            raise ValueError(f"samples: {part[index]} at {where}: expected finite samples")
        exponent = blocks.exponents(peaks, real)[..., None]
        scale, factor = blocks.powers(real, exponent), blocks.powers(real, -exponent)
    place = work[..., : part.shape[2]]
    if iq:
        np.multiply(part[..., 0], factor, out=place.real, casting="same_kind")
        np.multiply(part[..., 1], factor, out=place.imag, casting="same_kind")
    else:
        np.multiply(part, factor, out=place, casting="same_kind")
    return work, scale
