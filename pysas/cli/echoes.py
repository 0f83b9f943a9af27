"""`pysas echoes`: a file of compressed echoes from what a recorder leaves behind."""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas.cli.common import Command, Progress, add_overwrite, add_threads, require_places
from pysas.formats import files, io, matlab_variables, recordings
from pysas.formats.tables import Table, read_table
from pysas.model.echoes import Echoes
from pysas.navigation import Geometry, Poses, euler, geometry, pulse_centre
from pysas.signal import compression
from pysas.signal.baseband import demodulate

_NAV = ("time", "lat", "lon", "depth", "roll", "pitch", "heading")
_LEAD = 12  # periods of the band that a filtered pulse is let ring before and behind the measured one: 1e-4 of its echoes
_NUMBER = "a number, or FILE.mat:NAME"


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.epilog = f"NUMBER: {_NUMBER} for a variable of a MATLAB file. What the files mean is told in docs/conventions.md."
    files, numbers = sub.add_argument_group("files"), sub.add_argument_group("numbers")
    files.add_argument("--samples", required=True, metavar="FILE", help="raw binary, real pass-band, (ping, channel, sample)")
    files.add_argument("--dtype", required=True, help="of the samples: int16, <i2, >i4, float32 ...")
    files.add_argument("--shape", required=True, type=int, nargs=3, metavar=("PINGS", "CHANNELS", "SAMPLES"))
    files.add_argument(
        "--pulse", required=True, metavar="FILE", help="pass-band, from its leading edge on: a .wav, or FILE.mat:NAME"
    )
    files.add_argument("--nav", required=True, metavar="FILE", help=f"table of {', '.join(_NAV)}: s, deg, m (depth: down)")
    files.add_argument("--pings", required=True, metavar="FILE", help="table of time: leading edges of the pulses, s")
    files.add_argument(
        "--levers", required=True, metavar="FILE", help="table of name (tx, rx...), x, y, z: forward, starboard, down, m"
    )
    files.add_argument("-o", "--output", required=True, metavar="ECHOES", help="file to write (.npz, .h5)")
    add_overwrite(sub)
    for name, text in (
        ("fs", "rate of samples and pulse, Hz"),
        ("fc", "demodulation frequency, Hz: the middle of the band"),
        ("bandwidth", "what is kept about it, Hz"),
        ("t0", "time of sample 0 after the pulse's leading edge, s"),
        ("c", "speed of sound, m/s"),
    ):
        numbers.add_argument(f"--{name}", required=True, metavar="NUMBER", help=text)
    numbers.add_argument(
        "--pulse-centre",
        metavar="NUMBER",
        help="from a pulse's leading edge to the instant of its place, s (default: by the pulse)",
    )
    add_threads(sub)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    number = {name: _number(f"--{name}", getattr(arguments, name)) for name in ("fs", "fc", "bandwidth", "t0", "c")}
    read = ("samples", "pulse", "nav", "pings", "levers", "pulse_centre", *number)  # of which plain numbers are no files
    inputs = [_file(text)[0] for name in read if (text := getattr(arguments, name)) is not None]
    require_places(inputs, data=arguments.output, overwrite=arguments.overwrite)
    for name, value in number.items():
        _checks.number(f"--{name}", value, positive=name != "t0", low=0.0)
    fs, fc, band, t0 = (number[name] for name in ("fs", "fc", "bandwidth", "t0"))
    if band * arguments.shape[2] < fs:
        raise ValueError(f"--bandwidth {band:g} Hz: expected more than a record resolves, {fs / arguments.shape[2]:g} Hz")
    workers = _checks.threads(arguments.threads)
    samples = recordings.read_samples(arguments.samples, arguments.dtype, arguments.shape)
    replica = _replica(arguments.pulse, fs)
    lead = int(np.ceil(_LEAD * fs / band))
    with files.naming(arguments.pulse):
        pulse, rate = demodulate(np.pad(replica, lead), fs, fc, band, t0=-lead / fs, threads=workers)
        centre = pulse_centre(replica, fs)
    if arguments.pulse_centre is not None:
        centre = _checks.number("--pulse-centre", _number("--pulse-centre", arguments.pulse_centre), low=0.0)
    where = _where(arguments, centre, (t0, t0 + (samples.shape[-1] - 1) / fs))
    progress.step("demodulating")
    with files.naming(arguments.samples):
        data, _ = demodulate(samples, fs, fc, band, t0=t0, threads=workers)
    raw = Echoes(
        data, fs=rate, fc=fc, t0=t0, bandwidth=min(band, rate / 1.1), c=number["c"], tx=where.tx, rx=where.rx,
        velocity=where.velocity, compressed=False, ping_time=where.ping_time,
        attrs={"title": Path(arguments.samples).name, "frame": dataclasses.asdict(where.frame), "pulse_centre": centre},
    )  # fmt: skip
    with files.naming(arguments.pulse):
        echoes = compression.compress(
            raw, pulse=pulse, pulse_t0=-lead / fs, threads=workers, progress=progress.step("compressing")
        )
    io.save(arguments.output, echoes, overwrite=arguments.overwrite)
    if arguments.json:
        values = {"echoes": arguments.output, "shape": list(data.shape), "fs": rate, **echoes.attrs}
        print(json.dumps(values | {"receiver_error": where.receiver_error}))
    else:
        print(f"{where}\n{echoes!r}\nz is depth: pysas image {arguments.output} --z DEPTH images the bed")
    return 0


