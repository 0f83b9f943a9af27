"""Echoes, Beam, Grid, Image and Report: what the border accepts, keeps as views, rejects by name, and prints."""

from __future__ import annotations

import copy
import json
import pickle
import sys
from typing import Any

import numpy as np
import pytest

from pysas.model.echoes import Beam, Echoes
from pysas.model.grid import Grid
from pysas.model.image import Image, Report
from pysas.model.pulse import LFM

pytestmark = pytest.mark.reference  # no engine takes part

PING, CHANNEL, SAMPLE = 4, 3, 10
PULSE = LFM(100e3, 20e3, 1e-3)
ABEAM: Any = [0, 1, 0]


def changed(values: Any, index: Any, value: Any) -> Any:
    values = np.array(values, dtype=np.result_type(values, type(value)))
    values[index] = value
    return values


def fields(**changes: Any) -> dict[str, Any]:
    """Valid arguments for (ping, channel, sample) data: phase centres every 25 mm."""
    tx = np.zeros((PING, 3))
    tx[:, 0] = 0.075 * np.arange(PING)
    rx = tx[:, None, :] + np.array([[0.05 * i, 0, 0] for i in range(CHANNEL)])
    data = np.ones((PING, CHANNEL, SAMPLE), np.complex64)
    return {"data": data, "fs": 40e3, "fc": 100e3, "tx": tx, "rx": rx, **changes}


def flat(**changes: Any) -> dict[str, Any]:
    """Valid arguments for (ping, sample) data."""
    plain = fields()
    return plain | {"data": plain["data"][:, 0], "rx": plain["rx"][:, 0], **changes}


def test_views_of_three_axes() -> None:
    echoes = Echoes(**fields())
    assert (echoes.n_ping, echoes.n_channel, echoes.n_sample) == (PING, CHANNEL, SAMPLE)
    assert echoes.traces is echoes.data
    assert echoes.receivers is echoes.rx
    assert echoes.receiver_velocity is None
    assert echoes.start_time.tolist() == [0.0] * PING
    assert echoes.dtype == np.complex64


def test_views_of_two_axes() -> None:
    plain = flat(velocity=np.ones((PING, 3)), t0=np.arange(PING))
    echoes = Echoes(**plain)
    assert echoes.n_channel == 1
    assert echoes.traces.shape == (PING, 1, SAMPLE)
    assert np.shares_memory(echoes.traces, plain["data"])
    assert echoes.receivers.shape == (PING, 1, 3)
    assert np.shares_memory(echoes.receivers, echoes.rx)
    assert echoes.receiver_velocity is not None
    assert echoes.receiver_velocity.shape == (PING, 1, 3)
    assert echoes.start_time.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert echoes.start_time.dtype == np.float64


def test_velocity_per_ping_or_channel() -> None:
    for shape in ((PING, 3), (PING, CHANNEL, 3)):
        velocity = Echoes(**fields(velocity=np.full(shape, 0.5))).receiver_velocity
        assert velocity is not None
        assert velocity.shape == (PING, CHANNEL, 3)
        assert np.all(velocity == 0.5)


def test_default_bandwidth() -> None:
    """The pulse's, widened by an offset of the demodulation, else fs/1.1."""
    assert Echoes(**fields()).bandwidth == 40e3 / 1.1
    assert Echoes(**fields(pulse=PULSE)).bandwidth == 20e3
    assert Echoes(**fields(pulse=PULSE, fc=103e3)).bandwidth == 26e3
    assert Echoes(**fields(pulse=np.ones(5, complex))).bandwidth == 40e3 / 1.1
    assert Echoes(**fields(pulse=PULSE, bandwidth=22e3)).bandwidth == 22e3
    assert isinstance(Echoes(**fields()).bandwidth, float)


def test_defaults() -> None:
    echoes = Echoes(**fields())
    assert (echoes.c, echoes.t0, echoes.compressed, echoes.attrs) == (1500.0, 0.0, True, {})
    assert all(getattr(echoes, name) is None for name in ("beam", "pulse", "velocity", "ping_time"))
    assert Echoes(**fields(attrs=None)).attrs == {}
    assert Echoes(**fields()).attrs is not Echoes(**fields()).attrs


@pytest.mark.parametrize("dtype", ["<c8", ">c8", "<c16", ">c16"])
def test_data_of_any_layout_are_not_copied(dtype: str) -> None:
    base = np.ones((2 * PING, CHANNEL, 2 * SAMPLE), dtype)
    frozen = np.ones((PING, CHANNEL, SAMPLE), dtype)
    frozen.flags.writeable = False
    for data in (base[::2, :, ::-2], frozen, np.asfortranarray(frozen), np.broadcast_to(frozen[:1], frozen.shape)):
        echoes = Echoes(**fields(data=data))
        assert echoes.data is data
        assert np.shares_memory(echoes.traces, data)
        assert echoes.dtype == np.dtype(dtype).newbyteorder("=")
        assert echoes.dtype.isnative


