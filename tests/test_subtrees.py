"""Trees grown in C++ are those grown in Python: two programs of one geometry, each the other's check."""

from fractions import Fraction

import numpy as np
import pytest
from test_factorised import CASES, TRACKS, plane, tracked

import pysas
from pysas.engine import engine_of
from pysas.planning import forest, tiles

pytestmark = pytest.mark.cpp
SCENES = CASES | {name: (lambda name=name: tracked(TRACKS[name]), plane(130, 100, 26.0)) for name in TRACKS}


def leaves(tree):
    """Traces of each leaf, as sets, and its place, shape and ranges; parts of a group may come in either order."""
    found = {}
    level = tree.subtree.levels[0]
    for i in range(len(level)):
        first, rays = level.shape[i, 4], level.shape[i, 1]
        traces = frozenset(tree.order[level.span[i] : level.span[i + 1]].tolist())
        found[traces] = level.place[i], level.shape[i, :2], level.range[first : first + rays]
    return found


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("tol", [1e-2, 1e-4])
def test_both_builders_grow_the_same_trees(name, tol):
    make, grid = SCENES[name]
    plan = pysas.plan(make(), grid, tol, "ffbp", backend="cpp", fallback=False)
    near, layout, raster = plan.choices.near, plan.forest.layout, plan.forest.raster
    one, other = (
        forest.make_forest(
            plan.scene, raster, tiles.sections(raster), layout, near, 0.2 * tol, Fraction(0), True, engine_of(name)
        )
        for name in ("numba", "cpp")
    )
    assert one.rate == other.rate and one.share == other.share == 1 and len(one.trees) == len(other.trees)
    assert np.array_equal(one.scene.first, other.scene.first) and np.array_equal(one.scene.last, other.scene.last)
    for a, b in zip(one.trees, other.trees, strict=True):
        assert np.array_equal(a.read, b.read) and np.array_equal(np.sort(a.order), np.sort(b.order))
        expected, found = a.subtree.levels, b.subtree.levels
        assert [len(level) for level in found] == [len(level) for level in expected]
        assert [level.size for level in found] == [level.size for level in expected]
        assert [level.nodes for level in found] == [level.nodes for level in expected]
        assert np.allclose(found[-1].place, expected[-1].place, rtol=1e-9, atol=1e-9)
        assert np.array_equal(found[-1].range, expected[-1].range)
        mine, theirs = leaves(a), leaves(b)
        assert mine.keys() == theirs.keys()
        for traces, (place, shape, ranges) in mine.items():
            assert np.allclose(theirs[traces][0], place, rtol=1e-9, atol=1e-9)
            assert np.array_equal(theirs[traces][1], shape) and np.array_equal(theirs[traces][2], ranges)
