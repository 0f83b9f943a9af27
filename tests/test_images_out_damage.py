"""Copies of images for other programs, and of echoes in .mat, that are damaged: refused, or read as they were."""

from __future__ import annotations

import json
import struct
import subprocess
import sys
import tracemalloc
import zlib
from pathlib import Path

import pytest
import scipy.io
from test_io import images, survey

import pysas
from pysas.formats import catalogue

pytestmark = pytest.mark.reference  # no engine takes part

netCDF4 = pytest.importorskip("netCDF4")
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


def test_no_memory_is_taken_for_what_a_file_only_claims(tmp_path: Path) -> None:
    """2^30 pixels, 8 GiB, in files of some kilobytes: a shape that is written over, and chunks that were never written."""
    image = images()["masked plane"]
    plain, packed, empty = (tmp_path / name for name in ("plain.mat", "packed.mat", "empty.nc"))
    scipy.io.savemat(plain, {"schema": "pysas-image-1", "grid_kind": "plane", "data": image.data})
    raw = bytearray(plain.read_bytes())
    at = raw.index(struct.pack("<II", 5, 8) + struct.pack("<ii", *image.data.shape)) + 8
    raw[at : at + 8] = struct.pack("<ii", 2**15, 2**15)
    plain.write_bytes(raw)
    start = raw.rindex(struct.pack("<I", 14), 0, at)  # the last variable, compressed, with 2 MiB of zeros behind it
    content = zlib.compress(bytes(raw[start:]) + bytes(2**21))
    packed.write_bytes(raw[:start] + struct.pack("<II", 15, len(content)) + content)
    catalogue.by_name(str(empty), type(image)).write(str(empty), image, False)
    with netCDF4.Dataset(empty, "a") as file:
        file.renameVariable("real", "was")
        file.createDimension("long", 2**15)
        file.createVariable("long", "i1", ("long",))[:] = 0  # a dimension without numbers is refused before
        file.createVariable("real", "f8", ("long", "long"), zlib=True, chunksizes=(64, 64))
    tracemalloc.start()
    shape = r"data: found shape \(32768, 32768\) in \d+ bytes"
    for path, said in ((plain, shape), (packed, shape), (empty, "real: found 8589934592 bytes declared and 0 stored")):
        with pytest.raises(ValueError, match=rf"{path.name}: {said}"):
            pysas.load(path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 30e6


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
