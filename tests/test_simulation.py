"""The simulator against the pulse's own waveform, the closed-form delay, and quadrature; noise, threads, memory, errors."""

from __future__ import annotations

import math
import threading
import tracemalloc
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from pysas.model.beam import Beam
from pysas.model.pulse import LFM
from pysas.signal.echoing import delays
from pysas.signal.simulation import AliasingWarning, Element, _aliased, simulate

pytestmark = pytest.mark.reference  # no engine takes part

FloatArray = npt.NDArray[np.float64]
Complex = npt.NDArray[np.complex128]

FS, C = 60e3, 1480.0
PULSES = {
    "rect": LFM(100e3, 30e3, 2e-3),
    "down": LFM(100e3, -30e3, 2e-3),
    "gaussian": LFM(100e3, 30e3, 2e-3, "gaussian", 2e-4),
    "tukey": LFM(100e3, 30e3, 2e-3, "tukey", 0.3),
    "tukey 0": LFM(100e3, 30e3, 2e-3, "tukey", 0.0),
    "taylor": LFM(100e3, 30e3, 2e-3, "taylor", 30.0),
}
ALIASED = pytest.mark.filterwarnings("ignore::pysas.signal.simulation.AliasingWarning")
TRACE: dict[str, Any] = {"fs": FS, "duration": 0.02, "c": C, "t0": 0.03}


