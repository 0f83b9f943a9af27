"""Samples as a signal: on which carrier, in which band, and which way the pulse sweeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.fft
import scipy.ndimage

from pysas._checks import ComplexArray, FloatArray
from pysas.inspection.finding import Finding
from pysas.inspection.levels import Levels
from pysas.inspection.sample import Sample
from pysas.model.pulse import LFM

_REAL = 0.9  # of sum x^2 / sum |x|^2, which is 1 where samples are real
_BINS = 32  # of a band, where densities are compared
_APART = 1.08  # a band elsewhere holds so many times the energy of the declared one
_ELSEWHERE = 3.0  # so much that nothing is right
_LINE = 4.0  # times the median beside it
_BEYOND = 0.05  # share of energy that compressed data may have beyond their band
_SWEPT = 5.0  # standard errors
_CLEAR = 0.3  # log of a ratio of kurtosis


def carrier(sample: Sample, levels: Levels) -> Finding:
    """Real samples cast to complex: half of their energy lies at -fc, and no phase is right."""
    traces = sample.traces
    sounding = levels.sounding
    if sounding.any() and levels.real[sounding].all():
        text = "imaginary parts are all zero: real pass-band samples cast to complex"
        return Finding("base-band", "FAIL", text + ": mix down with fc and low-pass (pysas.demodulate), do not cast")
    if sample.echoes.compressed and sample.transfer is not None and sample.band[0] == 0:
        # the phases that compression took away come back: what was real is real again
        phase = sample.transfer / np.maximum(np.abs(sample.transfer), 1e-300)
        traces = sample.back(sample.spectra * phase.astype(sample.traces.dtype))
    elif sample.echoes.compressed:
        return Finding("base-band", "ok", "compressed with a pulse that is not given: imaginary parts there")
    energy = float(np.sum(np.abs(traces) ** 2))
    ratio = complex(np.sum(traces**2)) / energy if energy > 0 else 0j
    share = float(np.sum(traces.imag**2)) / energy if energy > 0 else 0.0
    if ratio.real > _REAL:
        text = f"{100 * share:.2g} % of the energy in imaginary parts: real pass-band samples cast to complex"
        return Finding("base-band", "FAIL", text + ": mix down with fc and low-pass (pysas.demodulate), do not cast")
    if abs(ratio) > _REAL:
        text = f"I and Q are proportional (circularity {abs(ratio):.2g}): one of them was stored twice, or lost"
        return Finding("base-band", "FAIL", text + ": demodulate the recorded samples again")
    return Finding("base-band", "ok", f"{100 * share:.3g} % of the energy in imaginary parts")


@dataclass(frozen=True)
class Density:
    """Power a hertz at base-band frequencies, smoothed over a share of the declared band."""

    frequency: FloatArray
    power: FloatArray  # sums to 1
    width: int  # bins of the declared band
    middle: float
    band: float

    def inside(self) -> npt.NDArray[np.bool_]:
        """Bins of the declared band."""
        span = float(self.frequency[1] - self.frequency[0]) * self.frequency.size
        off = (self.frequency - self.middle + span / 2) % span - span / 2
        return np.asarray(np.abs(off) <= self.band / 2)


def density(sample: Sample) -> Density:
    """Of the sampled traces, each counted alike; O(samples log samples)."""
    spectra = np.abs(sample.spectra) ** 2
    total = spectra.sum(axis=-1, keepdims=True)
    power = np.mean(np.divide(spectra, total, out=np.zeros_like(spectra), where=total > 0), axis=(0, 1), dtype=np.float64)
    middle, band = sample.band
    width = max(1, round(band / sample.echoes.fs * power.size))
    frequency = np.asarray(scipy.fft.fftfreq(power.size, 1 / sample.echoes.fs), dtype=np.float64)
    return Density(frequency, np.asarray(power), width, middle, band)


def declared(sample: Sample) -> Finding:
    """Where the energy lies against the band about fc that the echoes declare."""
    echoes, found = sample.echoes, density(sample)
    inside = found.inside()
    share = float(found.power[inside].sum())
    text = f"{100 * share:.3g} % of the energy within {found.middle:+.4g} +- {found.band / 2:.4g} Hz of fc"
    if found.width >= 0.9 * found.power.size or not found.power.any():
        return Finding("band", "ok", text)
    # without lines: they are no band
    beside = max(3, found.width // 4) | 1
    usual = scipy.ndimage.median_filter(found.power, size=beside, mode="wrap")
    even = np.minimum(found.power, _LINE * usual)
    # sliding over the circle of frequencies
    total = np.cumsum(np.r_[0.0, even, even[: found.width]])
    sliding = total[found.width :] - total[: -found.width]
    at = int(np.argmax(sliding))
    there = float(found.frequency[(at + found.width // 2) % found.power.size])
    off = _cyclic(there - found.middle, echoes.fs)
    dense = float(sliding[at]) / max(float(even[inside].sum()), 1e-300)
    # what few samples may have by chance, as neighbouring pings see the same
    many = (1 + len(sample.pings) / 4) * sample.traces.shape[-1] * found.width / found.power.size
    if off > 0.25 * found.band and dense > max(_APART, 1 + 5 / np.sqrt(many)):
        words = f"{text}; {dense:.2g} times as much in a band as wide about {there:+.4g} Hz"
        if _cyclic(there - echoes.fc, echoes.fs) < 0.2 * found.band:
            return Finding("band", "FAIL", words + ", which is fc: not demodulated: multiply by exp(-2j pi fc t) and low-pass")
        state = "FAIL" if dense > _ELSEWHERE else "warn"
        return Finding("band", state, words + ": demodulated with another fc, or fs, fc or bandwidth is not the data's")
    return _wide(sample, found, inside, text)


def _wide(sample: Sample, found: Density, inside: npt.NDArray[np.bool_], text: str) -> Finding:
    """Energy beyond the declared band that is no white noise."""
    fs = sample.echoes.fs
    bins = max(1, found.width // _BINS)
    smooth = np.convolve(np.r_[found.power[-bins:], found.power, found.power[:bins]], np.ones(bins) / bins, "same")[bins:-bins]
    usual = float(np.median(smooth[inside]))
    beside = np.abs((found.frequency - found.middle + fs / 2) % fs - fs / 2) > 0.55 * found.band
    outside = float(found.power[beside].sum())
    full = beside & (smooth > 0.5 * usual)
    white = np.count_nonzero(full) > 0.9 * np.count_nonzero(beside)
    occupied = (np.count_nonzero(full) + np.count_nonzero(inside)) / found.power.size * fs
    if not white and occupied > 1.5 * found.band:
        words = f"{text}, but {occupied:.3g} Hz are as full: fs or bandwidth is not the data's, or another signal is there"
        return Finding("band", "warn", words)
    tone = float(smooth[beside].max(initial=0.0)) / max(usual, 1e-300)
    if tone > 10 and outside > 0.01:
        where = float(found.frequency[beside][int(np.argmax(smooth[beside]))])
        words = f"{text}; a line {10 * np.log10(tone):.2g} dB above the band lies at {where:+.4g} Hz"
        return Finding("band", "warn", f"{words}: interference: filter it out")
    if sample.echoes.compressed and outside > _BEYOND:
        words = f"{text}, {100 * outside:.2g} % beyond: an image keeps its tol of what is declared, not in dark parts"
        return Finding("band", "warn", words + ": give the bandwidth that the data have, or filter them to it")
    return Finding("band", "ok", text)


def _cyclic(frequency: float, fs: float) -> float:
    return abs((frequency + fs / 2) % fs - fs / 2)


def sweep(sample: Sample) -> Finding:
    """Echoes stand out after the filter for the pulse, not after that for its conjugate."""
    if sample.transfer is None:
        return Finding("sweep", "ok", "no pulse to compare with")
    if sample.echoes.compressed and sample.band[0] != 0:
        return Finding("sweep", "ok", "compressed")
    right = kurtosis(sample.compressed)
    wrong = kurtosis(_other_way(sample))
    heard = (right > 0) & (wrong > 0)
    if not heard.any():
        return Finding("sweep", "ok", "nothing to hear")
    text = f"kurtosis {np.median(right[heard]):.3g} with the pulse, {np.median(wrong[heard]):.3g} with its conjugate"
    gain = np.log(wrong[heard] / right[heard])
    by_ping = np.where(heard.any(axis=1), np.median(np.where(heard, np.log((wrong + 1e-9) / (right + 1e-9)), 0), axis=1), 0)
    # what a short record may have by chance
    clear = max(_CLEAR, 6 / np.sqrt(sample.traces.shape[-1] * sample.band[1] / sample.echoes.fs))
    share = float(np.mean(by_ping > clear))
    turns = [_sure(by_ping[first::2]) for first in (0, 1)]
    if min(share, float(np.mean(by_ping < -clear))) > 0.1 or min(turns) < 0 < max(turns):
        words = f"{text}; ping {sample.pings[int(np.argmax(by_ping))]} fits the conjugate, ping "
        words += f"{sample.pings[int(np.argmin(by_ping))]} the pulse: up and down sweeps in turn"
        return Finding("sweep", "FAIL", f"{words}: compress each with its own pulse")
    # neighbours see the same echoes
    error = float(np.std(gain)) / np.sqrt(max(gain.size / 8, 1.0))
    mean = float(np.mean(gain))
    if mean > 0.02 and mean > _SWEPT * error:
        words = ": the conjugate fits better: I and Q swapped, data conjugated, or the sweep's sign wrong"
        return Finding("sweep", "FAIL", text + words + ": conjugate the data, or change the sign of the pulse's bandwidth")
    if mean > -0.02 or mean > -_SWEPT * error:
        text += ": no echo stands out enough to tell the sweep's sign"
    return Finding("sweep", "ok", text)


def _sure(gain: FloatArray) -> int:
    """Sign of a mean that stands out, else 0."""
    if gain.size < 5:
        return 0
    error = float(np.std(gain)) / np.sqrt(gain.size / 2)
    mean = float(np.mean(gain))
    return int(np.sign(mean)) if abs(mean) > max(0.02, _SWEPT * error) else 0


def _other_way(sample: Sample) -> ComplexArray:
    """The traces through the filter for the pulse of conjugate data (their mirror in time)."""
    transfer = sample.transfer
    if transfer is None:
        return sample.traces
    mirrored = np.roll(transfer[::-1], 1)  # P(-f)
    if sample.echoes.compressed:
        both = transfer * mirrored
        both = both / np.maximum(np.abs(both), 1e-300)
        return sample.back(sample.spectra * both.astype(sample.traces.dtype))
    if isinstance(sample.echoes.pulse, LFM) and sample.band[0] != 0:
        # a sweep about a frequency beside fc: down in place of up, where it is
        pulse = sample.echoes.pulse
        first = int(np.ceil(pulse.support[0] * sample.echoes.fs))
        other = LFM(pulse.fc, -pulse.bandwidth, pulse.duration, pulse.window, pulse.window_parameter)
        times = (first + np.arange(0 if sample.pulse is None else sample.pulse.size)) / sample.echoes.fs
        padded = np.zeros(sample.size, dtype=complex)
        padded[: times.size] = other.waveform(times, sample.echoes.fc)
        spectrum = scipy.fft.fft(np.roll(padded, first))
        return sample.back(sample.spectra * np.conj(spectrum / np.abs(spectrum).max()).astype(sample.traces.dtype))
    return sample.back(sample.spectra * mirrored.astype(sample.traces.dtype))


def kurtosis(traces: ComplexArray) -> FloatArray:
    """Mean |x|^4 / (mean |x|^2)^2 of every trace: 2 for noise; 0 for silence."""
    power = np.abs(traces).astype(np.float64) ** 2
    mean = power.mean(axis=-1)
    return np.asarray(np.divide(np.mean(power**2, axis=-1), mean**2, out=np.zeros_like(mean), where=mean > 0))