COMMAND = Command("echoes", "make a file of echoes from a recorder's samples, pulse and navigation", _add_arguments, _run)


def _where(arguments: argparse.Namespace, centre: float, span: tuple[float, float]) -> Geometry:
    """Transmitter and receivers of every ping, from navigation and lever arms."""
    nav, pings = (_table(path, names) for path, names in ((arguments.nav, _NAV), (arguments.pings, ("time",))))
    levers = _table(arguments.levers, ("x", "y", "z"), text="name")
    names, arms = list(levers.text["name"]), levers["x", "y", "z"]
    wrong = next((name for name in names if not name.lower().startswith(("tx", "rx"))), None)
    if wrong is not None:
        raise ValueError(f"{levers.path}: name {wrong!r:.60}: expected tx or rx... in every row")
    if (count := sum(name.lower().startswith("tx") for name in names)) != 1:
        raise ValueError(f"{levers.path}: {count} rows named tx: expected one transmitter")
    sender = next(row for row, name in enumerate(names) if name.lower().startswith("tx"))
    for path, found, of, expected in (
        (pings.path, len(pings), "pings", arguments.shape[0]),
        (levers.path, len(names) - 1, "receivers", arguments.shape[1]),
    ):
        if found != expected:
            raise ValueError(f"{path}: {found} {of}: expected {expected}, as --shape says of {arguments.samples}")
    attitude = euler(nav["roll"], nav["pitch"], nav["heading"], degrees=True, source=nav.path)
    poses = Poses.from_geodetic(nav["time"], nav["lat"], nav["lon"], attitude, depth=nav["depth"], source=nav.path)
    try:
        return geometry(
            poses, pings["time"], tx=arms[sender], rx=np.delete(arms, sender, axis=0), pulse_centre=centre,
            travel_time=span, source=pings.path,
        )  # fmt: skip
    except ValueError as error:
        if str(error).startswith(("tx", "rx")):
            raise ValueError(f"{levers.path}: {error}") from None
        raise


def _table(path: str, names: tuple[str, ...], text: str | None = None) -> Table:
    """A table that has these columns."""
    table = read_table(path, text=[] if text is None else [text])
    for name in names:
        if name not in table.columns:
            found = ", ".join([*table.columns, *table.text])
            raise ValueError(f"{table.path}: no column {name!r}: expected {', '.join(names)}, found {found}")
    return table


def _replica(text: str, fs: float) -> npt.NDArray[Any]:
    """The measured pulse, real pass-band."""
    path, name = _file(text)
    samples, rate = (matlab_variables.read_row(path, name), fs) if name else recordings.read_wav(path)
    if rate != fs:
        raise ValueError(f"{path}: {rate:g} Hz: expected the samples' rate, --fs {fs:g} Hz")
    if not np.isfinite(samples).all():
        raise ValueError(f"{path}: not finite first at sample {int(np.argmin(np.isfinite(samples)))}: expected finite samples")
    return samples


def _number(option: str, text: str) -> float:
    """What an option says, or the variable of a MATLAB file that it names."""
    path, name = _file(text)
    if not name:
        try:
            return _checks.number(option, float(text))
        except ValueError:
            raise ValueError(f"{option} {text!r:.60}: expected {_NUMBER}") from None
    values = matlab_variables.read_row(path, name)
    if values.size != 1:
        raise ValueError(f"{option}: {path}, {name}: {values.size} numbers: expected one")
    return _checks.number(f"{option}: {path}, {name}", values[0])


def _file(text: str) -> tuple[str, str]:
    """FILE.mat:NAME in two, or the text and no name."""
    path, colon, name = text.rpartition(":")
    return (path, name) if colon and path.lower().endswith(".mat") and name else (text, "")
