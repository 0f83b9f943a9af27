"""Callers from C and from Python get the same image, to the bit: one planner, one executor, the same kernels."""

import c_library
import numpy as np
import pytest
from scenes import C, survey

import pysas

pytestmark = pytest.mark.cpp
METHODS = {"backprojection": 0, "ffbp": 1, "auto": 2}
STEP = 1 / 64  # m: places that float64 holds exactly, however they are put together


def line(pings, spacing=2 / 64):
    tx = np.zeros((pings, 3))
    tx[:, 0] = (np.arange(pings) - pings // 2) * spacing
    tx[:, 2] = 5.0
    return tx


def plane(width, height, near=24.0, mask=None):
    return pysas.Grid.plane((np.arange(width) - width // 2) * STEP, near + np.arange(height) * STEP, mask=mask)


def relief(width, height, near=24.0):
    x, y = plane(width, height, near).axes["x"], plane(width, height, near).axes["y"]
    return pysas.Grid.surface(x, y, 0.02 * np.sin(x / 0.4) * np.cos(y[:, None] / 0.5))


def monostatic(pings=512, samples=1000, near=18.0, dtype=np.complex64, late=0.0, bright=0.0, **more):
    """`late` s later begins every other record; `bright`: level of what lies from 21 to 21.5 m, beside the image."""
    tx = line(pings)
    echoes = survey(tx, tx[:, None].copy(), near, samples=samples, **more)
    data = echoes.data.copy()
    if bright:
        place = (np.array([21.0, 21.5]) - near) * 2 / C * echoes.fs
        data[..., int(place[0]) : int(place[1])] *= bright
    t0 = echoes.start_time - late * (np.arange(pings) % 2)
    return echoes.replace(data=data.astype(dtype), t0=t0)


def six_receivers(pings=96, **more):
    tx = line(pings, 0.25)
    rx = tx[:, None] + np.array([0.25, 0.0, 0.0]) + np.arange(6)[:, None] * np.array([0.0625, 0.0, 0.0])
    velocity = np.tile([1.5, 0.0, 0.0], (pings, 1))
    echoes = survey(tx, rx, 18.0, samples=1000, velocity=velocity, **more)
    return echoes.replace(data=echoes.data.astype(np.complex64))


def circle(pings=600):
    tx = pysas.tracks.circular(pings, 20.0, height=4.0).position
    echoes = survey(tx, tx[:, None].copy(), 15.0, samples=600, fc=20e3, bandwidth=10e3)
    return echoes.replace(data=echoes.data.astype(np.complex64))


def weighed(echoes):
    rng = np.random.default_rng(7)
    return rng.uniform(0.1, 1.0, (echoes.n_ping, echoes.n_channel)) * (rng.random((echoes.n_ping, echoes.n_channel)) > 0.05)


def masked(width, height):
    wanted = np.zeros((height, width), dtype=bool)
    wanted[2:-3, 1:-5] = True
    return plane(width, height, mask=wanted)


SQUARE = pysas.Grid.plane((np.arange(256) - 128) * STEP, (np.arange(256) - 128) * STEP)
LIT = pysas.Beam((0.0, 1.0, 0.0), 0.1, 0.3, "cone")


def fading():
    angle = 0.01 * np.sin(np.arange(512))
    return pysas.Beam(
        np.stack([-np.sin(angle), np.cos(angle), 0 * angle - 0.2], axis=1), 0.1, 0.3, "fan", 0.6,
        np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1),
    )  # fmt: skip


SCENES = {
    "one receiver": (monostatic, plane(400, 380), {}),
    "six moving receivers": (six_receivers, plane(300, 200), {}),
    "record's ends": (lambda: monostatic(samples=260), plane(300, 260, 17.0), {}),
    "relief": (six_receivers, relief(200, 150), {}),
    "relief under trees": (monostatic, relief(400, 300), {}),
    "beam": (lambda: monostatic(192, beam=LIT), plane(150, 130), {}),
    "fan": (lambda: monostatic(192, beam=pysas.Beam((0.1, 1.0, 0.0), 0.1, 0.3)), plane(150, 130), {}),
    "fan that fades": (lambda: monostatic(beam=fading()), plane(400, 380), {}),
    "weights": (monostatic, plane(400, 400), {"weights": weighed}),
    "circle": (circle, SQUARE, {}),
    "points": (lambda: six_receivers(16), pysas.Grid.points(plane(60, 50).coordinates() + [0.0, 0.0, 0.25]), {}),
    "rows of points on lines": (monostatic, pysas.Grid.points(plane(200, 200).coordinates().reshape(200, 200, 3)), {}),
    "mask": (monostatic, masked(400, 390), {}),
    "complex128": (lambda: monostatic(128, dtype=np.complex128), plane(120, 100), {"tols": (1e-3, 1e-8)}),
    "late, of different starts": (lambda: monostatic(late=1e-3), plane(300, 260), {}),
    "bright beside the image": (lambda: monostatic(bright=1e4), plane(200, 180, 22.0), {}),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", SCENES)
def test_the_same_image_to_the_bit(name, method):
    make, grid, more = SCENES[name]
    echoes = make()
    weights, shares = more["weights"](echoes) if "weights" in more else None, []
    for tol in more.get("tols", (1e-2, 1e-3)):
        image = pysas.plan(echoes, grid, tol, method, 2, "cpp", weights)(echoes.data)
        found = c_library.call(echoes, grid, tol, METHODS[method], threads=1, weights=weights)
        assert found.code == 0 and found.factorised_share == image.report.factorised_share
        assert np.array_equal(found.image, image.data)
        shares.append(found.factorised_share)
    if method == "ffbp" and name in {"one receiver", "relief under trees", "weights", "mask", "fan that fades"}:
        assert max(shares) > 0.5
