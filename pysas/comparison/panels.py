"""A comparison as a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pysas import _checks
from pysas.comparison.rows import Comparison, Row, front

_ENGINES = ("backproject", "ffbp")
# marker and colour of what is not an engine
_STYLES = {
    "omega-k": ("D", "tab:green"), "range-Doppler": ("P", "tab:purple"), "chirp scaling": ("X", "tab:brown"),
    "one-way": ("*", "tab:pink"), "fourier_image, nufft": ("h", "tab:olive"), "fourier_image, gridding": ("<", "tab:cyan"),
    "fourier_image, frame": (">", "tab:orange"), "fourier_image, ftcg": ("d", "goldenrod"), "plain loop": ("p", "black"),
}  # fmt: skip
_KERNELS = {"numba": "s", "avx512": "o", "avx2": "^", "neon": "<", "baseline": "v"}


def figure(comparisons: Mapping[str, Comparison]) -> Any:
    """Error against run time, log-log: a panel a comparison, by title, the front in grey behind it.

    Parameters
    ----------
    comparisons : mapping of str to Comparison

    Returns
    -------
    matplotlib.figure.Figure
        Of no window: `savefig` writes it.

    Raises
    ------
    ImportError
        Without matplotlib.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise _checks.optional("matplotlib", "plot") from None
    columns = min(len(comparisons), 3)
    rows = -(-len(comparisons) // columns)
    size = (8.5, 7.5) if columns == 1 else (5.2 * columns, 4.6 * rows + 1.2)
    plot = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(plot)
    axes = plot.subplots(rows, columns, squeeze=False).ravel()
    handles: dict[str, Any] = {}
    for ax, (title, comparison) in zip(axes, comparisons.items(), strict=False):
        _draw(ax, comparison.rows, front(comparison.rows))
        ax.set_title(title, fontsize=10, parse_math=False)  # may be the name of a file
        handles |= {text: handle for handle, text in zip(*ax.get_legend_handles_labels(), strict=True)}
    for ax in axes[len(comparisons) :]:
        ax.remove()
    if len(axes) == len(comparisons):
        plot.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=3 if columns == 1 else 5)
    else:  # where panels are missing
        plot.legend(list(handles.values()), list(handles), loc="lower right", ncols=2)
    plot.draw_without_rendering()  # places, and so which labels would meet, are known from here
    for ax, comparison in zip(axes, comparisons.values(), strict=False):
        _name_settings(ax, comparison.rows)
    return plot


def _draw(ax: Any, rows: Sequence[Row], best: Sequence[int]) -> None:
    """Points of every method, those of an engine joined, over the front."""
    from matplotlib.ticker import LogLocator

    ax.plot([rows[i].seconds for i in best], [rows[i].error for i in best], color="0.85", lw=7, zorder=0, label="Pareto front")
    for method in dict.fromkeys(row.method for row in rows):
        own = [row for row in rows if row.method == method]
        engine = method.split(", ")[0] in _ENGINES
        if engine:
            marker = _KERNELS.get(method.split()[-1], "o")
            colour = "tab:blue" if method.startswith("backproject") else "tab:red"
        else:
            marker, colour = _STYLES.get(method, ("8", "tab:gray"))
        ax.plot(
            [r.seconds for r in own], [r.error for r in own], marker=marker, color=colour, ls="-" if engine else "none", lw=1,
            ms=7, mfc="none" if method.endswith(("numba", "baseline")) else colour, label=method,
        )  # fmt: skip
    ax.set(xscale="log", yscale="log", xlabel="seconds", ylabel="relative L2 error")
    ax.xaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    ax.xaxis.set_major_formatter("{x:g}")
    ax.xaxis.set_minor_formatter("{x:g}")
    ax.margins(x=0.12)
    ax.grid(alpha=0.3, which="both", lw=0.5)


def _name_settings(ax: Any, rows: Sequence[Row]) -> None:
    """Settings beside the points of methods that have several, where they meet the fewest labels, points and edges."""
    places = ax.transData.transform([(row.seconds, row.error) for row in rows])
    taken = [(x - 5, y - 5, x + 5, y + 5) for x, y in places]
    scale, frame = ax.figure.dpi / 72, ax.bbox
    for row, (x, y) in zip(rows, places, strict=True):
        if row.method.split(", ")[0] in _ENGINES or sum(other.method == row.method for other in rows) < 2:
            continue
        wide, high = 4.3 * scale * len(row.setting), 9 * scale
        spots = [(dx, dy) for dy in (-4, 6, -14, 16, -24, 26) for dx in (6, -6 - wide / scale)]
        boxes = [(x + dx * scale, y + dy * scale, x + dx * scale + wide, y + dy * scale + high) for dx, dy in spots]
        meets = [sum(a < right and b > left and c < top and d > low for a, c, b, d in taken) for left, low, right, top in boxes]
        meets = [n + (box[0] < frame.x0 or box[2] > frame.x1) for n, box in zip(meets, boxes, strict=True)]
        chosen = int(np.argmin(meets))
        taken.append(boxes[chosen])
        line = (
            {"arrowstyle": "-", "lw": 0.5, "color": "0.4", "shrinkA": 0.0} if chosen > 3 else None
        )  # it is far from its point
        ax.annotate(
            row.setting, (row.seconds, row.error), xytext=spots[chosen], textcoords="offset points", fontsize=8, arrowprops=line
        )
