"""The promise of `tol` on scenes drawn at random; `python tests/promise.py SEED` runs the scene of one seed alone."""

import faulthandler
import os
from dataclasses import replace

import numpy as np
import promise
import promise_oracle as oracle
import promise_scenes
import promise_trial
import pytest
from promise_trial import Outcome, Way
from scenes import PLANE, moving

import pysas

SCENES = 200
LONGEST = 60.0


def broken_of(draw, first):
    """What of ten seeds from the first on is broken; a hang names the test, and its traceback is the scene's."""
    broken = []
    for seed in range(first, first + 10):
        faulthandler.dump_traceback_later(LONGEST, exit=True)
        try:
            broken += [promise.words(o) for o in promise_trial.trial(draw(seed)) if o.verdict == "broken"]
        finally:
            faulthandler.cancel_dump_traceback_later()
    return broken


@pytest.mark.parametrize("first", range(0, SCENES, 10))
def test_promise_is_kept(first):
    """Each seed by one instruction set, some by Numba, and by the C library where its structs can say it."""
    broken = broken_of(promise_scenes.draw, first)
    assert not broken, "\n" + "\n".join(broken)


@pytest.mark.parametrize("first", range(0, SCENES // 2, 10))
def test_promise_is_kept_of_what_was_recorded_at_each_pings_speed(first):
    """The same of scenes with a sound speed a ping, with windows of what was recorded, or padded with NaN."""
    broken = broken_of(promise_scenes.recorded, first)
    assert not broken, "\n" + "\n".join(broken)


@pytest.mark.parametrize("seed", [705, 1288, 1351, 2297, 1982, 3190, 31103, 32430, 30248])
def test_promise_is_kept_where_it_was_broken(seed):
    """Blasts alike in all traces of one place, relief between sensors, sensors apart in every other ping, tails of impulses,
    images that lie between two nodes, an image in C that its type holds to within a third of tol."""
    broken = [promise.words(o) for o in promise_trial.trial(promise_scenes.draw(seed)) if o.verdict == "broken"]
    assert not broken, "\n" + "\n".join(broken)


@pytest.mark.slow
def test_promise_is_kept_by_every_engine():
    """All ways of 5,000 scenes; PYSAS_PROMISE names another first seed and number, such as 5000:20000."""
    first, count = map(int, os.environ.get("PYSAS_PROMISE", "0:5000").split(":"))
    outcomes = list(promise.run(list(range(first, first + count)), True, os.cpu_count() or 1))
    print(promise.table(outcomes))
    broken = [promise.words(o) for o in outcomes if o.verdict == "broken"]
    assert not broken, "\n" + "\n".join(broken)


@pytest.mark.reference
def test_scenes_are_of_every_kind():
    """What the seeds of CI draw: every family, track, array, grid and kind of data, and enough trees to mean something."""
    drawn = [promise_scenes.draw(seed) for seed in range(SCENES)]
    assert {scene.family for scene in drawn} == set(promise_scenes.FAMILIES)
    for kinds in (promise_scenes.TRACKS, promise_scenes.ARRAYS, promise_scenes.DATA):
        for kind in kinds:
            assert any(kind in scene.words.split(", ") or f"{kind} x" in scene.words for scene in drawn), kind
    assert {scene.grid.kind for scene in drawn} == {"plane", "polar", "surface", "volume", "points"}
    assert {scene.nan for scene in drawn} == {"raise", "mask"}
    assert any(scene.echoes.n_ping == 1 for scene in drawn) and any(scene.echoes.n_sample == 1 for scene in drawn)
    assert any(scene.echoes.n_ping == 2048 for scene in drawn)
    assert any(scene.echoes.fc < scene.echoes.occupied_bandwidth for scene in drawn)
    beams = [scene.echoes.beam for scene in drawn if scene.echoes.beam is not None]
    kinds = {(beam.shape, beam.taper > 0) for beam in beams}
    assert kinds == {("fan", False), ("fan", True), ("cone", False), ("cone", True)}
    assert {0.0, 0.5, 1.0} <= {beam.taper for beam in beams}
    assert any(beam.axis is not None and np.abs(np.sum(beam.axes * beam.boresights, axis=1)).max() > 0.1 for beam in beams)
    again = promise_scenes.draw(17)
    assert np.array_equal(again.echoes.data, drawn[17].echoes.data) and again.tol == drawn[17].tol


@pytest.mark.reference
def test_oracle_is_the_definition():
    """Its kernel is W's transform, its delay solves c tau = |x - tx| + |x - rx - v tau|, its sum is that of the reference."""
    f = (np.arange(200_000) + 0.5) / 400_000
    edge = np.clip((f - 1 / 2.2) / (0.5 - 1 / 2.2), 0, 1)
    for t in (0.0, 0.3, 1.0, 11.0, 10.999, 37.2):  # 11: x = 1
        assert oracle.kernel(t) == pytest.approx(np.mean(np.cos(np.pi / 2 * edge) ** 2 * np.cos(2 * np.pi * f * t)), abs=1e-9)
    rng = np.random.default_rng(1)
    for _ in range(50):
        e, v = rng.standard_normal(3) * 40, rng.standard_normal(3) * 40
        tau = oracle.delay(25.0, e, v, 1500.0)
        assert 1500.0 * tau == pytest.approx(25.0 + np.linalg.norm(e - v * tau), rel=1e-14)
    echoes = moving()
    pixels = np.arange(0, PLANE.size, 111)
    image, level, _ = oracle.direct_sum(echoes, PLANE.coordinates(pixels))
    exact, reference = pysas.reference.exact(echoes, PLANE, pixels)
    assert pysas.metrics.relative_error(image, exact, reference) < 1e-11
    assert np.allclose(level, reference, rtol=1e-11)


@pytest.mark.parametrize("engine", [pytest.param("cpp", marks=pytest.mark.cpp), "numba"])
def test_what_is_wrong_is_found(engine, monkeypatch):
    """An image twice as far off as allowed, a silent zero, a NaN, an unknown error: broken; the image as made is kept."""
    scene = replace(promise_scenes.draw(0), echoes=moving(), grid=PLANE, tol=1e-3, weights=None, lenient=False)
    known, way = promise_trial.truth(scene), Way(engine, "backproject")
    made, report = promise_trial.image(scene, way)
    level = np.sqrt(np.mean(np.abs(known.image) ** 2) + np.mean(known.level**2))

    def verdict(found):
        def image(*_):
            if isinstance(found, Exception):
                raise found
            return found, report

        monkeypatch.setattr(promise_trial, "image", image)
        return promise_trial.judge(scene, known, way).verdict

    assert verdict(made) == "kept"
    assert verdict(made + 2e-3 * level) == "broken"
    assert verdict(np.zeros_like(made)) == "broken"
    assert verdict(np.where(np.arange(made.shape[1]) == 3, np.nan, made)) == "broken"
    assert verdict(ValueError("fs: expected something else")) == "broken"
    assert verdict(AssertionError()) == "broken"
    assert verdict(ValueError("tol=1e-9: complex64 data over 20 m reach 1e-05 at best")) == "refused"


def test_table_of_outcomes():
    some = ((1, "kept", 0.5, ""), (2, "broken", 3.0, "why"), (3, "told", 1.5, ""))
    outcomes = [Outcome(seed, "cpp focus", verdict, ratio, words) for seed, verdict, ratio, words in some]
    row = promise.table(outcomes).splitlines()[1].split()
    assert row == ["cpp", "focus", "1", "1", "0", "0", "0", "1", "1.500", "3"]
    assert promise.words(outcomes[1]) == "seed 2: cpp focus: broken, error 3 tol why"


@pytest.mark.slow
def test_a_worker_that_dies_names_its_seed(monkeypatch):
    """The next seed is judged by another."""

    class Dying(promise.Worker):
        def take(self, seed):
            super().take(seed)
            if seed == 0:
                self.process.kill()

    monkeypatch.setattr(promise, "Worker", Dying)
    first, *others = promise.run([0, 20], False, 1)
    assert (first.seed, first.verdict, first.words) == (0, "broken", "the process died")
    assert others and {o.seed for o in others} == {20}
