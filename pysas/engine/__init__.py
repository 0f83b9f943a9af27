"""The only door to compiled code: which engines there are, and which of them runs."""

from __future__ import annotations

import importlib
import os
import platform
from collections.abc import Callable
from typing import Any

from pysas import _checks
from pysas.engine import native
from pysas.engine.interface import AnyEngine, Engine, Parts, Planning
from pysas.engine.native import SlowEngineWarning
from pysas.engine.traces import BLOCK, MONOSTATIC, MOVING, STOP_AND_HOP

__all__ = [
    "BACKENDS",
    "BLOCK",
    "MONOSTATIC",
    "MOVING",
    "STOP_AND_HOP",
    "AnyEngine",
    "Engine",
    "Parts",
    "Planning",
    "SlowEngineWarning",
    "backend_name",
    "engine_of",
    "get_include",
    "get_library",
    "show_config",
]

# a new engine is a module with an ENGINE, and a line here; modules are loaded when they are asked for
ENGINES: dict[str, Callable[[], Any]] = {
    "numba": lambda: importlib.import_module("pysas.engine.fallback"),
    "cpp": lambda: importlib.import_module("pysas.engine.cpp"),
}
BACKENDS = ("auto", *ENGINES)


def backend_name(backend: str = "auto") -> str:
    """The backend that will run: the argument, else PYSAS_BACKEND, else C++ where it was built."""
    name = _asked_for(backend)
    if name == "numba":
        return name
    built = native.extension() is not None
    if name == "cpp" and not built:
        raise ValueError(f"backend='cpp': the C++ extension is {native.absence()}: use 'numba' or 'auto'")
    return "cpp" if built else "numba"


def _asked_for(backend: str) -> str:
    name = _checks.choice("backend", backend, BACKENDS)
    return name if name != "auto" else _checks.choice("PYSAS_BACKEND", os.environ.get("PYSAS_BACKEND", "auto"), BACKENDS)


def engine_of(backend: str = "auto") -> AnyEngine:
    """The engine that will run, as `backend_name` has it.

    Warns
    -----
    SlowEngineWarning
        Numba runs though nobody asked for it; once a process.
    """
    name = backend_name(backend)
    if name == "numba" and _asked_for(backend) == "auto":
        native.warn_of_numba()
    engine: AnyEngine = ENGINES[name]().ENGINE
    return engine


def get_include() -> str:
    """Folder of the C header pysas.h.

    Raises
    ------
    FileNotFoundError
        The C++ parts were not built.
    """
    return _shipped("include", "pysas.h")[0]


def get_library() -> str:
    """Path of the C library, which needs no Python; link with it, or load it, and see pysas.h.

    Raises
    ------
    FileNotFoundError
        The C++ parts were not built.
    """
    return os.path.join(*_shipped("lib", "libpysas.so", "libpysas.dylib", "pysas.dll"))


def _shipped(folder: str, *names: str) -> tuple[str, str]:
    """The package's folder and the first of `names` in it."""
    path = os.path.join(os.path.dirname(os.path.dirname(__file__)), folder)
    for name in names:
        if os.path.exists(os.path.join(path, name)):
            return path, name
    raise FileNotFoundError(f"{os.path.join(path, names[0])}: not there: the C++ parts of pysas were not built")


def show_config(mode: str = "print") -> dict[str, Any] | None:
    """Versions, backends and thread settings; printed, or returned with mode="dict"."""
    import llvmlite.binding
    import numba
    import numpy
    import scipy

    import pysas

    _checks.choice("mode", mode, ("print", "dict"))
    extension = native.extension()
    name = backend_name()
    config = {
        "pysas": pysas.__version__,
        "backend": name,
        "isa": engine_of(name).isa(),
        "processor": llvmlite.binding.get_host_cpu_name(),
        "extension": native.absence() if extension is None else f"{extension.compiler()}, {', '.join(extension.levels())}",
        "threads": _checks.threads(None),
        "python": platform.python_version(),
        "numpy": numpy.__version__,
        "scipy": scipy.__version__,
        "numba": f"{numba.__version__} (llvmlite {llvmlite.__version__})",
    }
    if mode == "dict":
        return config
    width = max(len(name) for name in config)
    print("\n".join(f"{name:<{width}}  {value}" for name, value in config.items()))
    return None
