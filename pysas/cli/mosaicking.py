"""`pysas mosaic`: a survey's images on one map."""

from __future__ import annotations

import argparse
import dataclasses
import json

from pysas.cli.common import Command, Progress, add_overwrite
from pysas.survey.mosaics import COMBINE, mosaic


def _add_arguments(sub: argparse.ArgumentParser) -> None:
    sub.add_argument("store", metavar="STORE", help="images of a survey (.zarr)")
    sub.add_argument("-o", dest="output", metavar="OUT", required=True, help="map to write (.tif, .nc, .zarr)")
    sub.add_argument("--pixel", type=float, metavar="M", help="side of a pixel, m (default: the store's)")
    sub.add_argument("--crs", metavar="CRS", help="such as EPSG:32632 (default: UTM in the survey's zone, or local metres)")
    sub.add_argument("--combine", choices=COMBINE, default=COMBINE[0], help="of strips that overlap (default: nearest range)")
    sub.add_argument("--feather", type=float, default=0.0, metavar="M", help="blend strips over M m (default: not)")
    sub.add_argument("--db", type=float, metavar="DB", help="of a .tif: 8 bit over DB dB (default: magnitudes in float32)")
    add_overwrite(sub)


def _run(arguments: argparse.Namespace, progress: Progress) -> int:
    """1 where the map is empty."""
    found = mosaic(
        arguments.store, arguments.output, pixel=arguments.pixel, crs=arguments.crs, combine=arguments.combine,
        feather=arguments.feather, db=arguments.db, overwrite=arguments.overwrite, progress=progress.step("mosaic"),
    )  # fmt: skip
    if arguments.json:
        print(json.dumps(dataclasses.asdict(found)))
        return int(found.coverage == 0)
    rows, columns = found.shape
    print(f"{found.output}: {columns} x {rows} pixels of {found.pixel:g} m, {found.crs or 'local metres, no CRS'}")
    print(f"  coverage   {100 * found.coverage:.1f} % of the pixels; {found.missing} of {found.tiles} tiles missing")
    if found.reference is not None:
        print(f"  255        magnitude {found.reference:.4g}, the 99.9th percentile; 1: {arguments.db:g} dB below; 0: no data")
    return int(found.coverage == 0)


COMMAND = Command("mosaic", "write the images of a survey as one map: GeoTIFF, NetCDF or Zarr", _add_arguments, _run)
