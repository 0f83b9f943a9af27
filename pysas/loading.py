"""Files of any known format, as echoes or images: recognised by `formats`, brought to echoes by `signal`."""

from __future__ import annotations

import os

from pysas.formats import catalogue, files, own, unknown
from pysas.formats.files import name, naming
from pysas.formats.format import Look
from pysas.model.echoes import Echoes
from pysas.model.image import Image
from pysas.model.phase_history import PhaseHistory
from pysas.model.recording import Recording


def load(path: str | os.PathLike[str], *, channel: str | None = None) -> Echoes | Image:
    """Read echoes or an image from a file of any known format (docs/formats.md lists them).

    Parameters
    ----------
    path : str or path
        A regular file or a link to one, or a folder that holds a Zarr group. What it is, its content tells and not its name.
        `open_echoes` reads echoes of .npz, .h5 and .zarr by pings.
    channel : str, optional
        Of a file whose channels have pings of their own, CPHD for one: the one that is read. Needed where there are several.

    Returns
    -------
    Echoes or Image
        The scene's truth, where the file has it, is in `echoes.attrs` as arrays "truth_position", "truth_amplitude".
        Samples are read as they are, non-finite ones included; real ones are demodulated. Fields that a schema lacks are
        ignored, with a warning.

    Raises
    ------
    ValueError
        A damaged file, or one that breaks its format; names file, field, found and expected. One of no known format: what it
        looks like and what to do. A pipe or a device.
    MemoryError
        What a whole file holds does not fit; says how much.
    OSError, ImportError
        From the file system; a format whose library is not installed, with the extra that brings it.
    """
    return read(Look(name(path)), channel)


def read(look: Look, channel: str | None = None) -> Echoes | Image:
    """As `load`, of a file that was looked at."""
    found = catalogue.recognised(look)
    if found is None:
        if not look.folder:
            files.opened(look.path).close()  # raises what the file system says
        if (what := unknown.explained(look)) is not None:
            raise ValueError(f"{look.path}: {what}")
    known = found or own.FORMAT
    known.require_channel(look.path, channel)
    item = known.read(look.path, channel)
    if isinstance(item, Recording):
        from pysas.signal import recorded  # half a second that files of echoes need not wait for

        with naming(look.path):
            return recorded.demodulated(item)
    if isinstance(item, PhaseHistory):
        from pysas.signal import phase_history

        with naming(look.path):
            return phase_history.compressed(item)
    return item


def load_echoes(path: str | os.PathLike[str], *, channel: str | None = None) -> Echoes:
    """As `load`, of a file that holds echoes; ValueError where it holds an image."""
    item = load(path, channel=channel)
    if not isinstance(item, Echoes):
        raise ValueError(f"{name(path)}: found an image, expected echoes")
    return item


def load_image(path: str | os.PathLike[str]) -> Image:
    """As `load`, of a file that holds an image; ValueError where it holds echoes."""
    item = load(path)
    if not isinstance(item, Image):
        raise ValueError(f"{name(path)}: found echoes, expected an image")
    return item
