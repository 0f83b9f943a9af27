"""The installation: metadata, configuration, what `import pysas` costs, and the extension against its stub."""

from __future__ import annotations

import ast
import importlib.machinery
import importlib.metadata
import importlib.resources
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import pysas
from pysas.engine import SlowEngineWarning, engine_of, native

DISTRIBUTION = "pysas-sonar"
CONFIG = {"pysas", "backend", "processor", "extension", "threads", "python", "numpy", "scipy", "numba"}


@pytest.fixture(scope="module")
def distribution() -> importlib.metadata.Distribution:
    try:
        return importlib.metadata.distribution(DISTRIBUTION)
    except importlib.metadata.PackageNotFoundError:
        pytest.skip(f"{DISTRIBUTION} is not installed: the sources are tested in place")


def test_installed_package_is_the_one_tested(distribution: importlib.metadata.Distribution) -> None:
    origin = json.loads(distribution.read_text("direct_url.json") or "{}")
    if not origin.get("dir_info", {}).get("editable"):
        assert Path(str(distribution.locate_file("pysas/__init__.py"))).samefile(pysas.__file__)
    path = subprocess.run(
        [sys.executable, "-c", "import pysas; print(pysas.__file__)"], check=True, capture_output=True, text=True
    )
    assert path.stdout.strip() == pysas.__file__


def test_version_is_the_metadata_s(distribution: importlib.metadata.Distribution) -> None:
    assert distribution.version == pysas.__version__


def test_hard_dependencies(distribution: importlib.metadata.Distribution) -> None:
    hard = {re.split(r"[^\w-]", text)[0] for text in distribution.requires or [] if "extra ==" not in text}
    assert hard == {"numpy", "scipy", "numba"}


def test_console_script(distribution: importlib.metadata.Distribution) -> None:
    (script,) = (entry for entry in distribution.entry_points if entry.group == "console_scripts")
    assert (script.name, script.value) == ("pysas", "pysas.cli:main")
    assert callable(script.load())


def test_a_checkout_that_hides_the_installed_package_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder
) -> None:
    """Python started in a clone imports its sources, which have no extension."""

    def none() -> None:
        raise ImportError

    monkeypatch.setattr(native, "core", none)
    (tmp_path / "pysas" / "engine").mkdir(parents=True)
    monkeypatch.syspath_prepend(tmp_path)
    assert native.extension() is None and not recwarn
    (tmp_path / "pysas" / "engine" / "_core.cpython-311-x86_64-linux-gnu.so").touch()
    monkeypatch.syspath_prepend(tmp_path / "pysas" / "..")
    with pytest.warns(UserWarning, match="hides the installed"):
        assert native.extension() is None


def gone(name: str = native.MODULE) -> None:
    """In place of `native.core`: what Python says where no file of this Python is a module's."""
    raise ModuleNotFoundError(f"No module named {name!r}", name=name)


def broken() -> None:
    raise ImportError("/lib/libstdc++.so.6:\n version `GLIBCXX_3.4.30' not found")


