"""The same scenes under pytest-benchmark, for its statistics and comparisons: `pytest bench --benchmark-json=FILE`."""

import numpy as np
import pytest

import pysas
from bench.backprojection import SCENES, call, kernels
from bench.scenes import random_stripmap

CASES = [
    (scene, kernel, tol) for scene in SCENES for kernel in kernels() for tol in ((1e-8,) if "128" in scene else (1e-2, 1e-4))
]


@pytest.mark.parametrize(
    ("scene", "kernel", "tol"), CASES, ids=lambda value: str(value[0] if isinstance(value, tuple) else value)
)
@pytest.mark.parametrize("threads", [1, 2])
def test_backprojection(benchmark, scene, kernel, tol, threads):
    options = SCENES[scene]
    channels = options.get("channels", 1)
    echoes, grid = random_stripmap(192 // channels, 2048, 512, **options)
    image = benchmark.pedantic(call, (echoes, grid, tol, threads, *kernel[1:]), rounds=3, warmup_rounds=1)
    sampled = np.random.default_rng(0).choice(grid.size, 200, replace=False)
    error = pysas.metrics.relative_error(image.ravel()[sampled], *pysas.reference.exact(echoes, grid, sampled))
    benchmark.extra_info.update(
        error=error, terms_per_second=192 // channels * channels * grid.size / benchmark.stats["median"]
    )
    assert error <= tol
