"""The compiled module: whether it is there, what Numba in its place costs, and which instruction set it runs."""

from __future__ import annotations

import functools
import importlib
import os
import sys
import warnings
from typing import Any

from pysas import _checks
from pysas._pool import leaving

MODULE = "pysas.engine._core"


class SlowEngineWarning(UserWarning):
    """Numba runs, unasked, as the compiled module cannot: said once a process."""


def extension() -> Any | None:
    """The compiled module, or None where it was not built; a warning where an installed package has one (once)."""
    try:
        return core()
    except ImportError:
        _warn_of_others(tuple(sys.path))
        return None


def absence() -> str:
    """Why there is no compiled module, as the end of "it is ..."; empty where there is one."""
    try:
        core()
    except ImportError as error:
        if not isinstance(error, ModuleNotFoundError) or error.name != MODULE:
            return f"broken: {' '.join(str(error).split())}"
        others = _compiled(os.path.dirname(os.path.realpath(__file__)))
        return f"built for another Python: {', '.join(others)}" if others else "not built"
    return ""


def _compiled(folder: str) -> list[str]:
    """Compiled modules in a folder, for whatever Python."""
    parts = os.listdir(folder) if os.path.isdir(folder) else []
    return sorted(part for part in parts if part.startswith("_core.") and part.endswith((".so", ".pyd")))


@functools.cache
def warn_of_numba() -> None:
    """Say what it costs that Numba runs, and what to do about it."""
    _checks.warn(
        "pysas runs on Numba, at about two fifths of the speed, and compiles for ten seconds and more when first used: its C++ "
        f"extension is {absence()}. Install a wheel of pysas for this Python, or a C++17 compiler and pysas again. Where Numba "
        "is meant, backend='numba' or PYSAS_BACKEND=numba says so",
        SlowEngineWarning,
    )


@functools.cache
def _warn_of_others(folders: tuple[str, ...]) -> None:
    """Python in a checkout imports the sources there, which hide the package that was installed and built."""
    own = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    for folder in folders:
        other = os.path.join(os.path.realpath(folder or "."), os.path.basename(own))
        if other != own and _compiled(os.path.join(other, "engine")):
            warnings.warn(
                f"{own} has no compiled extension and hides the installed {other}, which has one: start Python in another "
                "folder, or build here (pip install -e .)",
                stacklevel=3,
            )
            return


def core() -> Any:
    """The compiled module, which must be there."""
    module = importlib.import_module(MODULE)
    _watch(module)
    return module


@functools.cache
def _watch(module: Any) -> None:
    leaving.join(leaving.Part(module.stop_others, module.away, module.keep_others))


def isa_name() -> str:
    """The instruction set that will run: PYSAS_ISA, else the best of this machine.

    Raises
    ------
    ValueError
        PYSAS_ISA names none that this machine and this build have.
    """
    levels = core().levels()
    name = _checks.choice("PYSAS_ISA", os.environ.get("PYSAS_ISA", "auto"), ("auto", *levels))
    return str(levels[-1] if name == "auto" else name)
