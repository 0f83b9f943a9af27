"""Stores of echoes: round trips, growth, killed writers, damage, and that pings are read and nothing else.

Zarr itself, opened without pysas, is the second opinion on what lies in a store.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import textwrap
import tracemalloc
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from test_io import ECHOES, images, same, survey

import pysas
from pysas.cli import main
from pysas.formats import io, stores
from pysas.formats.fields import Array
from pysas.model.beam import Beam
from pysas.model.pulse import LFM

pytestmark = pytest.mark.reference  # no engine takes part

CONTAINERS = (".npz", ".h5", ".zarr")
BY_PING = ("data", "ping_time", "rx", "t0", "tx", "velocity")  # arrays of `line`
PAGE = Path(__file__).parents[1] / "docs" / "survey.md"


def line(pings: int = 40, samples: int = 64, channels: int = 2, seed: int = 3, **changes: Any) -> pysas.Echoes:
    rng = np.random.default_rng(seed)
    shape = (pings, channels, samples)
    data = (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)).astype(np.complex64)
    tx = np.zeros((pings, 3))
    tx[:, 0] = 0.1 * np.arange(pings) + 1e-3 * rng.standard_normal(pings)
    rx = tx[:, None] + np.array([0.05, 0.0, 0.0]) * np.arange(1, channels + 1)[:, None]
    fields: dict[str, Any] = {
        "fs": 40e3, "fc": 1e5, "tx": tx, "rx": rx, "t0": 0.01 + 1e-4 * rng.random(pings), "ping_time": 0.1 * np.arange(pings),
        "velocity": np.ones((pings, 3)), "beam": Beam((0.0, 1.0, -0.2), 0.1, 0.3), "pulse": LFM(1e5, 3e4, 2e-3),
        "compressed": False,
    }  # fmt: skip
    return pysas.Echoes(data, **(fields | changes))


# Round trips


@pytest.mark.parametrize("case", [name for name in ECHOES if name != "big-endian"])
def test_a_store_gives_back_every_bit(case: str, tmp_path: Path) -> None:
    echoes = ECHOES[case]()
    pysas.save(tmp_path / "a.zarr", echoes)
    assert same(pysas.load(tmp_path / "a.zarr"), echoes)
    assert [item.name for item in tmp_path.iterdir()] == ["a.zarr"]


@pytest.mark.parametrize("source", CONTAINERS)
@pytest.mark.parametrize("target", CONTAINERS)
def test_every_container_becomes_every_other_by_blocks(
    source: str, target: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pysas.formats.echo_store._BLOCK_BYTES", 5000)  # of 1024 bytes a ping: many blocks, and a rest
    echoes = line()
    pysas.save(tmp_path / f"a{source}", echoes)
    with pysas.open_echoes(tmp_path / f"a{source}") as store:
        assert same(store.echoes(slice(7, 30)), echoes[7:30]) and store.complete and store.n_ping == 40
        assert store.swath == echoes.swath
        blocks = list(store.blocks(slice(3, None)))
        assert sum(block.n_ping for block in blocks) == 37 and (source == ".zarr" or len(blocks) > 5)
        assert np.array_equal(np.concatenate([block.data for block in blocks]), echoes.data[3:])
        store.save(tmp_path / f"b{target}")
        store.save(tmp_path / f"c{target}", slice(10, 20))
    assert same(pysas.load(tmp_path / f"b{target}"), echoes)
    assert same(pysas.load(tmp_path / f"c{target}"), echoes[10:20])


def test_int16_is_exact_to_half_a_step_of_each_ping(tmp_path: Path) -> None:
    data = line().data * np.logspace(-12, 12, 40, dtype=np.float32)[:, None, None]
    data[5] = 0
    data[6] = np.complex64(1e-44)  # subnormal
    echoes = line().replace(data=data)
    with pysas.EchoWriter(tmp_path / "a.zarr", int16=True) as writer:
        writer.append(echoes)
    found = pysas.load_echoes(tmp_path / "a.zarr")
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="r")
    scale, counts = group["scale"][:], group["data"][:]
    assert counts.dtype == np.int16 and counts.shape == (40, 2, 64, 2)
    most = np.abs(data.view(np.float32)).reshape(40, -1).max(axis=1).astype(float)
    loud = most > 1e-40
    assert np.all(scale[loud] >= most[loud] / 32767) and np.all(scale[loud] <= most[loud] / 32767 * (1 + 2**-22))
    assert np.all(np.abs(counts[loud]).reshape(38, -1).max(axis=1) == 32767) and not counts[5].any()
    error = np.abs((found.data - data).view(np.float32).astype(float)).reshape(40, -1).max(axis=1)
    assert np.all(error <= scale / 2 + 2.0**-23 * most) and found.dtype == np.complex64
    assert same(found.replace(data=data), echoes)


def test_int16_keeps_what_counts_and_refuses_what_it_cannot_hold(tmp_path: Path) -> None:
    echoes = line(4)
    data = echoes.data.copy()
    data[1, 1, 60:] = np.nan
    with pysas.EchoWriter(tmp_path / "a.zarr", int16=True) as writer:
        writer.append(echoes[:1])
        with pytest.raises(ValueError, match="data: nan in ping 2: expected finite samples"):
            writer.append(echoes.replace(data=data))
        assert writer.n_ping == 1
    with pysas.EchoWriter(tmp_path / "b.zarr", int16=True) as writer:
        writer.append(echoes.replace(data=data, valid=np.tile([0, 59], (4, 1))))
    found = pysas.load_echoes(tmp_path / "b.zarr")
    assert not found.data[..., 60:].any() and np.abs(found.data - echoes.data)[..., :60].max() < 2e-4
    with pytest.raises(ValueError, match=r"data: 3e\+38 in ping 0: expected finite samples that float32 holds|.*1e\+39"):
        big = echoes.data.astype(complex) * 0 + 1e39
        pysas.EchoWriter(tmp_path / "c.zarr", int16=True).append(echoes.replace(data=big))
    assert not (tmp_path / "c.zarr").exists()


def test_what_cannot_be_read_by_pings_is_read_whole_and_said(tmp_path: Path) -> None:
    pysas.save(tmp_path / "a.npz", line())
    with np.load(tmp_path / "a.npz") as file:
        np.savez_compressed(tmp_path / "b.npz", **file)
    with pytest.warns(UserWarning, match=r"b\.npz: data are deflated or in Fortran order, and read whole"):
        store = pysas.open_echoes(tmp_path / "b.npz")
    with store:
        assert same(store.echoes(slice(3, 9)), line()[3:9])


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_the_whole_files_checksum_is_compared_where_pings_are_read_in_order(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    pysas.save(path, line(400))  # more than what is read of a file's head
    raw = bytearray(path.read_bytes())
    raw[raw.index(line(400).data[300].tobytes())] ^= 1
    path.write_bytes(raw)
    with pysas.open_echoes(path) as store:
        assert store.echoes(slice(0, 200)).n_ping == 200
        with pytest.raises(ValueError, match=rf"{re.escape(str(path))}: data: damaged: found other bytes"):
            store.echoes(slice(200, 400))
        with pytest.raises(ValueError, match="damaged"):
            store.save(tmp_path / "b.zarr")
    assert [item.name for item in tmp_path.iterdir()] == [path.name]


def test_zarr_reads_what_pysas_wrote_and_pysas_what_zarr_wrote(tmp_path: Path) -> None:
    """A store as the page describes it, made by zarr alone: without pings, complete and crc32."""
    echoes = line()
    pysas.save(tmp_path / "a.zarr", echoes)
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="r")
    assert np.array_equal(group["data"][:], echoes.data) and np.array_equal(group["rx"][:], echoes.rx)
    assert group["rx"].metadata.dimension_names == ("ping", "channel", "xyz") and group.attrs["fs"] == 40e3
    made = zarr.create_group(str(tmp_path / "b.zarr"), zarr_format=3, attributes={"schema": "pysas-echoes-1", "fs": 40000})
    made.attrs.update({"fc": 1e5, "c": 1500, "compressed": False, "bandwidth": 3e4})
    for name in ("data", "tx", "rx", "t0"):
        array = getattr(echoes, name)
        made.create_array(
            name, shape=array.shape, chunks=(8, *array.shape[1:]), dtype=array.dtype,
            compressors=[zarr.codecs.Crc32cCodec()], filters=None,
        )[...] = array  # fmt: skip
    found = pysas.load_echoes(tmp_path / "b.zarr")
    assert same(found, echoes.replace(velocity=None, beam=None, pulse=None, ping_time=None, bandwidth=3e4))


# Growth


def test_readers_of_a_growing_store_see_whole_pings(tmp_path: Path) -> None:
    path, echoes = tmp_path / "a.zarr", line(300)
    writer = pysas.EchoWriter(path)
    assert not path.exists()
    done = 0
    for count in (1, 1, 2, 130, 1, 100, 65):
        writer.append(echoes[done : done + count])
        done += count
        with pysas.open_echoes(path) as store:
            assert not store.complete and store.n_ping == done == writer.n_ping
            assert same(store.echoes(), echoes[:done])
            early = store
    assert "not complete" in repr(early)
    writer.close()
    assert pysas.open_echoes(path).complete
    zarr_sees = zarr.open_group(str(path), mode="r")
    assert {name: array.shape[0] for name, array in zarr_sees.arrays() if name in BY_PING} == dict.fromkeys(BY_PING, 300)


def test_a_ping_half_written_is_not_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The disk is full at every file of an append in turn, and what is there remains readable and can be gone on with."""
    path, echoes = tmp_path / "a.zarr", line(6)
    writer = pysas.EchoWriter(path)
    writer.append(echoes[:3])
    real, left = os.replace, [0]

    def full(self: Path, target: Path) -> Path:
        left[0] -= 1
        if left[0] < 0:
            raise OSError(28, "No space left on device")
        real(self, target)
        return Path(target)

    failures = 0
    for allowed in range(100):
        left[0] = allowed
        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", full)
            try:
                writer.append(echoes[3:5])
                break
            except OSError:
                failures += 1
        assert same(pysas.load(path), echoes[:3])
        assert not list(path.rglob("*.partial"))
    assert failures == 7  # a chunk of each of six arrays, and the count; headers that were written stay so
    writer.append(echoes[5:])
    writer.close()
    assert same(pysas.load(path), echoes)


