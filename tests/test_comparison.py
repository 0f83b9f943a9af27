"""Methods side by side: what is judged against a known answer, what is stopped or does not apply, the command line."""

import json
import signal
import threading
import time
import warnings
from dataclasses import replace

import numpy as np
import pytest

import pysas
from pysas import cli, comparison
from pysas.comparison.limit import TooLongError, at_most

PULSE = pysas.LFM(100e3, 15e3, 1e-3, "tukey", 0.3)
GRID = pysas.Grid.plane(0.01 * np.arange(-40, 41), 8.0 + 0.01 * np.arange(-40, 41))


def survey(channels=None):
    """Raw echoes of one point from a straight track; `channels`: receivers that move."""
    track = pysas.tracks.straight(41, 0.04, 2.0, start=(-0.8, 0.0, 0.0))
    rx = track.position if channels is None else pysas.tracks.array(track, channels, 0.02)
    return pysas.simulate(
        [[0.0, 8.0, 0.0]], [1.0], PULSE, tx=track.position, rx=rx, fs=40e3, t0=0.009, duration=0.004,
        velocity=None if channels is None else track.velocity,
    )  # fmt: skip


@pytest.fixture(scope="module")
def raw():
    return survey()


@pytest.fixture(scope="module")
def echoes(raw):
    return pysas.compress(raw)


@pytest.fixture(scope="module")
def answer(echoes):
    return pysas.reference.exact(echoes, GRID)[0]


def giving(data, echoes):
    return lambda: pysas.Image(data, GRID, pysas.Report("given"), echoes.fc, echoes.c)


def row(seconds, error, method="m"):
    pair = (None, None)
    return comparison.Row(method, "", seconds, seconds, seconds, 1, 0.0, 0.0, (1, 1), 1.0, error, False, None, pair, pair, 0.0)


def test_front_holds_what_no_other_beats():
    rows = [row(1.0, 1e-3), row(2.0, 1e-2), row(0.5, 1e-1), row(3.0, 1e-4), row(3.0, 1e-5), row(4.0, 1e-5), row(0.7, np.nan)]
    assert comparison.front(rows) == [2, 0, 4]
    assert comparison.front([]) == []


@pytest.mark.parametrize("eps", [1e-1, 1e-3, 1e-6])
def test_an_image_off_by_eps_has_error_eps(echoes, answer, eps):
    found = comparison.compare(echoes, {("given", "scaled"): giving(answer * (1 + eps), echoes)}, rounds=1, count=50)
    (only,) = found.rows
    assert only.error == pytest.approx(eps, rel=1e-6)  # on the cuts the coherent sum is above the incoherent level
    assert only.loss == pytest.approx(-20 * np.log10(1 + eps), rel=1e-6)
    assert only.irw == pytest.approx(found.irw) and only.pslr == pytest.approx(found.pslr)
    # 0.886 c/(2 B) is the width of a flat band, which the pulse's taper widens
    assert 0.886 * 1500 / 30e3 < found.irw[1] < 1.3 * 0.886 * 1500 / 30e3
    assert only.shape == found.shape == GRID.shape and only.runs == 1 and only.terms_per_second > 0


def test_an_error_away_from_the_strongest_pixel_is_seen(echoes, answer):
    """Random pixels: a point that is not there, far from the cuts."""
    wrong = answer.copy()
    wrong[2:14, 2:14] += 0.5 * np.abs(answer).max()
    calls = {("given", "right"): giving(answer, echoes), ("given", "wrong"): giving(wrong, echoes)}
    right, wrong = comparison.compare(echoes, calls, rounds=1).rows
    assert right.error == 0 and wrong.error > 0.1 and wrong.loss == 0


def test_law_of_range_and_one_factor_are_free_where_said(echoes, answer):
    data = answer * (3 - 4j) / np.sqrt(GRID.axes["y"])[:, None]
    calls = {(name, ""): giving(data, echoes) for name in ("range-Doppler", "chirp scaling", "another")}
    rows = comparison.compare(echoes, calls, rounds=1).rows
    assert [r.fitted for r in rows] == [True, True, False]
    assert max(r.error for r in rows[:2]) < 1e-12 and rows[2].error > 0.5