def test_navigation_of_any_layout() -> None:
    plain = fields()
    big = fields(tx=plain["tx"].astype(">f4"), rx=np.asfortranarray(plain["rx"].astype(">f8")), t0=np.arange(PING, dtype=">i4"))
    echoes = Echoes(**big)
    assert echoes.tx.dtype == echoes.rx.dtype == np.float64
    assert np.allclose(echoes.tx, plain["tx"], rtol=1e-6)
    assert np.array_equal(echoes.rx, plain["rx"])
    assert Echoes(**fields(tx=plain["tx"].tolist())).tx.shape == (PING, 3)
    assert not np.shares_memory(Echoes(**plain).rx, plain["rx"])


def test_non_finite_samples_are_let_in() -> None:
    data = changed(fields()["data"], (1, 2, 3), complex(np.nan, 1))
    assert np.isnan(Echoes(**fields(data=data.astype(np.complex64))).data[1, 2, 3])


def test_replace() -> None:
    echoes = Echoes(**fields(pulse=PULSE, compressed=False, attrs={"a": 1}))
    other = echoes.replace(c=1480.0)
    assert (other.c, echoes.c) == (1480.0, 1500.0)
    assert other.data is echoes.data
    assert other.pulse is PULSE
    assert not other.compressed
    assert other.attrs == {"a": 1}
    with pytest.raises(ValueError, match="c=-1"):
        echoes.replace(c=-1.0)
    with pytest.raises(TypeError, match="speed"):
        echoes.replace(speed=1.0)


def test_frozen_and_compared_by_identity() -> None:
    echoes = Echoes(**fields())
    with pytest.raises(AttributeError):
        echoes.fs = 1.0  # type: ignore[misc]
    assert echoes != Echoes(**fields())
    assert len({echoes, echoes}) == 1


def test_pickle_and_copy() -> None:
    echoes = Echoes(**fields(beam=Beam(ABEAM, 0.1, 0.3), pulse=PULSE))
    for other in (pickle.loads(pickle.dumps(echoes)), copy.deepcopy(echoes)):
        assert np.array_equal(other.data, echoes.data)
        assert other.pulse == PULSE
        assert other.beam is not None
        assert other.beam.length == 0.1


