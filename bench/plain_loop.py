"""The yardstick: the loop a user would write first in Numba. It stays as it is; its own error is stated beside its speed.

Per pixel, ping and channel: two square roots in float64, linear interpolation, libm cosine and sine; prange over rows,
fastmath.
"""

import numba as nb
import numpy as np


@nb.njit(parallel=True, fastmath=True)
def plain_loop(data, tx, rx, x, y, z, fs, fc, c, t0):
    n_ping, n_channel, n_sample = data.shape
    image = np.zeros((y.size, x.size), dtype=np.complex64)
    for row in nb.prange(y.size):
        for col in range(x.size):
            total = 0j
            for ping in range(n_ping):
                there = np.sqrt((x[col] - tx[ping, 0]) ** 2 + (y[row] - tx[ping, 1]) ** 2 + (z - tx[ping, 2]) ** 2)
                for channel in range(n_channel):
                    r = rx[ping, channel]
                    back = np.sqrt((x[col] - r[0]) ** 2 + (y[row] - r[1]) ** 2 + (z - r[2]) ** 2)
                    tau = (there + back) / c
                    index = (tau - t0) * fs
                    i = int(index)
                    if 0 <= i < n_sample - 1:
                        w = index - i
                        sample = data[ping, channel, i] * (1 - w) + data[ping, channel, i + 1] * w
                        phase = 2 * np.pi * fc * tau
                        total += sample * complex(np.cos(phase), np.sin(phase))
            image[row, col] = total
    return image
