"""A stranger's path, with a clock: a fresh environment, the wheel, an own file, the first image.

    python .ci/stranger.py WHEEL [SECONDS]

The clock runs from before the environment is made; more than SECONDS in all (60) fail. No compiler is used. pip keeps its cache
unless PIP_NO_CACHE_DIR=1. The image must show the file's scatterer where it is.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# by docs/conventions.md: one scatterer of amplitude 1 at (0.3, 12, 5), heard by one receiver at 48 places
OWN = """
import numpy as np
fs, fc, c, t0 = 40e3, 60e3, 1480.0, 10e-3
tx = np.stack([0.05 * np.arange(48) - 1.2, np.zeros(48), np.zeros(48)], axis=-1)
tau = 2 * np.linalg.norm([0.3, 12, 5] - tx, axis=-1) / c
t = t0 + np.arange(400) / fs
data = np.sinc(20e3 * (t - tau[:, None])) * np.exp(-2j * np.pi * fc * tau[:, None])
np.savez("own.npz", schema="pysas-echoes-1", data=data.astype(np.complex64), fs=fs, fc=fc, c=c, t0=t0, tx=tx, rx=tx,
         compressed=True, bandwidth=20e3)
"""
LOOK = """
import numpy as np
import pysas
image = pysas.load_image("own_image.npz")
place = image.grid.coordinates()[np.argmax(np.abs(image))]
assert np.linalg.norm(place - [0.3, 12, 5]) < 0.04, place
print(f"brightest at {np.round(place, 2)}, by {image.report.backend}")
assert image.report.backend == "cpp", "the wheel's extension did not run"
"""


def main(wheel: str, limit: float = 60.0) -> None:
    """Walk the path; a step that fails, or too many seconds, end the program with a reason."""
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder, "venv", *(["Scripts", "python.exe"] if os.name == "nt" else ["bin", "python"]))
        names = ("PYTHONPATH", "PYSAS_BACKEND", "PYSAS_ISA", "PYSAS_WERROR")
        environment = {name: value for name, value in os.environ.items() if name not in names}
        environment |= {"CC": "false", "CXX": "false"}
        image = ["image", "own.npz", "--z", "5", "--x", "-1:1", "--y", "11:13", "--spacing", "0.02"]
        steps = {
            "environment": [sys.executable, "-m", "venv", "venv"],
            "pip install": [python, "-m", "pip", "install", "-q", f"pysas-sonar[plot] @ {Path(wheel).resolve().as_uri()}"],
            "own file": [python, "-c", OWN],
            "pysas image": [python, "-m", "pysas", *image],
        }
        began = last = time.monotonic()
        for name, command in steps.items():
            subprocess.run(command, cwd=folder, env=environment, check=True)
            now = time.monotonic()
            print(f"{name}: {now - last:.1f} s", flush=True)
            last = now
        used = os.times()
        processor = used.children_user + used.children_system
        print(f"to the first own image: {last - began:.1f} s of {limit:g}, {processor:.1f} s of a processor", flush=True)
        subprocess.run([python, "-c", LOOK], cwd=folder, env=environment, check=True)
        if not Path(folder, "own_image.png").is_file():
            sys.exit("FAILED: no picture")
    if last - began > limit:
        sys.exit(f"FAILED: {last - began:.1f} s: expected {limit:g} at most")


if __name__ == "__main__":
    main(sys.argv[1], *map(float, sys.argv[2:]))
