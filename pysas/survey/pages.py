"""The report of a survey's run: a page of HTML that needs nothing beside it, and its figures as JSON.

What stands in a store, names and reasons too, may come from anyone: all of it is escaped, and the page lets a browser fetch and
run nothing.
"""

from __future__ import annotations

import base64
import html
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pysas.formats import files
from pysas.imaging.words import spoken
from pysas.survey import pictures
from pysas.survey.image_store import DAMAGED, DONE, FAILED, StripStore, SurveyStore
from pysas.survey.reducing import rows_of
from pysas.survey.running import SurveyReport, plan_of, spans
from pysas.survey.tiling import StripPlan

SUFFIXES = ".html", ".htm"
_STATES = tuple(pictures.COLOURS)
_MOST_PICTURES, _MOST_NOTES = 40, 200
_STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; margin: 2em auto; max-width: 76em; padding: 0 1em; color: #222; }
table { border-collapse: collapse; margin: 0.6em 0; font-size: 13px; } th { background: #f0f0f0; }
th, td { border: 1px solid #ccc; padding: 0.25em 0.6em; text-align: left; } td:first-child { min-width: 6.5em; }
td.n { text-align: right; font-variant-numeric: tabular-nums; } td:last-child { overflow-wrap: anywhere; }
img { max-width: 100%; } img.map { max-width: 52em; }
.bad { color: #b00; font-weight: bold; } .good { color: #1e7a1e; font-weight: bold; }
"""
_MARK = '<meta name="generator" content="pysas survey">'
_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


def is_page(path: str | os.PathLike[str] | None) -> bool:
    """Whether a file is one that `page` wrote, with nothing but the same beside it."""
    try:
        with files.opened(path or "") as page, files.opened(Path(path or "").with_suffix(".json")) as beside:
            return _MARK.encode() in page.read(1024) and json.loads(beside.read(2**26)).keys() >= {"store", "version", "tiles"}
    except (OSError, ValueError, AttributeError):
        return False


def page(
    store: str | os.PathLike[str], report: SurveyReport, path: str | os.PathLike[str], *, overwrite: bool = False
) -> dict[str, Any]:
    """Write what became of a survey: a page of HTML with pictures, and beside it the same figures as JSON.

    Parameters
    ----------
    store : path
        Of the images.
    report : SurveyReport
        Of the run that the page tells of.
    path : path
        Of the page, ends in .html or .htm; the JSON has the same name and the suffix .json.
    overwrite : bool
        Replace files that are there; False: they are an error.

    Returns
    -------
    dict
        What stands in the JSON: `report.as_dict()`, "plan" (what it predicted) and "strips", a dict each.

    Raises
    ------
    ValueError, TypeError
        Another suffix or report; no such store, or attributes of it that are damaged. Tiles that are damaged are told of.
    OSError
        From the file system.

    Notes
    -----
    Without matplotlib the page has no pictures and says what to install. Quick-looks show the mean power of boxes of pixels;
    where a survey has more than 4e9 of them, or 20,000 tiles, of evenly spaced stretches of its strips. Of more than 40 strips
    the first 40 have one. Memory: some times a tile's magnitudes, and the pictures.
    """
    if not isinstance(report, SurveyReport):
        raise TypeError(f"report={type(report).__name__}: expected what pysas.survey.run returns")
    text = files.name(path)
    stem, suffix = os.path.splitext(text)
    if suffix.lower() not in SUFFIXES:
        raise ValueError(f"{text}: expected a name that ends in .html")
    targets = text, stem + ".json"
    for target in targets:
        if not overwrite and os.path.lexists(target):
            raise FileExistsError(f"{target}: exists: expected a new name, or overwrite=True")
    opened = SurveyStore(store)
    plans = [plan_of(opened, strip) for strip in opened.strips]
    tiles = [_Tiles(strip) for strip in opened.strips]
    shown = _quicklooks(plans, opened.strips, tiles) if pictures.drawable() else None
    map_shown = pictures.coverage(plans, [of_strip.states for of_strip in tiles]) if shown is not None else None
    values = report.as_dict() | {
        "plan": _predicted(opened.header.get("predicted")),
        "strips": [_figures(plan, of_strip) for plan, of_strip in zip(plans, tiles, strict=True)],
    }
    written = _html(values, report, map_shown, shown)
    content = json.dumps(values, indent=1, allow_nan=False)
    for target, what in zip(targets, (written, content), strict=True):
        with files.replacing(target, overwrite=overwrite) as file:
            file.write(pictures.printable(what).encode())
    return values


class _Tiles:
    """What a strip's records say, and what reading its tiles found.

    Attributes
    ----------
    states, reasons : list of str
        A tile each; what is wrong with those that are damaged.
    """

    def __init__(self, strip: StripStore) -> None:
        self.states = [pictures.MISSING] * strip.tiles
        self.reasons = [""] * strip.tiles
        self.terms, self.methods, self.notes = 0, set[str](), dict[str, list[int]]()
        self.error: float | None = None
        self.left_out = list[float]()
        for tile in range(strip.tiles):
            record = strip.record(tile)
            if record is None:
                if strip.has_record(tile):
                    self.states[tile], self.reasons[tile] = DAMAGED, "its record is damaged"
                continue
            self.states[tile] = str(record["state"])
            if self.states[tile] == FAILED:
                self.reasons[tile] = str(record.get("reason", ""))
            elif self.states[tile] == DAMAGED:
                self.reasons[tile] = "found damaged by verify"
            elif self.states[tile] == DONE:
                if not strip.whole(tile, record):
                    self.states[tile], self.reasons[tile] = DAMAGED, "pixels are missing or cut short"
                self._take(tile, record.get("report"))

    def _take(self, tile: int, report: Any) -> None:
        if not isinstance(report, Mapping):
            return
        self.methods.add(str(report.get("method", "")))
        if (error := _finite(report.get("predicted_error"))) is not None:
            self.error = max(error, self.error or 0.0)
        if (share := _finite(report.get("share_left_out"))) is not None:
            self.left_out.append(share)
        self.terms += int(_finite(report.get("terms")) or 0)
        notes = report.get("notes")
        for note in notes if isinstance(notes, list) else ():
            self.notes.setdefault(str(note), []).append(tile)

    def damaged(self, tile: int, reason: str) -> None:
        """Reading a tile found this."""
        self.states[tile], self.reasons[tile] = DAMAGED, reason


def _predicted(found: Any) -> dict[str, float]:
    given = found if isinstance(found, Mapping) else {}
    return {name: number for name in ("seconds", "memory", "threads") if (number := _finite(given.get(name))) is not None}


def _finite(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _quicklooks(plans: Sequence[StripPlan], strips: Sequence[StripStore], tiles: Sequence[_Tiles]) -> list[tuple[bytes, str]]:
    """Pictures of the first strips, and what each shows."""
    found = []
    many = min(len(plans), _MOST_PICTURES)
    for plan, strip, of_strip in zip(plans[:many], strips, tiles, strict=False):
        rows, said = rows_of(plan, strip, of_strip.states, of_strip.damaged, 1 / many)
        found.append((pictures.quicklook(plan, rows), said))
    return found


def _figures(plan: StripPlan, tiles: _Tiles) -> dict[str, Any]:
    """Of a strip, plain types."""
    near, far = sorted(abs(float(end) - plan.track) for end in (plan.y[0], plan.y[-1]))
    counts = {state: tiles.states.count(state) for state in _STATES}
    reasons: dict[tuple[str, str], list[int]] = {}
    for tile, (state, reason) in enumerate(zip(tiles.states, tiles.reasons, strict=True)):
        if reason or state == FAILED:
            reasons.setdefault((state, reason), []).append(tile)
    settings = plan.settings
    return {
        "name": plan.name, "line": plan.line, "side": plan.side, "tiles": plan.tiles, **counts,
        "share_done": counts[DONE] / max(plan.tiles, 1), "rows": int(plan.y.size), "columns": plan.columns,
        "pixel_along": plan.step, "pixel_across": float(np.mean(np.diff(plan.y))) if plan.y.size > 1 else 0.0,
        "near": near, "far": far, "length": plan.tiles * plan.columns * plan.step, "z": plan.z,
        "depth_map": plan.depth_map[0] if plan.depth_map else None, "tol": settings.tol, "method": settings.method,
        "backend": settings.backend, "nan": settings.nan, "window": settings.window, "methods": sorted(tiles.methods),
        "predicted_error": tiles.error, "terms": tiles.terms,
        "share_left_out": float(np.mean(tiles.left_out)) if tiles.left_out else None,
        "failures": [{"state": state, "reason": reason, "tiles": some} for (state, reason), some in reasons.items()],
        "notes": [{"note": note, "tiles": some} for note, some in tiles.notes.items()],
    }  # fmt: skip


def _html(
    values: Mapping[str, Any], report: SurveyReport, map_shown: bytes | None, shown: Sequence[tuple[bytes, str]] | None
) -> str:
    strips = values["strips"]
    title = f"Survey {os.path.basename(os.path.normpath(report.path))}"
    parts = [
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">{_MARK}<title>{_safe(title)}</title>',
        f'<meta http-equiv="Content-Security-Policy" content="{_safe(_POLICY)}">',
        f"<style>{_STYLE}</style></head><body>\n<h1>{_safe(title)}</h1>\n{_verdict(values)}",
        *_totals(values, report),
        "<h2>Coverage</h2>",
        _table(
            ("strip", "line", "side", "tiles", *_STATES, "done, %", "length, m", "terms", "not needed, %", "predicted error"),
            [
                (
                    s["name"], os.path.basename(s["line"]), s["side"], s["tiles"], *(s[state] for state in _STATES),
                    f"{100 * s['share_done']:.1f}", f"{s['length']:.4g}", f"{s['terms']:.3g}",
                    "" if s["share_left_out"] is None else f"{100 * s['share_left_out']:.3g}",
                    "" if s["predicted_error"] is None else f"{s['predicted_error']:.2g}",
                )
                for s in strips
            ],
        ),
        "<p>dark: no ping lights the tile; failed: its pings could not be imaged; damaged: its files are not what was written; "
        "missing: not made yet. Terms: those summed; others were not needed. Error: the largest of the planner's bounds.</p>",
    ]  # fmt: skip
    if map_shown is not None:
        parts.append(_image(map_shown, "coverage map", "map"))
    parts += ["<h2>Failures</h2>", *_failures(values)]
    parts.append("<h2>Quick-looks</h2>")
    if shown is None:
        parts.append("<p>No pictures: matplotlib is not installed: <code>pip install 'pysas-sonar[plot]'</code></p>")
    else:
        parts.append("<p>Mean power of boxes of pixels in dB; 0 m across is the mean track.</p>")
        for s, (content, said) in zip(strips, shown, strict=False):
            parts += [f"<h3>{_safe(s['name'])}</h3><p>{_safe(s['line'])}: {_safe(said)}</p>", _image(content, s["name"])]
        if len(shown) < len(strips):
            parts.append(f"<p>Of the first {len(shown)} strips; the other {len(strips) - len(shown)} have no picture here.</p>")
    notes = [(s["name"], note["note"], spans(note["tiles"])) for s in strips for note in s["notes"]]
    parts += ["<h2>Notes</h2>", _table(("strip", "note", "tiles"), notes[:_MOST_NOTES]) if notes else "<p>None.</p>"]
    if len(notes) > _MOST_NOTES:
        parts.append(f"<p>{len(notes) - _MOST_NOTES} more stand in the JSON beside this page.</p>")
    parts += ["<h2>Settings</h2>", _settings(strips), "</body></html>\n"]
    return "\n".join(parts)


def _verdict(values: Mapping[str, Any]) -> str:
    counts = {state: sum(s[state] for s in values["strips"]) for state in _STATES}
    bad = [f"{counts[state]} {state}" for state in _STATES[2:] if counts[state]]
    if not bad and values["complete"]:
        return f'<p class="good">Complete: all {values["tiles"]} tiles are there.</p>'
    return f'<p class="bad">Incomplete: {", ".join(bad) or "tiles of this run are not there"}, of {values["tiles"]} tiles.</p>'


def _totals(values: Mapping[str, Any], report: SurveyReport) -> Iterable[str]:
    seconds, made = values["seconds"], values["made"]
    engine = sum(one.seconds for one in report.made)
    share = made / max(values["tiles"], 1)
    predicted = values["predicted_seconds"]
    threads, memory = (values["plan"].get(name, math.nan) for name in ("threads", "memory"))
    rows = [
        ("store", values["store"]), ("pysas", values["version"]),
        ("tiles", f"{values['tiles']}: {made} made by this run, {values['before']} there before"),
        ("pixels of this run", f"{values['pixels']:.4g}"),
        ("terms of this run", f"{values['terms']:.4g}"),
        ("time of this run", f"{spoken(seconds)}, of which imaging {spoken(engine)}" if engine <= seconds
         else f"{spoken(seconds)}; imaging {spoken(engine)} of all processes together"),
        ("predicted", f"{spoken(predicted)} for all tiles on {threads:g} threads, reading and writing apart; "
         f"{memory / 1e6:.0f} MB a process"),
    ]  # fmt: skip
    if made and seconds and predicted:
        rows.append(
            ("measured / predicted", f"{seconds / (predicted * share):.2f}, for the {100 * share:.3g} % of tiles of this run")
        )
        rows.append(("speed", f"{values['pixels_per_second']:.3g} pixels/s, {values['terms'] / seconds:.3g} terms/s"))
    return "<h2>This run</h2>", _table((), rows)


def _failures(values: Mapping[str, Any]) -> Iterable[str]:
    """Of the store as it is, and what this run lost."""
    rows = [(s["name"], f["state"], spans(f["tiles"]), f["reason"]) for s in values["strips"] for f in s["failures"]]
    rows += [(lost["strip"], "lost", f"section {lost['section']}", lost["reason"]) for lost in values["lost"]]
    yield _table(("strip", "state", "tiles", "reason"), rows) if rows else "<p>None.</p>"


def _settings(strips: Sequence[Mapping[str, Any]]) -> str:
    """Strips of equal settings share a row."""
    rows: dict[tuple[str, ...], list[str]] = {}
    for s in strips:
        height = f"depth map {s['depth_map']}" if s["z"] is None else f"z = {s['z']:.6g}"
        row = (
            f"{s['tol']}", f"{s['method']} ({', '.join(s['methods'])})", f"{s['backend']}, nan={s['nan']}",
            "none" if s["window"] is None else f"{s['window']}",
            f"{s['pixel_along']:.4g} x {s['pixel_across']:.4g}", f"{s['near']:.4g} to {s['far']:.4g}", height,
        )  # fmt: skip
        rows.setdefault(row, []).append(s["name"])
    names = "strips", "tol", "method", "backend", "window", "pixel, m along x across", "swath, m", "seabed, m"
    return _table(names, [(", ".join(some), *row) for row, some in rows.items()])


def _table(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    head = f"<tr>{''.join(f'<th>{_safe(name)}</th>' for name in names)}</tr>\n" if names else ""
    body = "\n".join(f"<tr>{''.join(_cell(value) for value in row)}</tr>" for row in rows)
    return f"<table>\n{head}{body}\n</table>"


def _cell(value: Any) -> str:
    return f'<td class="n">{value}</td>' if isinstance(value, int) else f"<td>{_safe(value)}</td>"


def _safe(value: Any) -> str:
    return html.escape(str(value))


def _image(content: bytes, what: str, kind: str = "strip") -> str:
    return f'<img class="{kind}" alt="{_safe(what)}" src="data:image/png;base64,{base64.b64encode(content).decode()}">'
