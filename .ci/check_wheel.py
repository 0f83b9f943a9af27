"""What a wheel must hold and must not: `python .ci/check_wheel.py WHEEL...` prints sizes and symbols, and fails with reasons.

Needs pyelftools (auditwheel brings it) for Linux wheels.
"""

from __future__ import annotations

import io
import re
import sys
import zipfile
from pathlib import Path

LIBRARIES = {"linux": "libpysas.so", "macosx": "libpysas.dylib", "win": "pysas.dll"}
MOST = 6e6  # bytes of a wheel
FOLDER = rb"/(?:home|root|tmp|project|usr|opt|Users|private)/[\w./+-]+"  # of a machine that builds


def check(path: Path) -> list[str]:
    """Complaints about a wheel, whose contents are printed."""
    _, _, python, _, platform = path.stem.split("-")
    system = next((name for name in LIBRARIES if name in platform), "")
    wanted = {f"pysas/lib/{LIBRARIES.get(system, '?')}", "pysas/include/pysas.h"}
    print(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB")
    faults = [f"{path.stat().st_size / 1e6:.1f} MB: expected {MOST / 1e6:g} at most"] if path.stat().st_size > MOST else []
    if system == "linux" and "manylinux" not in platform:
        faults.append(f"tag {platform}: not repaired")
    with zipfile.ZipFile(path) as wheel:
        names = set(wheel.namelist())
        faults += [f"{name}: not there" for name in sorted(wanted - names)]
        if not any(name.endswith("dist-info/licenses/LICENSE") for name in names):
            faults.append("no licence")
        digits = python.removeprefix("cp")
        extension = re.compile(rf"pysas/engine/_core\.(cpython-{digits}-.*\.so|cp{digits}-.*\.pyd)")
        binaries = sorted(name for name in names if re.search(r"\.(so|pyd|dll|dylib)(\.|$)", name))
        if sum(map(bool, map(extension.fullmatch, binaries))) != 1:
            faults.append(f"{python}: expected one extension for it, found {', '.join(binaries) or 'none'}")
        for name in binaries:
            print(f"  {name}: {wheel.getinfo(name).file_size / 1e6:.2f} MB")
            if name not in wanted and not extension.fullmatch(name):
                faults.append(f"{name}: not ours, and its licence is not named")
            elif system == "linux":
                faults += [f"{name}: {fault}" for fault in elf_faults(wheel.read(name), name in wanted)]
    return faults


def elf_faults(data: bytes, library: bool) -> list[str]:
    """Debugging information, paths of the machine that built it, and names let out that are not the interface's."""
    from elftools.elf.elffile import ELFFile

    elf = ELFFile(io.BytesIO(data))
    symbols = elf.get_section_by_name(".dynsym").iter_symbols()
    out = {s.name for s in symbols if s["st_shndx"] != "SHN_UNDEF" and s["st_info"]["bind"] != "STB_LOCAL" and s.name}
    dynamic = list(elf.get_section_by_name(".dynamic").iter_tags())
    print(f"    exports {few(out)}; needs {', '.join(t.needed for t in dynamic if t.entry.d_tag == 'DT_NEEDED')}")
    header = (Path(__file__).parent.parent / "csrc/include/pysas.h").read_text(encoding="utf-8")
    wanted = set(re.findall(r"PYSAS_API [^;(]*?\b(pysas_\w+)\(", header)) if library else {"PyInit__core"}
    faults = [] if out == wanted else [f"exports {few(out - wanted)} too many, lacks {few(wanted - out)}"]
    debug = [section.name for section in elf.iter_sections() if section.name.startswith((".debug", ".zdebug"))]
    faults += [f"debugging information: {', '.join(debug)}"] if debug else []
    paths = [t.entry.d_tag for t in dynamic if t.entry.d_tag in ("DT_RPATH", "DT_RUNPATH")]
    paths += sorted({path.decode() for path in re.findall(FOLDER, data)})[:10]
    return faults + ([f"{', '.join(paths)}: expected none"] if paths else [])


def few(names: set[str]) -> str:
    """Their number and the first ones."""
    return f"{len(names)} ({', '.join(sorted(names)[:10])})" if names else "none"


if __name__ == "__main__":
    found = [f"{argument}: {fault}" for argument in sys.argv[1:] for fault in check(Path(argument))]
    sys.exit("\n".join(["FAILED:", *found]) if found or len(sys.argv) == 1 else 0)