def test_methods_that_run_and_their_table(raw, echoes):
    every = comparison.methods(echoes, GRID, [1e-2, 1e-4], raw=raw, fewer=True)
    wanted = {"backproject", "ffbp", "omega-k", "range-Doppler", "chirp scaling"}
    calls = {key: call for key, call in every.items() if key[0] in wanted and key[1] not in ("cubic, zp 2", "linear, zp 8")}
    calls |= {key: call for key, call in comparison.methods(echoes, GRID, []).items() if key[0] == "chirp scaling"} | {
        ("chirp scaling", "from raw"): every["chirp scaling", "raw echoes"]
    }
    shares = []
    found = comparison.compare(echoes, calls, rounds=2, progress=shares.append)
    assert {(r.method, r.setting) for r in found.rows} == calls.keys() - {("chirp scaling", "raw echoes")}
    assert found.left_out == {"chirp scaling, raw echoes": "echoes: compressed: expected raw ones"}
    assert shares == sorted(shares) and shares[-1] == 1
    for r in found.rows:
        if r.setting.startswith("tol "):
            assert r.error <= float(r.setting.removeprefix("tol "))
        assert r.least <= r.seconds <= r.most and r.runs == 2
    text = comparison.table(found)
    lines = text.splitlines()
    assert [line.split(" | ")[0].removeprefix("| ") for line in lines[4 : 4 + len(found.rows)]] == [
        r.method for r in found.rows
    ]
    assert sum(line.endswith("front |") for line in lines[4:]) == len(comparison.front(found.rows))
    assert "- chirp scaling, raw echoes: echoes: compressed: expected raw ones" in lines and "MB" not in lines[2]
    figure = comparison.figure({"one": found, "two": replace(found, rows=found.rows[:1])} | {"three": found, "four": found})
    assert len(figure.axes) == 4 and [ax.get_title() for ax in figure.axes[:2]] == ["one", "two"]
    (legend,) = figure.legends
    assert {t.get_text() for t in legend.get_texts()} == {r.method for r in found.rows} | {"Pareto front"}
    named = {t.get_text() for t in figure.axes[0].texts}
    assert named == {r.setting for r in found.rows if r.method in ("omega-k", "range-Doppler")}


def forever():
    for _ in range(6000):
        time.sleep(0.01)
    raise AssertionError("not stopped")


def test_what_takes_too_long_is_stopped_and_named(echoes, answer):
    keys = [("forever", "a"), ("fourier_image, gridding", "b"), ("fourier_image, frame", "b"), ("given", "")]
    calls = dict(zip(keys, [forever, forever, forever, giving(answer, echoes)], strict=True))
    found = comparison.compare(echoes, calls, rounds=1, limit=0.3)
    assert [r.method for r in found.rows] == ["given"]
    assert found.left_out["forever, a"] == "longer than 0.3 s"
    assert (
        found.left_out["fourier_image, frame, b"]
        == "not tried: fourier_image, gridding, many times cheaper, takes more than 0.03 s"
    )


@pytest.mark.parametrize("before", [signal.default_int_handler, signal.SIG_IGN])
def test_a_limit_is_no_ctrl_c_and_leaves_the_handler(before):
    """SIG_IGN is what a shell gives its background jobs."""
    kept = signal.signal(signal.SIGINT, before)
    try:
        with pytest.raises(TooLongError, match=r"longer than 0\.05 s"), at_most(0.05):
            forever()
        assert signal.getsignal(signal.SIGINT) is before
        if before is not signal.SIG_IGN:
            with pytest.raises(KeyboardInterrupt), at_most(60.0):
                signal.raise_signal(signal.SIGINT)
        for _ in range(200):  # a stop that comes as the work ends is neither lost in what follows nor raised there
            try:
                with at_most(0.001):
                    time.sleep(0.001)
            except TooLongError:
                pass
        time.sleep(0.01)
        assert signal.getsignal(signal.SIGINT) is before
    finally:
        signal.signal(signal.SIGINT, kept)


def test_elsewhere_than_in_the_main_thread_a_run_ends_first(echoes, answer):
    def slow():
        time.sleep(0.2)
        return giving(answer, echoes)()

    found = []
    calls = {("slow", ""): slow, ("given", ""): giving(answer, echoes)}
    thread = threading.Thread(target=lambda: found.append(comparison.compare(echoes, calls, rounds=1, limit=0.1)))
    thread.start()
    thread.join()
    assert found[0].left_out == {"slow, ": "longer than 0.1 s"} and len(found[0].rows) == 1


def test_warnings_are_kept_with_their_method(echoes, answer, recwarn):
    def warns():
        warnings.warn("of something", stacklevel=1)
        return giving(answer, echoes)()

    found = comparison.compare(echoes, {("warns", "a"): warns}, rounds=2)
    assert found.warned == {"warns, a": "of something"} and len(recwarn) == 0
    assert "Warned of:\n\n- warns, a: of something" in comparison.table(found)