_PLAIN = fields()
_SLOW = np.ones((PING, CHANNEL, 3))
ONES = np.ones((PING, CHANNEL, SAMPLE))
BAD_ECHOES: list[tuple[str, dict[str, Any], type[Exception], str]] = [
    ("data real", fields(data=ONES), TypeError, "data: expected complex64 or complex128 samples, found dtype float64"),
    ("data complex256", fields(data=ONES.astype(np.clongdouble)), TypeError, "data: expected complex64"),
    ("data object", fields(data=np.full((PING, CHANNEL, SAMPLE), None)), TypeError, "found dtype object"),
    ("data text", fields(data="abc"), TypeError, "data: expected complex64"),
    ("data ragged", fields(data=[[1j], [1j, 2j]]), ValueError, "data: expected an array, found sequences of unequal"),
    ("data 1-D", fields(data=np.ones(SAMPLE, complex)), ValueError, r"data: expected 2 or 3 dim.* found shape \(10,\)"),
    ("data 4-D", fields(data=np.ones((1, 1, 1, 1), complex)), ValueError, "data: expected 2 or 3 dimensions"),
    ("data empty", fields(data=np.ones((PING, 0, SAMPLE), complex)), ValueError, r"data: .* found shape \(4, 0, 10\)"),
    ("fs zero", fields(fs=0.0), ValueError, "fs=0.0: expected a finite number > 0"),
    ("fs negative", fields(fs=-40e3), ValueError, "fs=-40000.0"),
    ("fs nan", fields(fs=np.nan), ValueError, "fs=nan"),
    ("fs bool", fields(fs=True), TypeError, "fs=True"),
    ("fs text", fields(fs="40e3"), TypeError, "fs='40e3'"),
    ("fs array", fields(fs=np.array([40e3])), TypeError, "fs=array"),
    ("fs complex", fields(fs=np.complex64(40e3 + 1j)), TypeError, "fs=np.complex64"),
    ("fc zero", fields(fc=0), ValueError, "fc=0: expected a finite number > 0"),
    ("fc inf", fields(fc=np.inf), ValueError, "fc=inf"),
    ("c zero", fields(c=0.0), ValueError, "c=0.0"),
    ("c none", fields(c=None), TypeError, "c=None"),
    (
        "transposed",
        fields(data=fields()["data"].swapaxes(0, -1)),
        ValueError,
        r"data: shape .* beside 4 transmitters: .*axis 2",
    ),
    ("tx shape", fields(tx=np.zeros((PING + 1, 3))), ValueError, r"tx: expected shape \(4, 3\), found \(5, 3\)"),
    ("tx flat", fields(tx=np.zeros((PING, 2))), ValueError, r"tx: expected shape \(4, 3\), found \(4, 2\)"),
    ("tx nan", fields(tx=changed(_PLAIN["tx"], (2, 1), np.nan)), ValueError, "tx: nan at ping 2: expected finite"),
    ("tx complex", fields(tx=_PLAIN["tx"] + 1j), TypeError, "tx: expected real numbers, found dtype complex128"),
    ("tx bool", fields(tx=np.zeros((PING, 3), bool)), TypeError, "tx: expected real numbers, found dtype bool"),
    ("tx none", fields(tx=None), TypeError, "tx: expected real numbers, found dtype object"),
    ("rx per ping only", fields(rx=_PLAIN["tx"]), ValueError, r"rx: expected shape \(4, 3, 3\), found \(4, 3\)"),
    ("rx inf", fields(rx=changed(_PLAIN["rx"], (1, 2, 0), np.inf)), ValueError, "rx: inf at ping 1, channel 2"),
    ("rx of flat data", flat(rx=_PLAIN["rx"]), ValueError, r"rx: expected shape \(4, 3\), found \(4, 3, 3\)"),
    ("rx of flat data nan", flat(rx=changed(_PLAIN["tx"], (3, 2), np.nan)), ValueError, "rx: nan at ping 3: expected"),
    ("t0 nan", fields(t0=np.nan), ValueError, "t0=nan"),
    ("t0 shape", fields(t0=np.zeros(3)), ValueError, r"t0: expected shape \(4,\), found \(3,\)"),
    ("t0 ping inf", fields(t0=changed(np.zeros(PING), 3, np.inf)), ValueError, "t0: inf at ping 3"),
    ("t0 text", fields(t0="0"), TypeError, "t0='0'"),
    ("velocity shape", fields(velocity=_SLOW[:, :2]), ValueError, r"velocity: expected shape \(4, 3\) or \(4, 3, 3\)"),
    ("velocity vector", fields(velocity=np.zeros(3)), ValueError, r"velocity: expected shape \(4, 3\)"),
    (
        "velocity nan",
        fields(velocity=changed(_SLOW, (2, 1, 0), np.nan)),
        ValueError,
        "velocity: nan at ping 2, channel 1",
    ),
    (
        "velocity ping nan",
        fields(velocity=changed(_SLOW[:, 0], (2, 1), np.nan)),
        ValueError,
        "velocity: nan at ping 2: ",
    ),
    ("velocity fast", fields(velocity=_SLOW * 100), ValueError, "velocity: 173.205 m/s: expected below .* 150 m/s"),
    ("velocity of flat data", flat(velocity=_SLOW), ValueError, r"velocity: expected shape \(4, 3\), found"),
    ("bandwidth zero", fields(bandwidth=0.0), ValueError, "bandwidth=0.0"),
    ("bandwidth nan", fields(bandwidth=np.nan), ValueError, "bandwidth=nan"),
    ("pulse number", fields(pulse=1.0), TypeError, "pulse: expected complex64"),
    ("pulse real", fields(pulse=np.ones(5)), TypeError, "pulse: expected complex64 .* found dtype float64"),
    ("pulse 2-D", fields(pulse=np.ones((2, 5), complex)), ValueError, "pulse: expected 1 dimensions"),
    ("pulse empty", fields(pulse=np.ones(0, complex)), ValueError, "pulse: expected at least one sample"),
    ("pulse nan", fields(pulse=np.full(5, np.nan + 0j)), ValueError, "pulse: expected finite samples"),
    ("compressed", fields(compressed=1), TypeError, "compressed=1: expected True or False"),
    ("beam", fields(beam=0.3), TypeError, "beam=0.3: expected a pysas.Beam or None"),
    (
        "beam pings",
        fields(beam=Beam(np.ones((3, 3)), 0.1, 1)),
        ValueError,
        r"shape \(3, 3\): expected \(3,\) or \(4, 3\)",
    ),
    ("ping_time shape", fields(ping_time=np.zeros(2)), ValueError, r"ping_time: expected shape \(4,\)"),
    ("ping_time nan", fields(ping_time=np.full(PING, np.nan)), ValueError, "ping_time: nan at ping 0"),
    ("attrs", fields(attrs=[1]), TypeError, r"attrs=\[1\]: expected a mapping"),
    ("unknown", fields(speed=1.0), TypeError, "speed"),
    ("missing", {"data": _PLAIN["data"], "fs": 1.0, "fc": 1.0}, TypeError, "'tx' and 'rx'"),
]


