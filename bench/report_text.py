"""What `bench.report` writes of its measurements: the Markdown and the figure."""

import re

import numpy as np

HEAD = """# Error against run time

Written by `python -m bench.report{flag}`{kind}: every method on the same echoes and pixels, its error beside its time.

![Error against run time, one panel a scene, with the Pareto front](error-vs-time.jpg)

Joined points of an engine are its `tol`, from 1e-1 to 1e-5. Of the error asked for, the engines' worst has {worst:.2f}.

{machine}. {threads} threads, complex64; interleaved runs after one that is not counted, at most three; the whole took
{seconds:.0f} s. What takes longer than a limit is stopped and named below its table.

- **s**: median of the whole call (least to most). Preparation and sum as the report of the image states them; what is left of
  the call is planning, and what a reference does not report is left empty.
- **terms/s**: traces x pixels of the image over the median, in 1e9, also of methods that sum no terms.
- **error**: relative L2, in the promise's norm, against `pysas.reference.exact` on the sampled pixels: the cuts through the
  target, 24 pixels either side, and {random} random ones among the points. **loss** (of the target's pixel, positive where it
  is weaker), **IRW** and **PSLR** (along x / y) stand against the exact sum's. Omega-k may choose a finer range axis: it is
  compared with the exact sum on its own pixels nearest to those.
- Omega-k and one-way migration have the weight of back-projection, no factor free. Range-Doppler and chirp scaling have no such
  weight: their images are multiplied by sqrt(range), then by one fitted complex factor (marked *).
- Range-Doppler, omega-k and one-way start from compressed echoes, as the engines do; chirp scaling from raw ones, which it
  compresses in its own time; they have the pulse's spectrum as a window, which a matched filter has and chirp scaling has not.
- The plain loop holds receivers still, so that moving ones are beyond it.
- **MB**: growth of the resident set in one run, in a forked process; memory freed before and used again does not count.
- **front**: no method here is both faster and closer (the Pareto front, drawn grey).
"""
MARKERS = {"numba": "s", "avx512": "o", "avx2": "^", "baseline": "v"}
OTHERS = {
    "omega-k": ("D", "tab:green"), "range-Doppler": ("P", "tab:purple"), "chirp scaling": ("X", "tab:brown"),
    "one-way": ("*", "tab:pink"), "fourier_image, nufft": ("h", "tab:olive"), "plain loop": ("p", "black"),
}  # fmt: skip


def front(rows):
    """Indices of the rows that no other beats in both time and error, the fastest first."""
    found, least = [], np.inf
    for index in sorted(range(len(rows)), key=lambda i: (rows[i]["seconds"], rows[i]["error"])):
        if rows[index]["error"] < least:
            least = rows[index]["error"]
            found.append(index)
    return found


def pair(values, form, scale=1.0):
    return " / ".join("-" if value is None else format(scale * value, form) for value in values)


def number(value, form):
    return "" if not value else format(value, form)


def line(row, best):
    share = f", {100 * row['share']:.0f} % factorised" if row["method"].startswith("ffbp") else ""
    cells = [
        row["method"],
        row["setting"] + share,
        f"{row['seconds']:.3g} " + (f"({row['least']:.3g} to {row['most']:.3g})" if row["runs"] > 1 else "(once)"),
        number(row["prepare"], ".3g"),
        number(row["sum"], ".3g"),
        f"{row['terms_per_second'] / 1e9:.3g}",
        f"{row['error']:.1e}" + ("*" if row["fitted"] else ""),
        f"{round(row['loss'], 2) + 0.0:.2f}",
        pair(row["irw"], ".2f", 100),
        pair(row["pslr"], ".1f"),
        number(row["memory"], ".0f"),
        "front" if best else "",
    ]
    return f"| {' | '.join(cells)} |"


def reasons(found):
    """What was said of methods, those of one reason together."""
    grouped = {}
    for name, reason in found.items():
        grouped.setdefault(re.sub(r"\s+", " ", reason), []).append(name)
    return "\n".join(f"- {'; '.join(names)}: {reason}" for reason, names in grouped.items())


