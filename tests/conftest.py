"""What every test relies on: the same pysas in subprocesses, the folder of measured data, tests of the extension."""

from __future__ import annotations

import importlib.util
import os
from pathlib import Path

import hypothesis
import pytest

import pysas

# Subprocesses import the pysas that these tests import: `python -c` and `python -m` would put the working directory
# first, where the sources lie without the compiled extension.
os.environ["PYTHONSAFEPATH"] = "1"
os.environ["PYTHONPATH"] = str(Path(pysas.__file__).parents[1])
os.environ["MPLBACKEND"] = "Agg"

hypothesis.settings.register_profile("pysas", derandomize=True, deadline=None, database=None)
hypothesis.settings.load_profile("pysas")


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """Folder of measured data."""
    name = os.environ.get("PYSAS_DATA")
    if not name:
        pytest.skip("PYSAS_DATA does not name the folder of measured data")
    if not Path(name).is_dir():
        pytest.fail(f"PYSAS_DATA={name!r}: expected a folder")
    return Path(name)


if importlib.util.find_spec("pysas.engine._core") is None:  # Numba is meant, here and in subprocesses: nobody need be told
    os.environ.setdefault("PYSAS_BACKEND", "numba")

NO_EXTENSION = "needs the compiled extension pysas.engine._core, which is not built"


def names_numba(item: pytest.Item) -> bool:
    """Whether it is Numba's turn of a test that all engines take."""
    params = getattr(item, "callspec", None) and item.callspec.params
    turn = params and params.get("engine", params.get("backend"))
    return turn in ("numba", ("numba", None))


@pytest.hookimpl(tryfirst=True)  # before -m selects
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    built = importlib.util.find_spec("pysas.engine._core") is not None
    for item in items:
        if names_numba(item):
            item.add_marker(pytest.mark.numba)
        if not built and item.get_closest_marker("cpp"):
            item.add_marker(pytest.mark.skip(reason=NO_EXTENSION))
    # one of two processes begins where no engine takes part, while the other compiles Numba's kernels, which take half a minute
    items.sort(key=lambda item: item.get_closest_marker("reference") is None)
