"""Images of a strip as pings come: against one large image and the exact sum, whatever the blocks and the track."""

import numpy as np
import pytest

import pysas

FS, FC, BAND, C = 36e3, 100e3, 30e3, 1500.0
Y = np.arange(12.0, 17.0, 0.05)


def survey(pings=60, channels=8, backwards=False, uneven=0.0, shape="fan", taper=0.5, seed=0, samples=640):
    """An array that advances by half its length a ping, or by `uneven` (share) more or less, swaying and yawing."""
    rng = np.random.default_rng(seed)
    step = 0.025 * channels * (1 + uneven * rng.uniform(-1, 1, pings))
    x = np.cumsum(step) * (-1 if backwards else 1)
    tx = np.stack([x, 0.04 * np.sin(x), 3 + 0.02 * np.cos(2 * x)], axis=1)
    angle = 0.01 * np.sin(1.3 * x)
    axis = np.stack([np.cos(angle), np.sin(angle), np.zeros(pings)], axis=1)
    look = np.stack([-np.sin(angle), np.cos(angle), np.full(pings, -0.2)], axis=1)
    rx = tx[:, None] + (0.05 * (np.arange(channels) - (channels - 1) / 2))[:, None] * axis[:, None]
    data = np.fft.fft(rng.standard_normal((pings, channels, 2 * samples)).view(complex))
    data[..., np.abs(np.fft.fftfreq(samples)) > BAND / 2 / FS] = 0
    half = 0.15 if shape == "fan" else 0.3
    beam = pysas.Beam(look, 0.1, half, shape, taper, axis if shape == "fan" else None)
    return pysas.Echoes(
        np.fft.ifft(data).astype(np.complex64), fs=FS, fc=FC, tx=tx, rx=rx, c=C, t0=0.0155 + 1e-5 * rng.random(pings),
        velocity=np.tile([0.5, 0.02, 0.0], (pings, 1)), bandwidth=BAND, beam=beam, ping_time=0.25 * np.arange(pings),
    )  # fmt: skip


def some(echoes, order):
    """Pings `order`."""
    beam = echoes.beam
    axis = None if beam.axis is None else beam.axis[order]
    return echoes.replace(
        data=echoes.data[order], tx=echoes.tx[order], rx=echoes.rx[order], velocity=echoes.velocity[order],
        t0=echoes.t0[order], ping_time=echoes.ping_time[order],
        beam=pysas.Beam(beam.boresight[order], beam.length, beam.half_angle, beam.shape, beam.taper, axis),
    )  # fmt: skip


def fed(echoes, sizes=(1,)):
    """Echoes of so many pings each, again and again."""
    begin = turn = 0
    while begin < echoes.n_ping:
        end = begin + sizes[turn % len(sizes)]
        yield some(echoes, np.arange(begin, min(end, echoes.n_ping)))
        begin, turn = end, turn + 1


def wrong(image, echoes, tol):
    """Error of an image in units of tol's norm, on some of its pixels."""
    pixels = np.random.default_rng(0).choice(image.grid.size, min(image.grid.size, 120), replace=False)
    exact, level = pysas.reference.exact(echoes, image.grid, pixels)
    wrong = np.linalg.norm(image.data.ravel()[pixels] - exact)
    return wrong / max(np.linalg.norm(exact), np.linalg.norm(level)) / tol


@pytest.mark.parametrize("shape", ["fan", "cone"])
@pytest.mark.parametrize("backwards", [False, True])
def test_each_image_keeps_tol(backwards, shape):
    echoes = survey(backwards=backwards, shape=shape)
    strip = pysas.Strip(Y, 0.05, 2.0, tol=1e-3, origin=0.3)
    images = list(strip.stream(fed(echoes)))
    first = [image.grid.axes["x"][0] for image in images]
    assert np.allclose(np.diff(first), -2 if backwards else 2) and len(images) >= 6
    for image in images[1:-1:3]:
        assert image.grid.shape == (Y.size, 40) and image.report.terms > 0
        assert wrong(image, echoes, 1e-3) <= 1
    terms = sum(image.report.terms for image in images)
    assert 0.5 * terms < echoes.n_ping * echoes.n_channel * sum(image.grid.size for image in images)
    # every term lies in one of them: pixels beyond are dark
    for end, side in ((min(first), -1), (max(first) + 2, 1)):
        grid = pysas.Grid.plane(end + side * np.arange(0.0, 1.0, 0.5) + side * 1e-3, Y[::33])
        assert not np.any(pysas.reference.exact(echoes, grid)[1])


def test_speeds_and_windows_of_pings_go_through_blocks():
    echoes, rng = survey(), np.random.default_rng(5)
    windows = np.stack([rng.integers(0, 60, (60, 8)), rng.integers(500, 640, (60, 8))], axis=-1)
    echoes = echoes.replace(c=C * (1 + 0.003 * rng.uniform(-1, 1, 60)), valid=windows)

    def pings():
        for ping in range(60):
            one = some(echoes.replace(c=C, valid=None), np.array([ping]))
            yield one.replace(c=float(echoes.c[ping]), valid=windows[ping : ping + 1])

    images = list(pysas.Strip(Y, 0.05, 2.0, tol=1e-3, backend="numba").stream(pings()))
    assert len(images) >= 6
    for image in images[1:-1:3]:
        assert wrong(image, echoes, 1e-3) <= 1
    halves = [echoes[:20], echoes[20:]]
    again = pysas.survey.pings.joined(halves)
    assert np.array_equal(again.c, echoes.c) and np.array_equal(again.valid, echoes.valid)
    mixed = pysas.survey.pings.joined([halves[0].replace(c=C, valid=None), halves[1]])
    assert mixed.c[:20].tolist() == [C] * 20 and mixed.valid[:20].tolist() == [[[0, 639]] * 8] * 20


