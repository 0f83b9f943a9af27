"""Copies of images for other programs, and of echoes in .mat, that are damaged: refused, or read as they were."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from test_io import images, survey

from pysas.formats import catalogue

pytestmark = pytest.mark.reference  # no engine takes part

pytest.importorskip("netCDF4")
pytest.importorskip("zarr")
pytest.importorskip("xarray")

MUTATE = """
import json, os, shutil, sys, warnings
from pathlib import Path
import numpy as np, scipy.io, xarray
sys.path.insert(0, sys.argv[2])
from test_io import same
import pysas

def swapped(source, path):
    # a variable of another type
    other = str(rng.choice(["f4", "f8", "i8", "c8", "c16", "i2", "u1"]))
    if source.suffix == ".mat":
        variables = {name: value for name, value in scipy.io.loadmat(source).items() if name[0] != "_"}
        name = str(rng.choice(sorted(name for name, value in variables.items() if value.dtype.kind != "U")))
        scipy.io.savemat(path, variables | {name: variables[name].astype(other)}, do_compression=True)
        return
    other = other.replace("c8", "i4").replace("c16", "u4")
    with xarray.open_dataset(source, **({"engine": "zarr", "consolidated": False} if source.is_dir() else {})) as data:
        name = str(rng.choice(["real", "imag", "mask", "x", "y"]))
        changed = data.load().assign({name: (data[name].dims, data[name].values.astype(other), data[name].attrs)})
    changed.to_zarr(path, zarr_format=3, consolidated=False) if source.is_dir() else changed.to_netcdf(path)

def mutated(source, number):
    path, kind = folder / f"mutated{source.suffix}", "swap"
    shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
    if number % 20 == 19:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            swapped(source, path)
        return path, kind
    kind = ("flip", "flip", "flip", "burst", "cut", "zeros", "ones", "out", "in", "copy")[number % 10]
    inside = sorted(file for file in source.rglob("*") if file.is_file()) if source.is_dir() else [source]
    chosen = inside[rng.integers(len(inside))]
    raw = bytearray(chosen.read_bytes())
    place, length = int(rng.integers(len(raw))), int(rng.integers(1, 100))
    part = slice(place, min(place + length, len(raw)))
    if kind == "flip":
        raw[place] ^= 1 << rng.integers(8)
    elif kind == "cut":
        del raw[place:]
    elif kind == "out":
        del raw[part]
    elif kind == "in":
        raw[place:place] = rng.bytes(length)
    else:
        other, size = int(rng.integers(len(raw))), part.stop - part.start
        filled = {"burst": rng.bytes(size), "zeros": bytes(size), "ones": b"\\xff" * size, "copy": raw[other:other + size]}
        raw[part] = filled[kind]
    if source.is_dir():
        shutil.copytree(source, path, copy_function=os.link)
        (path / chosen.relative_to(source)).unlink()
        (path / chosen.relative_to(source)).write_bytes(raw)
    else:
        path.write_bytes(raw)
    return path, kind

folder, outcomes = Path(sys.argv[1]), {}
for source in sorted(folder.glob("source*")):
    good, rng = pysas.load(source), np.random.default_rng(11)
    outcome = outcomes[source.name] = {"refused": 0, "same": 0, "wrong": []}
    for number in range(200):
        path, kind = mutated(source, number)
        try:
            found = pysas.load(path)
        except (ValueError, OSError) as error:
            assert str(path) in str(error), repr(error)
            outcome["refused"] += 1
            continue
        if same(found, good):
            outcome["same"] += 1
        else:
            outcome["wrong"].append([number, kind])
print(json.dumps(outcomes))
"""


def test_mutated_copies_are_refused_or_hold_the_same(tmp_path: Path) -> None:
    """200 of each, in a subprocess: a crash is a failure here too."""
    items = {
        "source.nc": images()["masked plane"],
        "source.zarr": images()["masked plane"],
        "source.mat": images()["masked plane"],
    }
    for name, item in (items | {"source_echoes.mat": survey()}).items():
        catalogue.by_name(name, type(item)).write(str(tmp_path / name), item, False)
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", MUTATE, str(tmp_path), str(Path(__file__).parent)],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    outcomes = json.loads(run.stdout)
    assert len(outcomes) == 4
    for outcome in outcomes.values():
        assert outcome["wrong"] == []
        assert outcome["refused"] >= 100, outcomes  # the rest hit dates, padding, or are the same values in another dtype
