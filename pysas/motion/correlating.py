"""Kernels in Numba: two traces' correlation in windows, and the normal equations of what it says. They trust their
arguments."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

RAYLEIGH = 0.8325546111576977  # median of a Rayleigh distribution over its rms, sqrt(ln 2)
LIMIT = 2.0  # rms at which a window's amplitudes are clipped: a bright point correlates whatever the separation
_SUMS = {"contract", "reassoc", "nsz"}  # sums in any order, without which compilers take one term at a time


@njit(nogil=True, cache=True)
def _limit(trace, first, last, power, bits, top):  # type: ignore[no-untyped-def]
    """Square of what amplitudes trace[first:last] are clipped at; 0 where fewer than half of them were recorded.

    power, bits: room for as many reals, seen as reals and as whole numbers, of which positive reals have the same order; their
    median is found bit by bit from the `top` on, to one part in 4096.
    """
    count = np.int32(0)
    part = trace[first:last]
    for n in range(power.size):
        p = part[n].real * part[n].real + part[n].imag * part[n].imag
        power[n] = p
        count += np.int32(1) if p > 0 else np.int32(0)
    if 2 * count < last - first:
        return power.dtype.type(0)
    found = bits.dtype.type(0)
    for place in range(20):
        trial = bits.dtype.type(found | (1 << (top - place)))
        above = np.int32(0)
        for n in range(bits.size):
            above += np.int32(1) if bits[n] >= trial else np.int32(0)
        if 2 * above >= count:
            found = trial
    bits[0] = found
    return power.dtype.type((LIMIT / RAYLEIGH) ** 2) * power[0]


@njit(nogil=True, cache=True, fastmath=_SUMS)
def _clip(trace, first, last, most, re, im):  # type: ignore[no-untyped-def]
    """Parts of trace[first:last], to `re` and `im`, with squares clipped at `most`."""
    part = trace[first:last]
    for n in range(part.size):
        a, b = part[n].real, part[n].imag
        by = np.sqrt(most / max(a * a + b * b, most))
        re[n] = a * by
        im[n] = b * by


@njit(nogil=True, cache=True, fastmath=_SUMS)
def _products(a, b, c, d, length, out):  # type: ignore[no-untyped-def]
    """Sums of (c + j d)[n + lag] conj((a + j b)[n])."""
    for lag in range(out.size):
        re, im = np.float32(0), np.float32(0)
        for n in range(length):
            re += c[n + lag] * a[n] + d[n + lag] * b[n]
            im += d[n + lag] * a[n] - c[n + lag] * b[n]
        out[lag] = complex(re, im)


@njit(nogil=True, cache=True, fastmath=_SUMS)
def _both(a, b, c, d, length):  # type: ignore[no-untyped-def]
    """Sums of squares of a + j b and of c + j d where both are something, and how many."""
    here, there, count = np.float32(0), np.float32(0), 0
    for n in range(length):
        p, q = a[n] * a[n] + b[n] * b[n], c[n] * c[n] + d[n] * d[n]
        both = p > 0 and q > 0
        here += p if both else np.float32(0)
        there += q if both else np.float32(0)
        count += both
    return here, there, count


@njit(nogil=True, cache=True)
def windows(first, second, length, power, bits, top, products, powers, counts):  # type: ignore[no-untyped-def]
    """Correlations of rows of two traces (row, n) in windows of `length` samples.

    products (row, window, 2 m + 1): sum of second[n + lag] conj(first[n]), lag from -m to m; powers (row, window): root of the
    product of both sums of squares; counts (row, window): samples that both recorded. A window of fewer than half is left 0.
    power, bits, top: see `_limit`.
    """
    n_sample, reach = first.shape[1], products.shape[2] // 2
    kind = first.real.dtype
    a, b = np.empty(length, dtype=kind), np.empty(length, dtype=kind)
    c, d = np.zeros(length + 2 * reach, dtype=kind), np.zeros(length + 2 * reach, dtype=kind)
    for row in range(first.shape[0]):
        for window in range(products.shape[1]):
            low = window * length
            counts[row, window] = 0.0
            powers[row, window] = 0.0
            products[row, window, :] = 0.0
            one = _limit(first[row], low, low + length, power, bits, top)
            two = _limit(second[row], low, low + length, power, bits, top)
            if one == 0.0 or two == 0.0:
                continue
            _clip(first[row], low, low + length, one, a, b)
            begin, end = max(low - reach, 0), min(low + length + reach, n_sample)
            c[:] = 0
            d[:] = 0
            _clip(second[row], begin, end, two, c[begin - low + reach :], d[begin - low + reach :])
            _products(a, b, c, d, length, products[row, window])
            here, there, count = _both(a, b, c[reach:], d[reach:], length)
            powers[row, window] = math.sqrt(here) * math.sqrt(there)
            counts[row, window] = count


@njit(nogil=True, cache=True)
def gather(value, sigma, looks, apart, arms, found, cut, normal, right, squares):  # type: ignore[no-untyped-def]
    """Normal equations of each pair of pings, of 8 unknowns: x, y, z and turn of the earlier and of the later one.

    value, sigma (pair, slot, window): what u.(delta of the later - delta of the earlier phase centre) was measured to be, and
    how well (0: not at all); looks (pair, window, 3): u; apart (pair, slot, 3): the claimed way between both phase centres;
    arms (pair, slot, 2, 2): x and y of the earlier and the later one from its ping's pivot; found (pair, 8): unknowns that
    weights of Cauchy at `cut` sigma are made with. squares (pair, 2): sum of squares over sigma, and their number.

    The line of sight turns with the heading that is sought: hence the terms of `apart`.
    """
    row = np.zeros(8)
    for pair in range(value.shape[0]):
        for slot in range(value.shape[1]):
            for window in range(value.shape[2]):
                deviation = sigma[pair, slot, window]
                if deviation <= 0.0:
                    continue
                x, y, z = looks[pair, window, 0], looks[pair, window, 1], looks[pair, window, 2]
                turned = (x * apart[pair, slot, 1] - y * apart[pair, slot, 0]) / 2
                row[0], row[1], row[2] = -x, -y, -z
                row[3] = -(y * arms[pair, slot, 0, 0] - x * arms[pair, slot, 0, 1]) + turned
                row[4], row[5], row[6] = x, y, z
                row[7] = y * arms[pair, slot, 1, 0] - x * arms[pair, slot, 1, 1] + turned
                rest = value[pair, slot, window]
                for k in range(8):
                    rest -= row[k] * found[pair, k]
                ratio = rest / deviation
                weight = 1.0 / (deviation * deviation * (1.0 + (ratio / cut) ** 2))
                squares[pair, 0] += min(ratio * ratio, cut * cut)
                squares[pair, 1] += 1.0
                for k in range(8):
                    right[pair, k] += weight * row[k] * value[pair, slot, window]
                    for m in range(k + 1):
                        normal[pair, k, m] += weight * row[k] * row[m]
        for k in range(8):
            for m in range(k):
                normal[pair, m, k] = normal[pair, k, m]
