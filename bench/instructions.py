"""Instructions a term, counted in disassembled kernels: `python -m bench.instructions OBJECT ...`, see docs/performance.md.

An object is a source of `csrc/isa` compiled with the flags of setup.py, for AVX2 or NEON. The direct sum of complex64 goes
through a line of a block in two loops, over positions and over terms. What one more vector of either takes is the difference
between shortest ways round the loop over lines (no weights, no relief) that hold so many fused multiply-adds more, which the
kernel's source tells; that works whether the compiler unrolled a loop or not. How long an instruction takes, and how many run
side by side, is another matter.
"""

import argparse
import heapq
import re
import subprocess
from collections.abc import Sequence

VECTOR = 8  # terms
NODES, TRIG = 5, 5  # of the delay's polynomial; terms of the sine with tol 1e-3
SUM = re.compile(rf"add_lines<true, [\w:() ]*::Float, {NODES}, (\d), {TRIG}, (\d)>")
JUMP = re.compile(r"j\w+|b|b\.\w+|cbn?z|tbn?z")
ENDS = ("jmp", "b", "ret", "call", "bl")  # calls are not followed: plain sums have none
FUSED = re.compile(r"vfn?m(?:add|sub)\w*ps|fml[as]")

Code = dict[int, tuple[str, str]]  # by address: mnemonic and operands


def sums(path: str) -> tuple[int, dict[tuple[int, int], Code]]:
    """Lanes of a register, and code of the sums of whole lines by degree of interpolation and vectors of a window (0: any)."""
    said = subprocess.run(["objdump", "-f", path], capture_output=True, text=True, check=False).stdout
    lanes, tool = (8, "objdump") if "x86-64" in said else (4, "aarch64-linux-gnu-objdump")
    text = subprocess.run([tool, "-dC", "--no-show-raw-insn", path], capture_output=True, text=True, check=True).stdout
    out: dict[tuple[int, int], Code] = {}
    code: Code = {}
    for line in text.splitlines():
        if line.endswith(">:"):
            found = SUM.search(line)
            code = out.setdefault((int(found[1]), int(found[2])), {}) if found else {}
        elif instruction := re.match(r"\s*([0-9a-f]+):\t(\S+)\s*(.*)", line):
            code[int(instruction[1], 16)] = (instruction[2], instruction[3])
    return lanes, out


def target(code: Code, at: int) -> int | None:
    """Where a jump leads."""
    name, operands = code[at]
    found = re.search(r"\b([0-9a-f]+) <", operands) if JUMP.fullmatch(name) else None
    return int(found[1], 16) if found else None


def shortest(code: Code, begin: int, end: int, fused: int) -> int | None:
    """Instructions of the shortest way from one to the other with so many fused multiply-adds."""
    places = sorted(code)
    behind = dict(zip(places, places[1:], strict=False))
    seen: set[tuple[int, int]] = set()
    queue = [(1, begin, 0)]
    while queue:
        length, at, count = heapq.heappop(queue)
        if at not in code or (at, count) in seen or count > fused:
            continue
        seen.add((at, count))
        count += FUSED.fullmatch(code[at][0]) is not None
        if at == end and count == fused:
            return length
        for to in (None if code[at][0] in ENDS else behind.get(at), target(code, at)):
            if to is not None:
                heapq.heappush(queue, (length + 1, to, count))
    return None


def per_term(code: Code, lanes: int, degree: int) -> tuple[float, float] | None:
    """Instructions a term of the loop over positions and of that over terms; None where they call for some of their work."""
    registers = VECTOR // lanes
    # delay and phase; sine, cosine, the interval's two polynomials, a complex multiply-add
    position, term = (NODES - 2 + 1) * registers, (TRIG - 1 + TRIG + 2 * degree + 4) * registers
    found = []
    for at in code:
        to = target(code, at)
        if to is None or to > at:
            continue
        lengths = [shortest(code, to, at, a * position + b * term) for a, b in ((1, 1), (2, 1), (1, 2))]
        known = [length for length in lengths if length is not None]
        if len(known) == len(lengths):
            found.append(known)
    if not found:
        return None
    one, positions, terms = min(found)
    return (positions - one) / VECTOR, (terms - one) / VECTOR


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("object", nargs="+")
    parser.add_argument("--degree", type=int, default=3, help="of interpolation; tol 1e-3 takes 3 at twice the sample rate")
    chosen = parser.parse_args(arguments)
    print("| object | window, vectors | positions | terms | both |\n|---|---|---|---|---|")
    for path in chosen.object:
        lanes, found = sums(path)
        for window in (1, 2):
            counted = per_term(found[chosen.degree, window], lanes, chosen.degree)
            figures = "calls | |" if counted is None else f"{counted[0]:.1f} | {counted[1]:.1f} | {sum(counted):.1f}"
            print(f"| {path} | {window} | {figures} |")


if __name__ == "__main__":
    main()
