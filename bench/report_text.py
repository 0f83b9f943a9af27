"""What `bench.report` writes about its tables."""

from pysas.comparison import table

HEAD = """# Error against run time

Written by `python -m bench.report{flag}`{kind}: every method on the same echoes and pixels, its error beside its time.

![Error against run time, one panel a scene, with the Pareto front](error-vs-time.jpg)

Joined points of an engine are its `tol`, from 1e-1 to 1e-5. Of the error asked for, the engines' worst has {worst:.2f}.

{machine}. {threads} threads, complex64; interleaved runs after one that is not counted, at most three; the whole took
{seconds:.0f} s. What takes longer than {limit:g} s is stopped and named below its table, as is what does not apply.{measured}

- **s**: median of the whole call (least to most). Preparation and sum as the report of the image states them; what is left of
  the call is planning, and what a reference does not report is left empty.
- **terms/s**: traces x pixels of the image over the median, in 1e9, also of methods that sum no terms.
- **error**: relative L2, in the promise's norm, against `pysas.reference.exact` on the sampled pixels: the cuts through the
  target, 24 pixels either side, and {random} random ones among the points (measured data: through the strongest pixel, and
  anywhere). **loss** (of the target's pixel, positive where it is weaker), **IRW** and **PSLR** (along x / y) stand against the
  exact sum's. Omega-k may choose a finer range axis (**pixels**): it is compared with the exact sum on its own pixels nearest
  to those.
- Omega-k and one-way migration have the weight of back-projection, no factor free. Range-Doppler and chirp scaling have no such
  weight: their images are multiplied by sqrt(range), then by one fitted complex factor (marked *).
- Range-Doppler, omega-k and one-way start from compressed echoes, as the engines do; chirp scaling from raw ones, which it
  compresses in its own time; they have the pulse's spectrum as a window, which a matched filter has and chirp scaling has not.
- `fourier_image` sums patches by non-uniform FFTs ("nufft": back-projection, to its `error`) or inverts them ("gridding",
  "frame", "ftcg"): an estimate of the reflectivity, scaled as the sum is but with another response, so that its error says how
  far it is from back-projection, not from the scene.
- The plain loop holds receivers still, so that moving ones are beyond it, as are records that start at different times.
- **MB**: growth of the resident set in one run, in a forked process; memory freed before and used again does not count.
- **front**: no method here is both faster and closer (the Pareto front, drawn grey).
"""


def worst(found):
    """The engines' largest error, as a share of the one asked for."""
    asked = [row for scene in found.values() for row in scene.rows if row.setting.startswith("tol ")]
    return max(row.error / float(row.setting.removeprefix("tol ")) for row in asked)


def document(found, about, host, seconds, quick, random, limit, measured):
    machine = (
        f"{host['model']}, {host['cores']} processors, load {host['load'][0]:.1f} at the start; pysas {host['pysas']} "
        f"({host['extension']}), Python {host['python']}, NumPy {host['numpy']}, SciPy {host['scipy']}, Numba {host['numba']}"
    )
    kind = " (**the quick run**: small scenes and fewer settings)" if quick else ""
    text = [
        HEAD.format(
            flag=" --quick" if quick else "", kind=kind, machine=machine, threads=host["threads"], seconds=seconds,
            random=random, worst=worst(found), limit=limit,
            measured="" if measured else "\nMeasured data (Gotcha) were not at hand: that scene is left out.",
        )
    ]  # fmt: skip
    for name, scene in found.items():
        size = " x ".join(map(str, scene.shape))
        text.append(
            f"## {name[0].upper()}{name[1:]}\n\n{about[name]}; {scene.traces} traces x {scene.samples} samples, "
            f"{size} pixels. {table(scene)}"
        )
    return "\n".join(text)
