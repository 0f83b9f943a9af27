"""The figures of docs/figures.md: `python -m bench.figures --write docs/figures.md` makes all of them on one machine in one go.

A table stands between two comments of the page, `<!-- bench NAME -->` and `<!-- /bench -->`, under a line that says what it
was measured on; the text about the tables is written by hand and stays. It takes about half an hour; `--quick` runs small
scenes and prints what would be written.
"""

import datetime
import re
from pathlib import Path

from bench import backprojection, document, peers, survey, tolerance

# receivers, m, relief in m, method, tol
SURVEYS = [
    *((32, length, 0.0, "strip", tol) for length in (400.0, 60.0) for tol in (1e-2, 1e-3)),
    *((6, length, 0.0, "strip", tol) for length in (200.0, 60.0) for tol in (1e-2, 1e-3)),
    *((32, 20.0, 0.0, "backprojection", tol) for tol in (1e-2, 1e-3)),
    *((32, 10.0, 2.0, "auto", tol) for tol in (1e-2, 1e-3)),
    *((32, 60.0, 2.0, "strip", tol) for tol in (1e-2, 1e-3)),
    (32, 200.0, 2.0, "strip", 1e-2),
]


def surveys(quick=False):
    """Real-time factors of surveys."""
    lines = ["| receivers | scene | tol | real-time factor | error | factorised |", "|---|---|---|---|---|---|"]
    for receivers, length, relief, method, tol in [(6, 10.0, 0.0, "strip", 1e-2)] if quick else SURVEYS:
        cells = dict(zip(survey.HEAD, survey.row(receivers, length, relief, method, tol, 2, 200), strict=True))
        what = "strip" if method == "strip" else "image"
        scene = f"{what} of {length:g} m" + (f" over {relief:g} m of relief" if relief else "")
        scene += ", `backproject`" if method == "backprojection" else ""
        share = f"{100 * float(cells['factorised']):.0f} %"
        lines.append(f"| {receivers} | {scene} | {tol:.0e} | {cells['real-time factor']} | {cells['error']} | {share} |")
    return "\n".join(lines)


TABLES = {
    "tolerance": tolerance.text,
    "peers": peers.text,
    "survey": surveys,
    "kernel": lambda quick: backprojection.table(backprojection.measured(quick)),
}


def replaced(page, name, text):
    """The page with another table between the comments of that name."""
    pattern = rf"(<!-- bench {name} -->\n).*?(<!-- /bench -->)"
    new, count = re.subn(pattern, lambda found: f"{found[1]}\n{text}\n\n{found[2]}", page, flags=re.S)
    if count != 1:
        raise ValueError(f"{count} places for the table {name!r}: expected one")
    return new


def main():
    parser = document.parser(__doc__)
    parser.add_argument("--quick", action="store_true", help="small scenes, to see that all of it runs; print the tables")
    args = parser.parse_args()
    when = datetime.date.today()
    made = {name: f"On {document.machine()}, {when}.\n\n{table(args.quick)}" for name, table in TABLES.items()}
    if args.quick or not args.write:
        print("\n\n".join(f"## {name}\n\n{text}" for name, text in made.items()))
        return
    page = Path(args.write).read_text(encoding="utf-8")
    for name, text in made.items():
        page = replaced(page, name, text)
    document.write(page, args.write)


if __name__ == "__main__":
    main()
