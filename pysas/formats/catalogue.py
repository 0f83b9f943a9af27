"""The formats that are known: a new one is a module with a `FORMAT`, and its line here."""

from __future__ import annotations

from pysas.formats import (
    airsas,
    arrays,
    cphd,
    gotcha,
    image_cf,
    image_geotiff,
    image_png,
    matlab,
    openstb,
    own,
    sicd,
)
from pysas.formats.format import Format, Look

# in the order in which they are asked whether a file is theirs
FORMATS: tuple[Format, ...] = (
    matlab.FORMAT,
    image_cf.FORMAT,
    own.FORMAT,
    arrays.FORMAT,
    airsas.FORMAT,
    openstb.FORMAT,
    cphd.FORMAT,
    gotcha.FORMAT,
    sicd.FORMAT,
    image_geotiff.FORMAT,
    image_png.FORMAT,
)


def recognised(look: Look) -> Format | None:
    """The format of a file, or None."""
    return next((known for known in FORMATS if known.sniff(look)), None)


def inputs_of(look: Look) -> list[str]:
    """A file, and those that reading it reads too."""
    known = recognised(look)
    return [look.path, *(known.beside(look.path) if known is not None else [])]


def by_name(path: str, kind: type) -> Format:
    """The format in which something of type `kind` is written to a file of this name."""
    suffix = Look(path).suffix
    fitting = [known for known in FORMATS if issubclass(kind, known.writes)]
    for known in fitting:
        if suffix in known.suffixes:
            return known
    ends = ", ".join(dict.fromkeys(end for known in fitting for end in known.suffixes))
    raise ValueError(f"{path}: found suffix {suffix!r}, expected one of {ends}")
