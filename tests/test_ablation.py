"""Scenes as they are and with nothing left out: the images agree, and plans say what they left out."""

import importlib
import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parents[1]))  # at the end: pysas stays the installed one
ablation = importlib.import_module("bench.ablation")
BACKENDS = [pytest.param("cpp", marks=pytest.mark.cpp), "numba"]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize(
    ("row", "method"), [(row, method) for row in ablation.ROWS for method in row.methods], ids=lambda p: getattr(p, "name", p)
)
def test_leaving_out_changes_nothing(row, method, backend):
    found = ablation.measure(row, method, backend, scale=16, rounds=1, pixels=20)
    assert found["difference"] <= 2 * found["tol"]
    assert max(found["errors"]) <= found["tol"]
    if row.says is None:
        assert found["left_out"][0] > found["left_out"][1] + 0.2
    else:
        assert found["said"] == [True, False]
