"""Range compression: the matched filter, optionally with a spectral window or a Wiener inverse of the pulse.

Traces are filtered by FFT in batches of bounded memory, each zero-padded so that nothing wraps round. The filter is
scaled by its own response to the sampled pulse: an isolated echo of amplitude A on a sample instant peaks at A whatever
the window. Each trace is scaled by a power of two first, so amplitudes near the ends of the dtype's range neither
overflow nor become subnormal; the result depends neither on the batches nor on the number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.signal

from pysas import _checks
from pysas._checks import ComplexArray, FloatArray
from pysas.model.echoes import Echoes
from pysas.model.pulse import LFM

_BATCH_BYTES = 32 * 2**20
_SIGNIFICANT = 1e-3  # of the peak: a pulse's length is the span where its samples exceed this
_WINDOW_POINTS = 8193  # linear interpolation between so many points of a window is good to 1e-7

Complex = npt.NDArray[np.complex128]


@_checks.usual_errors
def compress(
    raw: Echoes,
    window: str | tuple[Any, ...] | None = None,
    inverse: float | None = None,
    threads: int | None = None,
    progress: Callable[[float], object] | None = None,
) -> Echoes:
    """Range compression by the matched filter (P. Pailhas et al. 2017, Eq 11, with the pulse's sampled energy as unit).

    An echo of amplitude A at travel time tau becomes A p(t - tau) exp(-2j pi fc tau) with p(0) = 1; `t0` and the number
    of samples stay. Samples of an echo that the record cuts off are lost to its peak.

    Parameters
    ----------
    raw : Echoes
        Uncompressed echoes with their `pulse`.
    window : str or tuple, optional
        Spectral window against side lobes, in the words of `scipy.signal.get_window` ("hann", ("taylor", 4, 35)...),
        spread over the occupied band: of an LFM pulse its own about its centre frequency, of a sampled waveform
        `raw.bandwidth` about `raw.fc`. Zero outside.
    inverse : float, optional
        Noise-to-signal ratio, > 0, relative to the peak of |P|^2 (P: the pulse's spectrum): the filter becomes
        conj(P) / (|P|^2 + inverse max|P|^2), which flattens the spectrum where the pulse is above the noise.
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS or all processors. The result is the same for any number.
    progress : callable, optional
        Called with the fraction done after each batch.

    Returns
    -------
    Echoes
        Compressed, same dtype, shape and geometry; `bandwidth` is that of `raw`.

    Raises
    ------
    ValueError
        Already compressed, no pulse, a pulse longer than the record, an unusable window, non-finite samples (the first
        one's ping, channel and sample are named).
    TypeError
        An argument of the wrong type.

    Notes
    -----
    O(traces n log n) time; the result and about 32 MB of work in memory.
    """
    if not isinstance(raw, Echoes):
        raise TypeError(f"raw={type(raw).__name__}: expected pysas.Echoes")
    if raw.compressed:
        raise ValueError("raw: compressed=True: expected raw echoes, these are range-compressed already")
    if raw.pulse is None:
        raise ValueError("raw: pulse=None: expected an LFM or a sampled waveform to compress with")
    if inverse is not None:
        inverse = _checks.number("inverse", inverse, positive=True)
    _checks.callback("progress", progress)
    workers = _checks.threads(threads)
    transfer = _transfer(raw, window, inverse).astype(raw.dtype)
    traces = raw.traces
    out = np.empty(traces.shape, dtype=raw.dtype)
    rows = max(1, _BATCH_BYTES // (3 * transfer.size * raw.dtype.itemsize))
    done = 0
    for batch in _batches(traces.shape[0], traces.shape[1], rows):
        out[batch] = _filter(traces[batch], transfer, workers, batch)
        done += out[batch].size
        if progress is not None:
            progress(done / out.size)
    return raw.replace(data=out.reshape(raw.data.shape), compressed=True)


def _filter(traces: ComplexArray, transfer: ComplexArray, workers: int, batch: tuple[slice, slice]) -> ComplexArray:
    """Filtered traces; the zero padding up to the length of `transfer` keeps the convolution linear."""
    peak = np.maximum(np.abs(traces.real).max(axis=-1, keepdims=True), np.abs(traces.imag).max(axis=-1, keepdims=True))
    if not np.isfinite(peak).all():
        ping, channel, sample = (int(i) for i in np.argwhere(~np.isfinite(traces))[0])
        value = traces[ping, channel, sample]
        where = f"ping {ping + batch[0].start}, channel {channel + batch[1].start}, sample {sample}"
        raise ValueError(f"raw: {value} at {where}: expected finite samples")
    kind = transfer.real.dtype
    limit = np.finfo(kind).maxexp - 2  # 2^limit and 2^-limit are both normal numbers
    exponent = np.clip(np.frexp(peak)[1], -limit, limit)
    n = traces.shape[-1]
    work = np.zeros((*traces.shape[:2], transfer.size), dtype=transfer.dtype)
    np.multiply(traces, np.ldexp(kind.type(1), -exponent), out=work[..., :n])
    work = scipy.fft.fft(work, axis=-1, overwrite_x=True, workers=workers)
    work *= transfer
    work = scipy.fft.ifft(work, axis=-1, overwrite_x=True, workers=workers)
    return np.asarray(work[..., :n] * np.ldexp(kind.type(1), exponent))


def _batches(pings: int, channels: int, rows: int) -> Iterator[tuple[slice, slice]]:
    """Blocks of whole pings, or parts of one ping where its channels alone exceed `rows`."""
    step_ping, step_channel = max(1, rows // channels), min(rows, channels)
    for ping in range(0, pings, step_ping):
        for channel in range(0, channels, step_channel):
            yield slice(ping, min(ping + step_ping, pings)), slice(channel, min(channel + step_channel, channels))


def _transfer(raw: Echoes, window: str | tuple[Any, ...] | None, inverse: float | None) -> Complex:
    """The filter's transfer function on the padded FFT grid, scaled to unit response at the peak.

    Padding: the pulse's samples lie at instants first ... first + size - 1, so a plain matched filter needs n more
    than those that reach past either end of the record. A window or inverse has no finite impulse response; padding by
    another n makes all lags from -(n - 1) to n - 1 distinct, so the circular convolution is again a linear one.
    """
    waveform, first = _sampled(raw)
    n = raw.n_sample
    significant = np.flatnonzero(np.abs(waveform) > _SIGNIFICANT * np.abs(waveform).max(initial=0.0))
    if significant.size == 0:
        raise ValueError(f"raw: pulse {raw.pulse!r}: expected at least one non-zero sample at fs {raw.fs:g} Hz")
    length = int(significant[-1] - significant[0]) + 1
    if length > n:
        raise ValueError(
            f"raw: pulse of {length} samples ({length / raw.fs:g} s): expected no longer than the record of "
            f"{n} samples ({n / raw.fs:g} s)"
        )
    size = n + max(first + waveform.size, -first) + (0 if window is None and inverse is None else n)
    size = scipy.fft.next_fast_len(max(size, waveform.size))
    padded = np.zeros(size, dtype=np.complex128)
    padded[: waveform.size] = waveform / np.abs(waveform).max()
    spectrum = scipy.fft.fft(np.roll(padded, first))
    transfer = np.conj(spectrum)
    power = np.abs(spectrum) ** 2
    if inverse is not None:
        transfer /= power + inverse * power.max()
    if window is not None:
        transfer *= _spectral_window(raw, window, scipy.fft.fftfreq(size, 1 / raw.fs))
    gain = float(np.mean(spectrum * transfer).real)
    if not np.isfinite(gain) or gain <= 0:
        raise ValueError(f"window={window!r}: leaves nothing of the pulse: expected weight in the occupied band")
    return np.asarray(transfer / (gain * np.abs(waveform).max()))


def _sampled(raw: Echoes) -> tuple[Complex, int]:
    """The pulse's samples at rate fs and the index of the first (negative where a Gaussian begins before t = 0)."""
    if not isinstance(raw.pulse, LFM):
        return np.asarray(raw.pulse, dtype=np.complex128), 0
    start, stop = raw.pulse.support
    first, last = int(np.ceil(start * raw.fs)), int(np.floor(stop * raw.fs))
    return raw.pulse.waveform(np.arange(first, last + 1) / raw.fs, raw.fc), first


def _spectral_window(raw: Echoes, window: str | tuple[Any, ...], frequency: FloatArray) -> FloatArray:
    expected = "expected a scipy.signal.get_window specification such as 'hann' or ('taylor', 4, 35)"
    if not isinstance(window, str | tuple):
        raise TypeError(f"window={window!r}: {expected}")
    try:
        shape = np.asarray(scipy.signal.get_window(window, _WINDOW_POINTS, fftbins=False), dtype=np.float64)
    except Exception as error:  # SciPy's own, whatever a tuple holds
        raise ValueError(f"window={window!r}: {expected} ({error})") from None
    centre, width = 0.0, raw.occupied_bandwidth
    if isinstance(raw.pulse, LFM):
        centre, width = raw.pulse.fc - raw.fc, raw.pulse.occupied_bandwidth
    grid = centre + width * np.linspace(-0.5, 0.5, _WINDOW_POINTS)
    return np.interp(frequency, grid, shape, left=0.0, right=0.0)