def survey(n_ping: int = 3, n_channel: int = 2) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Transmitters, receivers and receiver velocities of a short uneven track."""
    rng = np.random.default_rng(7)
    tx = rng.normal(0.0, 0.3, (n_ping, 3)) + [0.0, 0.0, 8.0]
    rx = tx[:, None, :] + rng.normal(0.0, 0.5, (n_ping, n_channel, 3))
    return tx, rx, rng.normal(0.0, 2.0, (n_ping, n_channel, 3))


def closed_form(point: FloatArray, tx: FloatArray, rx: FloatArray, v: FloatArray, c: float) -> FloatArray:
    """Positive root of (c^2 - v^2) tau^2 - 2 (c D1 - d.v) tau + D1^2 - d^2 = 0, in long double."""
    x, speed = np.asarray(point, dtype=np.longdouble), np.asarray(v, dtype=np.longdouble)
    d1 = np.sqrt(np.sum((x - tx) ** 2, axis=-1))
    d = x - rx
    a = c**2 - np.sum(speed**2, axis=-1)
    b = c * d1 - np.sum(d * speed, axis=-1)
    return np.asarray((b + np.sqrt(b**2 - a * (d1**2 - np.sum(d**2, axis=-1)))) / a, dtype=np.float64)


def direct(
    points: FloatArray, amplitudes: Any, pulse: LFM, tx: FloatArray, rx: FloatArray, v: FloatArray, n: int, fc: float
) -> Complex:
    """The formula of a record in plain NumPy, (ping, channel, n)."""
    t = TRACE["t0"] + np.arange(n) / FS
    out = np.zeros((*rx.shape[:2], n), dtype=np.complex128)
    for point, amplitude in zip(points, amplitudes, strict=True):
        tau = closed_form(point, tx[:, None], rx, v, C)[..., None]
        out += amplitude * pulse.waveform(t - tau, fc) * np.exp(-2j * np.pi * fc * tau)
    return out


@pytest.mark.parametrize("speed", [0.0, 3.0, 100.0])
def test_delay_is_the_root_of_the_quadratic(speed: float) -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-300.0, 300.0, (1000, 3)) + [0.0, 400.0, 0.0]
    tx, rx, direction = rng.normal(0.0, 1.0, (3, 3))
    v = speed * direction / np.linalg.norm(direction)
    np.testing.assert_allclose(delays(points, tx, rx, v, C), closed_form(points, tx, rx, v, C), rtol=0, atol=1e-14)


@ALIASED
@pytest.mark.parametrize("name", PULSES)
@pytest.mark.parametrize("fc", [100e3, 97e3])
def test_samples_are_the_pulse_s(name: str, fc: float) -> None:
    pulse, (tx, rx, v) = PULSES[name], survey()
    points = np.array([[1.0, 30.0, 0.0], [-2.0, 29.0, 0.5], [0.5, 20.0, 0.0]])  # the last one's leading edge is cut
    amplitudes = np.array([1.0, -0.3 + 0.8j, 2.0])
    echoes = simulate(points, amplitudes, pulse, tx=tx, rx=rx, velocity=v, fc=fc, dtype=np.complex128, **TRACE)
    assert echoes.data.shape == (3, 2, 1200) and not echoes.compressed and echoes.pulse is pulse and echoes.fc == fc
    expected = direct(points, amplitudes, pulse, tx, rx, v, 1200, fc)
    # 1e-10: 2 pi fc tau at 4000 turns in float64
    np.testing.assert_allclose(echoes.data, expected, rtol=0, atol=1e-10)
    assert np.abs(expected[..., 0]).max() > 0.01
    single = simulate(points, amplitudes, pulse, tx=tx, rx=rx, velocity=v, fc=fc, **TRACE)
    np.testing.assert_array_equal(single.data, echoes.data.astype(np.complex64))


@ALIASED
def test_phase_recurrence_stays_below_1e_12() -> None:
    """A pulse of 3000 samples at no range, against the quadratic phase in long double."""
    pulse, fs = LFM(100e3, 30e3, 75e-3), 40e3
    echo = simulate(
        np.zeros((1, 3)), [1.0], pulse, tx=np.zeros((1, 3)), rx=np.zeros((1, 3)), fs=fs, duration=0.08, dtype=np.complex128
    ).data[0]
    u = np.arange(3001, dtype=np.longdouble) / fs - np.longdouble(pulse.duration) / 2
    turns = np.longdouble(pulse.rate) * u**2 / 2
    angle = 2 * np.pi * (turns - np.rint(turns)).astype(np.float64)
    expected = np.exp(1j * angle)
    assert np.abs(echo[:3001] - expected).max() < 1e-12
    assert not echo[3001:].any()


@ALIASED
def test_stop_and_hop_single_receiver_and_start_times() -> None:
    tx, rx, _ = survey(3, 1)
    points, t0 = np.array([[1.0, 30.0, 0.0]]), np.array([0.03, 0.031, 0.029])
    common: dict[str, Any] = TRACE | {"t0": t0, "dtype": np.complex128}
    three = simulate(points, [1.0], PULSES["rect"], tx=tx, rx=rx, **common)
    two = simulate(points, [1.0], PULSES["rect"], tx=tx, rx=rx[:, 0], ping_time=[0, 1, 2], attrs={"title": "x"}, **common)
    np.testing.assert_array_equal(three.data[:, 0], two.data)
    assert two.attrs == {"title": "x"} and two.ping_time is not None
    tau = (np.linalg.norm(points - tx, axis=1) + np.linalg.norm(points - rx[:, 0], axis=1)) / C
    expected = PULSES["rect"].waveform(t0[:, None] + np.arange(1200) / FS - tau[:, None])
    np.testing.assert_allclose(two.data, expected * np.exp(-2j * np.pi * 100e3 * tau)[:, None], rtol=0, atol=1e-10)


@ALIASED
def test_spreading() -> None:
    tx, rx, v = survey()
    point = np.array([[1.0, 30.0, 0.0]])
    common: dict[str, Any] = TRACE | {"tx": tx, "rx": rx, "velocity": v, "dtype": np.complex128}
    plain = simulate(point, [1.0], PULSES["rect"], **common).data
    spread = simulate(point, [1.0], PULSES["rect"], spreading=True, **common).data
    tau = closed_form(point[0], tx[:, None], rx, v, C)
    there = np.linalg.norm(point[0] - tx, axis=1)[:, None]
    back = np.linalg.norm(point[0] - rx - v * tau[..., None], axis=2)
    np.testing.assert_allclose(spread, plain / (there * back)[..., None], rtol=1e-12)


def aimed(sine: float, element: Element, pulse: LFM, plane: str = "along", **changes: Any) -> float:
    """Largest sample from a point whose direction has the given sine with the boresight, in one plane of the element."""
    cosine = np.sqrt(1 - sine**2)
    point = 20.0 * np.array([[sine, cosine, 0.0] if plane == "along" else [0.0, cosine, sine]])
    origin = np.zeros((1, 3))
    data = simulate(point, [1.0], pulse, tx=origin, rx=origin, fs=20e3, duration=0.05, tx_element=element, **changes).data
    return float(np.abs(data).max())


def test_element_pattern_of_a_narrow_band() -> None:
    """Null at sin = c/(f length), and sinc(1/2) = 2/pi half way; 5 Hz of 100 kHz move the null by 5e-5."""
    pulse = LFM(100e3, 10.0, 10e-3, "gaussian", 1e-3)
    element = Element(0.1, 0.05)
    null = 1500.0 / (100e3 * 0.1)
    assert aimed(0.0, element, pulse) == pytest.approx(1.0, abs=1e-2)
    peak = aimed(0.0, element, pulse)
    assert aimed(null, element, pulse) < 2e-4
    assert aimed(null / 2, element, pulse) / peak == pytest.approx(2 / np.pi, abs=2e-3)
    assert aimed(null, element, pulse, "up") / peak == pytest.approx(2 / np.pi, abs=2e-3)
    assert aimed(2 * null, element, pulse, "up") < 2e-4
    assert aimed(null / 2, element, pulse, rx_element=element) / peak == pytest.approx((2 / np.pi) ** 2, abs=2e-3)
    assert aimed(0.0, Element(0.1, boresight=(0.0, -1.0, 0.0)), pulse) == 0.0
    assert aimed(0.3, Element(0.0), pulse) == pytest.approx(peak, rel=1e-2)


@ALIASED
def test_element_pattern_follows_the_instantaneous_frequency() -> None:
    """Elements turned ping by ping, receivers moving: the formula in plain NumPy."""
    pulse, (tx, rx, v) = PULSES["tukey"], survey()
    point, amplitude = np.array([2.0, 30.0, 1.0]), 1.5
    angle = np.array([-0.1, 0.05, 0.2])
    along = np.stack([np.cos(angle), np.sin(angle), np.zeros(3)], axis=1)
    boresight = np.stack([-np.sin(angle), np.cos(angle), np.zeros(3)], axis=1)
    near, far = Element(0.06, 0.02, 3.0 * boresight, along), Element(0.1)
    echoes = simulate(
        point[None], [amplitude], pulse, tx=tx, rx=rx, velocity=v, tx_element=near, rx_element=far, dtype=np.complex128, **TRACE
    )
    tau = closed_form(point, tx[:, None], rx, v, C)[..., None]
    out = (point - tx) / np.linalg.norm(point - tx, axis=1, keepdims=True)
    back = point - rx - v * tau
    back /= np.linalg.norm(back, axis=2, keepdims=True)
    f = pulse.fc + pulse.rate * (TRACE["t0"] + np.arange(1200) / FS - tau - pulse.duration / 2)
    gain = np.sinc(f * 0.06 * np.sum(out * along, axis=1)[:, None, None] / C)
    gain = gain * np.sinc(f * 0.02 * out[:, 2, None, None] / C) * np.sinc(f * 0.1 * back[..., 0, None] / C)
    expected = gain * direct(point[None], [amplitude], pulse, tx, rx, v, 1200, pulse.fc)
    np.testing.assert_allclose(echoes.data, expected, rtol=0, atol=1e-10)
    assert np.ptp(np.abs(expected[0, 0][np.abs(expected[0, 0]) > 0.3])) > 0.05


BEAMS = {
    "fan": Beam([0.1, 1, -0.3], 0.1, 0.5),
    "fan, taper": Beam([0.1, 1, -0.3], 0.1, 0.9, taper=0.4),
    "all taper": Beam([0.1, 1, -0.3], 0.1, np.pi / 2, taper=1.0),
    "axis askew, boresight of the ping": Beam(
        [[0, 1, 0], [0.1, 1, 0], [0, 1, -0.1]], 0.1, 0.8, "fan", 0.5, [[1, 0.4, 0.3], [1, 0.5, 0.2], [0.9, 0.4, 0]]
    ),
    "straight down": Beam([0, 0, -2], 0.1, 0.7, taper=0.5, axis=[0, 1, 0]),
    "cone": Beam([0.1, 1, -0.3], 0.1, 0.8, "cone"),
    "cone, taper": Beam([0.1, 1, -0.3], 0.1, 1.2, "cone", 0.7),
    "cone beyond a right angle": Beam([0, 0, 1], 0.1, 2.6, "cone", 0.5),
}


def lobe(beam: Beam, direction: FloatArray, ping: int) -> float:
    """The docstring's weight in plain trigonometry: alpha from the cosines of angles with axis and boresight."""

    def cosine(vector: Any) -> float:
        one = np.broadcast_to(np.asarray(vector, dtype=float), (3, 3))[ping]
        return float(direction @ one / np.linalg.norm(direction) / np.linalg.norm(one))

    if beam.shape == "cone":
        alpha = math.acos(cosine(beam.boresight))
    else:
        axis = np.cross(beam.boresight, [0, 0, 1]) if beam.axis is None else beam.axis
        alpha = abs(math.pi / 2 - math.acos(cosine(axis)))
        if cosine(beam.boresight) < 0:
            return 0.0
    if alpha > beam.half_angle:
        return 0.0
    full = (1 - beam.taper) * beam.half_angle
    return 1.0 if alpha <= full else math.cos(math.pi / 2 * (alpha - full) / (beam.taper * beam.half_angle)) ** 2


