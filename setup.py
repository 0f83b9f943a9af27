"""Build of the optional C++ extension pysas.engine._core; everything else about the package is in pyproject.toml.

Where the extension does not compile the package installs without it and runs on Numba. With PYSAS_WERROR=1 in the
environment warnings are errors and a failed build fails the installation, so that a build that must have the extension
cannot lose it in silence.
"""

import os
import sys
from pathlib import Path

from pybind11.setup_helpers import Pybind11Extension, build_ext
from setuptools import setup

STRICT = os.environ.get("PYSAS_WERROR") == "1"

if sys.platform == "win32":
    FLAGS = ["/O2", "/W4"] + ["/WX"] * STRICT
else:
    FLAGS = ["-O3", "-Wall", "-Wextra"] + ["-Werror"] * STRICT


class OptionalBuild(build_ext):
    """build_ext whose every failure leaves a package without the extension and one line that says so."""

    def finalize_options(self) -> None:
        super().finalize_options()
        # a kept build folder, or source tree, must not hand out an extension made with another compiler or other flags
        self.force = True
        self.folders = [self.build_lib, *(["."] if self.inplace else [])]

    def run(self) -> None:
        """Build; what fails before any extension is reached (no compiler found) comes out here."""
        try:
            super().run()
        except Exception as error:
            self._give_up(error)

    def build_extension(self, extension: Pybind11Extension) -> None:
        try:
            super().build_extension(extension)
        except Exception as error:
            self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        if STRICT:
            raise error
        for extension in self.extensions:
            for folder in self.folders:
                Path(folder, self.get_ext_filename(extension.name)).unlink(missing_ok=True)
        reason = " ".join(str(error).split())
        if len(reason) > 160:  # a whole command line: its program and how it ended say enough
            reason = f"{reason[:60]} ... {reason[-60:]}"
        print(f"warning: pysas.engine._core was not built, pysas will run on Numba alone: {reason}", file=sys.stderr)


setup(
    ext_modules=[
        Pybind11Extension(
            "pysas.engine._core",
            sources=["csrc/bind/module.cpp", "csrc/core/cpu.cpp"],
            include_dirs=["csrc"],
            depends=["csrc/core/cpu.hpp"],
            extra_compile_args=FLAGS,
            cxx_std=17,
            optional=not STRICT,
        )
    ],
    cmdclass={"build_ext": OptionalBuild},
)
