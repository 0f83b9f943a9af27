"""Regenerate the tables of bounds: `python -m bench.interpolation_table` prints them as they stand in pysas/planning/bounds.py.

THETA: largest phase advance theta = pi f/(over-sampling fs) over half an interval for which the truncated Jacobi-Anger
series of exp(j theta x) at degree d is wrong by at most 10^-e anywhere on the interval (worst frequency, worst place).
GUARD: zeros beside a record, after which what wraps round changes the low-passed trace by at most 10^-e,
relative to the rms of a white record: the root of the sum of squares of the low-pass kernel W's tail.
Both are computed from mathematics alone, in float64, not from the engine.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import jv

DEGREES = (1, 3, 5, 7)
DECADES = tuple(0.5 * i for i in range(2, 25))  # tolerances 1e-1 ... 1e-12
GUARD_DECADES = tuple(0.5 * i for i in range(2, 23))  # 1e-1 ... 1e-11


def series_error(theta: float, degree: int) -> float:
    """Largest error of the series cut at `degree`, by its tail (converges factorially), on 257 places of [-1, 1]."""
    x = np.cos(np.linspace(0, np.pi, 257))
    k = np.arange(degree + 1, degree + 40)
    tail = (2 * (1j**k) * jv(k, theta)) @ np.cos(k[:, None] * np.arccos(x))
    return float(np.abs(tail).max())


def theta_table() -> dict[int, tuple[float, ...]]:
    return {
        d: tuple(
            round(float(brentq(lambda t, d=d, e=e: np.log(series_error(t, d)) + e * np.log(10), 1e-7, 9.0)), 7) for e in DECADES
        )
        for d in DEGREES
    }


def low_pass_kernel(t: np.ndarray) -> np.ndarray:
    """Impulse response, at times in samples, of W (a raised cosine from 1/2.2 to 1/2 cycles per sample), closed form."""
    middle, half_width = (1 / 2.2 + 0.5) / 2, (0.5 - 1 / 2.2) / 2
    return 2 * middle * np.sinc(2 * middle * t) * np.cos(2 * np.pi * half_width * t) / (1 - (4 * half_width * t) ** 2)


def guard_table() -> tuple[int, ...]:
    t = np.arange(1, 400001) - 0.5  # half way between samples is the worst place
    tail = np.sqrt(np.cumsum((low_pass_kernel(t) ** 2)[::-1])[::-1])
    return tuple(int(np.argmax(tail < 10.0**-e)) + 1 for e in GUARD_DECADES)


def main() -> None:
    print("THETA = {")
    for degree, row in theta_table().items():
        print(f"    {degree}: (")
        for first in range(0, len(row), 8):
            print("        " + " ".join(f"{value}," for value in row[first : first + 8]))
        print("    ),")
    print("}")
    print(f"GUARD = {guard_table()}")


if __name__ == "__main__":
    main()
