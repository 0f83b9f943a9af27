"""What the command line writes: nothing over what it reads, nothing over what is there unasked, names checked before work."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pysas
from pysas import cli, comparison

SPANS = ["--x", "-1:1", "--y", "9:11", "--spacing", "0.5"]
READS = {"raw", "grid", "depth_map", "points", "file", "lines", "store", "samples", "pulse", "nav", "pings", "levers"}
READS |= {"fs", "fc", "bandwidth", "t0", "c", "pulse_centre"}  # of `echoes`, which may be variables of a file
TEXTS = {"crs", "dtype", "scheduler", "channel"}
WRITES = {"output", "png", "report"}
# by command: what it reads, with the arguments that name it, and what it may write
INPUTS = {
    "image": {"raw.npz": [], "grid.npz": ["--grid", "grid.npz"], "map.npz": ["--depth-map", "map.npz"], "raw.h5": []},
    "compare": {"raw.npz": [], "grid.npz": ["--grid", "grid.npz"], "map.npz": ["--depth-map", "map.npz"]},
    "simulate": {"points.csv": ["--points", "points.csv"]},
    "navigate": {"raw.npz": [], "grid.npz": ["--grid", "grid.npz"], "map.npz": ["--depth-map", "map.npz"], "raw.h5": []},
}
OUTPUTS = {
    "image": [("-o", ".npz"), ("-o", ".h5"), ("--png", ".png"), ("--png", ".svg")],
    "compare": [("-o", ".md"), ("-o", ".npz"), ("--png", ".png")],
    "simulate": [("-o", ".npz"), ("-o", ".h5")],
    "navigate": [("-o", ".npz"), ("-o", ".h5"), ("--png", ".png")],
}
WORK = ("simulating", "compressing", "imaging", "comparing", "checking", "track")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with inputs of every kind."""
    monkeypatch.chdir(tmp_path)
    tx = np.zeros((6, 3))
    tx[:, 0] = np.arange(6) * 0.05
    rng = np.random.default_rng(0)
    data = rng.standard_normal((6, 600, 2)).view(complex)[..., 0].astype(np.complex64)
    raw = pysas.Echoes(data, fs=40e3, fc=1e5, tx=tx, rx=tx, bandwidth=2e4, pulse=pysas.LFM(1e5, 2e4, 1e-3), compressed=False)
    grid = pysas.Grid.plane(np.arange(3) * 0.5, 9 + np.arange(4) * 0.5)
    for name in ("raw.npz", "raw.h5"):
        pysas.save(name, raw)
    pysas.save("grid.npz", pysas.Image(np.ones(grid.shape, np.complex64), grid, pysas.Report("given"), 1e5, 1500.0))
    np.savez("map.npz", x=np.array([-9.0, 9]), y=np.array([0.0, 20]), z=np.zeros((2, 2)))
    Path("points.csv").write_text("0,10,0,1\n")
    return tmp_path


def command(name: str, read: str, options: list[str]) -> list[str]:
    """A command that would do its work within a second."""
    if name == "simulate":
        return ["simulate", "--pings", "4", "--channels", "1", *INPUTS[name].get(read, []), *options]
    raw = read if read.startswith("raw") else "raw.npz"
    if name == "navigate" and "-o" not in options:  # which it has to have
        options = ["-o", "fixed.npz", *options]
    spans = [] if read.startswith("grid") else SPANS
    return [name, raw, *INPUTS[name].get(read, []), *spans, *options]


def contents(folder: Path) -> dict[str, bytes | str]:
    """All below a folder: a link's target, a file's bytes."""
    return {
        str(path.relative_to(folder)): os.readlink(path) if path.is_symlink() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_symlink() or path.is_file()
    }


