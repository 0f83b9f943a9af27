"""Instructions per term of the sum's two loops, counted in disassembled kernels: `python -m bench.instructions OBJECT ...`.

An object is a file of `csrc/isa` compiled with the flags of setup.py. Each loop is followed by its shortest way round (no
weights, no relief); its terms are its fused multiply-adds, over those that a term takes by the kernel's source. What is counted
is what the compiler wrote: how long an instruction takes, and how many run side by side, is another matter.
"""

import argparse
import heapq
import re
import subprocess
from collections.abc import Sequence

VECTOR = 8  # terms of a vector
NODES, TRIG = 5, 5  # of complex64's delay polynomial; terms of its sine with tol 1e-3, see docs/design.md
SYMBOL = re.compile(r"add_lines<true, [\w:() ]*::Float, 5, (\d), 5, (\d)>")
MACHINES = {"aarch64": "aarch64-linux-gnu-objdump", "x86-64": "objdump"}
JUMP = re.compile(r"j\w+|b|b\.\w+|cbn?z|tbn?z")
ALWAYS = ("jmp", "b", "ret", "call", "bl")  # nor are calls followed
FUSED = re.compile(r"vfn?m(add|sub)\w*ps|fml[as]")

Code = dict[int, tuple[str, str]]  # address: mnemonic, operands


def functions(path: str) -> dict[tuple[int, int], Code]:
    """Code of the sums over whole lines by degree of interpolation and registers of a window (0: gathers)."""
    said = subprocess.run(["objdump", "-f", path], capture_output=True, text=True, check=False).stdout
    name = next((tool for machine, tool in MACHINES.items() if machine in said), MACHINES["aarch64"])
    text = subprocess.run([name, "-dC", "--no-show-raw-insn", path], capture_output=True, text=True, check=True).stdout
    out: dict[tuple[int, int], Code] = {}
    code: Code = {}
    for line in text.splitlines():
        if line.endswith(">:"):
            found = SYMBOL.search(line)
            code = out.setdefault((int(found[1]), int(found[2])), {}) if found else {}
        elif instruction := re.match(r"\s*([0-9a-f]+):\t(\S+)\s*(.*)", line):
            code[int(instruction[1], 16)] = (instruction[2], instruction[3])
    return out


def target(code: Code, at: int) -> int | None:
    """Where a jump leads."""
    name, operands = code[at]
    found = re.search(r"\b([0-9a-f]+) <", operands) if JUMP.fullmatch(name) else None
    return int(found[1], 16) if found else None


def shortest(code: Code, begin: int, end: int, fused: int) -> int | None:
    """Instructions of the shortest way from one to the other that takes so many fused multiply-adds."""
    places = sorted(code)
    behind = dict(zip(places, places[1:], strict=False))
    seen: set[tuple[int, int]] = set()
    queue = [(0, begin, 0)]
    while queue:
        length, at, count = heapq.heappop(queue)
        if at not in code or (at, count) in seen:
            continue
        seen.add((at, count))
        count += FUSED.fullmatch(code[at][0]) is not None
        if at == end and count == fused:
            return length + 1
        if count > fused:
            continue
        for to in (None if code[at][0] in ALWAYS else behind.get(at), target(code, at)):
            if to is not None:
                heapq.heappush(queue, (length + 1, to, count))
    return None


def per_term(code: Code, lanes: int, degree: int) -> tuple[float, float] | None:
    """Instructions per term of the loop over positions and of that over terms: what one vector of either more takes.

    None where some of a loop's work is in a function of its own.
    """
    wide = VECTOR // lanes  # registers of a vector
    # the delay's Horner steps and the carrier's phase; sine, cosine, the interval's polynomial, a complex multiply-add
    position, term = (NODES - 2 + 1) * wide, (TRIG - 1 + TRIG + 2 * degree + 4) * wide
    back = {(to, at) for at in code if (to := target(code, at)) is not None and to <= at}
    lengths = []
    for to, at in back:
        each = [shortest(code, to, at, a * position + b * term) for a, b in ((1, 1), (2, 1), (1, 2))]
        if None not in each:
            lengths.append(each)
    if not lengths:
        return None
    one, positions, terms = min(lengths)
    return (positions - one) / VECTOR, (terms - one) / VECTOR


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("object", nargs="+")
    parser.add_argument("--degree", type=int, default=3, help="of interpolation")
    chosen = parser.parse_args(arguments)
    print("| object | window of | positions | terms | both |\n|---|---|---|---|---|")
    for path in chosen.object:
        found = functions(path)
        for (degree, window), code in sorted(found.items()):
            if degree != chosen.degree:
                continue
            lanes = 4 if any(name in ("fmla", "fmls") for name, _ in code.values()) else 8
            counted = per_term(code, lanes, degree)
            kind = "gathers" if window == 0 else f"{window} vector{'s' * (window > 1)}"
            figures = (*counted, sum(counted)) if counted else ("called", "called", "called")
            print("|", path, "|", kind, "|", *(f"{x:.2f} |" if counted else f"{x} |" for x in figures))


if __name__ == "__main__":
    main()