@ALIASED
@pytest.mark.parametrize("name", BEAMS)
def test_a_beam_weighs_every_points_echoes(name: str) -> None:
    beam, (tx, rx, v) = BEAMS[name], survey()
    rng = np.random.default_rng(11)
    seen = []
    for _ in range(24):
        away = rng.standard_normal(3)
        point = tx.mean(axis=0) + 28.0 * away / np.linalg.norm(away)
        common: dict[str, Any] = {"tx": tx, "rx": rx, "velocity": v, "dtype": np.complex128} | TRACE
        plain = simulate(point[None], [1.0], PULSES["tukey"], **common)
        echoes = simulate(point[None], [1.0], PULSES["tukey"], beam=beam, **common)
        assert echoes.beam is beam and plain.beam is None and np.any(plain.data, axis=-1).all()
        weights = np.array([lobe(beam, point - tx[ping], ping) for ping in range(3)])
        np.testing.assert_allclose(echoes.data, weights[:, None, None] * plain.data, rtol=0, atol=1e-12)
        seen += list(weights)
    assert min(seen) == 0 < max(seen)
    assert (beam.taper == 0) == (not any(0 < weight < 1 for weight in seen))


@ALIASED
def test_beam_and_elements_multiply() -> None:
    """A point on the edge of a hard beam counts, as in an image; one on the transmitter weighs 1."""
    tx, rx, v = survey()
    element, beam = Element(0.05), BEAMS["fan, taper"]
    points = np.array([[3.0, 25.0, 0.0]])
    common: dict[str, Any] = {"tx": tx, "rx": rx, "velocity": v, "dtype": np.complex128} | TRACE
    both = simulate(points, [1.0], PULSES["rect"], beam=beam, tx_element=element, **common)
    one = simulate(points, [1.0], PULSES["rect"], tx_element=element, **common)
    weights = np.array([lobe(beam, points[0] - place, ping) for ping, place in enumerate(tx)])
    np.testing.assert_allclose(both.data, weights[:, None, None] * one.data, rtol=0, atol=1e-12)
    place = np.zeros((1, 3))
    edges = np.array([[np.sin(a), np.cos(a), 0.0] for a in (0.3, 0.3 + 5e-8, 0.3 + 2e-7)]) * 20
    for shape in ("fan", "cone"):
        hard = Beam([0, 1, 0], 0.1, 0.3, shape)
        lit = [simulate(p[None], [1], PULSES["rect"], tx=place, rx=place, fs=FS, duration=0.05, beam=hard) for p in edges]
        assert [bool(np.any(echoes.data)) for echoes in lit] == [True, True, False]
        soft = Beam([0, 1, 0], 0.1, 0.3, shape, 1.0)
        near = simulate(place, [1], PULSES["rect"], tx=place, rx=place + 1, fs=FS, duration=0.05, beam=soft)
        plain = simulate(place, [1], PULSES["rect"], tx=place, rx=place + 1, fs=FS, duration=0.05)
        np.testing.assert_array_equal(near.data, plain.data)