def test_blocks_make_no_difference_beyond_tol():
    echoes = survey()
    whole = np.concatenate([image.data for image in pysas.Strip(Y, 0.05, 2.0, tol=1e-3).stream([echoes])], axis=1)
    for sizes, block in (((1,), 0.3), ((7, 3), 1.0), ((60,), 20.0), ((2, 50), None)):
        strip = pysas.Strip(Y, 0.05, 2.0, tol=1e-3, block=block)
        images = np.concatenate([image.data for image in strip.stream(fed(echoes, sizes))], axis=1)
        assert images.shape == whole.shape
        assert np.linalg.norm(images - whole) <= 1.5e-3 * np.linalg.norm(whole)


def test_neighbours_agree_with_one_large_image():
    echoes = survey(uneven=0.5)
    images = list(pysas.Strip(Y, 0.05, 2.0, tol=1e-3).stream(fed(echoes, (5,))))
    x = np.concatenate([image.grid.axes["x"] for image in images])
    large = pysas.focus(echoes, pysas.Grid.plane(x, Y), 1e-3)
    together = np.concatenate([image.data for image in images], axis=1)
    assert np.linalg.norm(together - large.data) <= 1.5e-3 * np.linalg.norm(large.data)


def test_images_come_as_soon_as_no_ping_lights_them():
    echoes = survey()
    given = []

    def pings():
        for number, one in enumerate(fed(echoes)):
            given.append(number)
            yield one

    seen = []
    for image in pysas.Strip(Y, 0.05, 1.0, tol=1e-2, block=0.4, slack=0.2).stream(pings()):
        seen.append((given[-1], float(image.grid.axes["x"][-1])))
    # a ping lights 17 m tan 8.6 degrees = 2.6 m to either side
    for number, last in seen[:-8]:
        assert last < echoes.tx[number, 0] - 2.0 and last > echoes.tx[number, 0] - 5.5
    assert len(seen) > 14


def test_gaps_are_told_and_late_pings_warned_of():
    echoes = survey(pings=120)
    order = np.concatenate([np.arange(30), np.arange(90, 120)])
    strip = pysas.Strip(Y, 0.05, 1.0, tol=1e-2)
    images = list(strip.stream(fed(some(echoes, order), (4,))))
    notes = [note for image in images for note in image.report.notes]
    assert len(notes) == 1 and notes[0].startswith("nothing lights x from")
    back = np.concatenate([np.arange(70), np.arange(20, 30)])
    with pytest.warns(UserWarning, match="given away.*slack="):
        list(strip.stream(fed(some(echoes, back), (1,))))


def test_height_maps_and_both_engines():
    echoes, asked = survey(pings=16, channels=4), []

    def ground(x, y):
        asked.append(float(x[0]))
        return 0.1 * np.sin(y)[:, None] * np.cos(x)[None, :]

    for backend in ("auto", "numba"):
        strip = pysas.Strip(Y[::4], 0.2, 2.0, z=ground, tol=1e-3, backend=backend)
        asked.clear()
        images = list(strip.stream(fed(echoes, (5,))))
        assert all(image.grid.kind == "surface" for image in images)
        for image in images:  # each once, beside some places between them that tell how far beams reach
            x, y = image.grid.axes["x"], image.grid.axes["y"]
            assert asked.count(float(x[0])) == 1
            assert np.array_equal(image.grid.height, 0.1 * np.sin(y)[:, None] * np.cos(x)[None, :])
        for image in images[1:3]:
            assert wrong(image, echoes, 1e-3) <= 1


def test_what_is_no_strip():
    echoes = survey(pings=4)
    for arguments in (
        {"step": 0.0}, {"length": 1.03}, {"length": -1.0}, {"slack": -1.0}, {"block": 0.0}, {"y": [[1.0]]}, {"origin": np.nan},
    ):  # fmt: skip
        with pytest.raises(ValueError, match=next(iter(arguments))):
            pysas.Strip(**{"y": Y, "step": 0.05, "length": 1.0} | arguments)
    strip = pysas.Strip(Y, 0.05, 1.0)
    assert list(strip.stream([])) == []
    with pytest.raises(TypeError, match="pings: int"):
        list(strip.stream([1]))
    with pytest.raises(ValueError, match="no beam"):
        list(strip.stream([echoes.replace(beam=None)]))
    with pytest.raises(ValueError, match="fs="):
        list(strip.stream([echoes, echoes.replace(fs=4e4)]))
    with pytest.raises(ValueError, match="taper="):
        other = pysas.Beam(echoes.beam.boresight, 0.1, 0.15, "fan", 0.4, echoes.beam.axis)
        list(strip.stream([echoes, echoes.replace(beam=other)]))
    with pytest.raises(ValueError, match="data"):
        list(strip.stream([echoes, echoes.replace(data=echoes.data[..., :-1])]))
    for wrong_z in (lambda x, y: np.zeros((3, x.size)), lambda x, y: np.full((y.size, x.size), np.nan)):
        with pytest.raises(ValueError, match="z: "):
            list(pysas.Strip(Y, 0.05, 1.0, z=wrong_z).stream([echoes]))
