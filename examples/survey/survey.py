"""A survey from two stores of echoes to a map, killed on the way and resumed, on this machine and on a Dask cluster.

    python examples/survey/survey.py --out FOLDER [--length 300]

`scene.py` beside it makes two lines that pass a wreck on opposite sides. They are imaged by `pysas survey`: once undisturbed,
once killed (kill -9) in the midst of it and resumed, and once by two workers of a Dask scheduler, of which one is killed. The
three stores are the same, byte by byte. A bit is then changed in one of them, which `--verify` names and `--resume` mends.
`pysas mosaic` makes a GeoTIFF in UTM of it, in which the targets lie where the scene has put them. Every command is printed as
it is run.
"""

from __future__ import annotations

import argparse
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

import pysas

OPTIONS = "--pixel 0.05 --swath 8:45 --tol 1e-2 --tile 10 --section 50"


def command(text: str, folder: Path, *, expect: int = 0) -> str:
    """Run a command of the command line in a folder; returns what it prints."""
    print(f"$ pysas {text}", flush=True)
    done = subprocess.run([sys.executable, "-m", "pysas", *shlex.split(text)], cwd=folder, stdout=subprocess.PIPE, text=True)
    print(done.stdout, end="", flush=True)
    if done.returncode != expect:
        raise SystemExit(f"pysas {text}: exit code {done.returncode}, expected {expect}")
    return done.stdout


def killed(text: str, folder: Path, store: Path, tiles: int) -> None:
    """Begin a command and kill it as soon as its store has so many tiles."""
    print(f"$ pysas {text}   # and kill -9", flush=True)
    process = subprocess.Popen([sys.executable, "-m", "pysas", *shlex.split(text)], cwd=folder, stdout=subprocess.DEVNULL)
    while process.poll() is None and len(list(store.glob("*/records/*/zarr.json"))) < tiles:
        time.sleep(0.01)
    process.kill()
    process.wait()


def content(store: Path) -> dict[str, bytes]:
    """All files of a store."""
    return {str(path.relative_to(store)): path.read_bytes() for path in sorted(store.rglob("*")) if path.is_file()}