@ALIASED
def test_noise_level() -> None:
    tx, rx, _ = survey(20, 2)
    common: dict[str, Any] = TRACE | {"tx": tx, "rx": rx, "dtype": np.complex128}
    points = np.array([[1.0, 30.0, 0.0]])
    clean = simulate(points, [3.0], PULSES["rect"], **common).data
    noisy = simulate(points, [3.0], PULSES["rect"], snr_db=6.0, seed=1, **common).data
    noise = noisy - clean
    variance = np.mean(np.abs(clean) ** 2) * 10**-0.6
    # 48000 samples: 0.5 % of scatter
    assert np.mean(np.abs(noise) ** 2) == pytest.approx(variance, rel=0.02)
    assert np.mean(noise.real**2) == pytest.approx(variance / 2, rel=0.03)
    assert abs(np.mean(noise.real * noise.imag)) < 0.02 * variance
    assert abs(np.mean(noise[..., 1:] * noise[..., :-1].conj())) < 0.02 * variance
    across = noise.reshape(40, -1) @ noise.reshape(40, -1).conj().T / noise.shape[-1]
    assert np.abs(across - np.diag(np.diag(across))).max() < 0.15 * variance  # traces are independent


@ALIASED
def test_same_bits_for_any_number_of_threads() -> None:
    rng = np.random.default_rng(2)
    tx, rx, v = survey(7, 3)
    points = rng.uniform(-5.0, 5.0, (200, 3)) + [0.0, 30.0, 0.0]
    common: dict[str, Any] = TRACE | {"tx": tx, "rx": rx, "velocity": v, "snr_db": 20.0}
    one, *others = (simulate(points, np.ones(200), PULSES["taylor"], seed=4, threads=n, **common).data for n in (1, 2, 3))
    for other in others:
        np.testing.assert_array_equal(one, other)
    assert np.any(one != simulate(points, np.ones(200), PULSES["taylor"], seed=5, **common).data)


