"""Tables of text with names of columns in their first line, as recorders write navigation, pings and lever arms.

Read line by line, so that memory is bounded by what lies in the file; every error names the file and the line. What the columns
mean is the reader's affair: nothing here knows navigation.
"""

from __future__ import annotations

import csv
import io
import os
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pysas import _checks
from pysas._checks import FloatArray
from pysas.formats import files

_LONGEST_LINE = 1 << 20


@dataclass(frozen=True, eq=False, repr=False)
class Table:
    """Columns of one file, by name: table["time"] is (row,), table["x", "y", "z"] (row, 3), float64.

    Parameters
    ----------
    path : str
        The file's name.
    columns : mapping
        Numbers, (row,) each; an empty field and "nan" are NaN.
    text : mapping
        Columns that were asked for as text, a list each.
    """

    path: str
    columns: Mapping[str, FloatArray]
    text: Mapping[str, Sequence[str]]

    def __getitem__(self, names: str | tuple[str, ...]) -> FloatArray:
        for name in (names,) if isinstance(names, str) else names:
            if name not in self.columns:
                raise KeyError(f"{self.path}: no column {name!r} of numbers: expected one of {', '.join(self.columns)}")
        if isinstance(names, str):
            return self.columns[names]
        return np.stack([self.columns[name] for name in names], axis=1)

    def __len__(self) -> int:
        return max((len(values) for values in (*self.columns.values(), *self.text.values())), default=0)

    def __repr__(self) -> str:
        return f"Table({self.path}: {len(self)} rows of {', '.join([*self.columns, *self.text])})"


def read_table(
    path: str | os.PathLike[str],
    *,
    text: Sequence[str] = (),
    scale: Mapping[str, float] | None = None,
    delimiter: str = ",",
) -> Table:
    """Read a table of text whose first line names its columns.

    Parameters
    ----------
    path : str or path
        A regular file in UTF-8. Empty lines and those that begin with "#" do not count.
    text : sequence of str
        Columns that are no numbers.
    scale : mapping of str to float, optional
        Factors on columns, for their units: {"roll": np.pi / 180, "x": 1e-3}.
    delimiter : str
        One character.

    Returns
    -------
    Table

    Raises
    ------
    ValueError, TypeError
        No names in the first line, or one twice; a line with more or fewer fields than there are names; a field that is no
        number; a column of `text` or `scale` that is not there. Names the file and the line.
    OSError
        From the file system.

    Notes
    -----
    O(file) time; 8 bytes a number in memory.
    """
    if not isinstance(delimiter, str) or len(delimiter) != 1:
        raise TypeError(f"delimiter={delimiter!r}: expected one character")
    if isinstance(text, str):
        raise TypeError(f"text={text!r}: expected a sequence of names")
    factors = {name: _checks.number(f"scale[{name!r}]", factor) for name, factor in (scale or {}).items()}
    name = files.name(path)
    with files.opened(path) as file, io.TextIOWrapper(file, encoding="utf-8-sig", newline="") as lines:
        rows = _rows(name, lines, delimiter)
        header = _header(name, next(rows, None))
        for asked, of in ((text, "text"), (factors, "scale")):
            for column in asked:
                if column not in header:
                    raise ValueError(f"{name}: {of}: no column {column!r}: expected one of {', '.join(header)}")
        words: dict[str, list[str]] = {column: [] for column in header if column in text}
        numbers = {column: array("d") for column in header if column not in text}
        for line, fields in rows:
            if len(fields) != len(header):
                raise ValueError(f"{name}, line {line}: {len(fields)} fields: expected {len(header)} ({', '.join(header)})")
            for column, field in zip(header, fields, strict=True):
                if column in words:
                    words[column].append(field)
                else:
                    numbers[column].append(_number(name, line, column, field))
    columns = {
        column: _checks.own(np.frombuffer(values, dtype=np.float64) * factors.get(column, 1.0), np.float64)
        if len(values)
        else np.zeros(0)
        for column, values in numbers.items()
    }
    return Table(name, columns, words)


def _rows(name: str, lines: io.TextIOWrapper, delimiter: str) -> Iterator[tuple[int, list[str]]]:
    """Fields, stripped, with the number of their line."""
    reader = csv.reader(_lines(lines), delimiter=delimiter, skipinitialspace=True)
    try:
        for fields in reader:
            stripped = [field.strip() for field in fields]
            if (any(stripped) or len(stripped) > 1) and not stripped[0].startswith("#"):
                yield reader.line_num, stripped
    except (csv.Error, UnicodeDecodeError) as error:
        raise ValueError(f"{name}, near line {reader.line_num}: expected lines of text in UTF-8: {error}") from None


def _lines(lines: io.TextIOWrapper) -> Iterator[str]:
    """Lines of a length that text has: one of gigabytes is not read to its end."""
    while line := lines.readline(_LONGEST_LINE):
        if len(line) == _LONGEST_LINE:
            raise csv.Error(f"a line of {_LONGEST_LINE} characters or more")
        yield line


def _header(name: str, first: tuple[int, list[str]] | None) -> list[str]:
    if first is None:
        raise ValueError(f"{name}: empty: expected a line with names of columns")
    line, header = first
    for i, column in enumerate(header):
        if _is_number(column) or not column:
            raise ValueError(f"{name}, line {line}: {column!r} for the name of column {i}: expected names, then numbers below")
        if column in header[:i]:
            raise ValueError(f"{name}, line {line}: {column!r} twice: expected each name once")
    return header


def _number(name: str, line: int, column: str, field: str) -> float:
    if not field:
        return np.nan
    if not _is_number(field):
        raise ValueError(f"{name}, line {line}, {column}: {field!r:.60}: expected a number (text=[{column!r}] if it is none)")
    return float(field)


def _is_number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return "_" not in field  # float() takes 1_000
