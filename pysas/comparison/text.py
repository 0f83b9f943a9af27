"""A comparison as text."""

from __future__ import annotations

import re
from collections.abc import Mapping

from pysas.comparison.rows import Comparison, Pair, Row, front


def table(comparison: Comparison) -> str:
    """Markdown: the exact sum's response, a line a row, the front marked, and what was left out or warned of, with reasons.

    A column that no row fills is left out; "pixels" is filled where an image has another shape than the first.
    """
    best = set(front(comparison.rows))
    lines = [_cells(row, number in best, comparison.shape) for number, row in enumerate(comparison.rows)]
    kept = [name for name in lines[0] if any(cells[name] for cells in lines)]
    text = [f"Exact sum: IRW {_pair(comparison.irw, '.2f', 100)} cm, PSLR {_pair(comparison.pslr, '.1f')} dB.\n"]
    text += [f"| {' | '.join(kept)} |\n|{'---|' * len(kept)}"]
    text += [f"| {' | '.join(cells[name] for name in kept)} |" for cells in lines]
    for title, found in (("Left out", comparison.left_out), ("Warned of", comparison.warned)):
        if found:
            text += [f"\n{title}:\n", _reasons(found)]
    return "\n".join(text) + "\n"


def _cells(row: Row, best: bool, shape: tuple[int, ...]) -> dict[str, str]:
    share = f", {100 * row.share:.0f} % factorised" if row.method.startswith("ffbp") else ""
    return {
        "method": row.method, "setting": row.setting + share,
        "s": f"{row.seconds:.3g} " + (f"({row.least:.3g} to {row.most:.3g})" if row.runs > 1 else "(once)"),
        "preparation": f"{row.prepare:.3g}" if row.prepare else "", "sum": f"{row.summed:.3g}" if row.summed else "",
        "pixels": "" if row.shape == shape else " x ".join(map(str, row.shape)),
        "1e9 terms/s": f"{row.terms_per_second / 1e9:.3g}", "error": f"{row.error:.1e}" + ("*" if row.fitted else ""),
        "loss, dB": "" if row.loss is None else f"{round(row.loss, 2) + 0.0:.2f}",
        "IRW, cm": _pair(row.irw, ".2f", 100), "PSLR, dB": _pair(row.pslr, ".1f"),
        "MB": "" if row.memory is None else f"{row.memory:.0f}", "front": "front" if best else "",
    }  # fmt: skip


def _pair(values: Pair, form: str, scale: float = 1.0) -> str:
    """Two numbers as text, "-" for one that is not known."""
    return " / ".join("-" if value is None else format(scale * value, form) for value in values)


def _reasons(found: Mapping[str, str]) -> str:
    """What was said of methods, those of one reason together."""
    grouped: dict[str, list[str]] = {}
    for name, reason in found.items():
        grouped.setdefault(re.sub(r"\s+", " ", reason), []).append(name)
    return "\n".join(f"- {'; '.join(names)}: {reason}" for reason, names in grouped.items())