@ALIASED
def test_chunks_and_blocks_do_not_change_the_result(monkeypatch: pytest.MonkeyPatch) -> None:
    tx, rx, v = survey(5, 2)
    points = np.random.default_rng(2).uniform(-5.0, 5.0, (50, 3)) + [0.0, 30.0, 0.0]
    common: dict[str, Any] = TRACE | {"tx": tx, "rx": rx, "velocity": v, "threads": 2, "snr_db": 20.0, "seed": 1}
    whole = simulate(points, np.ones(50), PULSES["rect"], **common).data
    monkeypatch.setattr("pysas.signal.simulation._TASK_SAMPLES", 1000)
    monkeypatch.setattr("pysas.signal.simulation._BLOCK_BYTES", 60_000)
    seen: list[float] = []
    pieces = simulate(points, np.ones(50), PULSES["rect"], progress=seen.append, **common).data
    np.testing.assert_array_equal(whole, pieces)
    assert seen == sorted(seen) and seen[-1] == 1.0 and len(seen) >= 3


@ALIASED
def test_an_interrupt_ends_the_work() -> None:
    tx, rx, _ = survey(50, 2)
    points = np.tile([1.0, 30.0, 0.0], (5000, 1))

    def interrupt(done: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(points, np.ones(5000), PULSES["rect"], tx=tx, rx=rx, threads=2, progress=interrupt, **TRACE)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("pysas")]


