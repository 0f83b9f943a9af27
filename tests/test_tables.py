"""Tables of text: columns by name, and what is wrong with a file, by its name and line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pysas

pytestmark = pytest.mark.reference  # no engine takes part


def write(folder: Path, text: str | bytes, name: str = "nav.csv") -> str:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


def test_columns_by_name(tmp_path: Path) -> None:
    path = write(tmp_path, '# a recorder\ntime, roll ,note\r\n1.5,10,ok\n\n2.5,-20,"a, b"\n# the end\n3.5,,\n')
    table = pysas.read_table(path, text=["note"], scale={"roll": np.pi / 180})
    np.testing.assert_array_equal(table["time"], [1.5, 2.5, 3.5])
    np.testing.assert_array_equal(table["roll"], [10 * (np.pi / 180), -20 * (np.pi / 180), np.nan])
    np.testing.assert_array_equal(table["roll", "time"][0], [10 * (np.pi / 180), 1.5])
    assert table.text["note"] == ["ok", "a, b", ""] and len(table) == 3
    assert repr(table) == f"Table({path}: 3 rows of time, roll, note)"
    assert table["time"].dtype == np.float64 and not table["time"].flags.writeable


def test_numbers_are_read_to_the_last_bit(tmp_path: Path) -> None:
    values = np.random.default_rng(0).normal(size=(50, 2)) * [1e9, 1e-9]
    text = "a\tb\n" + "\n".join(f"{a!r}\t{b!r}" for a, b in values.tolist())
    np.testing.assert_array_equal(pysas.read_table(Path(write(tmp_path, text)), delimiter="\t")["a", "b"], values)


def test_marks_of_byte_order_and_no_rows(tmp_path: Path) -> None:
    table = pysas.read_table(write(tmp_path, b"\xef\xbb\xbftime,x\n"))
    assert list(table.columns) == ["time", "x"] and table["time"].shape == (0,) and table["time", "x"].shape == (0, 2)


@pytest.mark.parametrize(
    ("text", "arguments", "error", "message"),
    [
        ("", {}, ValueError, "nav.csv: empty: expected a line with names"),
        ("1,2\n3,4\n", {}, ValueError, "nav.csv, line 1: '1' for the name of column 0: expected names"),
        ("a,,b\n", {}, ValueError, "line 1: '' for the name of column 1"),
        ("a,b,a\n", {}, ValueError, "line 1: 'a' twice"),
        ("# x\na,b\n1,2\n1\n", {}, ValueError, r"nav.csv, line 4: 1 fields: expected 2 \(a, b\)"),
        ("a,b\n1,2,3\n", {}, ValueError, "line 2: 3 fields: expected 2"),
        ("a,b\n1,2\n1,two\n", {}, ValueError, r"nav.csv, line 3, b: 'two': expected a number \(text=\['b'\] if it is none\)"),
        ("a\n1_000\n", {}, ValueError, "line 2, a: '1_000'"),
        ("a;b\n1;2\n", {}, ValueError, "line 2, a;b: '1;2'"),
        ("a\n1\n", {"text": ["b"]}, ValueError, "text: no column 'b': expected one of a"),
        ("a\n1\n", {"scale": {"b": 2.0}}, ValueError, "scale: no column 'b'"),
        ("a\n1\n", {"scale": {"a": np.inf}}, ValueError, r"scale\['a'\]=inf"),
        ("a\n1\n", {"text": "a"}, TypeError, "text='a': expected a sequence"),
        ("a\n1\n", {"delimiter": ", "}, TypeError, "delimiter=', '"),
        (b"a\n\xff\xfe\n", {}, ValueError, "nav.csv, near line .*: expected lines of text in UTF-8"),
        (b"a\n" + b"1" * 200_000 + b"\n", {}, ValueError, "nav.csv, near line 2: expected lines of text"),
        (b"a\n" + bytes(2_000_000), {}, ValueError, "nav.csv, near line 1: .* a line of 1048576 characters or more"),
    ],
)
def test_rejected(tmp_path: Path, text: Any, arguments: dict[str, Any], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        pysas.read_table(write(tmp_path, text), **arguments)


def test_a_column_that_is_not_there(tmp_path: Path) -> None:
    table = pysas.read_table(write(tmp_path, "time,name\n1,a\n"), text=["name"])
    for names in ("lat", ("time", "lat"), "name"):
        with pytest.raises(KeyError, match=r"nav\.csv: no column .* of numbers: expected one of time"):
            table[names]


def test_no_file(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="absent"):
        pysas.read_table(tmp_path / "absent.csv")
    with pytest.raises(IsADirectoryError):
        pysas.read_table(tmp_path)


def test_rows_of_empty_fields_are_rows(tmp_path: Path) -> None:
    """A blank row of navigation is a gap, not nothing."""
    path = tmp_path / "a.csv"
    path.write_text("time,b\n1,2\n,\n\n# no row\n3,4\n")
    assert np.array_equal(pysas.read_table(path)["time"], [1, np.nan, 3], equal_nan=True)