WRITE = """
import sys
sys.path.insert(0, sys.argv[2])
import pysas
from test_stores import line
echoes = line(3000, 32)
writer = pysas.EchoWriter(sys.argv[1], resume=len(sys.argv) > 3, int16=False)
print("begun", flush=True)
for ping in range(writer.n_ping, echoes.n_ping):
    writer.append(echoes[ping])
    print(ping, flush=True)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL there")
def test_a_killed_writer_leaves_the_pings_before_and_another_goes_on(tmp_path: Path) -> None:
    path, echoes = tmp_path / "a.zarr", line(3000, 32)
    rng = np.random.default_rng(4)
    before = 0
    for kill in range(8):
        command = [sys.executable, "-c", textwrap.dedent(WRITE), str(path), str(Path(__file__).parent)]
        with subprocess.Popen(command + ["resume"] * (kill > 0), stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None and process.stdout.readline() == "begun\n"
            said = -1
            for _ in range(int(rng.integers(2, 30))):
                said = int(process.stdout.readline())
            for _ in range(int(rng.integers(0, 20000))):  # somewhere within what follows
                pass
            os.kill(process.pid, signal.SIGKILL)
            rest = process.stdout.read().split()
        assert process.returncode == -signal.SIGKILL
        told = int(rest[-1]) if rest else said
        with pysas.open_echoes(path) as store:
            assert told + 1 <= store.n_ping <= told + 2 and store.n_ping > before and not store.complete
            before = store.n_ping
            assert same(store.echoes(), echoes[:before])
    with pysas.EchoWriter(path, resume=True) as writer:
        writer.append(echoes[before:])
    assert same(pysas.load(path), echoes)


def test_pings_of_another_kind_are_refused(tmp_path: Path) -> None:
    echoes = line(4)
    writer = pysas.EchoWriter(tmp_path / "a.zarr")
    writer.append(echoes)
    with pytest.raises(TypeError, match="echoes=ndarray: expected pysas.Echoes"):
        writer.append(echoes.data)  # type: ignore[arg-type]
    others: dict[str, dict[str, Any]] = {
        "fs": {"fs": 41e3}, "velocity": {"velocity": None}, "data": {"data": echoes.data[..., :5]}, "beam_length": {
        "beam": Beam((0.0, 1.0, -0.2), 0.2, 0.3)}, "bandwidth": {"pulse": None, "bandwidth": 3e4}, "t0": {"t0": 0.1},
        "c": {"c": np.full(4, 1500.0)}, "attrs": {"attrs": {"title": "x"}}, "valid": {"valid": np.tile([0, 9], (4, 1))},
    }  # fmt: skip
    others["data "] = {"data": echoes.data.astype(complex)}
    for name, change in others.items():
        with pytest.raises(ValueError, match=rf"^{name.strip()}\w*: .* after .*: expected the same of all pings") as caught:
            writer.append(echoes.replace(**change))
        assert len(str(caught.value)) < 250
    assert same(pysas.load(tmp_path / "a.zarr"), echoes)


def test_resume_refuses_what_it_would_spoil(tmp_path: Path) -> None:
    """Zarr takes a missing chunk for zeros and would give them a checksum; arrays that do not grow would lack pings."""
    parts = line(6).data.view(np.float32).reshape(6, 2, 64, 2)
    spoilt: dict[str, Callable[[Path], Any]] = {
        "data, chunk 0 .*: missing": lambda p: (p / "data" / "c.0.0.0").unlink(),
        "data, chunk 0 .*: damaged": lambda p: flipped(p / "data" / "c.0.0.0"),
        "heave: found a row a ping, expected only fields of pysas-echoes-1": lambda p: put(p, "heave", np.ones(6)),
        "data: found real and imaginary part along an axis": lambda p: (shutil.rmtree(p / "data"), put(p, "data", parts)),
        "pings: missing, expected": lambda p: header(p, pings=None),
    }
    path = tmp_path / "a.zarr"
    for message, spoil in spoilt.items():
        pysas.save(path, line(6))
        spoil(path)
        with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: {message}"):
            pysas.EchoWriter(path, resume=True)


def test_int16_goes_on_with_samples_of_either_precision(tmp_path: Path) -> None:
    echoes = line(4)
    for resume, dtype in ((False, np.complex128), (True, np.complex64), (True, np.complex128)):
        with pysas.EchoWriter(tmp_path / "a.zarr", int16=not resume, resume=resume) as writer:
            writer.append(echoes.replace(data=echoes.data.astype(dtype)))
    found = pysas.load_echoes(tmp_path / "a.zarr").data
    assert np.array_equal(found[:4], found[4:8]) and np.array_equal(found[:4], found[8:])


@pytest.mark.skipif(sys.platform == "win32", reason="no such names there")
def test_a_store_is_known_by_its_folder_and_not_by_its_name_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    odd = "a::b/http:/x.zarr"  # Zarr takes "::" and "://" for a place in the network
    (tmp_path / odd).parent.mkdir(parents=True)
    pysas.save(odd, line(4))
    writer = pysas.EchoWriter("w.zarr")
    with pysas.open_echoes("a::b/http://x.zarr") as store:
        writer.append(line(4))
        monkeypatch.chdir("a::b")
        assert same(store.echoes(), line(4))
        writer.append(line(4))
        writer.close()
        assert pysas.load_echoes(tmp_path / "w.zarr").n_ping == 8 and os.listdir() == ["http:"]
        for _ in range(3):  # folders' numbers are given again
            pysas.save(tmp_path / odd, line(4, seed=9))
            with pytest.raises(ValueError, match=r"x\.zarr: found another store than was opened"):
                store.echoes()


def test_outputs(tmp_path: Path) -> None:
    echoes, path = line(4), tmp_path / "a.zarr"
    with pytest.raises(ValueError, match=r"a\.h5: expected a name that ends in \.zarr"):
        pysas.EchoWriter(tmp_path / "a.h5")
    with pytest.raises(FileNotFoundError, match=r"a\.zarr"):
        pysas.EchoWriter(path, resume=True)
    with pytest.raises(FileNotFoundError, match="no such folder"):
        pysas.save(tmp_path / "none" / "a.zarr", echoes)
    with pytest.raises(ValueError, match="expected one of both"):
        pysas.EchoWriter(path, resume=True, overwrite=True)
    with pytest.raises(ValueError, match=r"a\.zarr: found suffix '\.zarr', expected \.npz or \.h5"):
        pysas.save(path, images()["plane"])
    pysas.save(path, echoes)
    for write in (lambda: pysas.EchoWriter(path), lambda: pysas.save(path, echoes, overwrite=False)):
        with pytest.raises(FileExistsError, match=r"a\.zarr: exists: expected a new name"):
            write()
    pysas.save(path, line(7))
    assert pysas.load_echoes(path).n_ping == 7
    (tmp_path / "folder.zarr").mkdir()
    (tmp_path / "folder.zarr" / "zarr.json").write_text("[" * 200_000)  # deeper than Python reads
    (tmp_path / "file.zarr").write_text("mine")
    for other in ("folder.zarr", "file.zarr"):
        with pytest.raises(ValueError, match=rf"{other}: exists and is no store of echoes"):
            pysas.save(tmp_path / other, echoes)
    zarr.create_group(str(tmp_path / "other.zarr"), zarr_format=3, attributes={"schema": "somebody's"})
    with pytest.raises(ValueError, match=r"other\.zarr: exists and is no store of echoes"):
        pysas.save(tmp_path / "other.zarr", echoes)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a.zarr", "file.zarr", "folder.zarr", "other.zarr"]


@pytest.mark.skipif(sys.platform == "win32", reason="no permissions of POSIX there")
def test_a_store_takes_anothers_place_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.zarr"
    pysas.save(path, line(4))
    path.chmod(0o750)
    pysas.save(path, line(5))
    assert path.stat().st_mode & 0o777 == 0o750

    def full(*_: Path) -> None:
        raise OSError(28, "No space left on device", "a part")

    moves = iter((os.rename, full, os.rename))  # the old store aside, the new one to its place, the old one back
    for name, fake, message in (
        ("rename", lambda *names: next(moves)(*names), "No space left on device"),
        ("access", lambda *_: False, "the store is read-only"),  # root may write everywhere
    ):
        with monkeypatch.context() as patch, pytest.raises(OSError, match=rf"{message}: '{re.escape(str(path))}'$"):
            patch.setattr(os, name, fake)
            pysas.save(path, line(6))
    assert pysas.load_echoes(path).n_ping == 5 and [item.name for item in tmp_path.iterdir()] == ["a.zarr"]


def test_what_could_not_be_read_again_is_not_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "_MOST_CHUNK", 1000)  # a ping has 1024 bytes, in int16 half of that
    monkeypatch.setattr(stores, "_CHUNK_BYTES", 1000)
    with pytest.raises(ValueError, match="data: found 1024 bytes a ping, expected at most 1000"):
        pysas.save(tmp_path / "a.zarr", line(4))
    monkeypatch.setattr(stores, "_MOST_HEADER", 9000)
    with pytest.raises(ValueError, match="zarr.json: found .* bytes, expected a file of at most 9000"):
        pysas.EchoWriter(tmp_path / "b.zarr", int16=True).append(line(4, attrs={"log": "x" * 9000}))
    assert not list(tmp_path.iterdir())
    pysas.EchoWriter(tmp_path / "c.zarr", int16=True).append(line(4))
    assert np.abs(pysas.load_echoes(tmp_path / "c.zarr").data - line(4).data).max() < 2e-4


# Damage


def put(path: Path, name: str, array: Array) -> None:
    """An array that Zarr writes, of a row a ping."""
    zarr.open_group(str(path), mode="r+").create_array(
        name, data=array, chunks=array.shape, compressors=[zarr.codecs.Crc32cCodec()], filters=None,
        dimension_names=("ping", *map(str, range(1, array.ndim))),
    )  # fmt: skip


def header(path: Path, **changes: Any) -> None:
    """Attributes changed by somebody who knows of the checksum; None: taken away."""
    text = json.loads((path / "zarr.json").read_text())
    attributes = {name: value for name, value in (text["attributes"] | changes).items() if value is not None}
    attributes.pop("crc32", None)
    plain = json.dumps(attributes, sort_keys=True, separators=(",", ":"))
    text["attributes"] = attributes | {"crc32": zlib.crc32(plain.encode())}
    (path / "zarr.json").write_text(json.dumps(text))


def of_array(path: Path, name: str, change: Callable[[dict[str, Any]], Any]) -> None:
    text = json.loads((path / name / "zarr.json").read_text())
    change(text)
    (path / name / "zarr.json").write_text(json.dumps(text))


def chunked(path: Path, name: str, *shape: int) -> None:
    of_array(path, name, lambda text: text["chunk_grid"]["configuration"].update(chunk_shape=shape))


def written_to(path: Path, name: str, value: Array) -> None:
    zarr.open_group(str(path), mode="r+")[name][...] = value


def flipped(file: Path, place: int = 100) -> None:
    raw = bytearray(file.read_bytes())
    raw[place] ^= 4
    file.write_bytes(raw)


BROKEN: dict[str, tuple[Callable[[Path], Any], str]] = {
    "another schema": (lambda p: header(p, schema="pysas-echoes-9"), "schema: found 'pysas-echoes-9', expected"),
    "no schema": (lambda p: header(p, schema=None), "arrays of no known format: .*data may be the samples"),
    "an attribute changed": (
        lambda p: (p / "zarr.json").write_text((p / "zarr.json").read_text().replace("40000.0", "40001.0")),
        "zarr.json: damaged: found other attributes",
    ),
    "no group": (lambda p: (p / "zarr.json").unlink(), "zarr.json: missing"),
    "no JSON": (lambda p: (p / "zarr.json").write_text("{"), "zarr.json: no Zarr v3 group"),
    "an array for a group": (lambda p: shutil.copy(p / "tx" / "zarr.json", p / "zarr.json"), "zarr.json: no Zarr v3 group"),
    "text for fs": (lambda p: header(p, fs="fast"), "fs: found .* expected float64"),
    "a list for fs": (lambda p: header(p, fs=[1.0]), "fs: found object"),
    "fs below zero": (lambda p: header(p, fs=-1.0), r"fs=-1\.0: expected a finite number > 0"),
    "pings a text": (lambda p: header(p, pings="many"), "pings: found 'many', expected a whole number"),
    "no pings": (lambda p: header(p, pings=0), "pings: found 0, expected a whole number >= 1"),
    "true pings": (lambda p: header(p, pings=True), "pings: found True"),
    "more pings than are there": (lambda p: header(p, pings=41), "data: found 40 pings, expected 41 or more"),
    "complete a number": (lambda p: header(p, complete=1), "complete: found 1, expected true or false"),
    "no tx": (lambda p: shutil.rmtree(p / "tx"), "tx: missing, expected float64"),
    "tx twice": (lambda p: header(p, tx=1.0), "tx: found as an attribute and as an array"),
    "an array without a header": (lambda p: (p / "tx" / "zarr.json").unlink(), "tx: zarr.json: missing"),
    "other codecs": (lambda p: of_array(p, "tx", lambda text: text["codecs"].pop()), "tx: found codecs bytes, expected"),
    "other chunks": (lambda p: chunked(p, "rx", 128, 1, 3), "rx: found float64 of shape .* numbers, whole along axis 0"),
    "chunks of nothing": (lambda p: chunked(p, "tx", 0, 3), r"tx: found float64 of shape .* in chunks of \(0, 3\), expected"),
    "a chunk of terabytes": (lambda p: chunked(p, "tx", 10**12, 3), "tx: found chunks of .* at most 268435456 bytes each"),
    "chunks of another length": (lambda p: chunked(p, "tx", 64, 3), r"tx, chunk 0 \(0 to 63 .*: found 3076 bytes, .* 1540"),
    "pings beyond what is there": (
        lambda p: (header(p, pings=10**13), [of_array(p, name, lambda text: text["shape"].__setitem__(0, 10**13))
                   for name in BY_PING]),
        r"(ping_time|rx|t0|tx|velocity), chunk 1 .*: missing",
    ),
    "axes without names": (
        lambda p: (header(p, pings=30), [of_array(p, name, lambda text: text.pop("dimension_names")) for name in BY_PING]),
        r"\w+: found shape \(40.*\), expected .*ping=30",
    ),
    "a number beyond float64": (lambda p: header(p, fs=10**400), "fs: int too large"),
    "a group": (lambda p: (shutil.rmtree(p / "tx"), zarr.open_group(str(p)).create_group("tx")), "tx: found object"),
    "another type": (lambda p: of_array(p, "tx", lambda text: text.update(data_type="int64")), "tx: found int64 .*float64"),
    "no chunk of navigation": (lambda p: (p / "tx" / "c.0.0").unlink(), r"tx, chunk 0 \(0 to 127 .*\): missing"),
    "a short chunk": (lambda p: os.truncate(p / "tx" / "c.0.0", 99), "tx, chunk 0 .*: found 99 bytes, expected 3076"),
    "a long chunk": (lambda p: os.truncate(p / "tx" / "c.0.0", 2**40), "tx, chunk 0 .*: found 1099511627776 bytes"),
    "a folder": (lambda p: ((p / "tx" / "c.0.0").unlink(), (p / "tx" / "c.0.0").mkdir()), "tx, chunk 0 .*: found .* bytes"),
    "a bit of navigation": (lambda p: flipped(p / "tx" / "c.0.0"), "tx, chunk 0 .*: damaged .*checksum"),
    "a bit of samples": (lambda p: flipped(p / "data" / "c.0.0.0"), "data, chunk 0 .*: damaged .*checksum"),
    "a missing chunk": (lambda p: (p / "data" / "c.0.0.0").unlink(), r"data, chunk 0 \(0 to 127 along axis 0\): missing"),
    "NaN": (lambda p: written_to(p, "tx", np.full((40, 3), np.nan)), "tx: nan at ping 0"),
    "two pulses": (
        lambda p: zarr.open_group(str(p), mode="r+").create_array(
            "waveform", data=np.ones(3, np.complex64), chunks=(3,), compressors=[zarr.codecs.Crc32cCodec()], filters=None),
        "waveform: found beside pulse_kind",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_store_is_one_error_that_names_it(case: str, tmp_path: Path) -> None:
    change, message = BROKEN[case]
    path = tmp_path / "line.zarr"
    pysas.save(path, line())
    change(path)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: {message}") as caught:
        pysas.load(path)
    assert type(caught.value) is ValueError and len(str(caught.value)) < 500


INT16: dict[str, tuple[Callable[[Path], Any], str]] = {
    "no scale": (lambda p: shutil.rmtree(p / "scale"), "scale: missing, expected float64 a ping"),
    "a scale below zero": (lambda p: written_to(p, "scale", -np.ones(40)), "scale: -1 at ping 0: expected numbers > 0"),
    "a small scale": (lambda p: written_to(p, "scale", np.full(40, 1e-50)), "scale: 1e-50 at ping 0: .* that float32 holds"),
    "a large scale": (lambda p: written_to(p, "scale", np.full(40, 1e35)), r"scale: 1e\+35 at ping 0: expected numbers > 0"),
    "no number": (lambda p: written_to(p, "scale", np.full(40, np.nan)), "scale: nan at ping 0"),
    "no I and Q": (
        lambda p: of_array(p, "data", lambda t: (t["shape"].__setitem__(3, 1),
                           t["chunk_grid"]["configuration"]["chunk_shape"].__setitem__(3, 1))),
        "scale: found float64 of shape .*, whose last axis is I and Q",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", INT16)
def test_a_broken_store_of_int16(case: str, tmp_path: Path) -> None:
    change, message = INT16[case]
    path = tmp_path / "line.zarr"
    with pysas.EchoWriter(path, int16=True) as writer:
        writer.append(line())
    change(path)
    with pytest.raises(ValueError, match=rf"^{re.escape(str(path))}: {message}"):
        pysas.load(path)


def test_other_things_of_that_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"none\.zarr"):
        pysas.load(tmp_path / "none.zarr")
    (tmp_path / "file.zarr").write_bytes(b"PK")
    with pytest.raises(ValueError, match=r"file\.zarr: found a file, expected a folder"):
        pysas.load(tmp_path / "file.zarr")
    pysas.save(tmp_path / "image.npz", images()["plane"])
    with pytest.raises(ValueError, match=r"image\.npz: schema: found 'pysas-image-1', expected 'pysas-echoes-1'"):
        pysas.open_echoes(tmp_path / "image.npz")
    pysas.save(tmp_path / "a.zarr", line())
    (tmp_path / "a.zarr" / "note.txt").write_text("read me")
    zarr.open_group(str(tmp_path / "a.zarr"), mode="r+").create_group("log")
    header(tmp_path / "a.zarr", ship="Alma")
    with pytest.warns(UserWarning, match=r"a\.zarr: ignored, not in pysas-echoes-1: log, ship"):
        assert same(pysas.load(tmp_path / "a.zarr"), line())


def test_without_zarr_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pysas.save(tmp_path / "a.zarr", line(2))
    monkeypatch.setitem(sys.modules, "zarr", None)
    for call in (
        lambda: pysas.load(tmp_path / "a.zarr"),
        lambda: pysas.open_echoes(tmp_path / "a.zarr"),
        lambda: pysas.save(tmp_path / "b.zarr", line(2)),
        lambda: pysas.EchoWriter(tmp_path / "b.zarr").append(line(2)),
    ):
        with pytest.raises(ImportError, match=r"zarr is not installed: pip install 'pysas-sonar\[survey\]'"):
            call()
    assert [item.name for item in tmp_path.iterdir()] == ["a.zarr"]


@pytest.mark.parametrize("int16", [False, True])
def test_mutated_stores_are_refused_or_hold_the_same(int16: bool, tmp_path: Path) -> None:
    """Each file of a store in turn: bits, bursts, cuts, zeros, parts copied elsewhere, and files in each other's place."""
    source = tmp_path / "source.zarr"
    truth = {"truth_position": np.zeros((2, 3)), "truth_amplitude": np.ones(2)}
    with pysas.EchoWriter(source, int16=int16) as writer:
        writer.append(survey(attrs={"title": "x"} | truth))
    good = pysas.load(source)
    files = sorted(path.relative_to(source) for path in source.rglob("*") if path.is_file())
    rng = np.random.default_rng(7)
    refused = 0
    for number in range(200):
        path = tmp_path / "mutated.zarr"
        shutil.copytree(source, path)
        target = path / files[int(rng.integers(len(files)))]
        raw = bytearray(target.read_bytes())
        kind = ("flip", "flip", "flip", "burst", "cut", "zeros", "copy", "swap")[number % 8]
        if kind == "flip":
            raw[rng.integers(len(raw))] ^= 1 << rng.integers(8)
        elif kind == "burst":
            start = int(rng.integers(len(raw)))
            raw[start : start + 9] = rng.bytes(len(raw[start : start + 9]))
        elif kind == "cut":
            del raw[rng.integers(len(raw)) :]
        elif kind == "zeros":
            start = int(rng.integers(len(raw)))
            raw[start : start + 40] = bytes(len(raw[start : start + 40]))
        elif kind == "copy":
            start, other, size = *rng.integers(0, len(raw), 2), int(rng.integers(1, 200))
            raw[start : start + size] = raw[other : other + size]
        else:
            raw = bytearray((source / files[int(rng.integers(len(files)))]).read_bytes())
        target.write_bytes(raw)
        try:
            found = pysas.load(path)
        except (ValueError, UserWarning) as error:
            assert str(path) in str(error), repr(error)
            refused += 1
        else:
            assert same(found, good), (number, kind, target)
        shutil.rmtree(path)
    assert refused >= 100  # the rest hit padding of chunks, or spaces and dates of headers


