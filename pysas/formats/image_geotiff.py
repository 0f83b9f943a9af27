"""Images as GeoTIFF, in local metres: complex pixels as they are, or bytes of dB for a picture on a map."""

from __future__ import annotations

import numpy as np

from pysas.formats import geotiff, image_maps
from pysas.formats.format import Format
from pysas.model.image import Image


def _write(path: str, image: Image, overwrite: bool) -> None:
    made = image_maps.of(path, image)
    data = np.ascontiguousarray(made.data, made.data.dtype.newbyteorder("="))
    geotiff.write_whole(path, data, made.affine, made.tags, mask=made.mask, overwrite=overwrite)


def _draw(path: str, image: Image, span: float, overwrite: bool) -> None:
    made = image_maps.of(path, image)
    coding, data = made.decibels(span)
    geotiff.write_whole(path, data, made.affine, made.tags, coding=coding, overwrite=overwrite)


FORMAT = Format(
    name="geotiff",
    title="GeoTIFF",
    suffixes=(".tif", ".tiff"),
    holds="images of planes and surfaces with even steps",
    kept="complex pixels, places, mask, fc, c and report as tags; with --db bytes of dB",
    lost="heights of a surface; no CRS: coordinates are those of the echoes",
    write=_write,
    draw=_draw,
    writes=(Image,),
    extra="survey",
)
