"""Whether the scenes of the promise find a bound that is broken: eleven bounds, one factor in one of them at a time.

    python tests/mutations.py                    plant each, run the scenes until one breaks, print what was found
    python tests/mutations.py tree filter        only those whose names hold one of the words

Each is planted in a copy of the tree; of C++ only the changed file is compiled again. A scene that breaks without any mutation
does not count. Nothing in this tree is changed.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("pysas", "csrc", "tests", "setup.py", "pyproject.toml", "README.md", "LICENSE", "MANIFEST.in")
FLAGS = [
    "-O3",
    "-std=c++17",
    "-fvisibility=hidden",
    "-ffp-contract=off",
    "-fPIC",
    "-Icsrc",
    "-Icsrc/include",
    "-DPYSAS_BUILD=1",
]


@dataclass(frozen=True)
class Mutation:
    """A text of one file that is replaced; it must stand there exactly once."""

    name: str
    factor: str
    file: str
    old: str
    new: str


# The factor is what a slip makes: a missing 2 pi or square, a term of a sum, a unit.
MUTATIONS = (
    Mutation(
        "filter's measured error", "1/20", "csrc/core/filters.cpp",
        "filter.error = measure(filter, band);", "filter.error = measure(filter, band) / 20;",
    ),
    Mutation(
        "polynomials of sine and cosine", "1e-3", "pysas/planning/bounds.py",
        "return (fits[0], fits[1]), worst", "return (fits[0], fits[1]), 1e-3 * worst",
    ),
    Mutation(
        "remainder of the delay polynomial", "1e-4", "csrc/planning/settings.cpp",
        "2 * pi * wave * 2 * 1.3", "1e-4 * 2 * pi * wave * 2 * 1.3",
    ),
    Mutation(
        "rounding of float offsets in a block", "1e-3", "csrc/planning/settings.cpp",
        "pi * turns * eps", "1e-3 * pi * turns * eps",
    ),
    Mutation(
        "samples that moving receivers need", "0 of the speed", "csrc/planning/scene.cpp",
        "/ (model.c - speed) - trace.t0", "/ (model.c - 0 * speed) - trace.t0",
    ),
    Mutation(
        "zeros against wrap-round", "1/8", "pysas/planning/bounds.py",
        "return GUARD[min(max(index, 0), len(GUARD) - 1)]", "return GUARD[min(max(index, 0), len(GUARD) - 1)] // 8",
    ),
    Mutation(
        "interpolation by transforms", "1/30", "pysas/planning/fallback/settings.py",
        "return float(2 * np.sum", "return float(2 / 30 * np.sum",
    ),
    Mutation(
        "interpolation of a tree", "1/12", "csrc/planning/bounds.cpp", "return 1.2 * std::sqrt", "return 0.1 * std::sqrt",
    ),
    Mutation(
        "rays of a tree", "0.7", "csrc/planning/subapertures.cpp",
        "pi / (rate * (spare_across", "pi / (0.7 * rate * (spare_across",
    ),
    Mutation(
        "lattice of weights uniform in view angle", "1e-3", "pysas/planning/view_angles.py",
        "        wrong = _rms((read(", "        wrong = 1e-3 * _rms((read(",
    ),
    Mutation(
        "weights' quadratic along a vector of pixels", "1e-3", "pysas/planning/view_angles.py",
        "return np.asarray(np.sqrt(third**2", "return 1e-3 * np.asarray(np.sqrt(third**2",
    ),
)  # fmt: skip


class Tree:
    """A copy of the sources in which a mutation is planted and taken out again."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        for name in COPIED:
            source = ROOT / name
            if source.is_dir():
                shutil.copytree(source, folder / name)  # with what Numba has compiled already: times of change are kept
            elif source.exists():
                shutil.copy2(source, folder / name)
        self.objects: Path | None = None

    def plant(self, mutation: Mutation) -> None:
        path = self.folder / mutation.file
        text = path.read_text(encoding="utf-8")
        assert text.count(mutation.old) == 1, f"{mutation.file}: {mutation.old!r} stands there {text.count(mutation.old)} times"
        path.write_text(text.replace(mutation.old, mutation.new), encoding="utf-8")
        self._rebuild(mutation.file)

    def restore(self, mutation: Mutation) -> None:
        shutil.copy2(ROOT / mutation.file, self.folder / mutation.file)
        self._rebuild(mutation.file)

    def _rebuild(self, file: str) -> None:
        """Compile a file of csrc and link the extension and the library again; all of it the first time."""
        if file.startswith("pysas/engine/"):  # Numba looks at no file but the function's own
            shutil.rmtree(self.folder / "pysas" / "engine" / "__pycache__", ignore_errors=True)
        if not file.startswith(("csrc/core/", "csrc/planning/")):
            return
        if self.objects is None:
            build = [sys.executable, "setup.py", "build_ext", "--inplace", "--build-temp", "objects"]
            subprocess.run(build, cwd=self.folder, check=True, stdout=subprocess.DEVNULL)
            self.objects = next(self.folder.glob("objects/**/csrc"))
        else:
            target = self.objects.parent / Path(file).with_suffix(".o")
            subprocess.run(["c++", *FLAGS, "-c", file, "-o", target], cwd=self.folder, check=True)
            core = [path for room in ("core", "planning", "isa") for path in sorted(self.objects.glob(f"{room}/*.o"))]
            core.append(self.objects / "bind" / "c_api.o")
            extension = next((self.folder / "pysas" / "engine").glob("_core*.so"))
            library = next((self.folder / "pysas" / "lib").glob("libpysas.*"))
            bindings = [self.objects / "bind" / name for name in ("module.o", "plans.o")]
            for objects, out in (([*core, *bindings], extension), (core, library)):
                out.unlink()  # a process may have the old one open
                subprocess.run(["c++", "-shared", "-pthread", *objects, "-o", out], check=True)

    def broken(self, count: int, jobs: int, known: frozenset[tuple[str, str]], first: bool) -> list[tuple[str, str]]:
        """(seed, way) of what breaks and is not known to; with `first` only the first of them."""
        command = [sys.executable, "tests/promise.py", "--count", str(count), "--share", "--jobs", str(jobs)]
        environment = os.environ | {"PYTHONPATH": str(self.folder)}
        found = []
        with subprocess.Popen(command, cwd=self.folder, env=environment, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            for line in process.stdout:
                match = re.match(r"seed (\d+): (.*?): broken", line)
                if match and match.groups() not in known:
                    found.append((match[1], match[2]))
                    if first:
                        process.terminate()
                        break
        return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--count", type=int, default=200, help="scenes, the first so many seeds")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    wanted = [m for m in MUTATIONS if not given.names or any(name in m.name for name in given.names)]
    with tempfile.TemporaryDirectory() as folder:
        tree = Tree(Path(folder))
        known = frozenset(tree.broken(given.count, given.jobs, frozenset(), False))
        print(f"{'broken without a mutation':45} {len(known)} images of {given.count} scenes", flush=True)
        missed = 0
        for mutation in wanted:
            begun = time.monotonic()
            tree.plant(mutation)
            found = tree.broken(given.count, given.jobs, known, True)
            tree.restore(mutation)
            missed += not found
            words = f"seed {found[0][0]}, {found[0][1]}" if found else "MISSED"
            print(f"{mutation.name:45} x {mutation.factor:15} {words} ({time.monotonic() - begun:.0f} s)", flush=True)
    print(f"{len(wanted) - missed} of {len(wanted)} found")
    return int(missed > max(0, len(wanted) // 10))


if __name__ == "__main__":
    sys.exit(main())
