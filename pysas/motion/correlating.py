"""Kernels in Numba: two traces' correlation in windows, and the normal equations of what it says. They trust their
arguments."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

RAYLEIGH = 0.8325546111576977  # median of a Rayleigh distribution over its rms, sqrt(ln 2)
LIMIT = 2.0  # rms at which a window's amplitudes are clipped: a bright point correlates whatever the separation


@njit(nogil=True, cache=True)
def _limit(trace, first, last, scratch):  # type: ignore[no-untyped-def]
    """What amplitudes trace[first:last] are clipped at; 0 where fewer than half of them were recorded."""
    count = 0
    for n in range(first, last):
        power = trace[n].real * trace[n].real + trace[n].imag * trace[n].imag
        if power > 0.0:
            scratch[count] = power
            count += 1
    if 2 * count < last - first:
        return 0.0
    return LIMIT * math.sqrt(np.median(scratch[:count])) / RAYLEIGH


@njit(nogil=True, cache=True)
def _clipped(value, most):  # type: ignore[no-untyped-def]
    size = math.sqrt(value.real * value.real + value.imag * value.imag)
    return complex(value) * (most / size if size > most else 1.0)


@njit(nogil=True, cache=True)
def windows(first, second, length, products, powers, counts):  # type: ignore[no-untyped-def]
    """Correlations of rows of two traces (row, n) in windows of `length` samples.

    products (row, window, 2 m + 1): sum of second[n + lag] conj(first[n]), lag from -m to m; powers (row, window): root of the
    product of both sums of squares; counts (row, window): samples that both recorded. A window of fewer than half is left 0.
    """
    n_sample, reach = first.shape[1], products.shape[2] // 2
    scratch = np.empty(length)
    a, b = np.empty(length, dtype=np.complex128), np.empty(length + 2 * reach, dtype=np.complex128)
    for row in range(first.shape[0]):
        for window in range(products.shape[1]):
            low = window * length
            high = low + length
            one = _limit(first[row], low, high, scratch)
            two = _limit(second[row], low, high, scratch)
            counts[row, window] = 0.0
            powers[row, window] = 0.0
            for lag in range(2 * reach + 1):
                products[row, window, lag] = 0.0
            if one == 0.0 or two == 0.0:
                continue
            for n in range(length):
                a[n] = _clipped(first[row, low + n], one)
            for n in range(length + 2 * reach):
                at = low + n - reach
                b[n] = _clipped(second[row, at], two) if 0 <= at < n_sample else 0.0
            here, there, count = 0.0, 0.0, 0
            for n in range(length):
                p = a[n].real * a[n].real + a[n].imag * a[n].imag
                q = b[n + reach].real * b[n + reach].real + b[n + reach].imag * b[n + reach].imag
                if p > 0.0 and q > 0.0:
                    here += p
                    there += q
                    count += 1
            for lag in range(2 * reach + 1):
                total = 0.0 + 0.0j
                for n in range(length):
                    total += b[n + lag] * a[n].conjugate()
                products[row, window, lag] = total
            powers[row, window] = math.sqrt(here * there)
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