@ALIASED
def test_memory_is_bounded() -> None:
    """Beside 64 MB of data: 32 MB of complex128 sums, not the 128 MB that all traces would take."""
    tx = np.zeros((1000, 3))
    arguments: dict[str, Any] = {"fs": 80e3, "duration": 0.1, "t0": 0.03, "threads": 2, "snr_db": 0.0, "seed": 1}
    points = np.array([[0.0, 30.0, 0.0]])
    simulate(points, [1.0], PULSES["rect"], tx=tx[:1], rx=tx[:1], **arguments)
    tracemalloc.start()
    try:
        echoes = simulate(points, [1.0], PULSES["rect"], tx=tx, rx=tx, **arguments)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert echoes.data.nbytes == 64_000_000
    assert peak - echoes.data.nbytes < 40e6


def quadrature_share(pulse: LFM, fc: float, fs: float) -> float:
    """1 - integral of |spectrum|^2 over the sampled band / energy, composite Gauss-Legendre."""
    shift = pulse.fc - fc
    edges = np.linspace(-fs / 2 - shift, fs / 2 - shift, int(2 * fs * pulse.duration) + 64)
    nodes, weights = np.polynomial.legendre.leggauss(8)
    half = np.diff(edges)[:, None] / 2
    power = np.abs(pulse.spectrum(edges[:-1, None] + half * (1 + nodes))) ** 2
    return float(1 - np.sum(half * weights * power) / pulse.energy)


@pytest.mark.parametrize(
    ("pulse", "fs", "fc"),
    [
        (LFM(100e3, 20e3, 1e-3), 20e3, 100e3),
        (LFM(100e3, -20e3, 1e-3), 30e3, 105e3),
        (LFM(100e3, 30e3, 2e-3, "tukey", 0.1), 40e3, 100e3),
        (LFM(100e3, 30e3, 2e-3, "taylor"), 40e3, 100e3),
        (LFM(100e3, 20e3, 1e-3, "gaussian", 2e-4), 20e3, 100e3),
        (LFM(100e3, 20e3, 1e-3, "gaussian", 1e-4), 60e3, 100e3),
    ],
)
def test_aliased_share(pulse: LFM, fs: float, fc: float) -> None:
    assert _aliased(pulse, fc, fs) == pytest.approx(quadrature_share(pulse, fc, fs), rel=2e-3, abs=1e-9)


def test_aliasing_warning() -> None:
    origin = np.zeros((1, 3))
    scene: dict[str, Any] = {"tx": origin, "rx": origin, "duration": 0.05}
    # share 0.05325 by quadrature_share, norm 0.2308
    with pytest.warns(AliasingWarning, match=r"fs=20000 Hz: 0.23 of the pulse's norm \(0.053 of its energy\)"):
        simulate(np.array([[0.0, 20.0, 0.0]]), [1], LFM(100e3, 20e3, 1e-3), fs=20e3, **scene)
    simulate(
        np.array([[0.0, 20.0, 0.0]]), [1], LFM(100e3, 30e3, 2e-3, "tukey", 0.1), fs=40e3, **scene
    )  # a warning would be an error


