"""Regenerate a table of bounds: `python -m bench.interpolation_table` prints it as it stands in pysas/planning/bounds.py.

GUARD: zeros beside a record, after which what wraps round changes the low-passed trace by at most 10^-e,
relative to the rms of a white record: the root of the sum of squares of the low-pass kernel W's tail.
It is computed from mathematics alone, in float64, not from the engine.
"""

import numpy as np

GUARD_DECADES = tuple(0.5 * i for i in range(2, 23))  # 1e-1 ... 1e-11


def low_pass_kernel(t: np.ndarray) -> np.ndarray:
    """Impulse response, at times in samples, of W (a raised cosine from 1/2.2 to 1/2 cycles per sample), closed form."""
    middle, half_width = (1 / 2.2 + 0.5) / 2, (0.5 - 1 / 2.2) / 2
    return 2 * middle * np.sinc(2 * middle * t) * np.cos(2 * np.pi * half_width * t) / (1 - (4 * half_width * t) ** 2)


def guard_table() -> tuple[int, ...]:
    t = np.arange(1, 400001) - 0.5  # half way between samples is the worst place
    tail = np.sqrt(np.cumsum((low_pass_kernel(t) ** 2)[::-1])[::-1])
    return tuple(int(np.argmax(tail < 10.0**-e)) + 1 for e in GUARD_DECADES)


def main() -> None:
    print(f"GUARD = {guard_table()}")


if __name__ == "__main__":
    main()
