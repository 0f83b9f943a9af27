"""The compiled module: whether it is there, and which instruction set it runs."""

from __future__ import annotations

import functools
import importlib
import os
import sys
import warnings
from typing import Any

from pysas import _checks
from pysas._pool import leaving


def extension() -> Any | None:
    """The compiled module, or None where it was not built; a warning where an installed package has one (once)."""
    try:
        return core()
    except ImportError:
        _warn_of_others(tuple(sys.path))
        return None


@functools.cache
def _warn_of_others(folders: tuple[str, ...]) -> None:
    """Python in a checkout imports the sources there, which hide the package that was installed and built."""
    own = os.path.dirname(os.path.dirname(os.path.realpath(__file__)))
    for folder in folders:
        other = os.path.join(os.path.realpath(folder or "."), os.path.basename(own))
        engine = os.path.join(other, "engine")
        parts = os.listdir(engine) if other != own and os.path.isdir(engine) else []
        if any(part.startswith("_core.") and part.endswith((".so", ".pyd")) for part in parts):
            warnings.warn(
                f"{own} has no compiled extension and hides the installed {other}, which has one: start Python in another "
                "folder, or build here (pip install -e .)",
                stacklevel=3,
            )
            return


def core() -> Any:
    """The compiled module, which must be there."""
    module = importlib.import_module("pysas.engine._core")
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