@pytest.mark.parametrize(
    ("change", "error", "text"),
    [
        ({"calls": {}}, ValueError, "calls: expected at least one"),
        ({"calls": {("a", "b"): lambda: 3}}, TypeError, "found int returned"),
        ({"limit": 0.0}, ValueError, "limit=0.0"),
        ({"rounds": 0}, ValueError, "rounds=0"),
        ({"count": 0}, ValueError, "count=0"),
        ({"target": (0.0, 8.0)}, ValueError, "expected both or neither"),
        ({"target": (0.0, np.nan), "half": (1.0, 1.0)}, ValueError, "target: nan"),
    ],
)
def test_border(echoes, answer, change, error, text):
    calls = change.pop("calls", {("given", ""): giving(answer, echoes)})
    with pytest.raises(error, match=text):
        comparison.compare(echoes, calls, **change)


def test_border_of_echoes(raw, echoes, answer):
    calls = {("given", ""): giving(answer, echoes)}
    with pytest.raises(ValueError, match="compressed=False"):
        comparison.compare(raw, calls)
    data = echoes.data.copy()
    data[3, 5] = np.nan
    with pytest.raises(ValueError, match="ping 3, channel 0, sample 5"):
        comparison.compare(echoes.replace(data=data), calls)
    with pytest.raises(ValueError, match="none runs; chirp scaling, raw echoes: echoes: compressed"):
        comparison.compare(
            echoes, {("chirp scaling", "raw echoes"): comparison.methods(echoes, GRID)["chirp scaling", "raw echoes"]}
        )


def test_command_line(tmp_path, capsys):
    beam = pysas.Beam([0.0, 1.0, 0.0], 0.05, 0.6)
    pysas.save(tmp_path / "raw.npz", survey(2).replace(beam=beam))
    spans = ["--x", "-0.3:0.3", "--y", "7.7:8.3", "--spacing", "0.02"]
    paths = {"-o": tmp_path / "table.md", "--png": tmp_path / "figure.png"}
    options = [str(part) for pair in paths.items() for part in pair]
    code = cli.main(["compare", str(tmp_path / "raw.npz"), *spans, *options, "--json", "--threads", "1"])
    out = capsys.readouterr()
    found = json.loads(out.out)
    assert code == 0 and out.err == "" and paths["--png"].read_bytes().startswith(b"\x89PNG")
    rows = [(r["method"], r["setting"]) for r in found["rows"]]
    assert rows[:10] == [(name, f"tol {tol:g}") for name in ("backproject", "ffbp") for tol in comparison.TOLS]
    assert found["traces"] == 82 and found["shape"] == [31, 31] and found["front"]
    text = paths["-o"].read_text()
    # an array's phase centres are made for what takes one channel
    assert {
        ("omega-k", "sinc, zp 2"),
        ("range-Doppler", "linear"),
        ("one-way", "45 degrees"),
        ("chirp scaling", "raw echoes"),
    } <= {*rows}
    assert "82 phase centres, made even (2 channels)" in text and found["notes"][0] in text
    assert "a beam ends within patches" in found["left_out"]["fourier_image, nufft, error 1e-02"]
    assert text.startswith("raw.npz: 82 traces") and text.count("| backproject |") == 5
    code = cli.main(["compare", str(tmp_path / "raw.npz"), *spans, "--tol", "1e-1", "1e-3"])
    out = capsys.readouterr()
    assert code == 0 and out.out.count("| backproject |") == 2 and "comparing" in out.err


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (["--tol", "1e-9"], "tol=1e-09"),
        (["--limit", "-1"], "limit=-1"),
        (["--png", "x.xyz"], "found suffix '.xyz'"),
        (["-o", "nowhere/x.md"], "no such folder"),
        (["--threads", "0"], "threads=0"),
        (["--grid", "polar.npz"], "found polar"),
    ],
)
def test_what_cannot_be_compared_is_said_before_the_work(raw, tmp_path, monkeypatch, capsys, options, text):
    monkeypatch.chdir(tmp_path)
    pysas.save("raw.npz", raw)
    polar = pysas.Grid.polar(np.linspace(7, 9, 5), np.linspace(1, 2, 5))
    pysas.save("polar.npz", pysas.Image(np.ones(polar.shape, complex), polar, pysas.Report("given"), 100e3, 1500.0))
    code = cli.main(["compare", "raw.npz", *options])
    out = capsys.readouterr()
    assert code == 2 and out.out == "" and text in out.err and "compressing" not in out.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["polar.npz", "raw.npz"]
