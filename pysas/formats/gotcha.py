"""Phase history of AFRL's Gotcha data and others of its layout: a structure `data` in a .mat file of MATLAB's versions 5 to 7.

Its fields are fp (K, pulse) the phase history, freq (K,) Hz, x, y, z (pulse,) m and r0 (pulse,) m, the range of the scene's
centre, which is the origin (AFRL, "Gotcha Volumetric SAR Data Set Overview").
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pysas import _checks
from pysas.formats import files
from pysas.formats.format import Format, Look
from pysas.formats.matlab_variables import Structure, read_structure, shows_structure
from pysas.formats.radar_xml import SPEED
from pysas.model.phase_history import PhaseHistory, even_grid

_START = b"MATLAB 5.0 MAT-file"
_NAME = "data"
_NUMBERS = ("freq", "x", "y", "z", "r0")
_OFF = 1.0  # m between r0 and the distance of the origin: more than any correction of a track


def _sniff(look: Look) -> bool:
    return look.head.startswith(_START) and shows_structure(look.head, {"fp", *_NUMBERS})


def _read(path: str, channel: str | None) -> PhaseHistory:
    fields = read_structure(path, _NAME)
    with files.naming(path):
        return _history(fields)


def _history(fields: Structure) -> PhaseHistory:
    for name in ("fp", *_NUMBERS):
        if not isinstance(fields.get(name), np.ndarray):
            raise ValueError(f"{_NAME}.{name}: expected numbers")
    samples = np.asarray(fields["fp"]).T
    if samples.dtype.kind != "c" or samples.ndim != 2 or min(samples.shape) < 1:
        raise ValueError(f"{_NAME}.fp: found {samples.dtype} of shape {samples.shape[::-1]}: expected complex (K, pulse)")
    pings, count = samples.shape
    freq = _row(fields, "freq", count)
    x, y, z, r0 = (_row(fields, name, pings) for name in ("x", "y", "z", "r0"))
    position = np.stack([x, y, z], axis=1)
    off = np.abs(np.linalg.norm(position, axis=1) - r0)
    if off.max() > _OFF:
        ping = int(np.argmax(off))
        raise ValueError(f"r0: {r0[ping]:.9g} m at ping {ping}, {off[ping]:.4g} m off the distance of the origin")
    step, middle = even_grid(freq)
    half = SPEED / (4 * step)  # of the swath in which ranges are told apart
    attrs: dict[str, Any] = {
        "source": "Gotcha phase history", "scene_area": {"x": [-half, half], "y": [-half, half], "z": 0.0},
    }  # fmt: skip
    found = fields.get("af")
    if isinstance(found, dict):  # corrections of an autofocus, which are not applied
        attrs["af"] = {name: value.ravel().tolist() for name, value in found.items() if isinstance(value, np.ndarray)}
    return PhaseHistory(
        samples=samples, first=np.full(pings, middle - count // 2 * step), step=np.full(pings, step), tx=position, rx=position,
        reference=2 * r0 / SPEED, c=SPEED, attrs=attrs,
    )  # fmt: skip


def _row(fields: Structure, name: str, count: int) -> Any:
    values = np.asarray(fields[name])
    if values.size != count or values.size != max(values.shape):
        raise ValueError(f"{_NAME}.{name}: found shape {values.shape}: expected {count} numbers, as fp has")
    return _checks.reals(f"{_NAME}.{name}", values.ravel(), [(count,)], ("index",))


FORMAT = Format(
    name="gotcha",
    title="AFRL Gotcha .mat, radar phase history",
    suffixes=(".mat",),
    holds="echoes",
    kept="samples and places; autofocus corrections in attrs, not applied",
    lost="angles of view (th, phi), which the places tell",
    sniff=_sniff,
    read=_read,
)
