"""What is public of pysas, by its own lists: the names that the reference must have."""

import importlib

MODULES = (
    "pysas", "pysas.circular", "pysas.comparison", "pysas.metrics", "pysas.motion", "pysas.navigation", "pysas.plot",
    "pysas.reference", "pysas.reference.bounds", "pysas.reference.ftcg", "pysas.reference.rasters", "pysas.simulation",
    "pysas.survey", "pysas.tracks",
)  # fmt: skip


def public_names() -> set[str]:
    """Dotted names of all modules above and of what they offer: by `__all__`, or without one what is defined there."""
    found = set(MODULES)
    for name in MODULES:
        room, _, last = name.rpartition(".")
        module = getattr(importlib.import_module(room), last) if room else importlib.import_module(name)
        lies = module.__name__  # pysas.simulation is pysas.signal's
        own = [key for key, value in vars(module).items() if getattr(value, "__module__", None) == lies and key[0] != "_"]
        found |= {f"{name}.{key}" for key in getattr(module, "__all__", own)}
    return found
