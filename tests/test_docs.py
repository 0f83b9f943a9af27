"""The documentation: code of its pages runs in the order in which it stands, and the reference has every public name."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import docs_scenes
import pytest

import pysas
from pysas import cli

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [DOCS / "start.md", *sorted((DOCS / "howto").glob("*.md"))]
NAME = re.compile(r"^   (\w+)$", re.MULTILINE)


def blocks(text: str) -> Iterator[tuple[str, str]]:
    """Language and text of each fenced block."""
    for found in re.finditer(r"^```(\w+)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        yield found[1], found[2]


def test_blocks_are_found() -> None:
    assert list(blocks("a\n```python\nx = 1\n```\nb\n```bash\nls\n```\n")) == [("python", "x = 1\n"), ("bash", "ls\n")]


def by_shell(text: str) -> None:
    """Run commands: ours in this process, installations not at all (.ci/run does), anything else by a shell."""
    lines = text.splitlines()
    if any(line.startswith("pip install") for line in lines):
        said = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
        assert all(f'as_in_readme "{line}"' in said for line in lines)
        return
    if not all(line.startswith("pysas ") for line in lines):
        subprocess.run(["bash", "-euc", text], check=True)
        return
    for line in lines:
        assert cli.main(shlex.split(line, comments=True)[1:]) == 0, line


@pytest.mark.parametrize(
    "page", [pytest.param(page, id=page.stem, marks=[pytest.mark.cpp] * (page.stem == "languages")) for page in PAGES]
)
def test_the_code_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=":")
    text = page.read_text(encoding="utf-8")
    for name, make in (
        ("line.npz", docs_scenes.line),
        ("circle.npz", docs_scenes.circle),
        ("adc.bin", docs_scenes.recording),
        ("nav.csv", docs_scenes.navigation),
    ):
        if name in text and page.stem != "index":  # which makes them itself
            make(tmp_path)
    if "image.c" in text:
        shutil.copy(ROOT / "examples" / "c" / "image.c", tmp_path)
    names: dict[str, object] = {}
    ran = 0
    for language, code in blocks(text):
        if language == "python":
            exec(compile(code, str(page), "exec"), names)  # noqa: S102
        elif language == "bash":
            by_shell(code)
        ran += language in ("python", "bash")
    assert ran
    check = {
        "start": started,
        "index": given,
        "own-data": recorded,
        "languages": alike,
        "circular": round_about,
        "survey": mapped,
    }
    check.get(page.stem, lambda names: None)(names)


def started(names: dict) -> None:
    """The target of the page, at 0.3, 20 m; 200 echoes of amplitude 1."""
    place = pysas.metrics.peak_position(names["image"], near=(0.3, 20.0), radius=0.2)
    assert place == pytest.approx((0.3, 20.0), abs=1e-3)
    assert abs(names["image"].data).max() == pytest.approx(200, rel=0.03)  # pulses begin between samples
    shell = pysas.load_image("mine_image.npz")
    assert pysas.metrics.peak_position(shell, near=(0.3, 20.0), radius=0.2) == pytest.approx((0.3, 20.0), abs=1e-3)


def given(names: dict) -> None:
    """What the page makes is what the other pages are run with here."""
    made = {name: pysas.load_echoes(name) for name in ("line.npz", "circle.npz")}
    Path("again").mkdir()
    docs_scenes.line(Path("again"))
    docs_scenes.circle(Path("again"))
    for name, echoes in made.items():
        same = pysas.load_echoes(Path("again", name))
        assert (echoes.data == same.data).all() and (echoes.rx == same.rx).all() and str(echoes) == str(same)


def recorded(names: dict) -> None:
    place = pysas.metrics.peak_position(names["image"], near=(0.2, 20.0), radius=0.3)
    assert place == pytest.approx((0.2, 20.0), abs=1e-3)


def alike(names: dict) -> None:
    """To rounding: the program's pixels are first + j step, those of the page's grid differ by a rounding of float64."""
    image, same = names["image"], names["same"].data
    assert abs(same).max() > 100
    assert abs(image - same).max() <= 1e-6 * abs(same).max()


def round_about(names: dict) -> None:
    assert max(names["sharp"]) == names["sharp"][2]


def mapped(names: dict) -> None:
    assert names["found"].missing == 0 and 0.5 < names["found"].coverage <= 1


# Files and figures


def test_what_the_readme_names_is_there() -> None:
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    named = set(re.findall(r"\]\(([^)#:]+)\)", text)) | set(re.findall(r"`((?:docs|examples)/[^` ]+)`", text))
    assert len(named) > 20
    assert [name for name in sorted(named) if not (ROOT / name).exists()] == []


def test_every_table_of_figures_has_its_place() -> None:
    """`bench.figures` puts a table between the two comments of its name."""
    (body,) = re.findall(r"^TABLES = \{\n(.*?)^\}", (ROOT / "bench" / "figures.py").read_text(encoding="utf-8"), re.M | re.S)
    page = (DOCS / "figures.md").read_text(encoding="utf-8")
    tables = re.findall(r"<!-- bench (\w+) -->\n(.*?)<!-- /bench -->", page, re.S)
    assert sorted(name for name, _ in tables) == sorted(re.findall(r'^    "(\w+)":', body, re.M))
    assert all(text.count("|---") >= 1 for _, text in tables)


# The reference


def listed() -> dict[str, list[str]]:
    """What each page's lists name, by module."""
    found: dict[str, list[str]] = {}
    for path in (DOCS / "reference").glob("*.rst"):
        text = path.read_text(encoding="utf-8")
        for module, body in re.findall(r"\.\. currentmodule:: (\S+)\n(.*?)(?=^\.\. currentmodule|\Z)", text, re.M | re.S):
            for part in re.findall(r"\.\. autosummary::\n(?:   :.*\n)*\n((?:   \w+\n)+)", body):
                found.setdefault(module, []).extend(NAME.findall(part))
        for module, name in re.findall(r"\.\. py:data:: (\S+)\.(\w+)", text):
            found.setdefault(module, []).append(name)
    return found