# Pings and no others


def test_a_reader_opens_the_chunks_of_its_pings_and_no_others(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stores, "_CHUNK_BYTES", 8 * 1024)  # 8 pings of 1024 bytes
    path = tmp_path / "a.zarr"
    pysas.save(path, line(400))
    with pysas.open_echoes(path) as store:
        assert "8 pings a chunk" in store.stored
        for number in (*range(12), *range(16, 50)):  # all but those of pings 96 to 127
            (path / "data" / f"c.{number}.0.0").unlink()
        assert same(store.echoes(slice(100, 120)), line(400)[100:120])
        assert sum(block.n_ping for block in store.blocks(slice(96, 128))) == 32
        with pytest.raises(ValueError, match=r"a\.zarr: data, chunk 16 \(128 to 135 along axis 0\): missing"):
            store.echoes(slice(100, 129))
        with pytest.raises(TypeError, match="pings=5: expected a slice"):
            store.echoes(5)  # type: ignore[arg-type]
        for wrong in (slice(0, 9, 2), slice(5, 5), slice(400, None)):
            with pytest.raises(ValueError, match="expected some of 400 that follow each other"):
                store.echoes(wrong)


@pytest.mark.parametrize("suffix", CONTAINERS)
def test_memory_is_that_of_the_pings_that_are_read(suffix: str, tmp_path: Path) -> None:
    """A line of 64 MiB: opened, read by tiles, given to a strip, and converted."""
    path = tmp_path / f"a{suffix}"
    pysas.save(path, line(1024, 4096))
    pysas.open_echoes(path).close()  # modules
    tracemalloc.start()
    with pysas.open_echoes(path) as store:
        opened = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        for first in (0, 500, 900):
            assert store.echoes(slice(first, first + 32)).n_ping == 32
        tile = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        assert sum(block.n_ping for block in store.blocks()) == 1024
        along = tracemalloc.get_traced_memory()[1]
        tracemalloc.reset_peak()
        for other in CONTAINERS:
            store.save(tmp_path / f"b{other}")
        converted = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    mega = 2**20
    assert opened < 3 * mega  # navigation: 0.2 MB
    assert tile < 16 * mega  # 2 MiB a tile, a chunk of 2 MiB and its copies
    assert along < 56 * mega  # two blocks of 16 MiB: the one before is given away when the next one is there
    assert converted < 80 * mega  # that, the store's chunks on their way out
    assert path.suffix != ".zarr" or sum(file.stat().st_size for file in path.rglob("c.*")) > 64 * mega


