"""Range compression: the matched filter, optionally with a spectral window or a Wiener inverse of the pulse.

Traces are filtered by FFT in blocks of bounded memory, each zero-padded so that nothing wraps round. The filter is
scaled by its own response to the sampled pulse: an isolated echo of amplitude A on a sample instant peaks at A whatever
the window. Each trace is scaled by a power of two first, so amplitudes near the ends of the dtype's range neither
overflow nor become subnormal; the result depends neither on the blocks nor on the number of threads.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy.fft

from pysas import _checks
from pysas._checks import ComplexArray
from pysas.model.echoes import Echoes
from pysas.model.gaps import windows_of, with_windows
from pysas.model.pulse import LFM
from pysas.signal import blocks, replicas

_KEPT = 64  # transfer functions, where every ping has a pulse of its own


@_checks.usual_errors
def compress(
    raw: Echoes,
    window: str | tuple[Any, ...] | None = None,
    inverse: float | None = None,
    pulse: LFM | ComplexArray | Sequence[LFM | ComplexArray] | None = None,
    pulse_t0: npt.ArrayLike = 0.0,
    nan: str = "raise",
    out: ComplexArray | None = None,
    threads: int | None = None,
    progress: Callable[[float], object] | None = None,
) -> Echoes:
    """Range compression by the matched filter (P. Pailhas et al. 2017, Eq 11, with the pulse's sampled energy as unit).

    An echo of amplitude A at travel time tau becomes A p(t - tau) exp(-2j pi fc tau) with p(0) = 1; `t0` and the number
    of samples stay. Samples of an echo that the record cuts off are lost to its peak. Samples outside `raw.valid` count as
    zero, whatever they hold; the result has the same `valid`.

    Parameters
    ----------
    raw : Echoes
        Uncompressed echoes; their samples may lie in a mapped file.
    window : str or tuple, optional
        Spectral window against side lobes, in the words of `scipy.signal.get_window` ("hann", ("taylor", 4, 35)...),
        spread over the occupied band: of an LFM pulse its own about its centre frequency, of a measured one
        `raw.bandwidth` about `raw.fc`. Zero outside.
    inverse : float, optional
        Noise-to-signal ratio, > 0, relative to the peak of |P|^2 (P: the pulse's spectrum): the filter becomes
        conj(P) / (|P|^2 + inverse max|P|^2), which flattens the spectrum where the pulse is above the noise.
    pulse : LFM, (sample,) complex, or a sequence of as many as there are pings, optional
        What was transmitted, if it is not `raw.pulse`: an LFM or complex base-band samples at rate `raw.fs`, such as
        `demodulate` makes of a measured pulse; one for all pings, or each ping's own (up- and down-sweeps in turn).
    pulse_t0 : float or (ping,)
        Time of the first sample of measured pulses after transmission began, s; less than 0 where samples before the
        leading edge belong to it. It need not be a whole number of samples: the pulse is read as a band-limited signal.
    nan : {"raise", "mask"}
        Non-finite samples that were recorded: an error, or they count as zero and stay non-finite in the result (as NaN). At a
        trace's ends they shorten the result's `valid`; others the imaging functions' own `nan` judges.
    out : complex array, optional
        Filled and returned as the result's data: of the data's shape and dtype, in memory of its own, a mapped file for
        instance.
    threads : int, optional
        Worker threads; default PYSAS_NUM_THREADS or all processors. The result is the same for any number.
    progress : callable, optional
        Called with the fraction done after each block.

    Returns
    -------
    Echoes
        Compressed, same dtype, shape and geometry; `bandwidth` and `pulse` are those of `raw`.

    Raises
    ------
    ValueError
        Already compressed, no pulse or another number of them than of pings, a pulse longer than the record, an unusable
        window, non-finite samples (the first one's ping, channel and sample are named), an `out` of another shape or in the
        memory of `raw`.
    TypeError
        An argument of the wrong type.

    Notes
    -----
    O(traces n log n) time, and O(n log n) for each different pulse; the result and about 32 MB of work in memory.
    """
    if not isinstance(raw, Echoes):
        raise TypeError(f"raw={type(raw).__name__}: expected pysas.Echoes")
    if raw.compressed:
        raise ValueError("raw: compressed=True: expected raw echoes, these are range-compressed already")
    if inverse is not None:
        inverse = _checks.number("inverse", inverse, positive=True)
    _checks.choice("nan", nan, ("raise", "mask"))
    _checks.callback("progress", progress)
    workers = _checks.threads(threads)
    _checks.target(out, raw.data.shape, raw.dtype, whose="the data's")
    _checks.apart(out, raw.data, "raw")
    different, which = replicas.of_pings(raw, pulse, pulse_t0)
    size = max(replicas.padded_size(raw, replica, window is not None or inverse is not None) for replica in different)
    size = scipy.fft.next_fast_len(size)

    @functools.lru_cache(maxsize=_KEPT)
    def transfer(number: int) -> ComplexArray:
        return replicas.transfer(raw, different[number], size, window, inverse).astype(raw.dtype)

    transfer(0)  # errors before the work
    if out is None:
        out = np.empty(raw.data.shape, dtype=raw.dtype)
    traces, windows, target = raw.traces, raw.windows, out if out.ndim == 3 else out[:, None]
    rows = max(1, blocks.BYTES // (3 * size * raw.dtype.itemsize))
    done = shortened = 0
    if nan == "mask":
        windows = np.array(windows)
    for block in blocks.batches(traces.shape[0], traces.shape[1], rows):
        filters = np.stack([transfer(int(number)) for number in (which[block[0]] if len(different) > 1 else [0])])[:, None]
        recorded = np.asarray(traces[block])
        if raw.valid is not None:
            recorded = _recorded(recorded, windows[block])
        if nan == "mask":
            windows[block], count = windows_of(recorded, windows[block])
            shortened += count
        target[block] = _filter(recorded, filters, workers, block, nan)
        done += target[block].size
        blocks.let_go(raw.data, out)
        if progress is not None:
            progress(done / out.size)
    made = raw.replace(data=out, compressed=True)
    return with_windows(made, windows) if shortened else made


def _recorded(traces: ComplexArray, windows: npt.NDArray[np.int64]) -> ComplexArray:
    """Traces with zeros in place of what was not recorded."""
    at = np.arange(traces.shape[-1])
    return np.where((at >= windows[..., :1]) & (at <= windows[..., 1:]), traces, traces.dtype.type(0))


def _filter(traces: ComplexArray, filters: ComplexArray, workers: int, block: tuple[slice, slice], nan: str) -> ComplexArray:
    """Traces filtered by their pings' transfer functions, or all by one."""
    bad = None
    peak = _peaks(traces)
    if not np.isfinite(peak).all():
        bad = ~np.isfinite(traces)
        if nan == "raise":
            ping, channel, sample = (int(i) for i in np.argwhere(bad)[0])
            value = traces[ping, channel, sample]
            where = f"ping {ping + block[0].start}, channel {channel + block[1].start}, sample {sample}"
            raise ValueError(f"raw: {value} at {where}: expected finite samples (or nan='mask')")
        traces = np.where(bad, 0, traces)
        peak = _peaks(traces)
    kind = filters.real.dtype
    exponent = blocks.exponents(peak, kind)
    n, size = traces.shape[-1], filters.shape[-1]
    work = np.zeros((*traces.shape[:2], size), dtype=filters.dtype)  # zeros behind a trace keep the convolution linear
    np.multiply(traces, blocks.powers(kind, -exponent), out=work[..., :n])
    work = scipy.fft.fft(work, axis=-1, overwrite_x=True, workers=workers)
    work *= filters
    work = scipy.fft.ifft(work, axis=-1, overwrite_x=True, workers=workers)
    result = np.asarray(work[..., :n] * blocks.powers(kind, exponent))
    if bad is not None:
        result[bad] = complex(np.nan, np.nan)
    return result


def _peaks(traces: ComplexArray) -> npt.NDArray[Any]:
    parts = [np.abs(part).max(axis=-1, keepdims=True) for part in (traces.real, traces.imag)]
    return np.asarray(np.maximum(*parts))