def test_every_public_name_is_in_the_reference() -> None:
    spec = DOCS / "public_names.py"
    names: dict = {}
    exec(compile(spec.read_text(encoding="utf-8"), str(spec), "exec"), names)  # noqa: S102
    public = names["public_names"]()
    assert {f"pysas.{name}" for name in pysas.__all__} <= public
    found = listed()
    assert all(len(set(some)) == len(some) for some in found.values())
    have = {f"{module}.{name}" for module, some in found.items() for name in some} | set(found)
    assert public - have == set()
    assert have - public == set()  # no name is listed that is not there


# Other languages


def test_the_structs_of_julia_are_those_of_the_header() -> None:
    header = re.sub(r"/\*.*?\*/", "", (ROOT / "csrc" / "include" / "pysas.h").read_text(encoding="utf-8"), flags=re.S)
    julia = (ROOT / "examples" / "julia" / "pysas_image.jl").read_text(encoding="utf-8")
    kinds = {
        "size_t": "Csize_t", "int64_t": "Int64", "int32_t": "Int32", "double": "Float64", "const double*": "Ptr{Float64}",
        "const int64_t*": "Ptr{Int64}", "const uint8_t*": "Ptr{UInt8}", "const char*": "Cstring", "void*": "Ptr{Cvoid}",
        "double[3]": "NTuple{3,Float64}",
    }  # fmt: skip
    for name in ("Survey", "Grid", "Options"):
        (body,) = re.findall(rf"typedef struct pysas_{name.lower()} {{(.*?)}} pysas_{name.lower()};", header, re.S)
        expected = []
        for declared in (" ".join(part.split()) for part in body.split(";")[:-1]):
            if "(*progress)" in declared:
                expected.append(("progress", "Ptr{Cvoid}"))
                continue
            kind, rest = re.fullmatch(r"((?:const )?\w+\*?) (.*)", declared).groups()
            for one in rest.split(", "):
                bare, many = re.fullmatch(r"(\w+)(\[3\])?", one).groups()
                expected.append((bare, kinds[kind + (many or "")]))
        (text,) = re.findall(rf"struct {name}\n(.*?)^end", julia, re.S | re.M)
        assert re.findall(r"^    (\w+)::([^ \n]+)", text, re.M) == expected


if shutil.which("mkoctfile") and shutil.which("octave"):  # not where there is no Octave; no test is skipped

    @pytest.mark.cpp
    def test_matlab_s_function_images_in_octave(tmp_path: Path) -> None:
        for path in (ROOT / "examples" / "matlab").iterdir():
            shutil.copy(path, tmp_path)
        folder = str(Path(pysas.get_library()).parent)
        paths = [f"-I{pysas.get_include()}", f"-L{folder}", "-lpysas", f"-Wl,-rpath,{folder}"]
        subprocess.run(["mkoctfile", "--mex", "pysas_image.c", *paths], cwd=tmp_path, check=True)
        more = (
            "failed = 0; try, pysas_image(data, survey, [0 1 3], y, 5, 1e-3); catch e, failed = 1; disp(e.message), end\n"
            "two = pysas_image(double(data), survey, x, y, target(3), 1e-8); printf('%.3e\\n', norm(image - two) / norm(two))"
        )
        run = subprocess.run(
            ["octave", "--no-gui", "--quiet", "--eval", f"image_target; {more}"], cwd=tmp_path, capture_output=True, text=True
        )
        peak, refused, difference = run.stdout.split("\n")[:3]
        found = re.fullmatch(r"peak (\S+) at x = (\S+) m, y = (\S+) m", peak)
        assert found, run.stderr
        # 96 echoes of amplitude 1 of a point at (0.3, 12)
        assert [float(part) for part in found.groups()] == pytest.approx([96, 0.3, 12], rel=1e-3)
        assert refused.endswith("x: expected even spacing")
        assert 0 < float(difference) < 1e-3
