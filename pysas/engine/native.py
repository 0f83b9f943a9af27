"""The compiled module: whether it is there, and which instruction set it runs."""

from __future__ import annotations

import functools
import importlib
import os
from typing import Any

from pysas import _checks
from pysas._pool import leaving


def extension() -> Any | None:
    """The compiled module, or None where it was not built."""
    try:
        return core()
    except ImportError:
        return None


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