@pytest.fixture
def unsaid(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Nobody chose an engine, nor was told that it is Numba."""
    monkeypatch.delenv("PYSAS_BACKEND", raising=False)
    native.warn_of_numba.cache_clear()
    yield
    native.warn_of_numba.cache_clear()


def test_numba_unasked_is_told_once(unsaid: None, monkeypatch: pytest.MonkeyPatch, recwarn: pytest.WarningsRecorder) -> None:
    monkeypatch.setattr(native, "core", gone)
    monkeypatch.setattr(native, "_compiled", lambda folder: [])
    config = pysas.show_config("dict")
    assert config is not None and (config["backend"], config["extension"]) == ("numba", "not built")
    assert not recwarn  # who looks is told by what it says
    plans = [pysas.plan(*small_scene()) for _ in range(2)]
    (warning,) = recwarn
    assert warning.category is SlowEngineWarning and warning.filename == __file__
    for part in ("Numba", "two fifths", "ten seconds", "extension is not built.", "compiler", "PYSAS_BACKEND=numba"):
        assert part in str(warning.message)
    assert all(plan.backend == "numba" for plan in plans)


@pytest.mark.parametrize("how", ["argument", "environment"])
def test_numba_that_is_asked_for_is_silent(unsaid: None, how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "core", gone)
    if how == "environment":
        monkeypatch.setenv("PYSAS_BACKEND", "numba")
    assert engine_of("numba" if how == "argument" else "auto").name == "numba"  # a warning is an error here


@pytest.mark.cpp
def test_cpp_is_silent(unsaid: None) -> None:
    assert engine_of().name == "cpp" and native.absence() == ""


def test_why_there_is_no_extension_is_told(unsaid: None, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(native, "core", gone)
    monkeypatch.setattr(native, "_compiled", lambda folder: ["_core.cpython-39-x86_64-linux-gnu.so"])
    with pytest.warns(SlowEngineWarning, match=r"is built for another Python: _core\.cpython-39-x86_64-linux-gnu\.so\."):
        engine_of()
    for core, reason in (
        (lambda: gone("libfirst"), "broken: No module named 'libfirst'"),
        (broken, "broken: /lib/libstdc++.so.6: version `GLIBCXX_3.4.30' not found"),
    ):
        native.warn_of_numba.cache_clear()
        monkeypatch.setattr(native, "core", core)
        config = pysas.show_config("dict")
        assert config is not None and config["extension"] == reason
        with pytest.warns(SlowEngineWarning, match=re.escape(f"extension is {reason}.")):
            engine_of()
        with pytest.raises(ValueError, match=re.escape(f"backend='cpp': the C++ extension is {reason}: use")):
            engine_of("cpp")


def test_compiled_modules_of_any_python_are_found(tmp_path: Path) -> None:
    names = ["_core.cp312-win_amd64.pyd", "_core.cpython-312-darwin.so"]
    for name in [*names, "_core.pyi", "core.so", "_numba.py"]:
        (tmp_path / name).touch()
    assert native._compiled(str(tmp_path)) == names and native._compiled(str(tmp_path / "none")) == []


def test_a_copy_without_extension_tells_so_on_standard_error_alone(tmp_path: Path) -> None:
    """A whole process: the sources without what was compiled, an extension that does not load, one of another Python.

    They hide a package that has one, which is told before.
    """
    copy = tmp_path / "pysas"
    shutil.copytree(Path(pysas.__file__).parent, copy, ignore=shutil.ignore_patterns("*.so", "*.pyd", "lib"))
    engine = copy / "engine"
    echoes, _ = small_scene()
    pysas.save(tmp_path / "raw.npz", echoes)
    environment = {name: value for name, value in os.environ.items() if name != "PYSAS_BACKEND"}
    hidden = tmp_path / "installed" / "pysas"
    (hidden / "engine").mkdir(parents=True)
    (hidden / "engine" / "_core.cpython-311-x86_64-linux-gnu.so").touch()
    environment["PYTHONPATH"] = os.pathsep.join([str(tmp_path), str(hidden.parent)])
    command = [sys.executable, "-m", "pysas", "info", "raw.npz", "--json"]
    suffix = importlib.machinery.EXTENSION_SUFFIXES[0]
    for file, reason in (
        ("", "is not built."),
        ("_core.cpython-39-x86_64-linux-gnu.so", "is built for another Python: _core.cpython-39-x86_64-linux-gnu.so."),
        (f"_core{suffix}", "is broken: "),
    ):
        if file:
            (engine / file).write_bytes(b"not a library")
        run = subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True, text=True)
        assert json.loads(run.stdout)
        first, line = run.stderr.splitlines()
        assert f"hides the installed {hidden}" in first
        assert line.startswith("pysas: warning: pysas runs on Numba") and f"extension {reason}" in line
    silent = environment | {"PYSAS_BACKEND": "numba"}
    run = subprocess.run(command, cwd=tmp_path, env=silent, check=True, capture_output=True, text=True)
    assert run.stderr == "" and json.loads(run.stdout)


def small_scene() -> tuple[pysas.Echoes, pysas.Grid]:
    tx = np.zeros((8, 3))
    tx[:, 0] = np.arange(8) * 0.02
    echoes = pysas.Echoes(np.ones((8, 900), "c8"), fs=4e4, fc=1e5, tx=tx, rx=tx, t0=0.02, bandwidth=3e4)
    return echoes, pysas.Grid.plane(np.arange(8) * 0.01, 18 + np.arange(8) * 0.01)


def test_types_are_shipped() -> None:
    files = importlib.resources.files("pysas")
    assert files.joinpath("py.typed").is_file()
    assert files.joinpath("engine", "_core.pyi").is_file()


def test_show_config(capsys: pytest.CaptureFixture[str]) -> None:
    config = pysas.show_config("dict")
    assert config is not None
    assert config.keys() >= CONFIG
    assert config["pysas"] == pysas.__version__
    assert isinstance(config["threads"], int) and config["threads"] >= 1
    assert capsys.readouterr().out == ""
    assert pysas.show_config() is None
    printed = capsys.readouterr().out
    for name, value in config.items():
        assert re.search(rf"^{re.escape(name)}\s+{re.escape(str(value))}$", printed, re.MULTILINE)


def test_show_config_rejects_unknown_mode() -> None:
    with pytest.raises(ValueError, match="mode='json'"):
        pysas.show_config("json")


def test_public_names_exist() -> None:
    assert len(set(pysas.__all__)) == len(pysas.__all__)
    missing = [name for name in pysas.__all__ if not hasattr(pysas, name)]
    assert not missing


def test_import_loads_no_optional_library() -> None:
    optional = ("matplotlib", "h5py", "xarray", "pandas", "zarr", "dask", "rasterio", "pyproj")
    code = f"import sys; from pysas import *; print([n for n in {optional} if n in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert result.stdout.strip() == "[]"


def test_import_loads_nothing_that_is_not_asked_for() -> None:
    """Names are loaded when they are used."""
    heavy = "print(*{'scipy', 'numba', 'matplotlib'} & set(sys.modules))"
    for some in ("pysas", "pysas.cli; pysas.Echoes, pysas.Grid, pysas.Beam, pysas.load"):
        code = f"import sys, {some}; {heavy}; pysas.Grid, pysas.reference"
        run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
        assert run.stdout.split() == []


def test_what_is_shown_is_what_is_public() -> None:
    assert [name for name in dir(pysas) if not name.startswith("_")] == sorted(pysas.__all__)


def test_names_may_be_asked_for_by_several_threads_at_once() -> None:
    code = (
        "import sys, threading, pysas; sys.setswitchinterval(1e-6); failed = []\n"
        "def ask(name):\n"
        "    try: getattr(pysas, name)\n"
        "    except BaseException as error: failed.append((name, error))\n"
        "threads = [threading.Thread(target=ask, args=(name,)) for name in pysas.__all__]\n"
        "for thread in threads: thread.start()\n"
        "for thread in threads: thread.join()\n"
        "print(failed)"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.strip() == "[]"


@pytest.mark.cpp
def test_numba_is_not_loaded_where_cpp_runs() -> None:
    code = (
        "import sys, numpy as np, pysas\n"
        "tx = np.zeros((8, 3)); grid = pysas.Grid.plane(np.arange(8) * 0.01, 18 + np.arange(8) * 0.01)\n"
        "echoes = pysas.Echoes(np.ones((8, 900), 'c8'), fs=4e4, fc=1e5, tx=tx, rx=tx, t0=0.02, bandwidth=3e4)\n"
        "for call in (pysas.backproject, pysas.ffbp, pysas.focus): call(echoes, grid, backend='cpp')\n"
        "echoes = echoes.replace(data=echoes.data.astype('>c8')); pysas.focus(echoes, grid, backend='cpp')\n"
        "print(*{'numba', 'llvmlite'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert run.stdout.split() == []


@pytest.mark.cpp
def test_extension_is_what_its_stub_says() -> None:
    from pysas.engine import _core

    # names of functions and arguments: how pybind11 spells arrays' types is its own affair
    stub = ast.parse(importlib.resources.files("pysas").joinpath("engine", "_core.pyi").read_text())
    expected = {node.name: [a.arg for a in node.args.args] for node in stub.body if isinstance(node, ast.FunctionDef)}
    public = {name: value for name, value in vars(_core).items() if callable(value) and not name.startswith("_")}
    functions = {name: value for name, value in public.items() if not isinstance(value, type)}
    initialisers = {n.name: [] for n in stub.body if isinstance(n, ast.ClassDef)}
    for node in (n for n in stub.body if isinstance(n, ast.ClassDef)):
        for own in node.body:
            if isinstance(own, ast.FunctionDef) and own.name == "__init__":
                initialisers[node.name] = [a.arg for a in own.args.args[1:]]
    made = {name: value.__init__.__doc__.splitlines()[0] for name, value in public.items() if isinstance(value, type)}
    assert {name: re.findall(r"[(,] ?(\w+): ", text)[1:] for name, text in made.items()} == initialisers
    found = {name: re.findall(r"[(,] ?(\w+): ", value.__doc__.splitlines()[0]) for name, value in functions.items()}
    assert found == expected


@pytest.mark.cpp
def test_extension_reports_itself() -> None:
    from pysas.engine import _core

    assert set(_core.levels()) <= {"baseline", "avx2", "avx512", "neon"} and _core.isa("auto") == _core.levels()[-1]
    assert re.fullmatch(r"(gcc|clang|msvc) \S.*", _core.compiler())
    config = pysas.show_config("dict")
    assert config is not None
    assert config["extension"] == f"{_core.compiler()}, {', '.join(_core.levels())}"


@pytest.mark.cpp
def test_the_c_library_and_its_header_are_shipped() -> None:
    assert (Path(pysas.get_include()) / "pysas.h").is_file()
    assert Path(pysas.get_library()).is_file()
