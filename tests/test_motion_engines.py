"""Tracks found through either engine are one: a short line, as the engine in Numba reads some thousand samples a second."""

import numpy as np
import pytest
from motion_scenes import scene

import pysas


@pytest.mark.parametrize("engine", [pytest.param("cpp", marks=pytest.mark.cpp), "numba"])
def test_a_short_line(engine, monkeypatch):
    monkeypatch.setenv("PYSAS_BACKEND", engine)
    _, claim, truth = scene(pings=6, swath=(20.0, 24.0), density=30.0, targets=(), seed=5, sway=0.05, yaw=0.012)
    motion = pysas.micronavigate(claim, seabed=8.0, iterations=2, windows=1.0, elements=(0.10, 0.05))
    assert motion.found, motion.why
    steps, found = np.diff(truth.shift[:, 1]), np.diff(motion.sway)
    assert np.abs(steps).max() > 1e-3 and np.abs(found - steps - np.mean(found - steps)).max() < 0.2e-3
