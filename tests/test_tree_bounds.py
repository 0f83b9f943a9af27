"""What trees of sub-apertures rest on where neighbours differ: bands of all traces, rays for short, squinted and bistatic
groups, records of every trace, tables near records' ends."""

from types import SimpleNamespace

import answers
import numpy as np
import pytest

import pysas
from pysas.engine import tree
from pysas.engine.traces import TRACE
from pysas.planning import subapertures

BACKENDS = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]
C, FS, FC, B = 1500.0, 40e3, 100e3, 30e3
TOLS = (1e-2, 1e-3, 1e-4)
TOO_NEAR = {"odd sensors lie far off their middle", "squinted, few samples before", "abeam, longer"}  # for trees at 1e-4
ALTERNATE = np.arange(128) % 2 == 1


def noise(traces, samples, bandwidth=B, fs=FS):
    rng = np.random.default_rng(3)
    spectrum = rng.standard_normal((traces, 2 * samples)) + 1j * rng.standard_normal((traces, 2 * samples))
    spectrum[:, np.abs(np.fft.fftfreq(2 * samples)) * fs > bandwidth / 2] = 0
    return np.fft.ifft(spectrum)[:, :samples].astype(np.complex64)


def survey(tx, rx, grid, tol, samples=1200, before=300, over=FS / B, fc=FC, t0=None, **more):
    """Echoes whose records begin `before` samples ahead of the image, and the share of tol that an image errs by."""
    fs = over * B
    places = grid.coordinates()[:: max(1, grid.size // 50)]
    path = np.linalg.norm(places - tx[:, None], axis=-1) + np.linalg.norm(places - rx[:, None], axis=-1)
    t0 = path.min() / C - before / fs if t0 is None else t0
    data = noise(len(tx), int(np.ptp(path) / C * fs) + samples, fs=fs)
    echoes = pysas.Echoes(data, fs=fs, fc=fc, tx=tx, rx=rx, c=C, bandwidth=B, t0=t0, **more)
    some = np.random.default_rng(1).choice(grid.size, 40, replace=False)
    exact, level = answers.exact(echoes, grid, some)

    def error(image):
        wrong = np.linalg.norm(image.data.ravel()[some] - exact)
        return float(wrong / max(np.linalg.norm(exact), np.linalg.norm(level)) / tol)

    return echoes, error


def line(count=128, step=0.02):
    return (np.arange(count)[:, None] - (count - 1) / 2) * np.array([step, 0, 0])


def plane(x=0.0, y=20.0, nx=64, ny=64, step=0.02):
    return pysas.Grid.plane(x + (np.arange(nx) - nx / 2) * step, y + np.arange(ny) * step)


def moved(rows, vector):
    return np.where(rows[:, None], np.asarray(vector, dtype=float), 0.0)


# what a sample of some traces, or of phase centres alone, does not see: (transmitters, receivers, velocities)
DIFFERING = {
    "transmitter and receiver swap": (line() + moved(ALTERNATE, [0, -9, 0]), line() + moved(~ALTERNATE, [0, -9, 0]), None),
    "odd sensors lie far off their middle": (line() + moved(ALTERNATE, [0, 8, 0]), line() - moved(ALTERNATE, [0, 8, 0]), None),
    # the steepest is the last odd ping, at no end of sums or differences
    "odd sensors lie aslant off their middle": (
        line(127, 0.004) + moved(ALTERNATE[:127], [2.5, 2.5, 0]),
        line(127, 0.004) - moved(ALTERNATE[:127], [2.5, 2.5, 0]),
        None,
    ),
    "odd receivers are fast": (line(), line(), moved(ALTERNATE, [0, 60, 0])),
    "one ping far from its neighbours": (line() + moved(np.arange(128) == 57, [0, 4, 0]), line(), None),
    "fixed transmitter": (0 * line(), line(), None),
    "fixed receiver aside": (line(), 0 * line() + [0, -6, 0], None),
    "two clusters": (np.where(ALTERNATE[:, None], 1.2, -1.2) * [1.0, 0, 0] + 1e-3 * line(), None, None),
}


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name, tol", [(n, t) for n in DIFFERING for t in TOLS if t > 1e-4 or n not in TOO_NEAR])
def test_traces_that_differ_from_their_neighbours(name, tol, backend):
    tx, rx, velocity = DIFFERING[name]
    echoes, error = survey(tx, tx if rx is None else rx, grid := plane(), tol, samples=3000, before=1300, velocity=velocity)
    image = pysas.ffbp(echoes, grid, tol, fallback=False, backend=backend)
    assert image.report.factorised_share == 1 and error(image) <= 1
    assert image.report.predicted_error <= tol


# a place of the image in metres, a track's length, pixels (x, y), over-sampling
SHORT = {
    "squinted": ((3.86, -2.06), 0.0875, (130, 1), 1.15),
    "squinted, few samples before": ((3.86, -2.06), 0.5, (64, 64), 1.15),
    "ahead": ((4.37, 0.0), 0.0875, (64, 16), 1.15),
    "abeam": ((0.0, 4.37), 0.0875, (64, 16), 1.15),
    "abeam, longer": ((0.0, 6.0), 2.0, (16, 64), 1.15),
    "squinted, over-sampled": ((3.86, -2.06), 0.3, (64, 16), 3.0),
    "carrier below the band": ((3.0, 2.0), 0.5, (64, 16), 1.15),
}


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name, tol", [(n, t) for n in SHORT for t in TOLS if t > 1e-4 or n not in TOO_NEAR])
def test_short_groups_with_few_rays(name, tol, backend):
    (x, y), length, (nx, ny), over = SHORT[name]
    tx = line(61, length / 60)
    grid = plane(x, y, nx, ny, 0.006)
    echoes, error = survey(tx, tx, grid, tol, before=700, over=over, fc=18e3 if name.startswith("carrier") else FC)
    image = pysas.ffbp(echoes, grid, tol, fallback=False, backend=backend)
    assert image.report.factorised_share == 1 and error(image) <= 1


@pytest.mark.parametrize("fallback", [True, False])
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("name", ["odd pings late", "one ping late", "random"])
def test_records_that_begin_at_different_times(monkeypatch, name, backend, fallback):
    """Of 128 pings fewer than a sample of them were seen to miss part of the image."""
    monkeypatch.setattr("pysas.engine.cpp.TREES_MUST_PAY", False)
    late = {"odd pings late": ALTERNATE, "one ping late": np.arange(128) == 57, "random": np.random.default_rng(5).random(128)}
    t0 = 2 * 17.0 / C + 2 * 3.6 / C * late[name]
    echoes, error = survey(line(), line(), grid := plane(), 1e-3, t0=t0, samples=900)
    if fallback:
        assert error(pysas.ffbp(echoes, grid, 1e-3, backend=backend)) <= 1
    else:
        with pytest.raises(ValueError, match="expected all terms to go through the tree"):
            pysas.ffbp(echoes, grid, 1e-3, fallback=False, backend=backend)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("tol", [1e-2, 1e-4])
@pytest.mark.parametrize("over", [1.33, 2.5, 4.0, 8.0])
def test_over_sampled_records_that_begin_beside_the_image(monkeypatch, over, tol, backend):
    """Tables must hold what a record's end rings with, up to half the sample rate, however few nodes the band needs."""
    monkeypatch.setattr("pysas.engine.cpp.TREES_MUST_PAY", False)
    tx = line(192)
    echoes, error = survey(tx, tx, grid := plane(ny=128), tol, samples=300, before=4, over=over)
    image = pysas.ffbp(echoes, grid, tol, backend=backend)
    assert error(image) <= 1


@pytest.mark.parametrize(
    "width, rate, half", [(6, 1.2, 8), (6, 1.45, 8), (8, 1.4, 10), (8, 1.6, 10), (8, 1.31, 8), (8, 1.7, 8)]
)
@pytest.mark.parametrize("bearing", [0.0, 0.5, 1.2, np.pi / 2])
@pytest.mark.parametrize("length", [0.05, 0.3, 1.5, 8.0])
def test_rays_hold_the_spectrum_of_the_outermost_traces(width, rate, half, bearing, length):
    """Echoes of the traces at a group's ends, sampled on its rays and read between them, against themselves: Kaiser-Bessel taps
    as they are used, delays written out here."""
    taps = tree.taps(width, rate, half)
    away = max(4.0, 2.5 * length)
    ends = np.array([[-length / 2, 0, 0], [length / 2, 0, 0]])
    trace = np.zeros(2, TRACE)
    trace["tx"] = trace["rx"] = ends
    medium = SimpleNamespace(c=C, fc=FC, fs=FS, band=B / 2 / FS)
    low, high = bearing - 0.05, bearing + 0.05
    beam, _ = subapertures.spacing(trace, np.zeros(3), medium, 0.0, (low, high), (away, away + 1), taps)

    def echo(angle):
        distance = np.sqrt(away**2 + length**2 / 4 - np.outer([-1, 1], away * length * np.cos(angle)))
        return np.exp(4j * np.pi * ((FC + B / 2) * distance - FC * away) / C)

    offset = np.arange(-half - width // 2 + 1, half + width // 2 + 1)
    kernel = np.concatenate([taps.filter[:0:-1], taps.filter]).astype(float)
    worst = 0.0
    for first in np.linspace(low, high, 23):
        smooth = np.array([np.convolve(row, kernel, "valid") for row in echo(first + offset * beam)])
        for x in np.linspace(-0.5, 0.5, 5):
            weights = np.polynomial.polynomial.polyval(x, taps.tap[:, :width].astype(float))
            read = smooth @ weights
            worst = max(worst, float(np.max(np.abs(read - echo(np.array([first + (0.5 + x) * beam]))[:, 0]))))
    assert worst <= 1.3 * taps.worst


def test_sub_images_of_too_many_nodes_are_not_made():
    """Pixels of a metre, pings far apart: nodes would be ten thousand times as many as the pixels."""
    tx = line(128, 0.3)
    echoes, error = survey(tx, tx, grid := plane(y=40.0, step=1.0), 1e-2, samples=3000, before=1300)
    image = pysas.ffbp(echoes, grid, 1e-2, backend="numba")
    assert image.report.notes == ("summed directly: a tree would take longer",) and error(image) <= 1
    with pytest.raises(ValueError, match="expected all terms to go through the tree, found: a tree would take longer"):
        pysas.ffbp(echoes, grid, 1e-2, fallback=False, backend="numba")


def test_a_fixed_transmitter_is_cut_by_its_phase_centres():
    """Pieces of the transmitter's own path, which has no length, were as many as the pings."""
    tx = 0 * line(512)
    echoes, _ = survey(tx, line(512), grid := plane(ny=128), 1e-2, samples=3000, before=1300)
    plan = pysas.plan(echoes, grid, 1e-2, "ffbp", fallback=False)
    assert plan.by.trees <= 8


def test_tracks_are_cut_into_no_more_pieces_than_they_have_pings():
    """However many are asked for: a platform that stands still while its receivers drift has almost no path."""
    centres = np.linspace(0, 1e-3, 7)[:, None] * np.array([1.0, 0, 0])
    pieces = subapertures.cut_track(np.repeat(centres, 2, axis=0), np.repeat(np.arange(7), 2), 1e-12, 1, 1000)
    assert [list(piece) for piece in pieces] == [[2 * i, 2 * i + 1] for i in range(7)]
    velocity = np.where(ALTERNATE[:, None], 30.0, -30.0) * [1.0, 0, 0]
    echoes, error = survey(0 * line(), 0 * line(), grid := plane(nx=16, ny=16), 1e-2, before=700, velocity=velocity)
    plan = pysas.plan(echoes, grid, 1e-2, "ffbp")
    assert error(plan(echoes.data)) <= 1