def document(result):
    host = result["machine"]
    machine = (
        f"{host['model']}, {host['cores']} processors, load {host['load'][0]:.1f} at the start; pysas {host['pysas']} "
        f"({host['extension']}), Python {host['python']}, NumPy {host['numpy']}, SciPy {host['scipy']}, Numba {host['numba']}"
    )
    quick = result["quick"]
    asked = [row for scene in result["scenes"].values() for row in scene["rows"] if row["setting"].startswith("tol ")]
    worst = max(row["error"] / float(row["setting"].removeprefix("tol ")) for row in asked)
    kind = " (**the quick run**: small scenes and fewer settings)" if quick else ""
    text = [
        HEAD.format(
            flag=" --quick" if quick else "", kind=kind, machine=machine, threads=host["threads"], seconds=result["seconds"],
            random=200 if quick else 400, worst=worst,
        )
    ]  # fmt: skip
    for name, scene in result["scenes"].items():
        rows, best = scene["rows"], set(front(scene["rows"]))
        size = " x ".join(map(str, scene["grid"]))
        irw, pslr = pair(scene["exact"]["irw"], ".2f", 100), pair(scene["exact"]["pslr"], ".1f")
        text.append(
            f"## {name[0].upper()}{name[1:]}\n\n{scene['about']}; {scene['traces']} traces x {scene['samples']} samples, "
            f"{size} pixels. Exact sum: IRW {irw} cm, PSLR {pslr} dB.\n\n"
            "| method | setting | s | preparation | sum | 1e9 terms/s | error | loss, dB | IRW, cm | PSLR, dB | MB | |\n"
            f"|{'---|' * 12}\n" + "\n".join(line(row, i in best) for i, row in enumerate(rows)) + "\n"
        )
        if scene["left_out"]:
            text.append(f"Left out:\n\n{reasons(scene['left_out'])}\n")
        if scene["warned"]:
            text.append(f"Warned of:\n\n{reasons(scene['warned'])}\n")
    return "\n".join(text)


def style(method):
    """Marker, colour and line of a series."""
    if method in OTHERS:
        return (*OTHERS[method], "none")
    engine, kernel = method.split(", ")
    return MARKERS[kernel.split()[-1]], "tab:blue" if engine == "backproject" else "tab:red", "-"


def figure(path, result):
    """Error against time, log-log, a panel a scene; the front in grey."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator

    plot = Figure(figsize=(14, 9.6), layout="constrained")
    FigureCanvasAgg(plot)
    handles = {}
    for ax, (name, scene) in zip(plot.subplots(2, 3).flat, result["scenes"].items(), strict=True):
        rows = scene["rows"]
        best = [rows[i] for i in front(rows)]
        ax.plot([r["seconds"] for r in best], [r["error"] for r in best], color="0.8", lw=6, zorder=0, label="Pareto front")
        for method in dict.fromkeys(row["method"] for row in rows):
            marker, colour, joined = style(method)
            own = [row for row in rows if row["method"] == method]
            ax.plot(
                [r["seconds"] for r in own], [r["error"] for r in own], marker=marker, color=colour, ls=joined, lw=1, ms=6,
                mfc="none" if method.endswith(("numba", "baseline")) else colour, label=method,
            )  # fmt: skip
            if joined == "none" and len(own) > 1:
                for r in own:
                    ax.annotate(r["setting"], (r["seconds"], r["error"]), xytext=(4, 3), textcoords="offset points", fontsize=6)
        ax.set(xscale="log", yscale="log", xlabel="seconds", ylabel="relative L2 error", title=f"{name}, {scene['about']}")
        ax.xaxis.set_minor_locator(LogLocator(subs=(2, 5)))
        ax.xaxis.set_major_formatter("{x:g}")
        ax.xaxis.set_minor_formatter("{x:g}")
        ax.grid(alpha=0.3, which="both", lw=0.5)
        handles |= {text: handle for handle, text in zip(*ax.get_legend_handles_labels(), strict=True)}
    plot.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=5, fontsize=9)
    plot.savefig(path, dpi=80, pil_kwargs={"quality": 75, "optimize": True})
