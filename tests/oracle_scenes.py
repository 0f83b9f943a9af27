"""Scenes and the oracle's answers for `csrc/tests/test_scenes.cpp`: `python tests/oracle_scenes.py FILE` writes them.

`make qemu` makes the file each time: so its answers are those of the oracle that stands beside it, and none is kept as bytes
that nobody can read. A scene is arrays of float64, each after its length: its name's letters, then those of `arrays`. Samples
are rounded to complex64 before the oracle sees them, so that one answer holds for images in complex64 and in complex128.
"""

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scenes import PLANE, SCENES, moving, straight
from test_c_python import monostatic, plane, relief, six_receivers

import pysas

SINGLE, DOUBLE, TREES = (1e-3, 1e-1, 1e-2, 1e-4, 1e-5), (1e-4, 1e-8), (1e-3, 1e-2, 1e-4)


@dataclass(frozen=True)
class Case:
    """A scene, the tolerances to keep, and whether trees must take less time than the direct sum is predicted to."""

    echoes: pysas.Echoes
    grid: pysas.Grid
    direct: tuple[tuple[float, ...], tuple[float, ...]] = (SINGLE, DOUBLE)
    trees: tuple[float, ...] = ()
    must_pay: bool = False


def fan(angle: float, taper: float) -> pysas.Beam:
    return pysas.Beam((0.1, 1.0, -0.2), 0.1, angle, "fan", taper)


def cases() -> dict[str, Case]:
    none: tuple[float, ...] = ()
    some = ((1e-3,), none)
    return {
        "straight": Case(straight(), PLANE),
        "moving receivers": Case(moving(), PLANE),
        "relief": Case(moving(), SCENES["surface"][1]),
        "circle": Case(SCENES["circular"][0](), SCENES["circular"][1], (SINGLE[:3], (1e-6,))),
        "record's ends": Case(straight(), SCENES["record's edges"][1], (SINGLE[:3], (1e-6,))),
        "cone": Case(straight(beam=pysas.Beam((0.0, 1.0, -0.2), 0.1, 0.2, "cone")), PLANE, (SINGLE[:4], (1e-6,))),
        "fan that fades": Case(moving(beam=fan(0.3, 0.6)), PLANE, (SINGLE[:4], (1e-6,))),
        "trees": Case(monostatic(96), plane(96, 80), some, TREES),
        "trees, moving receivers": Case(six_receivers(24), plane(96, 80), some, TREES),
        "trees, relief": Case(monostatic(96), relief(96, 80), some, TREES[:2]),
        "trees, fan": Case(monostatic(96, beam=fan(0.3, 0.5)), plane(96, 80), some, TREES[:2]),
        "trees that pay": Case(monostatic(), plane(400, 380), (none, none), (1e-2,), True),
    }


def arrays(case: Case) -> Iterator[object]:
    echoes, grid, beam = case.echoes, case.grid, case.echoes.beam
    echoes = echoes.replace(data=echoes.data.astype(np.complex64).astype(np.complex128))
    pixels = np.random.default_rng(5).choice(grid.size, min(grid.size, 200), replace=False)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    corner = grid.coordinates(np.array([0, 1, grid.shape[1]]))
    even = grid.axes.keys() >= {"x", "y"} and np.ptp(grid.coordinates()[..., 2]) == 0
    yield [
        echoes.n_ping, echoes.n_channel, echoes.n_sample, echoes.fs, echoes.fc, echoes.occupied_bandwidth, echoes.mean_speed,
        beam.half_angle if beam else 0, beam.taper if beam else 0, bool(beam and beam.shape == "fan"), *grid.shape,
        *corner[0], *corner[1] - corner[0], *corner[2] - corner[0], case.must_pay,
    ]  # fmt: skip
    yield echoes.start_time
    yield echoes.tx
    yield echoes.receivers
    yield () if echoes.receiver_velocity is None else echoes.receiver_velocity
    for direction in (beam.boresight, beam.axis) if beam else (None, None):
        yield () if direction is None else np.broadcast_to(direction, echoes.tx.shape)
    yield () if even else grid.coordinates()
    yield echoes.data.view(np.float64)
    yield pixels
    yield exact.view(np.float64)
    yield level
    yield from (*case.direct, case.trees)


def main(path: str) -> None:
    with Path(path).open("wb") as file:
        for name, case in cases().items():
            for values in (list(name.encode()), *arrays(case)):
                flat = np.ravel(np.asarray(values, dtype=np.float64))
                file.write(np.concatenate([[flat.size], flat]).tobytes())


if __name__ == "__main__":
    main(*sys.argv[1:])
