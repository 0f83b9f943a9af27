"""Mutated copies of a radar's file, read in a process of their own: what is refused, what stays the same, what is wrong."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any


def mutated(source: Path, folder: Path, spans: list[list[int]], words: list[list[str]], count: int = 200) -> dict[str, Any]:
    """Outcomes by their names. `spans`: bytes of values without a checksum, where a flipped bit cannot be told from a value;
    `words`: what is replaced by what to swap types."""
    arguments = [str(source), str(count), str(folder), json.dumps(spans), json.dumps(words)]
    run = subprocess.run([sys.executable, "-c", MUTATE, *arguments], capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    found: dict[str, Any] = json.loads(run.stdout)
    return found


MUTATE = """
import json, sys, warnings
from pathlib import Path
import numpy as np
import pysas

source, count, folder = Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
spans = json.loads(sys.argv[4])  # bytes that hold values without a checksum
original, good = source.read_bytes(), pysas.load(source)
rng = np.random.default_rng(5)
FREE = ("title", "source", "cphd", "sicd", "af")  # attrs that no image depends on

def values(item):
    # places in Earth-fixed coordinates: the axes on which they lie may be turned by less than is checked
    found = {}
    frame = getattr(item, "attrs", {}).get("ecef")
    if frame is not None:
        axes, origin = np.array(frame["axes"]), np.array(frame["origin"])
        turned = {"tx": item.tx @ axes + origin, "rx": item.rx @ axes + origin, "velocity": item.velocity @ axes}
        attrs = {name: value for name, value in item.attrs.items() if name != "ecef"}
        item = item.replace(**turned, attrs=attrs)
    for name, value in vars(item).items():
        if hasattr(value, "__dataclass_fields__"):
            found |= {f"{name}.{key}": part for key, part in values(value).items()}
        elif isinstance(value, dict):
            kept = {key: json.dumps(part, default=list) for key, part in value.items() if key not in FREE}
            found |= {f"{name}.{key}": np.array(part) for key, part in kept.items()}
        elif value is not None:
            found[name] = np.asarray(value)
    return found

def alike(a, b):
    if a.dtype.kind not in "fc":
        return np.array_equal(a, b)
    if a.shape != b.shape or a.dtype != b.dtype or not a.size:
        return a.shape == b.shape and a.dtype == b.dtype
    return np.abs(a - b).max() <= 16 * np.finfo(a.dtype).eps * np.abs(a).max()

places = [place for place in range(len(original)) if not any(low <= place < high for low, high in spans)]
outcome = {"refused": 0, "same": 0, "wrong": [], "payload": 0}
wanted = values(good)
for number in range(count):
    kind = ("flip", "flip", "burst", "cut", "swap", "zeros", "ones", "out", "in", "payload")[number % 10]
    raw, start = bytearray(original), int(rng.choice(places))
    if kind == "flip":
        raw[start] ^= 1 << rng.integers(8)
    elif kind == "burst":
        for place in [p for p in range(start, start + 1 + rng.integers(16)) if p in places]:
            raw[place] = rng.integers(256)
    elif kind == "cut":
        del raw[rng.integers(len(raw)):]
    elif kind == "swap":
        words = json.loads(sys.argv[5])
        old, new = words[rng.integers(len(words))]
        raw = bytearray(original.replace(old.encode(), new.encode(), 1))
    elif kind in ("zeros", "ones"):
        for place in [p for p in range(start, start + rng.integers(1, 64)) if p in places]:
            raw[place] = 0 if kind == "zeros" else 255
    elif kind == "out":
        del raw[start:start + rng.integers(1, 2000)]
    elif kind == "in":
        raw[start:start] = rng.bytes(rng.integers(1, 100))
    elif kind == "payload":
        low, high = spans[rng.integers(len(spans))]
        raw[rng.integers(low, high)] ^= 1 << rng.integers(8)
    path = folder / f"mutated{source.suffix}"
    path.write_bytes(raw)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = values(pysas.load(path))
    except (ValueError, OSError) as error:
        outcome["refused"] += 1
        assert str(path) in str(error), repr(error)
        continue
    if kind == "payload":
        outcome["payload"] += 1
    elif found.keys() == wanted.keys() and all(alike(found[key], wanted[key]) for key in wanted):
        outcome["same"] += 1
    else:
        changed = [key for key in found if key not in wanted or not alike(found[key], wanted[key])]
        outcome["wrong"].append([number, kind, bytes(raw[start - 30:start + 40]).decode("latin1"), changed])
print(json.dumps(outcome))
"""
