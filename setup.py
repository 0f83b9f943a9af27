"""Build of the optional C++ parts: the extension pysas.engine._core and the C library; everything else is in pyproject.toml.

One `build_ext` compiles the kernels once for each instruction set, with that set's flags, and links them into both; it says
what it compiles, which pip shows with -v. Where the C++ does not compile the package installs without it and runs on Numba.
With PYSAS_WERROR=1 in the environment warnings are errors and a failed build fails the installation, so that a build that
must have the extension cannot lose it in silence.
"""

import os
import platform
import shutil
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pybind11.setup_helpers import Pybind11Extension, build_ext
from setuptools import setup

STRICT = os.environ.get("PYSAS_WERROR") == "1"
WINDOWS = sys.platform == "win32"
NAMES = {"x86_64": "x86", "amd64": "x86", "i386": "x86", "i686": "x86", "aarch64": "arm64"}
MACHINE = NAMES.get(platform.machine().lower(), platform.machine().lower())
if sys.platform == "darwin":
    # for one processor, as an instruction set's source is: python.org's Python would have each file compiled for two
    os.environ.setdefault("ARCHFLAGS", f"-arch {platform.machine()}")

if WINDOWS:
    FLAGS = ["/O2", "/W4", "/std:c++17", "/EHsc"] + ["/WX"] * STRICT
    LIBRARY = "pysas.dll"
else:
    # contraction off: every fused multiply-add is written as one, so that compilers cannot make results differ
    FLAGS = ["-O3", "-g0", "-std=c++17", "-fvisibility=hidden", "-ffp-contract=off", "-Wall", "-Wextra"] + ["-Werror"] * STRICT
    LIBRARY = "libpysas.dylib" if sys.platform == "darwin" else "libpysas.so"

CORE = [str(path) for room in ("core", "planning") for path in sorted(Path("csrc", room).glob("*.cpp"))]
CORE.append("csrc/bind/c_api.cpp")
TABLE = [
    line.split("|")
    for line in Path("csrc/isa/sets.txt").read_text(encoding="utf-8").splitlines()
    if line.strip() and line[0] != "#"
]
SETS = {row[0].strip(): row[3 if WINDOWS else 2].split() for row in TABLE if row[1].strip() == MACHINE}
MACROS = [("PYSAS_SETS", "".join(f"PYSAS_SET({name})" for name in SETS))]


def say(text: str) -> None:
    print(f"pysas: {text}\n", end="", flush=True)  # at once, as several threads speak


class OptionalBuild(build_ext):
    """build_ext whose every failure leaves a package without C++ and one line that says so."""

    def finalize_options(self) -> None:
        super().finalize_options()
        # a kept build folder, or source tree, must not hand out an extension made with another compiler or other flags
        self.force = True
        self.folders = [Path(self.build_lib), *([Path(".")] if self.inplace else [])]

    def run(self) -> None:
        """Build; what fails before any extension is reached (no compiler found) comes out here."""
        try:
            super().run()
        except Exception as error:
            self._give_up(error)

    def build_extension(self, extension: Pybind11Extension) -> None:
        try:
            began = time.monotonic()
            own = ["csrc", "csrc/include"]
            sets = [(f"csrc/isa/{name}.cpp", [], SETS.get(name, []), own) for name in ("baseline", *SETS)]
            own_flags = [flag for flag in extension.extra_compile_args if flag not in FLAGS]  # pybind11's: /bigobj with MSVC
            bind = [(source, [], own_flags, extension.include_dirs) for source in extension.sources]
            core = [(source, MACROS, [], own) for source in CORE]
            jobs = [*sets, *bind, *core]  # the longest first: a set takes 15 to 25 s, a file of bind 10 s, of the core 1 to 3 s
            at_once = os.cpu_count() or 1
            compiler = getattr(self.compiler, "compiler_cxx", ["MSVC"])[0]
            names = ", ".join(["baseline", *SETS])
            say(f"{compiler} compiles {len(jobs)} files, {at_once} at a time; instruction sets for {MACHINE}: {names}")
            with ThreadPoolExecutor(at_once) as pool:
                objects = list(pool.map(lambda job: self._object(*job), jobs))
            bound = objects[len(sets) : len(sets) + len(bind)]
            shared = objects[: len(sets)] + objects[len(sets) + len(bind) :]
            say(f"compiled in {time.monotonic() - began:.0f} s; linking {LIBRARY} and {extension.name}")
            self._library(shared)
            extension.sources, extension.extra_objects = [], bound + shared
            extension.extra_link_args += self._exports("PyInit_*")
            super().build_extension(extension)
        except Exception as error:
            self._give_up(error)

    def _object(self, source: str, macros: list[tuple[str, str]], flags: list[str], include: list[str]) -> str:
        began = time.monotonic()
        (made,) = self.compiler.compile(
            [source], output_dir=self.build_temp, macros=[*macros, ("PYSAS_BUILD", "1")], include_dirs=include,
            extra_postargs=[*FLAGS, *flags],
        )  # fmt: skip
        say(f"{source} {' '.join(flags)} {time.monotonic() - began:.1f} s".replace("  ", " "))
        return str(made)

    def _exports(self, pattern: str) -> list[str]:
        """What lets the names of `pattern` alone out, as templates of the standard library ignore -fvisibility."""
        if sys.platform != "linux":
            return []
        script = Path(self.build_temp, f"{pattern.rstrip('*')}.map")
        script.write_text(f"{{ global: {pattern}; local: *; }};\n", encoding="utf-8")
        return [f"-Wl,--version-script={script}"]

    def _library(self, objects: list[str]) -> None:
        """The C library and its header, beside the package's modules."""
        flags = [] if WINDOWS else ["-pthread", *self._exports("pysas_*")]
        built = Path(self.build_temp, LIBRARY)
        self.compiler.link_shared_object(objects, str(built), extra_postargs=flags, target_lang="c++")
        for folder in self.folders:
            for source, place in ((built, "lib"), (Path("csrc/include/pysas.h"), "include")):
                (folder / "pysas" / place).mkdir(parents=True, exist_ok=True)
                shutil.copy(source, folder / "pysas" / place)

    def _give_up(self, error: Exception) -> None:
        if STRICT:
            raise error
        for folder in self.folders:
            for extension in self.extensions:
                (folder / self.get_ext_filename(extension.name)).unlink(missing_ok=True)
            (folder / "pysas" / "lib" / LIBRARY).unlink(missing_ok=True)
        reason = " ".join(str(error).split())
        if len(reason) > 160:  # a whole command line: its program and how it ended say enough
            reason = f"{reason[:60]} ... {reason[-60:]}"
        print(f"warning: pysas.engine._core was not built, pysas will run on Numba alone: {reason}", file=sys.stderr)


setup(
    ext_modules=[
        Pybind11Extension(
            "pysas.engine._core",
            sources=["csrc/bind/module.cpp", "csrc/bind/plans.cpp"],
            include_dirs=["csrc"],
            depends=[str(path) for path in Path("csrc").rglob("*.*pp")] + [str(path) for path in Path("csrc").rglob("*.inl")],
            extra_compile_args=FLAGS,
            extra_link_args=[] if WINDOWS else ["-pthread"],
            cxx_std=17,
            optional=not STRICT,
        )
    ],
    cmdclass={"build_ext": OptionalBuild},
)
