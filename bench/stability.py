"""Stiff and extreme cases, measured: `python -m bench.stability` prints docs/stability.md.

Errors are against `pysas.reference.exact` on sampled pixels of random band-limited echoes, relative to the promise's norm.
"""

import re
import warnings

import numpy as np

import pysas
from bench.document import parser, write
from pysas import circular

C, FS, BAND = 1500.0, 40e3, 30e3
HEAD = """# Stiff and extreme cases

Written by `python -m bench.stability --write docs/stability.md`; each row is asserted by the tests it names. Errors are
relative L2 against `pysas.reference.exact`, of back-projection unless said otherwise, beside the `tol` asked for.

| case | measured | limit found | what the user sees there | test |
|---|---|---|---|---|
"""


def track(x, y=0.0, z=5.0):
    x = np.asarray(x, dtype=float)
    return np.stack([x, np.full(x.size, y), np.full(x.size, z)], axis=1)


LINE = track((np.arange(64) - 32) * 0.03)


def survey(tx, near, samples=900, fc=100e3, rx=None, dtype=np.complex128):
    """Random echoes whose spectrum fills the band."""
    rng = np.random.default_rng(0)
    keep = np.abs(np.fft.fftfreq(4 * samples)) <= BAND / 2 / FS
    spectrum = rng.standard_normal((len(tx), 1, keep.size)) + 1j * rng.standard_normal((len(tx), 1, keep.size))
    data = np.fft.ifft(spectrum * keep)[..., :samples].astype(dtype)
    rx = tx[:, None] if rx is None else rx
    return pysas.Echoes(data, fs=FS, fc=fc, tx=tx, rx=rx, c=C, t0=2 * near / C, bandwidth=BAND)