def by_dask(lines: str, folder: Path) -> None:
    """The same survey by a scheduler and two workers, one of which dies."""
    address = folder / "scheduler.json"
    address.unlink(missing_ok=True)
    quiet = {"cwd": folder, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "start_new_session": True}
    dask = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    processes = [subprocess.Popen([*dask, "--scheduler-file", str(address)], **quiet)]
    try:
        while not (address.exists() and address.stat().st_size):
            time.sleep(0.05)
        worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--scheduler-file", str(address), "--nthreads", "1"]
        processes += [subprocess.Popen([*worker, "--no-dashboard", "--host", "127.0.0.1"], **quiet) for _ in range(2)]
        at = json.loads(address.read_text())["address"]
        text = f"survey {lines} -o dask.zarr {OPTIONS} --scheduler {at}"
        print(f"$ pysas {text}   # and kill -9 of a worker", flush=True)
        client = subprocess.Popen([sys.executable, "-m", "pysas", *shlex.split(text)], cwd=folder)
        while client.poll() is None and not list((folder / "dask.zarr").glob("*/records/*/zarr.json")):
            time.sleep(0.01)
        os.killpg(processes[1].pid, signal.SIGKILL)
        if client.wait() != 0:
            raise SystemExit("the survey on the cluster did not end well")
    finally:
        for process in processes:
            try:
                os.killpg(process.pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            process.wait()


def places(tiff: Path, truth: dict) -> None:
    """How far from its truth in UTM each target's centre of power lies, among pixels within 6 dB of its peak."""
    import rasterio

    with rasterio.open(tiff) as file:
        print(f"{tiff.name}: {file.width} x {file.height} pixels of {file.res[0]:g} m, {file.crs}")
        power, step = file.read(1).astype(float) ** 2, file.res[0]
        for east, north in zip(truth["targets"]["easting"], truth["targets"]["northing"], strict=True):
            row, column = file.index(east, north)
            near = power[row - 8 : row + 9, column - 8 : column + 9]
            strong = np.argwhere(near > np.nanmax(near) / 4)
            middle = np.average(strong, axis=0, weights=near[tuple(strong.T)])
            x, y = file.xy(*(middle + (row - 8, column - 8)))
            off = np.hypot(x - east, y - north)
            print(f"  target at E {east:.2f}, N {north:.2f}: found {100 * off:.1f} cm away")
            if off > step / 2:
                raise SystemExit("a target is not where it was put")


def draw(folder: Path, truth: dict, path: Path) -> None:
    """The map, and the wreck as each line saw it, on that line's own axes."""
    import matplotlib.pyplot as plt
    import rasterio
    import xarray

    with rasterio.open(folder / "survey.tif") as file:
        step = max(1, file.width // 2000)
        counts = file.read(1, out_shape=(file.height // step, file.width // step), resampling=rasterio.enums.Resampling.average)
        left, bottom, right, top = file.bounds
        crs = file.crs.to_string()
    figure, axes = plt.subplots(figsize=(13, 8), layout="constrained")
    shown = np.ma.masked_equal(counts, 0)
    axes.imshow(shown, cmap="copper", extent=(left, right, bottom, top), vmin=20, vmax=255)
    wreck = truth["wreck"]
    axes.set(xlabel=f"easting, m ({crs})", ylabel="northing, m", facecolor="0.93")
    axes.ticklabel_format(useOffset=False, style="plain")
    for number, place in enumerate(([0.03, 0.57, 0.3, 0.37], [0.67, 0.07, 0.3, 0.37])):
        strip = xarray.open_zarr(folder / "survey.zarr", group=f"{number:03d}-starboard", consolidated=False)
        own = pysas.Grid.plane([0.0], [0.0], origin=strip.origin, rotation=strip.rotation)
        x, y = own.along_axes([[wreck["x"], wreck["y"]]])[0]
        near = strip.magnitude.sel(x=slice(x - 14, x + 14), y=slice(y - 12, y + 12)).load()
        inset = axes.inset_axes(place)
        level = 20 * np.log10(np.maximum(near, 1e-9)) - 20 * np.log10(float(np.median(strip.magnitude[:, ::20])))
        inset.imshow(level, cmap="copper", vmin=-20, vmax=25, extent=(-14, 14, y + 12, y - 12), aspect="equal")
        inset.set_title(f"the wreck from line {number + 1}: along the line and across it, m", fontsize=9)
    figure.savefig(path, dpi=110, pil_kwargs={"quality": 88} if path.suffix == ".jpg" else None)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", required=True, type=Path)
    parser.add_argument("--length", type=float, default=300.0, help="of the lines, m")
    parser.add_argument("--png", type=Path, help="picture to draw (needs matplotlib)")
    args = parser.parse_args()
    folder = args.out.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    scene = Path(__file__).with_name("scene.py")
    subprocess.run([sys.executable, scene, "--out", folder, "--length", str(args.length)], check=True)
    lines = "line1.zarr line2.zarr"
    for name in ("survey.zarr", "killed.zarr", "dask.zarr"):
        shutil.rmtree(folder / name, ignore_errors=True)

    command(f"survey {lines} -o survey.zarr {OPTIONS}", folder)
    killed(f"survey {lines} -o killed.zarr {OPTIONS}", folder, folder / "killed.zarr", 3)
    command(f"survey {lines} -o killed.zarr {OPTIONS} --resume", folder)
    by_dask(lines, folder)
    undisturbed = content(folder / "survey.zarr")
    for other in ("killed.zarr", "dask.zarr"):
        if content(folder / other) != undisturbed:
            raise SystemExit(f"{other} is not survey.zarr")
        print(f"{other}: all {len(undisturbed)} files as in survey.zarr, byte by byte")

    shard = folder / "killed.zarr" / "000-starboard" / "data" / "c.0.2"
    bits = bytearray(shard.read_bytes())
    bits[12345] ^= 1
    shard.write_bytes(bits)
    command("survey -o killed.zarr --verify", folder, expect=1)
    command("survey -o killed.zarr --resume", folder)
    command("survey -o killed.zarr --verify", folder)
    if content(folder / "killed.zarr") != undisturbed:
        raise SystemExit("the store was not mended")

    command("mosaic survey.zarr -o survey.tif --db 40 --overwrite", folder)
    command("mosaic survey.zarr -o float.tif --overwrite", folder)
    truth = json.loads((folder / "truth.json").read_text())
    places(folder / "float.tif", truth)
    if args.png is not None:
        draw(folder, truth, args.png)


if __name__ == "__main__":
    main()
