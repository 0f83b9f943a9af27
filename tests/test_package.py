"""The installation: metadata, configuration, what `import pysas` costs, and the extension against its stub."""

from __future__ import annotations

import ast
import importlib.metadata
import importlib.resources
import inspect
import json
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

import pysas

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
    code = "import sys, pysas; print([name for name in ('matplotlib', 'h5py', 'xarray', 'pandas') if name in sys.modules])"
    result = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert result.stdout.strip() == "[]"


def stub_signatures(text: str) -> dict[str, str]:
    """`name(arguments) -> type` of every public function of a stub, and the name alone of every other public name."""
    found = {}
    for node in ast.parse(text).body:
        if isinstance(node, ast.FunctionDef):
            found[node.name] = f"{node.name}({ast.unparse(node.args)}) -> {ast.unparse(node.returns) if node.returns else None}"
        elif isinstance(node, ast.ClassDef):
            found[node.name] = node.name
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found[node.target.id] = node.target.id
    return {name: text for name, text in found.items() if not name.startswith("_")}


def module_signatures(module: Any) -> dict[str, str]:
    """The same of a compiled module; pybind11 writes a function's signature into the first line of its docstring."""
    public = {name: value for name, value in vars(module).items() if not name.startswith("_")}
    return {
        name: (value.__doc__ or "").splitlines()[0] if inspect.isroutine(value) else name
        for name, value in public.items()
        if not isinstance(value, ModuleType)
    }


def test_signatures_of_a_stub() -> None:
    stub = "N: int\nclass A: ...\ndef f(a: int, b: float = 1.0) -> str: ...\ndef _g() -> None: ...\n"
    assert stub_signatures(stub) == {"N": "N", "A": "A", "f": "f(a: int, b: float=1.0) -> str"}


@pytest.mark.cpp
def test_extension_is_what_its_stub_says() -> None:
    from pysas.engine import _core

    stub = importlib.resources.files("pysas").joinpath("engine", "_core.pyi").read_text()
    assert module_signatures(_core) == stub_signatures(stub)


@pytest.mark.cpp
def test_extension_reports_itself() -> None:
    from pysas.engine import _core

    assert _core.isa() in ("baseline", "avx2", "avx512")
    assert re.fullmatch(r"(gcc|clang|msvc) \S.*", _core.compiler())
    config = pysas.show_config("dict")
    assert config is not None
    assert config["extension"] == f"{_core.compiler()}, {_core.isa()}"
