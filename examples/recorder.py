"""From a recorder's files to an image: what an ADC sampled, a measured pulse, navigation and lever arms.

`focused` is the whole way, in fifteen statements with the constants above it; what follows only writes the picture and compares
the image with known targets. `examples/recorder.sh` goes the same way without Python.

    python examples/recorder.py FOLDER --out recorder.png
    python examples/recorder.py FOLDER --nav nav_bad.csv        # the same with navigation that lacks 8 mm of sway

The folder holds adc.bin (int16, ping x receiver x sample), replica.wav (the pulse, from its leading edge on), nav.csv (time,
lat, lon, depth, roll, pitch, heading; degrees, metres), pings.csv (time), levers.csv (transmitter, then receivers: forward,
starboard, down, m), survey.mat (fs, c, t_delay of sample 0) and targets.csv (lat, lon, depth of known targets).
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
import scipy.io
import scipy.io.wavfile

import pysas
import pysas.plot
from pysas.navigation import Frame, Poses, euler, geometry

FC, BAND, BED = 100e3, 36e3, 20.0  # Hz: carrier, and what is kept about it of a pulse from 85 to 115 kHz; m: the bed's depth
LEAD = 200  # zeros on both ends of the pulse: a filter rings before and behind it


def focused(folder: Path, nav_name: str) -> tuple[pysas.Image, Frame]:
    """The image at the bed's depth, and the frame it is in."""
    fs, c, t0 = (scipy.io.loadmat(folder / "survey.mat")[name].item() for name in ("fs", "c", "t_delay"))
    nav, pings = pysas.read_table(folder / nav_name), pysas.read_table(folder / "pings.csv")
    arms = pysas.read_table(folder / "levers.csv", text=["name"])["x", "y", "z"]
    adc = np.memmap(folder / "adc.bin", "<i2", "r").reshape(len(pings), len(arms) - 1, -1)
    data, rate = pysas.demodulate(adc, fs, FC, bandwidth=BAND, t0=t0)
    replica = np.pad(scipy.io.wavfile.read(folder / "replica.wav")[1], LEAD)
    pulse, _ = pysas.demodulate(replica, fs, FC, bandwidth=BAND, t0=-LEAD / fs)
    attitude = euler(nav["roll"], nav["pitch"], nav["heading"], degrees=True, source=nav.path)
    poses = Poses.from_geodetic(nav["time"], nav["lat"], nav["lon"], attitude, depth=nav["depth"], source=nav.path)
    # pulse_centre is 0 because this recording is a simulation in which all of a pulse leaves from where the transmitter is at
    # its leading edge; a sonar moves meanwhile: navigation.pulse_centre(replica, fs) - LEAD / fs
    where = geometry(
        poses, pings["time"], tx=arms[0], rx=arms[1:], pulse_centre=0.0, travel_time=(t0, t0 + (adc.shape[-1] - 1) / fs)
    )
    raw = pysas.Echoes(data, fs=rate, fc=FC, t0=t0, c=c, tx=where.tx, rx=where.rx, velocity=where.velocity, compressed=False)
    grid = pysas.Grid.plane(np.arange(-3, 3, 0.01), np.arange(22.3, 25.6, 0.01), z=BED)
    return pysas.focus(pysas.compress(raw, pulse=pulse, pulse_t0=-LEAD / fs), grid), where.frame


def main(arguments: list[str] | None = None) -> list[dict[str, float]]:
    """Run the example; returns what it prints of each target, m and dB."""
    parser = argparse.ArgumentParser(description="Image a recorder's files and compare known targets with the truth.")
    default = Path(os.environ["PYSAS_DATA"]) / "recorder" if "PYSAS_DATA" in os.environ else None
    parser.add_argument(
        "folder", nargs="?", type=Path, default=default, help="with the files (default: recorder in $PYSAS_DATA)"
    )
    parser.add_argument("--nav", default="nav.csv", help="navigation, a file of the folder (%(default)s)")
    parser.add_argument("--out", type=Path, default=Path("recorder.png"), help="picture to write (%(default)s)")
    options = parser.parse_args(arguments)
    if options.folder is None:
        parser.error("no data: name their folder or set PYSAS_DATA")

    image, frame = focused(options.folder, options.nav)
    print(f"{frame}\n{image}")
    truth = pysas.read_table(options.folder / "targets.csv")
    targets = frame.from_geodetic(truth["lat"], truth["lon"], truth["depth"])
    pysas.plot.quicklook(image, options.out, targets=targets, title=f"{options.nav}, bed at {BED:g} m; circles: true places")
    print(f"wrote {options.out}\ntargets: true x, y, depth; error of the image in x, y; level")
    x, y = np.meshgrid(image.grid.axes["x"], image.grid.axes["y"])
    found = []
    for target, depth in zip(targets, truth["depth"], strict=True):
        near = np.abs(np.where(np.hypot(x - target[0], y - target[1]) < 0.2, image.data, 0))
        row, column = np.unravel_index(int(np.argmax(near)), near.shape)
        place = pysas.metrics.peak_position(image, near=(x[row, column], y[row, column]), radius=0.02)
        dx, dy = place[0] - target[0], place[1] - target[1]
        found.append({"depth": depth, "dx": dx, "dy": dy, "level_db": 20 * np.log10(near[row, column])})
        above = f"  {1e3 * (BED - depth):.0f} mm above the bed: layover" if abs(depth - BED) > 1e-3 else ""
        print(
            f"  {target[0]:7.3f} m {target[1]:7.3f} m {depth:5.1f} m  {1e3 * dx:+8.2f} mm {1e3 * dy:+8.2f} mm  "
            f"{found[-1]['level_db']:5.1f} dB{above}"
        )
    return found


if __name__ == "__main__":
    main()