def refused(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """The one line of an error that comes before any work and changes nothing."""
    before = contents(Path.cwd())
    code = cli.main(arguments)
    out = capsys.readouterr()
    lines = [line for line in out.err.splitlines() if line.startswith("pysas: error: ")]
    assert code == 2 and out.out == "" and len(lines) == 1 and "Traceback" not in out.err, out.err
    assert not any(f"{word} ..." in out.err for word in WORK), out.err
    assert contents(Path.cwd()) == before
    return lines[0]


def test_every_option_that_names_a_file_is_one_of_these() -> None:
    """A new option belongs in the tables above, and a command that writes has --overwrite."""
    (commands,) = (a for a in cli.parser()._actions if isinstance(a, argparse._SubParsersAction))
    for name, sub in commands.choices.items():
        named = {a.dest for a in sub._actions if a.type is None and a.choices is None and a.nargs != 0}
        assert named <= READS | WRITES | TEXTS, name
        assert ("overwrite" in {a.dest for a in sub._actions}) == bool(named & WRITES), name
        assert name in ("demo", "info", "check", "echoes", "convert", "survey", "mosaic") or {
            flag for flag, _ in OUTPUTS[name]
        } == {a.option_strings[0] for a in sub._actions if a.dest in WRITES}


ALIASES: dict[str, Callable[[str, str], str]] = {
    "same name": lambda read, suffix: read,
    "with a dot": lambda read, suffix: f"./{read}",
    "up and down": lambda read, suffix: f"../{Path.cwd().name}/{read}",
    "absolute": lambda read, suffix: str(Path.cwd() / read),
    "linked folder": lambda read, suffix: os.symlink(".", "folder") or f"folder/{read}",  # type: ignore[func-returns-value]
    "symbolic link": lambda read, suffix: os.symlink(read, f"link{suffix}") or f"link{suffix}",  # type: ignore[func-returns-value]
    "link to a link": lambda read, suffix: (
        os.symlink(read, "first") or os.symlink("first", f"link{suffix}") or f"link{suffix}"  # type: ignore[func-returns-value]
    ),
    "hard link": lambda read, suffix: os.link(read, f"hard{suffix}") or f"hard{suffix}",  # type: ignore[func-returns-value]
}


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights there")
@pytest.mark.parametrize("overwrite", [[], ["--overwrite"]], ids=["", "overwrite"])
@pytest.mark.parametrize("alias", ALIASES)
@pytest.mark.parametrize("name", INPUTS)
def test_what_is_read_is_never_replaced(
    name: str, alias: str, overwrite: list[str], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tried = 0
    for read in INPUTS[name]:
        for option, suffix in OUTPUTS[name]:
            path = ALIASES[alias](read, suffix)
            if Path(path).suffix == suffix:
                line = refused(command(name, read, [option, path, *overwrite]), capsys)
                assert "is read by this command" in line and path in line
                tried += 1
            for made in ("folder", "first", f"link{suffix}", f"hard{suffix}"):
                Path(made).unlink(missing_ok=True)
    # another spelling keeps the suffix: scatterers' is none that anything is written with
    assert tried or (name == "simulate" and alias in ("same name", "with a dot", "up and down", "absolute", "linked folder"))


@pytest.mark.parametrize("name", OUTPUTS)
def test_what_is_there_is_replaced_only_where_asked(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    read = next(iter(INPUTS[name]))
    for option, suffix in OUTPUTS[name]:
        path = Path(f"old{suffix}")
        path.write_bytes(b"old")
        path.chmod(0o600)
        line = refused(command(name, read, [option, str(path)]), capsys)
        assert f"{option} {path}: exists" in line and "--overwrite" in line
        if name not in ("compare", "navigate"):  # which run for long, or find no track here
            assert cli.main(command(name, read, [option, str(path), "--overwrite"])) == 0
            assert path.read_bytes() != b"old" and (os.name != "posix" or path.stat().st_mode & 0o777 == 0o600)
            capsys.readouterr()


def test_the_demo_replaces_nothing_unasked(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("raw.npz", "image.npz", "image.png", "report.json", "report.txt"):
        (folder / "demo").mkdir()
        (folder / "demo" / name).write_bytes(b"mine")
        assert f"{name}: exists" in refused(["demo"], capsys)
        (folder / "demo" / name).unlink()
        (folder / "demo").rmdir()
    assert "points.csv" in refused(["demo", "-o", "points.csv"], capsys)


@pytest.mark.parametrize("name", ["image", "compare"])
def test_two_outputs_of_one_name(name: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    os.symlink("new.png", "link.png")
    os.symlink(".", "folder")
    for second in ("new.png", "./new.png", "folder/new.png", "link.png", str(folder / "new.png")):
        if name == "compare":
            line = refused(command(name, "raw.npz", ["-o", "new.png", "--png", second]), capsys)
            assert "is the file of -o too" in line
    os.symlink("new.npz", "both.png")  # image: only through a link, as -o and --png take other suffixes
    assert "is the file of -o too" in refused(command(name, "raw.npz", ["-o", "new.npz", "--png", "both.png"]), capsys)


BAD = {
    "missing folder": ("nowhere/x{}", "no such folder"),
    "a file for a folder": ("points.csv/x{}", "points.csv"),
    "a folder": ("folder{}", "expected a regular file or a new name"),
    "no writing there": ("/proc/x{}", "/proc/x"),
    "too long": ("x" * 300 + "{}", "too long"),
    "null": ("x\0{}", "without a null"),
    "a device": ("device{}", "expected a regular file or a new name"),
}


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs /proc")
@pytest.mark.parametrize("case", BAD)
@pytest.mark.parametrize("name", OUTPUTS)
def test_names_that_cannot_be_written_are_told_before_the_work(
    name: str, case: str, folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, text = BAD[case]
    for option, suffix in OUTPUTS[name]:
        (folder / f"folder{suffix}").mkdir()
        (folder / f"device{suffix}").symlink_to("/dev/null")
        for overwrite in ([], ["--overwrite"]):
            options = [option, path.format(suffix), *overwrite]
            assert text in refused(command(name, next(iter(INPUTS[name])), options), capsys)
        (folder / f"folder{suffix}").rmdir()
        (folder / f"device{suffix}").unlink()


def test_what_is_missing_for_a_format_is_told_before_the_work(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from matplotlib.figure import Figure

    def fail(*_: Any, **__: Any) -> None:
        raise RuntimeError("'xelatex' not found")

    for name in ("image", "compare"):
        for suffix in (".xyz", ".npz", ".h5"):
            assert f"found suffix '{suffix}'" in refused(command(name, "raw.npz", ["--png", f"x{suffix}"]), capsys)
        with monkeypatch.context() as patch:  # where a format needs a program
            patch.setattr(Figure, "savefig", fail)
            assert "cannot write pgf here: 'xelatex'" in refused(command(name, "raw.npz", ["--png", "x.pgf"]), capsys)
    for name in ("image", "simulate"):
        assert "expected .npz or .h5" in refused(command(name, next(iter(INPUTS[name])), ["-o", "x.mat"]), capsys)
        with monkeypatch.context() as patch:
            patch.setitem(sys.modules, "h5py", None)
            assert "[hdf5]" in refused(command(name, next(iter(INPUTS[name])), ["-o", "x.h5"]), capsys)


@pytest.mark.parametrize("method", ["backprojection", "ffbp"])
def test_an_image_of_nothing_is_written_and_ends_with_1(method: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    far = ["--x", "0:1", "--y", "900:901", "--spacing", "0.1"]
    code = cli.main(["image", "raw.npz", *far, "-o", "far.npz", "--method", method])
    assert code == 1 and "pysas: warning: " in capsys.readouterr().err
    found = pysas.load("far.npz")
    assert found.report.terms == 0 and not found.data.any()


@pytest.mark.parametrize(
    "value", ["", " ", "0", "-1", "1.5", "x", "1 2", "+2", "1_0", "²", "٣", "9" * 30, "9" * 5000, "4097", str(2**31 - 1)]
)
def test_numbers_of_threads_in_the_environment(
    value: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PYSAS_NUM_THREADS", value)
    line = refused(command("image", "raw.npz", ["-o", "x.npz"]), capsys)
    assert "PYSAS_NUM_THREADS=" in line and "expected a whole number" in line and len(line) < 200
    with pytest.raises(ValueError, match="threads="):
        pysas.simulate([[0, 10, 0]], [1], pysas.LFM(1e5, 2e4, 1e-3), tx=[[0, 0, 0]], rx=[[0, 0, 0]], fs=4e4, duration=0.02,
                       threads=4097)  # fmt: skip


@pytest.mark.parametrize("value", ["1", " 2 ", "002", "4096"])
def test_numbers_of_threads_that_are(value: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYSAS_NUM_THREADS", value)
    assert cli.main(command("image", "raw.npz", ["-o", "x.npz"])) == 0


@pytest.mark.skipif(os.name != "posix", reason="no such files there")
def test_scatterers_come_from_a_regular_file(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A device without an end, a device that is empty, and what is no text."""
    os.symlink("/dev/zero", "zero.csv")
    os.symlink("/dev/null", "null.csv")
    Path("binary.csv").write_bytes(bytes(range(256)))
    Path("empty.csv").write_bytes(b"")
    cases = {
        "zero.csv": "regular file",
        "null.csv": "regular file",
        "binary.csv": "x,y,z",
        "empty.csv": "x,y,z",
        "raw.npz": "x,y,z",
    }
    for name, text in cases.items():
        code = cli.main(["simulate", "-o", "x.npz", "--points", name])
        err = capsys.readouterr().err
        assert code == 2 and text in err and name in err and "Traceback" not in err and not Path("x.npz").exists()


ROW = comparison.Row(
    "backproject", "tol 0.01", 1.0, 1.0, 1.0, 1, 0.1, 0.9, (3, 3), 1e6, 1e-3, False, 0.0, (0.1, 0.1), (-13.0, -13.0), 0.0
)  # fmt: skip


@pytest.mark.parametrize("name", ["a$_{b$c", "back\\slash$$", "ünï–✓", "new\nline", "bad\udcff"], ids=ascii)
def test_names_of_files_are_no_mathematics_and_any_bytes(
    name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        os.rename("raw.npz", f"{name}.npz")
    except OSError:  # a file system that takes only text
        return
    found = comparison.Comparison(6, 600, (3, 3), (0.1, 0.1), (-13.0, -13.0), (ROW,))
    monkeypatch.setattr(comparison, "compare", lambda *_, **__: found)
    options = [*SPANS, "-o", f"{name}.md", "--png", f"{name}.png", "--tol", "1e-2"]
    assert cli.main(["compare", f"{name}.npz", *options]) == 0
    assert Path(f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert name.split("\udcff")[0] in Path(f"{name}.md").read_text("utf-8")
    assert cli.main(["image", f"{name}.npz", *SPANS, "-o", f"{name} image.npz"]) == 0
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="needs a shell")
def test_standard_output_that_is_closed_full_or_poor(folder: Path) -> None:
    run = f'"{sys.executable}" -c "import sys; from pysas.cli import main; sys.exit(main(sys.argv[1:]))" image raw.npz'
    run += f" {' '.join(SPANS)}"
    script = f"""
        {run} -o closed.npz >&- 2>&-; echo $?
        PYTHONIOENCODING=ascii {run} -o ü.npz; echo $?
        {run} --json > /dev/full; echo $?
    """
    found = subprocess.run(["sh", "-c", script], capture_output=True, text=True, timeout=120, encoding="utf-8")
    codes = [line for line in found.stdout.splitlines() if line.isdigit()]
    assert codes == ["0", "0", "2"] and "Traceback" not in found.stderr, found.stderr
    assert Path("closed.npz").exists() and Path("ü.npz").exists()
