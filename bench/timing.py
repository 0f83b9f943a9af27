"""What the benchmarks time calls with."""

import time


def timed(call, repeats=1, of=min, warm=False):
    """What `call` returns and its seconds: of several runs the least, or as `of` says; `warm`: after one that compiles."""
    if warm:
        call()
    seconds = []
    for _ in range(repeats):
        clock = time.perf_counter()
        result = call()
        seconds.append(time.perf_counter() - clock)
    return result, of(seconds)
