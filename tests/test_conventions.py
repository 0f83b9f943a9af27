"""docs/conventions.md: its tables are the schema that files are read by, and its writer writes what `pysas.load` takes."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import pysas
from pysas.formats import fields, io
from pysas.model.grid import KINDS

PAGE = (Path(__file__).parents[1] / "docs" / "conventions.md").read_text(encoding="utf-8")


def rows(heading: str) -> list[list[str]]:
    """Fields of the tables below a heading, their first lines and rules apart."""
    (text,) = re.findall(rf"^### {heading}\n(.*?)(?=^##)", PAGE, re.DOTALL | re.MULTILINE)
    lines = [line for line in text.splitlines() if line.startswith("|")]
    bodies = [line for line, after in zip(lines, [*lines[1:], ""], strict=True) if not {"|---"} & {line[:4], after[:4]}]
    return [[field.strip() for field in line.strip("|").split("|")] for line in bodies]


def told(shape: str) -> tuple[str, ...]:
    """The page's words for shapes as `io` has them: "or ping" is a scalar or (ping,)."""
    return tuple(part.strip() for part in (f" {shape}").split(" or ")) if shape else ("",)


def test_echoes_are_described_as_they_are_read() -> None:
    table = rows("Echoes")
    assert [row[0].removesuffix(" *") for row in table] == list(io.ECHO_FIELDS)
    assert [row[0][:-2] for row in table if row[0].endswith(" *")] == list(io._ECHO_NEEDS)
    for (name, entries, shape, *_), (kind, *shapes) in zip(table, io.ECHO_FIELDS.values(), strict=True):
        words = fields.KINDS[kind][0].removeprefix("a string") or "text"
        assert entries == words, name
        assert sorted(told(shape)) == sorted(shapes), name
    assert f'"{io.ECHOES}"' in PAGE and f'"{io.IMAGE}"' in PAGE


def test_images_are_described_as_they_are_read() -> None:
    table = {row[0]: row[1:] for row in rows("Images")}
    for kind in KINDS:
        fields = io.image_table(kind, (7, 8))
        text = table[kind][0]
        own = {name for name in fields if name.startswith("grid_")} - {"grid_kind", "grid_mask"}
        assert set(re.findall(r"grid_\w+", text)) == own
        if kind != "points":
            assert table[kind][1] == fields["data"][1]
            for name in own:
                shape = fields[name][1].replace(" ", ", ")
                assert f"{name} ({shape})" in text
    general = {name.removesuffix(" *") for name in table} - set(KINDS)
    assert general == {"schema", "data", "fc", "c", "grid_kind", "grid_mask", "report"}


def test_the_writer_in_python_writes_what_an_image_is_made_of(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its scatterer of amplitude 1: N echoes make N, phase 0, where it is."""
    (text,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert "pysas" not in text.replace("pysas-echoes-1", "")
    monkeypatch.chdir(tmp_path)
    exec(text, {})  # noqa: S102
    echoes = pysas.load("line.h5")
    assert isinstance(echoes, pysas.Echoes) and echoes.compressed and echoes.data.shape == (48, 2, 400)
    assert (echoes.fs, echoes.fc, echoes.c, echoes.t0) == (40e3, 60e3, 1480.0, 10e-3)
    image = pysas.backproject(echoes, pysas.Grid.points([[0.3, 12, 5], [0.3, 12.3, 5]]), tol=1e-5).data / (48 * 2)
    assert image[0] == pytest.approx(1, abs=1e-4) and abs(image[1]) < 0.1


def test_every_writer_writes_what_must_be_there() -> None:
    for language in ("python", "matlab", "julia"):
        (text,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
        assert [name for name in io._ECHO_NEEDS if not re.search(rf"""["']{name}["']|\b{name}={name}\b""", text)] == []


def as_others_write(path: Path, compressed: Any) -> None:
    """By HDF5's own functions as other languages call them: strings of fixed length, pairs of floats, other byte orders."""
    pair = np.dtype([("r", "<f4"), ("i", "<f4")])
    with h5py.File(path, "w", libver=("earliest", "v110")) as file:
        kind = h5py.h5t.C_S1.copy()
        kind.set_size(14)
        item = h5py.h5d.create(file.id, b"schema", kind, h5py.h5s.create(h5py.h5s.SCALAR))
        item.write(h5py.h5s.ALL, h5py.h5s.ALL, np.array(b"pysas-echoes-1"), mtype=kind)
        values = np.zeros((3, 2, 5), pair)
        values["r"], values["i"] = np.arange(30).reshape(3, 2, 5), 1
        file["data"] = values
        for name, value in {
            "fs": 4e4,
            "fc": 1e5,
            "c": 1500.0,
            "t0": 0.01,
            "tx": np.ones((3, 3)),
            "rx": np.ones((3, 2, 3)),
        }.items():
            file[name] = np.asarray(value, ">f8")
        file["compressed"] = compressed


@pytest.mark.parametrize("compressed", [np.uint8(0), np.uint8(1), np.False_])
def test_what_other_languages_write_is_read(tmp_path: Path, compressed: Any) -> None:
    as_others_write(tmp_path / "a.h5", compressed)
    echoes = pysas.load(tmp_path / "a.h5")
    assert isinstance(echoes, pysas.Echoes) and echoes.compressed is bool(compressed)
    np.testing.assert_array_equal(echoes.data, (np.arange(30) + 1j).reshape(3, 2, 5))


def test_a_flag_is_0_or_1(tmp_path: Path) -> None:
    as_others_write(tmp_path / "a.h5", np.uint8(2))
    with pytest.raises(ValueError, match=r"a.h5: compressed: found 2, expected 0 or 1"):
        pysas.load(tmp_path / "a.h5")
