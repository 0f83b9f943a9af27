"""Mistakes that data show, made with good surveys of `bench.mistake_scenes`: each is named, and good data are told nothing."""

from __future__ import annotations

import importlib
import json
from typing import Any

import numpy as np
import pytest

import pysas
from pysas.cli import main
from pysas.inspection.wavefront import Echo, fit, lateness

mistakes: Any = importlib.import_module("bench.mistakes")
scenes: Any = importlib.import_module("bench.mistake_scenes")

# points on a line, compressed; speckle on an arc, raw
FAST = [scenes.SCENES[i] for i in (9, 13)]


@pytest.fixture(scope="module", params=FAST, ids=lambda scene: scene.name)
def case(request: pytest.FixtureRequest) -> Any:
    (made,) = mistakes.cases(0, [request.param])
    return made


def test_good_data_are_told_nothing(case: Any) -> None:
    assert mistakes.spoken(case.echoes) == []
    assert mistakes.spoken(pysas.compress(case.echoes)) == []


@pytest.mark.reference
def test_mistakes_are_named(case: Any) -> None:
    """All of those that these data can show, which are most of them."""
    shown = [mistake for mistake in mistakes.MISTAKES if mistake.shown(case)]
    assert len(shown) >= 0.7 * len(mistakes.MISTAKES)
    found = {mistake.name: mistakes.named(mistake, case.with_mistake(mistake)) for mistake in shown}
    assert {name: said for name, (right, said) in found.items() if not right} == {}


def test_the_same_file_is_told_the_same(case: Any) -> None:
    (mistake,) = (m for m in mistakes.MISTAKES if m.name == "pings shuffled")
    echoes = case.with_mistake(mistake)
    assert pysas.inspect(echoes) == pysas.inspect(echoes)


def test_measured_data_are_told_nothing(data_dir: Any) -> None:
    assert {name: mistakes.spoken(echoes) for name, echoes in scenes.measured().items()} == {
        "stripmap_perturbed": [], "circular": [], "gotcha": [],
    }  # fmt: skip


@pytest.mark.slow
def test_the_whole_table() -> None:
    """At least 95 % of the scenes that can show a mistake name it; at most 1 % of good ones are told of any."""
    rows, said = mistakes.table()
    assert {name: said[name] for name in said if said[name]} == {}
    # of fewer than twenty scenes one may miss it
    missed = {name: (right, count) for name, _, right, count, _ in rows if right < min(0.95 * count, count - 1)}
    assert missed == {} and sum(row[2] for row in rows) >= 0.98 * sum(row[3] for row in rows)


@pytest.mark.slow
def test_good_data_of_more_seeds_are_told_nothing() -> None:
    told = [
        (case.name, seed, words)
        for seed in range(1, 6)
        for case in mistakes.cases(seed, scenes.SCENES)
        for echoes in (case.echoes, pysas.compress(case.echoes))
        if (words := mistakes.spoken(echoes))
    ]
    assert len(told) <= 2, told  # 1 % of 200


def test_a_place_is_fitted_to_exact_delays() -> None:
    """Delays and phases written down from the distances of a place: it is found again, and a late start as what it is."""
    place = np.array([0.3, 20.0, -3.0])
    x = np.arange(-48, 48) * 0.025
    tx = np.stack([x, 0.1 * np.sin(3 * x), 0.05 * np.cos(2 * x)], axis=1)
    rx = tx[:, None] + np.array([0.0, 0.1, 0.3])[:, None] * np.array([1.0, 0.0, 0.0])
    delay = (np.linalg.norm(place - tx, axis=1)[:, None] + np.linalg.norm(place - rx, axis=2)) / 1500.0
    phase = np.angle(np.exp(-2j * np.pi * (1e5 * delay % 1)))
    echo = Echo(delay, phase, tx, rx, np.arange(96), 1500.0, 1e5, 20e3)
    found = fit(echo)
    assert found.coherence > 0.9999 and np.linalg.norm(found.place - place) < 1e-3
    assert abs(lateness(found)[0]) < 1e-7
    wrong = fit(Echo(delay, -phase, tx, rx, np.arange(96), 1500.0, 1e5, 20e3))
    assert wrong.coherence < 0.5
    late = fit(Echo(delay + 1e-3, phase, tx, rx, np.arange(96), 1500.0, 1e5, 20e3), late=True)
    assert late.coherence > 0.999 and late.late == pytest.approx(1e-3, rel=0.02)


def noisy(**changes: Any) -> pysas.Echoes:
    """White noise of 4 receivers."""
    rng = np.random.default_rng(5)
    tx = np.stack([0.1 * np.arange(40.0), np.zeros(40), np.full(40, 5.0)], axis=1)
    rx = tx[:, None] + np.array([0.0, 0.05, 0.1, 0.15])[:, None] * np.array([1.0, 0.0, 0.0])
    data = (rng.standard_normal((40, 4, 300)) + 1j * rng.standard_normal((40, 4, 300))).astype(np.complex64)
    fields = {"data": data, "fs": 40e3, "fc": 100e3, "tx": tx, "rx": rx, "bandwidth": 30e3, "compressed": False} | changes
    fields.setdefault("pulse", pysas.LFM(100e3, 30e3, 1e-3))
    return pysas.Echoes(fields.pop("data"), **fields)


@pytest.mark.parametrize("pings", [8, 33, 140])
@pytest.mark.parametrize("channels", [1, 4, 16])
def test_noise_is_told_nothing(pings: int, channels: int) -> None:
    """White noise has no order, sweep or place: by chance some pings are alike."""
    rng = np.random.default_rng([pings, channels])
    tx = np.stack([0.05 * channels * np.arange(pings), 0.1 * np.sin(np.arange(pings) / 20), np.full(pings, 5.0)], axis=1)
    rx = tx[:, None] + np.arange(channels)[:, None] * np.array([0.1, 0.0, 0.0])
    for n in (60, 400):
        data = rng.standard_normal((2, pings, channels, n)).astype(np.float32)
        echoes = noisy(data=data[0] + 1j * data[1], tx=tx, rx=rx)
        assert mistakes.spoken(echoes) == []
        assert mistakes.spoken(pysas.compress(echoes)) == []


@pytest.mark.parametrize(("single", "double"), [(1e-35, 1e-300), (1e36, 1e300)])
def test_levels_of_any_size(single: float, double: float) -> None:
    """Squares of which neither dtype holds."""
    data = noisy().data
    assert mistakes.spoken(noisy(data=data * np.float32(single))) == []
    assert mistakes.spoken(noisy(data=data.astype(np.complex128) * double)) == []


def test_what_is_no_echoes() -> None:
    with pytest.raises(TypeError, match="echoes=str: expected"):
        pysas.inspect("survey.npz")  # type: ignore[arg-type]


def test_image_says_what_check_finds(tmp_path: Any, capsys: pytest.CaptureFixture[str]) -> None:
    echoes = noisy()
    pysas.save(tmp_path / "cast.npz", echoes.replace(data=echoes.data.real.astype(np.complex64)))
    spans = ["--x=1:1.2", "--y=1:1.2", "--spacing", "0.05"]
    assert main(["image", str(tmp_path / "cast.npz"), *spans, "--json"]) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["shape"] == [5, 5]
    assert "pysas: warning: FAIL, no image of these echoes can be right: base-band: imaginary parts are all zero" in err
    assert main(["check", str(tmp_path / "cast.npz")]) == 1
    assert "FAIL  base-band" in capsys.readouterr().out