def plane(near=20.0, step=0.02, shape=(48, 64), x=0.0):
    return pysas.Grid.plane(x + (np.arange(shape[1]) - shape[1] // 2) * step, near + np.arange(shape[0]) * step)


def error(echoes, grid, tol, method="backprojection"):
    pixels = np.random.default_rng(1).choice(grid.size, min(grid.size, 200), replace=False)
    exact, level = pysas.reference.exact(echoes, grid, pixels)
    image = pysas.plan(echoes, grid, tol, method)(echoes.data)
    return float(pysas.metrics.relative_error(image.data.ravel()[pixels], exact, level))


def said(call):
    """The message of the error that a call ends with."""
    try:
        call()
    except ValueError as found:
        return "`" + re.sub(r"\s+", " ", str(found)) + "`"
    raise AssertionError("no error where one was expected")


def worst(cases):
    """`1.2e-04 at tol 1e-03` of several (echoes, grid), the worst of each tol."""
    return ", ".join(f"{max(error(e, g, tol) for e, g in cases):.1e} at tol {tol:.0e}" for tol in (1e-3, 1e-9))


def range_over_wavelength():
    def far(ratio, dtype):
        away = ratio * C / 1e6
        return survey(track((np.arange(64) - 32) * 0.3, z=50.0), away - 5, fc=1e6, dtype=dtype), plane(away, shape=(64, 96))

    at = far(7e6, np.complex64)
    double = error(*far(7e6, complex), 7.01e-8)
    measured = (
        f"7e6: {error(*at, 1e-3):.1e} at tol 1e-3, {error(*at, 1e-5):.1e} at 1e-5, complex128 {double:.1e} at 7e-8; "
        f"ffbp {error(*at, 1e-3, 'ffbp'):.1e} at 1e-3"
    )
    beyond = far(1e10, np.complex64)
    limit = "least tol 1e-14 range/wavelength; trees to 1e9 wavelengths, the direct sum beyond"
    return measured, limit, said(lambda: pysas.backproject(*beyond, 1e-5))


def map_offsets():
    def moved(off):
        away = np.array([off, off / 10, 0.0])
        grid = pysas.Grid.plane(off + np.arange(70) * 0.02, off / 10 + 20 + np.arange(40) * 0.02)
        return survey(LINE + away, 18.0), grid

    measured = f"5e6 m: {worst([moved(5e6)])}; 1e12 m: {worst([moved(1e12)])}"
    limit = "none of the sum; the coordinates' own rounding: 1e-9 m at 5e6 m, 2e-6 m at 1e10 m"
    return measured, limit, "nothing; exact delays per pixel where rounded lines are not even enough for tol"


def places():
    tx = track(np.arange(64) * 0.05, z=0.0)
    echoes = survey(tx, 0.0, 400)
    grids = [pysas.Grid.plane(np.arange(64) * 0.05, y) for y in ([-0.5, 0.0, 0.5], [-4.0, -3.99], [1e-3, 0.1])]
    return worst([(echoes, grid) for grid in grids]), "none", "ffbp sums these pixels directly: `report.factorised_share`"


def tracks():
    rng = np.random.default_rng(3)
    cases = {
        "gap": np.r_[np.arange(40) * 0.03, 4 + np.arange(30) * 0.03],
        "reversal": np.r_[np.arange(40) * 0.03, 1.2 - np.arange(40) * 0.031],
        "repeats": np.repeat(np.arange(30) * 0.04, 3),
        "one ping": np.zeros(1),
        "prime number": np.arange(67) * 0.03,
        "uneven": np.sort(rng.uniform(-1, 1, 80)),
    }
    found = worst([(survey(track(x), 18.0), plane()) for x in cases.values()])
    return f"{found} (worst of {', '.join(cases)})", "none", "nothing; `pysas check` warns of gaps and repeats"


def baselines():
    def apart(length):
        near = (15 + np.hypot(length, 20) - 3) / 2
        return survey(LINE, near, rx=LINE[:, None] + np.array([length, 3.0, 1.0])), plane()

    measured = f"2 x the range: {worst([apart(40.0)])}; 2000 x: {error(*apart(4e4), 1e-3):.1e} at tol 1e-3"
    return measured, "1e-14 range/wavelength, as above", said(lambda: pysas.backproject(*apart(4e4), 1e-9))


def pixels():
    found = [f"{step:.0e} m: {worst([(survey(LINE, 18.0), plane(step=step, shape=(20, 41)))])}" for step in (1e-9, 1e-6, 0.5)]
    return "; ".join(found), "none", "coarse pixels: exact delays per pixel, so a term takes longer; trees give way to the sum"


def low_quality():
    found = [f"Q {fc / BAND:.2g}: {worst([(survey(LINE, 18.0, fc=fc), plane())])}" for fc in (18e3, 600.0)]
    narrow = circular.PointSpread(pysas.LFM(100e3, 100e3, 10e-6, "gaussian", 2e-6), C)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        narrow.approximate(0.01)
    refused = said(lambda: pysas.reference.omega_k(survey(LINE, 18.0, fc=600.0), threads=1))
    return "; ".join(found), "none of the sum; Fourier algorithms need fs < 2 fc", f"{refused}; PSF: `{seen[0].message}`"


def bessel():
    tone = circular.PointSpread(pysas.LFM(1e6, 1.0, 1.0, "gaussian", 0.2), C)
    sharp = circular.PointSpread(pysas.LFM(1e6, 1e3, 50e-3, "gaussian", 1.9e-3), C)
    j0 = abs(tone.exact(250.0) / tone.approximate(250.0) - 1)
    i0 = abs(circular.energy(sharp) / circular.asymptotic_energy(sharp) - 1)
    large = circular.PointSpread(pysas.LFM(1e6, 40.0, 0.25, "gaussian", 1e-2), C)
    broken = "nan" if np.isnan(circular.energy(large)) else "a number"
    z = [(2 * psf.k * psf.gaussian_width) ** 2 for psf in (sharp, large)]
    measured = f"k r {tone.k * 250:.2g}: Eq 19 to Eq 21 {j0:.1e}; b² a0² {z[0]:.1e}: energy to its asymptote {i0:.1e}"
    limit = f"b² a0² above about 1e9 ({broken} at {z[1]:.1e}); k r: none to 1e8 ({abs(tone.exact(2.5e4)):.0e} where 0 is exact)"
    return measured, limit, "nan; `asymptotic_energy` holds there"


def circle_offset():
    angle = np.linspace(-np.pi, np.pi, 2001)
    a = 1 - 1e-12
    view = circular.view_angle(angle, a)
    back = np.abs(circular.track_angle(view, a) - angle).max()
    product = np.abs(circular.view_rate(angle, a) * circular.view_density(view, a) - 1).max()
    return (
        f"a = 1 - 1e-12: round trip {back:.1e} rad, rate x density - 1 {product:.1e}",
        "a = 1",
        said(lambda: circular.view_angle(0.1, 1.0)),
    )


def fourier():
    raw = pysas.Echoes(
        survey(track((np.arange(128) - 64) * 0.006, z=0.0), 20.0, fc=30e3).data, fs=30e3, fc=30e3,
        tx=track((np.arange(128) - 64) * 0.006, z=0.0), rx=track((np.arange(128) - 64) * 0.006, z=0.0)[:, None], c=C,
        t0=2 * 20 / C, pulse=pysas.LFM(30e3, 20e3, 4e-3), compressed=False,
    )  # fmt: skip
    wide = raw.replace(tx=raw.tx * 0.055 / 0.006, rx=raw.rx * 0.055 / 0.006, t0=2 * 75 / C)
    window = np.kaiser(128, 20)[:, None, None]  # its main lobe ends before the propagating waves

    def largest(turn):
        data = window * turn ** np.arange(128)[:, None, None] * raw.data[:1]
        return np.abs(pysas.reference.omega_k(raw.replace(data=data), threads=1).data).max()

    leak = largest(-1.0) / largest(1.0)
    edge = said(lambda: pysas.reference.chirp_scaling(raw, threads=1))
    zero = said(lambda: pysas.reference.chirp_scaling(wide, threads=1))
    return (
        f"omega-k: waves beyond 2k leave {leak:.1e} of what others do",
        "chirp scaling and range-Doppler: k_u below 0.999 x 2k, ranges short of the zero of the secondary rate",
        f"{edge}; {zero}",
    )


def one_way():
    """Random echoes marched over 0.2 m in steps of 1e-3 to 10 spacings, and through contrasts of sound speed."""
    rng = np.random.default_rng(0)
    u = np.arange(-32, 32) * 0.01
    tx = np.stack([u, 0 * u, 0 * u], axis=1)
    taper = np.hanning(64)[:, None] * np.hanning(60)
    spectrum = np.fft.fft(taper * (rng.standard_normal((64, 60)) + 1j * rng.standard_normal((64, 60))))
    data = np.fft.ifft(spectrum * (np.abs(np.fft.fftfreq(60, 1 / 20e3)) < 7e3))
    echoes = pysas.Echoes(data, fs=20e3, fc=100e3, tx=tx, rx=tx, c=C, t0=2 / C, bandwidth=14e3)
    grid = pysas.Grid.plane(u, [1.5, 1.6, 1.7])
    level = np.sqrt(np.sum(np.abs(data) ** 2))

    def size(**options):
        image = pysas.reference.one_way(echoes, grid, half_angle=0.1, threads=1, **options).data
        return float(np.abs(image).max() / level)

    marched = [size(step=ratio * 0.01) for ratio in (1e-3, 1e-1, 1.0, 10.0)]
    layered = [size(layers=[(0.0, C), (1.55, C * contrast)]) for contrast in (0.1, 10.0)]
    measured = (
        f"dz/dx 1e-3 to 10: largest value {min(marched):.3f} to {max(marched):.3f} of the record's norm; "
        f"contrasts of 10 : 1 down and up {layered[0]:.3f}, {layered[1]:.3f}"
    )
    far = echoes.replace(tx=5 * tx, rx=5 * echoes.rx)
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        pysas.reference.one_way(far, pysas.Grid.plane(5 * u, [1.5]), half_angle=0.3, threads=1)
    return measured, "none of the march; the spacing of pings: pi/k_x", f"`{seen[0].message}`"


def frames():
    points = pysas.reference.rasters.jittered(21, 1, 0.2)[:, 0]
    found = []
    for gap in (1e-6, 1e-13, 0.0):
        points[11] = points[10] + gap
        frame = pysas.reference.Frame(points, 10, pysas.reference.Gaussian())
        solution = frame.solve(frame.sampling @ np.ones(21))
        found.append(f"gap {gap:g}: condition {frame.condition:.1e}, rank {frame.rank} of 21, residual {solution.residual:.1e}")
        ill = solution.ill_posed
    limit = "singular values below 21 eps of the largest are dropped"
    return "; ".join(found), limit, f"`solution.ill_posed` is {ill}; the solution of least norm"


ROWS = (
    (
        "range/wavelength to 7e6",
        range_over_wavelength,
        (
            "test_range_over_wavelength",
            "test_beyond_1e9_wavelengths_tol_is_refused_and_trees_are_not_grown",
            "test_stiff_ratios",
        ),
    ),
    (
        "map offsets of 5e6 m",
        map_offsets,
        (
            "test_utm_offset_of_5e6_m_loses_nothing",
            "test_coordinates_of_a_map_projection",
        ),
    ),
    (
        "pixels on the transducer, on the track, behind it",
        places,
        (
            "test_pixels_on_the_track_on_the_transducer_and_behind",
            "test_any_place_of_the_image",
        ),
    ),
    (
        "gaps, reversals, repeats, one ping, a prime number",
        tracks,
        (
            "test_gaps_repeats_reversals_and_wide_baselines",
            "test_tracks_that_break_the_toy",
            "test_odd_sizes",
        ),
    ),
    (
        "baselines longer than the range",
        baselines,
        (
            "test_baselines_longer_than_the_range",
            "test_gaps_repeats_reversals_and_wide_baselines",
        ),
    ),
    (
        "pixels far finer and coarser than the resolution",
        pixels,
        (
            "test_pixels_far_finer_and_far_coarser_than_the_resolution",
            "test_coarse_pixels_do_not_round_tol_away",
        ),
    ),
    (
        "Q below 2",
        low_quality,
        (
            "test_quality_below_2",
            "test_stiff_ratios",
            "test_low_quality_warns_and_the_exact_form_does_not",
        ),
    ),
    (
        "J0 and I0 arguments to 1e6",
        bessel,
        (
            "test_huge_arguments",
            "test_exact_where_k_r_is_a_million",
        ),
    ),
    (
        "off-centre fraction a -> 1 on a circle",
        circle_offset,
        (
            "test_no_digits_are_lost",
            "test_a_point_all_but_on_the_track",
        ),
    ),
    (
        "evanescent edge; secondary rate through zero",
        fourier,
        (
            "test_nothing_that_cannot_propagate_is_imaged",
            "test_the_evanescent_edge_is_refused_where_migration_is_unbounded",
            "test_a_vanishing_secondary_rate_names_its_range",
        ),
    ),
    (
        "one-way marching: dz/dx, layer contrasts",
        one_way,
        (
            "test_energy_never_grows_beyond_what_enters",
            "test_base_band_keeps_energy",
            "test_layers_against_delays_by_snells_law",
            "test_pings_too_far_apart_are_said",
        ),
    ),
    (
        "frames: condition to 1e16, coincident samples",
        frames,
        (
            "test_condition_numbers_up_to_the_inverse_of_eps",
            "test_duplicated_samples_change_nothing",
        ),
    ),
)


def main():
    args = parser(__doc__).parse_args()
    lines = [f"| {case} | {' | '.join(measure())} | {', '.join(tests)} |" for case, measure, tests in ROWS]
    write(HEAD + "\n".join(lines) + "\n", args.write)


if __name__ == "__main__":
    main()