@ALIASED
def test_what_the_record_does_not_hold_is_left_out() -> None:
    origin = np.zeros((1, 3))
    scene: dict[str, Any] = {"tx": origin, "rx": origin, "fs": FS, "duration": 0.01, "t0": 0.01}
    points = np.array([[0, 1, 0], [0, 1e3, 0], [0, 1e200, 0]])
    assert not simulate(points, np.ones(3), PULSES["rect"], **scene).data.any()
    assert not simulate(np.zeros((0, 3)), [], PULSES["rect"], **scene).data.any()
    # 0.07 s at 100 kHz: the product is 7000.000000000001
    assert simulate(points, np.ones(3), PULSES["rect"], **scene | {"fs": 100e3, "duration": 0.07}).n_sample == 7000


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"pulse": np.ones(8)}, TypeError, "pulse=ndarray: expected a pysas.LFM"),
        ({"points": np.zeros((2, 2))}, ValueError, r"points: expected shape \(point, 3\)"),
        ({"points": [[0, 0, np.nan], [0, 0, 0]]}, ValueError, "points: nan at point 0"),
        ({"amplitudes": [1.0]}, ValueError, r"amplitudes: expected shape \(2,\)"),
        ({"amplitudes": [1.0, np.inf]}, ValueError, "amplitudes: inf at point 1"),
        ({"amplitudes": ["a", "b"]}, TypeError, "amplitudes: expected real or complex numbers"),
        ({"tx": np.zeros(3)}, ValueError, r"tx: expected shape \(ping, 3\)"),
        ({"rx": np.zeros((3, 3))}, ValueError, r"rx: expected shape \(2, channel, 3\) or \(2, 3\)"),
        ({"rx": np.zeros((2, 0, 3))}, ValueError, r"rx: shape \(2, 0, 3\)"),
        ({"rx": np.full((2, 3), np.nan)}, ValueError, "rx: nan at ping 0"),
        ({"fs": 0}, ValueError, "fs=0"),
        ({"fc": -1.0}, ValueError, "fc=-1"),
        ({"c": 0.0}, ValueError, "c=0"),
        ({"duration": -1.0}, ValueError, "duration=-1"),
        ({"duration": 1e-3}, ValueError, "duration=0.001: expected at least the pulse's 0.002 s"),
        ({"duration": 1e9}, ValueError, r"duration=1000000000.0: 6e\+13 samples"),
        ({"t0": [0.0]}, ValueError, r"t0: expected shape \(2,\)"),
        ({"velocity": np.zeros(3)}, ValueError, "velocity: expected shape"),
        ({"velocity": np.full((2, 3), 200.0)}, ValueError, "velocity: 346.41 m/s"),
        ({"spreading": 2}, TypeError, "spreading=2"),
        ({"spreading": True}, ValueError, "point 0 at .* lies on the transmitter or receiver of ping 0, channel 0"),
        ({"tx_element": 0.1}, TypeError, "tx_element=0.1"),
        ({"rx_element": Element(0.1, boresight=np.tile([0, 1, 0], (3, 1)))}, ValueError, "rx_element: boresight of shape"),
        ({"beam": 0.3}, TypeError, "beam=0.3: expected a pysas.Beam or None"),
        (
            {"beam": Beam(np.ones((3, 3)), 0.1, 1.0)},
            ValueError,
            r"beam: boresight of shape \(3, 3\): expected \(3,\) or \(2, 3\)",
        ),
        (
            {"points": np.ones((2, 3)), "beam": Beam([0, -1, 0], 0.1, 0.1), "snr_db": 3.0},
            ValueError,
            "snr_db=3.0: no echo lies in the record and the beam",
        ),
        ({"snr_db": np.nan}, ValueError, "snr_db=nan"),
        ({"snr_db": 3.0, "t0": 5.0}, ValueError, "snr_db=3.0: no echo lies in the record"),
        ({"seed": -1}, ValueError, "seed=-1"),
        ({"dtype": np.float32}, TypeError, "dtype=float32"),
        ({"dtype": "complex"}, None, ""),
        ({"dtype": "nonsense"}, TypeError, "dtype='nonsense'"),
        ({"threads": 0}, ValueError, "threads=0"),
        ({"progress": 3}, TypeError, "progress=3"),
        ({"attrs": []}, TypeError, "attrs"),
    ],
)
@ALIASED
def test_arguments_are_validated(changes: dict[str, Any], error: type[Exception] | None, message: str) -> None:
    arguments: dict[str, Any] = {
        "points": np.zeros((2, 3)),
        "amplitudes": np.ones(2),
        "pulse": PULSES["rect"],
        "tx": np.zeros((2, 3)),
        "rx": np.zeros((2, 3)),
        "fs": FS,
        "duration": 0.01,
    } | changes
    if error is None:
        simulate(**arguments)
        return
    with pytest.raises(error, match=message):
        simulate(**arguments)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"length": -1.0}, "length=-1"),
        ({"length": 0.1, "height": np.nan}, "height=nan"),
        ({"length": 0.1, "boresight": (0, 0, 0)}, "boresight=.* expected non-zero"),
        ({"length": 0.1, "along": (0, 1, 0)}, "along=.*cosine 1 with boresight"),
        ({"length": 0.1, "boresight": np.ones((2, 3)), "along": np.ones((3, 3))}, "along: 3 vectors"),
    ],
)
def test_elements_are_validated(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Element(**arguments)