@pytest.mark.parametrize("suffix", CONTAINERS)
def test_a_strip_is_imaged_from_a_store(suffix: str, tmp_path: Path) -> None:
    echoes = line(60, 400, t0=0.01, pulse=None, bandwidth=2e4, compressed=True, velocity=None)
    strip = pysas.Strip(np.arange(9.0, 11.0, 0.1), 0.1, 2.0, tol=1e-2, slack=0.5, block=1.0)
    expected = list(strip.stream(echoes[i : i + 8] for i in range(0, 60, 8)))
    pysas.save(tmp_path / f"a{suffix}", echoes)
    with pysas.open_echoes(tmp_path / f"a{suffix}") as store:
        found = list(strip.stream(store.echoes(slice(i, i + 8)) for i in range(0, 60, 8)))
        assert len(list(strip.stream(store.blocks()))) == len(found)
    assert len(found) == len(expected) > 2
    assert all(np.array_equal(a.data, b.data) and a.data.any() for a, b in zip(found, expected, strict=True))


# The command line


def run(capsys: pytest.CaptureFixture[str], *arguments: Any) -> tuple[int, str, str]:
    code = main([str(argument) for argument in arguments])
    return code, *capsys.readouterr()


def test_convert(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pysas.save(tmp_path / "a.npz", line())
    a, b, c, d = (tmp_path / name for name in ("a.npz", "b.zarr", "c.h5", "d.zarr"))
    assert run(capsys, "convert", a, b, "--int16")[:2] == (0, f"{b}: 40 pings, stored as int16 I and Q, 128 pings a chunk\n")
    code, out, err = run(capsys, "convert", b, c, "--pings", "10:30", "--json")
    assert (code, json.loads(out), err) == (0, {"output": str(c), "shape": [20, 2, 64], "stored": "complex64"}, "")
    assert same(pysas.load(c), pysas.load_echoes(b)[10:30])
    assert run(capsys, "convert", c, d, "--pings", "5:")[0] == 0 and pysas.load_echoes(d).n_ping == 15
    for arguments, message in (
        ((a, b), "b.zarr: exists"),
        ((a, c), "c.h5: exists"),
        ((b, b, "--overwrite"), "is read by this command"),
        ((c, c, "--overwrite"), "is read by this command"),
        ((a, tmp_path / "x.npz", "--int16"), "int16: expected a .zarr"),
        ((a, tmp_path / "x.txt"), "found suffix '.txt'"),
        ((a, tmp_path / "x.zarr", "--pings", "30:10"), "expected some of 40 that follow each other"),
        ((tmp_path / "none.zarr", tmp_path / "x.npz"), "none.zarr"),
    ):
        code, _, err = run(capsys, "convert", *arguments)
        assert code == 2 and message in err, err
    with pytest.raises(SystemExit):
        main(["convert", str(a), str(b), "--pings", "5"])
    assert run(capsys, "convert", a, b, "--overwrite")[0] == 0 and same(pysas.load(b), line())
    assert sorted(item.name for item in tmp_path.iterdir()) == ["a.npz", "b.zarr", "c.h5", "d.zarr"]


def test_info_and_check_read_some_of_the_pings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stores, "_CHUNK_BYTES", 4 * 4096)
    monkeypatch.setattr("pysas.cli.check._MOST_PINGS", 64)
    path, echoes = tmp_path / "a.zarr", line(400, 256)
    writer = pysas.EchoWriter(path)
    writer.append(echoes)
    for number in (*range(2, 40), *range(60, 90)):  # pings 8 to 159 and 240 to 359 of 4 a chunk
        (path / "data" / f"c.{number}.0.0").unlink()
    code, out, _ = run(capsys, "info", path)
    assert code == 0 and "complex64, 4 pings a chunk; not complete" in out
    peak = np.abs(echoes.data).max(axis=(1, 2))
    assert f"largest magnitude {peak[0]:.3g} in ping 0, {peak[200]:.3g} in ping 200, {peak[399]:.3g} in ping 399" in out
    values = json.loads(run(capsys, "info", path, "--json")[1])
    assert values["shape"] == [400, 2, 256] and values["complete"] is False
    code, out, _ = run(capsys, "check", path, "--json")
    rows = {row["check"]: row for row in json.loads(out)["checks"]}
    assert rows["looked at"]["text"].startswith("samples of pings 168 to 231 of 400, navigation of all; pings are still added")
    assert rows["finite samples"]["text"] == f"{64 * 2 * 256} samples"
    tx = echoes.tx.copy()
    tx[300:, 0] += 25.0
    jump = echoes.replace(tx=tx, rx=echoes.rx + (tx - echoes.tx)[:, None])
    pysas.save(tmp_path / "b.zarr", jump)
    rows = {row["check"]: row for row in json.loads(run(capsys, "check", tmp_path / "b.zarr", "--json")[1])["checks"]}
    assert rows["track"]["state"] != "ok" and "300" in rows["track"]["text"]
    writer.close()


# The page


def test_the_page_tells_what_a_store_has(tmp_path: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    (table,) = re.findall(r"^\| in a store .*?\n\|[-|]*\n(.*?)\n\n", page, re.DOTALL | re.MULTILINE)
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()]
    assert [row[0] for row in rows] == ["data", "scale", *stores._OWN]
    with pysas.EchoWriter(tmp_path / "a.zarr", int16=True) as writer:
        writer.append(survey())
    group = zarr.open_group(str(tmp_path / "a.zarr"), mode="r")
    arrays = dict(group.arrays())
    assert {*arrays, *group.attrs} <= {*io.ECHO_FIELDS, "scale", *stores._OWN}
    for name, place, entries, shape, *_ in rows:
        if place == "array":
            assert str(arrays[name].dtype) in entries and shape.split(" or ")[-1] == " ".join(
                arrays[name].metadata.dimension_names
            )
        else:
            assert place == "attribute" and name in group.attrs and shape == ""
    assert f"{stores._CHUNK_PINGS} pings" in page and f"{stores._CHUNK_BYTES // 2**20} MiB" in page