@pytest.mark.parametrize(("arguments", "error", "text"), [b[1:] for b in BAD_ECHOES], ids=[b[0] for b in BAD_ECHOES])
def test_echoes_errors(arguments: dict[str, Any], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        Echoes(**arguments)


BAD_BEAM: list[tuple[tuple[Any, ...], type[Exception], str]] = [
    (([0, 1], 0.1, 0.3), ValueError, r"boresight: expected shape \(3,\) or \(ping, 3\), found \(2,\)"),
    (([0, 0, 0], 0.1, 0.3), ValueError, "expected non-zero vectors"),
    (([[0, 1, 0], [0, 0, 0]], 0.1, 0.3), ValueError, "expected non-zero vectors"),
    (([[0, 1, 0], [0, np.nan, 0]], 0.1, 0.3), ValueError, "boresight: nan at ping 1"),
    (("y", 0.1, 0.3), TypeError, "boresight: expected real numbers"),
    (([0, 1, 0], 0.0, 0.3), ValueError, "length=0.0: expected a finite number > 0"),
    (([0, 1, 0], 0.1, 0.0), ValueError, "half_angle=0.0"),
    (([0, 1, 0], 0.1, 3.2, "cone"), ValueError, r"half_angle=3.2: expected radians in \(0, pi\]"),
    (([0, 1, 0], 0.1, 1.6), ValueError, r"half_angle=1.6: expected radians in \(0, pi/2\] for a fan"),
    (([0, 1, 0], 0.1, 0.3, "square"), ValueError, "shape='square': expected 'fan' or 'cone'"),
    (([0, 1, 0], 0.1, 0.3, None), ValueError, "shape=None: expected 'fan' or 'cone'"),
    (([0, 1, 0], 0.1, 0.3, "fan", -0.1), ValueError, "taper=-0.1: expected a share of the half-angle, 0 to 1"),
    (([0, 1, 0], 0.1, 0.3, "cone", 1.1), ValueError, "taper=1.1: expected a share of the half-angle, 0 to 1"),
    (([0, 1, 0], 0.1, 0.3, "fan", 1e-5), ValueError, "taper=1e-05: 3e-06 rad: expected 0 or at least 1e-05 rad"),
    (([0, 1, 0], 0.1, 0.3, "fan", np.nan), ValueError, "taper=nan"),
    (([0, 1, 0], 0.1, 0.3, "fan", "half"), TypeError, "taper='half'"),
    (([0, 1, -1], 0.1, 0.3, "fan", 0.0, [0, -2, 2]), ValueError, "axis=.*: along boresight"),
    (([[0, 1, -1]] * 2, 0.1, 0.3, "fan", 0.0, [[1, 0, 0], [0, 2, -2]]), ValueError, r"axis=[\s\S]*: along boresight"),
    (([0, 1, 0], 0.1, 0.3, "fan", 0.0, [0, 0, 0]), ValueError, "axis=.*: expected non-zero vectors"),
    (([0, 1, 0], 0.1, 0.3, "fan", 0.0, [1, np.nan, 0]), ValueError, "axis: nan"),
    (([0, 1, 0], 0.1, 0.3, "fan", 0.0, [1, 0]), ValueError, r"axis: expected shape .*found \(2,\)"),
    (
        ([[0, 1, 0]] * 4, 0.1, 0.3, "fan", 0.0, [[1, 0, 0]] * 3),
        ValueError,
        "axis: of 3 pings: expected as many as boresight's, 4",
    ),
    (([0, 1, 0], 0.1, 0.3, "fan", 0.0, "x"), TypeError, "axis: expected real numbers"),
    (([0, 1, 0], 0.1, 0.3, "cone", 0.0, [1, 0, 0]), ValueError, "axis=.*: expected None for a cone"),
    (([0, 0, -1], 0.1, 0.3), ValueError, "boresight=.*: vertical: expected an axis along the element beside it"),
    (([[0, 1, 0], [0, 0, 2]], 0.1, 0.3), ValueError, r"boresight=[\s\S]*: vertical: expected an axis"),
    (([0, 1, 0], 0.1, np.nan), ValueError, "half_angle=nan"),
    (([0, 1, 0], 0.1, True), TypeError, "half_angle=True"),
]


@pytest.mark.parametrize(("arguments", "error", "text"), BAD_BEAM)
def test_beam_errors(arguments: tuple[Any, ...], error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        Beam(*arguments)


def test_beam() -> None:
    double: Any = [0, 2, 0]
    beam = Beam(double, 1, np.pi, "cone")
    assert beam.boresight.dtype == np.float64
    assert (beam.length, beam.half_angle) == (1.0, np.pi)
    fan = Beam(double, 1, np.pi / 2)
    assert (fan.shape, fan.taper, fan.axis) == ("fan", 0.0, None)
    np.testing.assert_array_equal(fan.axes, [[1.0, 0.0, 0.0]])  # y x z = x
    assert Beam([0, 0, -1], 1, 0.3, "cone").half_angle == 0.3  # a cone may look straight down, a fan with an axis
    np.testing.assert_allclose(Beam([0, 0, -1], 1, 0.3, axis=[3, 4, 0]).axes, [[0.6, 0.8, 0.0]], rtol=1e-15)
    given: Any = np.array([1.0, 0.0, 0.0])
    kept = Beam(double, 1, 0.3, axis=given)
    given[:] = 0
    np.testing.assert_array_equal(kept.axes, [[1.0, 0.0, 0.0]])
    assert Echoes(**fields(beam=Beam(np.ones((PING, 3)), 0.1, 1))).beam is not None


def test_directions_of_a_beam_are_one_or_those_of_its_pings() -> None:
    """One boresight with an axis of each ping, or the other way round, is well."""
    axes = np.tile([1.0, 0.1, 0.0], (PING, 1))
    assert Echoes(**fields(beam=Beam(ABEAM, 0.1, 1, axis=axes))).beam is not None
    assert Echoes(**fields(beam=Beam(np.ones((PING, 3)), 0.1, 1, axis=axes[0]))).beam is not None
    with pytest.raises(ValueError, match=rf"beam: axis of shape \({PING - 1}, 3\): expected \(3,\) or \({PING}, 3\)"):
        Echoes(**fields(beam=Beam(ABEAM, 0.1, 1, axis=axes[1:])))


def test_phase_centre_spacing() -> None:
    """3 channels 50 mm apart give phase centres 25 mm apart; pings advance 75 mm: an even 25 mm."""
    median, largest = Echoes(**fields()).phase_centre_spacing()
    assert median == pytest.approx(0.025)
    assert largest == pytest.approx(0.025)
    slow = fields()
    slow["tx"] = slow["tx"] * 2
    slow["rx"] = slow["tx"][:, None, :] + (fields()["rx"] - fields()["tx"][:, None, :])
    assert Echoes(**slow).phase_centre_spacing() == pytest.approx((0.025, 0.1))
    one = {name: value[:1] if name in ("data", "tx", "rx") else value for name, value in fields().items()}
    assert Echoes(**one).phase_centre_spacing() == pytest.approx((0.025, 0.025))
    single = {name: value[:1] if name in ("data", "tx", "rx") else value for name, value in flat().items()}
    assert Echoes(**single).phase_centre_spacing() == (0.0, 0.0)


def test_warnings() -> None:
    """A spacing of 25 mm is too wide for D/2 below D = 50 mm, for D/4 below D = 100 mm; fs below 1.1 bandwidths."""

    def warned(length: float, **changes: Any) -> list[str]:
        return Echoes(**fields(beam=Beam(ABEAM, length, 0.5), **changes)).warnings()

    assert warned(0.101) == []
    assert len(warned(0.09)) == 1
    assert "> D/4 = 0.0225 m" in warned(0.09)[0]
    assert "0.025 m > D/2 = 0.0225 m" in warned(0.045)[0]
    assert warned(0.1) == []
    assert "fs is 1 x the bandwidth 40000 Hz: below 1.1" in warned(1.0, bandwidth=40e3)[0]
    still = Echoes(**fields(tx=np.zeros((PING, 3)), rx=np.zeros((PING, CHANNEL, 3))))
    assert still.warnings() == ["the track does not move: no along-track resolution"]


def test_swath_and_resolution() -> None:
    echoes = Echoes(**fields(t0=np.array([0.01, 0.02, 0.015, 0.01]), bandwidth=30e3))
    assert echoes.swath == pytest.approx((7.5, 750 * (0.02 + 9 / 40e3)))
    assert echoes.range_resolution == pytest.approx(0.886 * 1500 / 60e3)


def test_echoes_repr() -> None:
    text = repr(Echoes(**fields(pulse=PULSE, compressed=False, velocity=np.ones((PING, 3)), beam=Beam(ABEAM, 0.04, 0.5))))
    for part in (
        "4 pings x 3 channels x 10 samples, complex64, raw",
        "fs 40000 Hz = 2 x bandwidth 20000 Hz, fc 100000 Hz, c 1500 m/s",
        "0.00 to 0.17 m slant range",
        "phase centres every 0.025 m (largest gap 0.025 m), moving receivers",
        "LFM(100 kHz, 20 kHz up-sweep, 1 ms, rect)",
        "fan, half-angle 28.6 deg with a hard edge, D 0.04 m",
        "warning    along-track under-sampled: median spacing 0.025 m > D/2 = 0.02 m",
    ):
        assert part in text
    assert "range-compressed" in repr(Echoes(**fields()))
    assert "5 samples" in repr(Echoes(**fields(pulse=np.ones(5, complex))))
    assert "stop-and-hop" in repr(Echoes(**fields()))


X, Y, Z = np.array([0.0, 1.0, 2.5]), np.array([10.0, 20.0]), np.array([-1.0, 0.0, 1.0, 2.0])


def test_plane() -> None:
    grid = Grid.plane(X, Y, 7.0)
    assert (grid.kind, grid.shape, grid.size, list(grid.axes)) == ("plane", (2, 3), 6, ["x", "y"])
    expected = [[x, y, 7.0] for y in Y for x in X]
    assert grid.coordinates().tolist() == expected
    assert grid.coordinates([4, 0, 4]).tolist() == [expected[i] for i in (4, 0, 4)]
    assert grid.height == 7.0


def test_polar() -> None:
    r, angle = np.array([1.0, 2.0, 3.0]), np.array([0.0, np.pi / 2, np.pi, -0.3])
    grid = Grid.polar(r, angle, (5.0, 6.0, 7.0))
    assert (grid.shape, list(grid.axes), grid.centre) == ((4, 3), ["r", "angle"], (5.0, 6.0, 7.0))
    expected = [[5 + q * np.cos(a), 6 + q * np.sin(a), 7.0] for a in angle for q in r]
    assert np.allclose(grid.coordinates(), expected, atol=1e-15)


def test_surface() -> None:
    height = np.arange(6.0).reshape(2, 3) ** 2
    grid = Grid.surface(X, Y, height)
    assert grid.shape == (2, 3)
    assert grid.coordinates().tolist() == [[x, y, height[j, i]] for j, y in enumerate(Y) for i, x in enumerate(X)]
    assert grid.coordinates([5]).tolist() == [[2.5, 20.0, 25.0]]


def test_volume() -> None:
    grid = Grid.volume(X, Y, Z)
    assert (grid.shape, grid.size, list(grid.axes)) == ((4, 2, 3), 24, ["x", "y", "z"])
    assert grid.coordinates().tolist() == [[x, y, z] for z in Z for y in Y for x in X]


def test_points() -> None:
    points = np.arange(24.0).reshape(2, 4, 3)
    grid = Grid.points(points)
    assert (grid.kind, grid.shape, grid.size, dict(grid.axes)) == ("points", (2, 4), 8, {})
    assert np.array_equal(grid.coordinates(), points.reshape(-1, 3))
    assert grid.coordinates(np.array([7], np.uint8)).tolist() == [[21.0, 22.0, 23.0]]
    assert Grid.points([[1, 2, 3]]).shape == (1,)


def test_axes_of_any_layout() -> None:
    swapped = np.array([[0, 9], [1, 9], [2, 9]], ">f4")[:, 0]
    swapped.flags.writeable = False
    grid = Grid.plane(swapped, range(4, 0, -1))
    assert grid.axes["x"].dtype == np.float64
    assert grid.coordinates()[[0, -1]].tolist() == [[0, 4, 0], [2, 1, 0]]


def test_mask() -> None:
    mask = np.array([[True, False, True], [False, False, True]])
    grid = Grid.plane(X, Y, mask=mask)
    assert np.array_equal(grid.mask, mask) and not np.shares_memory(grid.mask, mask)
    assert grid.coordinates().shape == (6, 3)
    assert "3 of 6 pixels imaged" in repr(grid)
    assert Grid.points(np.zeros((2, 3)), mask=[True, False]).mask is not None


FLAT: Any = np.zeros((2, 3))
BAD_GRID: list[tuple[str, Any, type[Exception], str]] = [
    ("no x", lambda: Grid.plane([], Y), ValueError, "x: expected at least one coordinate"),
    ("2-D y", lambda: Grid.plane(X, np.zeros((2, 2))), ValueError, r"y: expected shape \(n,\), found \(2, 2\)"),
    ("scalar x", lambda: Grid.plane(1.0, Y), ValueError, r"x: expected shape \(n,\), found \(\)"),
    ("nan x", lambda: Grid.plane([0, np.nan], Y), ValueError, r"x: nan at index \(1,\)"),
    ("complex x", lambda: Grid.plane(X + 0j, Y), TypeError, "x: expected real numbers, found dtype complex128"),
    ("text y", lambda: Grid.plane(X, "abc"), TypeError, "y: expected real numbers"),
    ("bool y", lambda: Grid.plane(X, [True, False]), TypeError, "y: expected real numbers, found dtype bool"),
    ("z nan", lambda: Grid.plane(X, Y, np.nan), ValueError, "z=nan"),
    ("z array", lambda: Grid.plane(X, Y, FLAT), TypeError, "z=array"),
    (
        "mask shape",
        lambda: Grid.plane(X, Y, mask=np.ones((3, 2), bool)),
        ValueError,
        r"mask: .* shape \(2, 3\), found \(3, 2\)",
    ),
    ("mask int", lambda: Grid.plane(X, Y, mask=np.ones((2, 3), int)), TypeError, "mask: expected booleans"),
    ("mask ragged", lambda: Grid.plane(X, Y, mask=[[True], [True, False]]), ValueError, "mask: expected an array"),
    ("centre", lambda: Grid.polar(X, Y, (0, 0)), ValueError, r"centre: expected shape \(3,\), found \(2,\)"),
    ("centre inf", lambda: Grid.polar(X, Y, (0, 0, np.inf)), ValueError, "centre: inf"),
    ("angle empty", lambda: Grid.polar(X, np.zeros(0)), ValueError, "angle: expected at least one"),
    ("surface shape", lambda: Grid.surface(X, Y, FLAT.T), ValueError, r"z: expected shape \(2, 3\), found \(3, 2\)"),
    ("surface nan", lambda: Grid.surface(X, Y, changed(FLAT, (1, 2), np.nan)), ValueError, "z: nan at row 1, column 2"),
    ("volume z", lambda: Grid.volume(X, Y, 1.0), ValueError, r"z: expected shape \(n,\)"),
    ("points flat", lambda: Grid.points([1.0, 2.0, 3.0]), ValueError, r"points: expected shape \(..., 3\)"),
    ("points pairs", lambda: Grid.points(np.zeros((4, 2))), ValueError, r"points: expected shape \(4, 3\), found"),
    ("points none", lambda: Grid.points(np.zeros((0, 3))), ValueError, r"points: expected at least one point"),
    ("points nan", lambda: Grid.points(changed(FLAT, (1, 2), np.nan)), ValueError, "points: nan at point 1"),
    ("points ragged", lambda: Grid.points([[1, 2, 3], [4]]), ValueError, "points: expected an array"),
    ("pixel float", lambda: Grid.plane(X, Y).coordinates([0.0]), TypeError, "pixels: expected a 1-D array of whole"),
    ("pixel bool", lambda: Grid.plane(X, Y).coordinates([True]), TypeError, "pixels: expected"),
    ("pixel 2-D", lambda: Grid.plane(X, Y).coordinates([[1]]), TypeError, "pixels: expected a 1-D"),
    ("pixel high", lambda: Grid.plane(X, Y).coordinates([6]), ValueError, "expected 0 <= pixel < 6, found 6 to 6"),
    ("pixel negative", lambda: Grid.plane(X, Y).coordinates([-1]), ValueError, "found -1 to -1"),
]


@pytest.mark.parametrize(("make", "error", "text"), [b[1:] for b in BAD_GRID], ids=[b[0] for b in BAD_GRID])
def test_grid_errors(make: Any, error: type[Exception], text: str) -> None:
    with pytest.raises(error, match=text):
        make()


def test_grid_repr() -> None:
    text = repr(Grid.plane(np.arange(5) * 0.25, [3.0], 1.5))
    assert "Grid: plane, 1 x 5 pixels" in text
    assert "0 to 1 m every 0.25 m" in text
    assert "z          1.5 m" in text
    assert "angle      0 to 1 rad every 0.5 rad" in repr(Grid.polar([1, 2], [0, 0.5, 1]))
    assert "centre     (0.0, 0.0, 0.0) m" in repr(Grid.polar([1, 2], [0, 0.5, 1]))
    assert "z          2 to 3 m" in repr(Grid.surface([0, 1], [0], [[2, 3]]))
    assert "Grid: points, 2 x 4 pixels" in repr(Grid.points(np.zeros((2, 4, 3))))


REPORT = Report("backprojection", tol=1e-3, backend="numba", threads=2, terms=1000, choices={"degree": 3}, notes=("a note",))


def image(data: Any = None, grid: Grid | None = None) -> Image:
    grid = grid or Grid.plane(X, Y)
    data = np.zeros(grid.shape, np.complex64) if data is None else data
    return Image(data, grid, REPORT, 100e3, 1500.0)


def test_db() -> None:
    """20 log10 of magnitudes 10, 1, 0.1, 5 and 0 against the largest, and against a given amplitude."""
    found = image(np.array([[10, 1j, -0.1], [3 + 4j, 0, 0]], np.complex64))
    with np.errstate(all="raise"):
        assert np.allclose(found.db(), np.array([[0, -20, -40], [-6.0206, -np.inf, -np.inf]]), atol=1e-4)
        assert np.allclose(found.db(1.0)[0], [20, 0, -20], atol=1e-5)
        assert np.all(image().db() == -np.inf)
    assert found.db().dtype == np.float64
    for bad in (0.0, -1.0, np.nan):
        with pytest.raises(ValueError, match="reference="):
            found.db(bad)


def test_image_keeps_its_data() -> None:
    data = np.ones((2, 3), np.complex128)[:, ::-1]
    assert image(data).data is data
    assert image(data.astype(">c8")).db().tolist() == [[0.0] * 3] * 2


BAD_IMAGE: list[tuple[str, dict[str, Any], type[Exception], str]] = [
    ("real", {"data": np.ones((2, 3))}, TypeError, "data: expected complex pixels, found dtype float64"),
    ("shape", {"data": np.ones((3, 2), complex)}, ValueError, r"data: .* shape \(2, 3\), found \(3, 2\)"),
    ("grid", {"grid": (2, 3)}, TypeError, r"grid=\(2, 3\): expected a pysas.Grid"),
    ("report", {"report": {}}, TypeError, "report={}: expected a Report"),
    ("fc", {"fc": 0.0}, ValueError, "fc=0.0"),
    ("c", {"c": np.nan}, ValueError, "c=nan"),
]


@pytest.mark.parametrize(("change", "error", "text"), [b[1:] for b in BAD_IMAGE], ids=[b[0] for b in BAD_IMAGE])
def test_image_errors(change: dict[str, Any], error: type[Exception], text: str) -> None:
    good = {"data": np.ones((2, 3), complex), "grid": Grid.plane(X, Y), "report": REPORT, "fc": 1e5, "c": 1500.0}
    with pytest.raises(error, match=text):
        Image(**{**good, **change})


def test_image_repr() -> None:
    text = repr(image(changed(np.zeros((2, 3), complex), (1, 2), 3j)))
    for part in (
        "complex128, backprojection, tol 0.001, numba 2 threads",
        "peak       3 at x 2.5000, y 20.0000, z 0.0000 m",
        "sum, 1000 terms",
        "note       a note",
        "Grid: plane, 2 x 3 pixels",
    ):
        assert part in text


def test_xarray_labels() -> None:
    pytest.importorskip("xarray", reason="needs the optional package xarray")
    plane = image(np.arange(6).reshape(2, 3) + 0j).to_xarray()
    assert plane.dims == ("y", "x")
    assert plane.coords["x"].values.tolist() == X.tolist()
    assert plane.coords["y"].attrs == {"units": "m"}
    assert plane.attrs == {"fc": 100e3, "c": 1500.0, "method": "backprojection"}
    assert complex(plane.sel(x=2.5, y=20.0)) == 5
    polar = image(grid=Grid.polar(X, Y)).to_xarray()
    assert polar.dims == ("angle", "r")
    assert polar.coords["angle"].attrs == {"units": "rad"}
    volume = image(grid=Grid.volume(X, Y, Z)).to_xarray()
    assert volume.dims == ("z", "y", "x")
    assert volume.coords["z"].values.tolist() == Z.tolist()
    height = np.arange(6.0).reshape(2, 3)
    surface = image(grid=Grid.surface(X, Y, height)).to_xarray()
    assert surface.coords["height"].dims == ("y", "x")
    assert np.array_equal(surface.coords["height"].values, height)
    points = image(grid=Grid.points(np.arange(24.0).reshape(2, 4, 3))).to_xarray()
    assert points.dims == ("point_0", "point_1")
    assert points.coords["z"].values[1, 3] == 23.0


def test_xarray_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(ImportError, match=r"xarray is not installed: pip install 'pysas-sonar\[xarray\]'"):
        image().to_xarray()


def test_report_round_trip() -> None:
    text = json.dumps(REPORT.as_dict())
    assert Report.from_dict(json.loads(text)) == REPORT
    assert Report.from_dict({"method": "ffbp"}) == Report("ffbp")
    for bad in ({}, {"method": "x", "colour": 1}):
        with pytest.raises(ValueError, match="report: found"):
            Report.from_dict(bad)
