"""What `pysas check` notices: each fault is put into a good survey, and only its own check may speak."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import pysas
from pysas.inspection import inspect

pytestmark = pytest.mark.reference  # no engine takes part

FS, FC = 40e3, 100e3


def survey(**changes: Any) -> pysas.Echoes:
    """A swaying track of 60 pings, 3 receivers that turn with it, noise as data."""
    rng = np.random.default_rng(3)
    ping = np.arange(60.0)
    tx = np.stack([0.15 * ping, 0.1 * np.sin(ping / 9), 0.05 * np.cos(ping / 13)], axis=1)
    heading = 0.01 * np.sin(ping / 7)
    arm = np.stack([np.cos(heading), np.sin(heading), np.zeros(60)], axis=1)
    rx = tx[:, None] + np.array([0.1, 0.2, 0.3])[:, None] * arm[:, None]
    data = (rng.standard_normal((60, 3, 200)) + 1j * rng.standard_normal((60, 3, 200))).astype(np.complex64)
    fields: dict[str, Any] = {"data": data, "fs": FS, "fc": FC, "tx": tx, "rx": rx, "ping_time": 0.1 * ping}
    fields |= {"pulse": pysas.LFM(FC, 30e3, 1e-3), "compressed": False} | changes
    return pysas.Echoes(fields.pop("data"), **fields)


def findings(echoes: pysas.Echoes) -> dict[str, tuple[str, str]]:
    return {finding.name: (finding.state, finding.text) for finding in inspect(echoes) if finding.state != "ok"}


def moved(name: str, index: Any, by: tuple[float, float, float]) -> pysas.Echoes:
    changed = getattr(survey(), name).copy()
    changed[index] += by
    return survey(**{name: changed})


def samples(index: Any, value: complex) -> pysas.Echoes:
    data = survey().data.copy()
    data[index] = value
    return survey(data=data)


def clipped(gain: Any = 1.0) -> pysas.Echoes:
    data = survey().data.copy()
    data.real, data.imag = np.clip(data.real, -2, 2), np.clip(data.imag, -2, 2)
    return survey(data=(data * gain).astype(np.complex64))


def samples_times(factor: float, pings: slice) -> pysas.Echoes:
    data = survey().data.copy()
    data[pings] *= factor
    return survey(data=data)


def plus(constant: complex) -> pysas.Echoes:
    return survey(data=survey().data + np.complex64(constant))


def gap() -> pysas.Echoes:
    return samples((7, 1, slice(60, 160)), 0)


def rounded(step: float) -> pysas.Echoes:
    """Positions of one receiver at the transmitter, to so many metres."""
    good = survey()
    tx = np.round(good.tx / step) * step
    return survey(data=good.data[:, 0], tx=tx, rx=tx)


def single() -> pysas.Echoes:
    good = survey()
    tx = (good.tx + [5e5, 6.6e6, 0]).astype(np.float32)
    return survey(data=good.data[:, 0], tx=tx, rx=tx)


def overlap() -> pysas.Echoes:
    """Three phase centres 0.05 m apart in steps of 0.11 m."""
    tx = np.stack([0.11 * np.arange(60.0), np.zeros(60), np.zeros(60)], axis=1)
    return survey(tx=tx, rx=tx[:, None] + np.array([0.1, 0.2, 0.3])[:, None] * np.array([1.0, 0, 0]))


def yawing(by: float = 0.4) -> np.ndarray:
    """Boresights that turn between pings 29 and 30, 0.4 rad = 22.9 degrees."""
    yaw = np.where(np.arange(60) < 30, 0.0, by)
    return np.stack([np.sin(yaw), np.cos(yaw), np.full(60, 0.0)], axis=1)


def missing_ping() -> pysas.Echoes:
    """Pings 30 and 31 were not recorded: the track goes on smoothly."""
    good = survey()
    kept = np.delete(np.arange(60), [30, 31])
    assert good.ping_time is not None
    return survey(data=good.data[kept], tx=good.tx[kept], rx=good.rx[kept], ping_time=good.ping_time[kept])


FAULTS: dict[str, tuple[pysas.Echoes, str, str, str]] = {
    "not a number": (samples((4, 1, 7), np.nan), "finite samples", "FAIL", "ping 4, channel 1, sample 7"),
    "infinite": (samples((9, 0, 0), np.inf), "finite samples", "FAIL", "ping 9, channel 0, sample 0"),
    "dead channel": (samples((slice(None), 2), 0), "silent traces", "warn", "first at ping 0, channel 2; dead channels 2"),
    "lost trace": (samples((5, 1), 0), "silent traces", "warn", "1 of 180, first at ping 5, channel 1"),
    "clipped": (clipped(), "clipping", "warn", "largest value 2"),
    "clipped, then amplified": (clipped(np.linspace(1, 9, 200)), "clipping", "warn", "before a gain that varies with time"),
    "stuck channel": (samples((slice(None), 1), 0.4 - 0.1j), "silent traces", "warn", "stuck channels 1"),
    "gap": (gap(), "gaps", "warn", "first at ping 7, channel 1, samples 60 to 159"),
    "gain": (samples_times(4.0, slice(30, None)), "gain", "warn", "step of +11.8 dB first at ping 30"),
    "constant": (plus(0.5 + 0.5j), "offset", "warn", "is a constant"),
    "cast": (survey(data=survey().data.real.astype(np.complex64)), "base-band", "FAIL", "cast to complex"),
    "one signal twice": (survey(data=(survey().data.real * (1 + 1j)).astype(np.complex64)), "base-band", "FAIL", "I and Q"),
    "degrees": (survey(tx=survey().tx * 1e-5 + [10, 60, 0], rx=survey().rx * 1e-5 + [10, 60, 0]), "units", "FAIL", "latitude"),
    "kilometres": (survey(tx=survey().tx / 1e3, rx=survey().rx / 1e3), "units", "warn", "kilometres taken for metres"),
    "kilohertz": (
        survey(fs=FS / 1e3, fc=FC / 1e3, pulse=None, bandwidth=None, compressed=True),
        "units",
        "warn",
        "kHz for Hz",
    ),
    "rounded": (rounded(0.01), "units", "FAIL", "multiples of 0.01 m"),
    "single": (single(), "units", "FAIL", "multiples of 0.0312 m (float32 holds no more)"),
    "long pulse, fast": (survey(velocity=np.full((60, 3), [60.0, 0, 0])), "Doppler", "warn", "60 m/s for a pulse of 0.001 s"),
    "overlap": (overlap(), "phase centres", "warn", "ghosts of"),
    "time stands still": (survey(ping_time=np.repeat(np.arange(30.0), 2)), "ping times", "FAIL", "ping 1"),
    "sway of one ping": (moved("tx", 20, (0, 0.05, 0)), "track", "FAIL", "first at ping 20"),
    "a step up": (moved("tx", slice(40, None), (0, 0, 0.05)), "track", "FAIL", "first at ping 40"),
    "repeated position": (survey(tx=survey().tx[[*range(30), 29, *range(31, 60)]]), "track", "warn", "first at ping 30"),
    "missing ping": (missing_ping(), "track", "warn", "before ping 30"),
    "one receiver": (moved("rx", (20, 1), (0, 0.05, 0)), "receivers", "FAIL", "ping 20, channel 1"),
    "pulse too long": (survey(pulse=pysas.LFM(FC, 3e4, 0.1)), "pulse", "FAIL", "longer than the record"),
    "pulse beside the band": (survey(fc=115e3, bandwidth=3e4), "pulse", "FAIL", "beyond what fs 40000 Hz holds"),
    "no pulse": (survey(pulse=None), "pulse", "warn", "needs it"),
    "band": (survey(bandwidth=38e3), "range sampling", "FAIL", "below 1.1"),
    "beam ahead": (survey(beam=pysas.Beam([1, 0.2, -0.2], 0.3, 0.3)), "beam", "warn", "looks along it"),
    "cone ahead": (survey(beam=pysas.Beam([1, 0.2, 0], 0.3, 0.3, "cone")), "beam", "warn", "looks along it"),
    "beam across": (
        survey(beam=pysas.Beam([0, 1, 0], 0.3, 0.3, axis=[0, 0, 1])),
        "beam",
        "warn",
        "axis as given: 0, 0, 1; its middle",
    ),
    "yawing beam": (survey(beam=pysas.Beam(yawing(), 0.3, 0.3)), "beam", "warn", "turns by 22.9 deg first before ping 30"),
    "yawing cone": (survey(beam=pysas.Beam(yawing(), 0.3, 0.3, "cone")), "beam", "warn", "turns by 22.9 deg"),
    "other side": (survey(beam=pysas.Beam(yawing(np.pi), 0.3, 0.3)), "beam", "warn", "turns by 180 deg first before ping 30"),
    "sparse": (survey(beam=pysas.Beam([0, 1, 0], 0.02, 1.0)), "along-track sampling", "FAIL", "above D/2"),
}


def test_a_good_survey_is_good() -> None:
    assert findings(survey()) == {}
    flat = survey()
    assert findings(survey(data=flat.data[:, 0], rx=flat.rx[:, 0])) == {}


@pytest.mark.parametrize("fault", FAULTS)
def test_each_fault_is_found_where_it_is(fault: str) -> None:
    echoes, name, state, text = FAULTS[fault]
    found = findings(echoes)
    assert found[name][0] == state and text in found[name][1]
    # a moved transmitter is also one against its receivers; a faulty navigation point shows in the spacing too
    assert found.keys() - {name} <= {"track", "receivers", "along-track sampling"}, found


def test_a_sound_beam_is_described() -> None:
    """Yaw of 0.02 rad a ping and boresights of any depression are no fault of a fan; the track sways by 0.6 degrees."""
    ping = np.arange(60)
    look = np.stack([0.01 * (-1.0) ** ping, np.ones(60), -0.5 - 0.4 * np.sin(ping)], axis=1)
    for beam, text in (
        (pysas.Beam(look, 0.3, 0.2, taper=0.25), "fan, half-angle 11.5 deg falling over its outer 25 %, D 0.3 m, axis level"),
        (pysas.Beam([0, -1, 0], 0.3, 0.2, axis=[-2, 0, 0.1]), "with a hard edge, D 0.3 m, axis as given: -0.999, 0, 0.0499"),
        (pysas.Beam([0, 1, -1], 0.3, 0.2, "cone"), "cone, half-angle 11.5 deg with a hard edge"),
    ):
        (found,) = (finding for finding in inspect(survey(beam=beam)) if finding.name == "beam")
        assert found.state == "ok" and text in found.text
    one = survey()
    still = survey(data=one.data[:1], tx=one.tx[:1], rx=one.rx[:1], ping_time=None, beam=pysas.Beam([1, 0, 0], 0.3, 0.1))
    assert "beam" not in findings(still)


def test_silence_and_noise_without_a_finite_sample() -> None:
    state, text = findings(samples(slice(None), 0))["finite samples"]
    assert state == "FAIL" and text.startswith("all samples are zero")
    assert findings(samples(slice(None), np.nan))["finite samples"][0] == "FAIL"


@pytest.mark.parametrize("pings", [1, 2, 3, 4])
def test_short_surveys(pings: int) -> None:
    good = survey()
    assert good.ping_time is not None
    some = survey(data=good.data[:pings], tx=good.tx[:pings], rx=good.rx[:pings], ping_time=good.ping_time[:pings])
    assert findings(some) == {}


@pytest.mark.parametrize("name", ["stripmap_perturbed", "circular"])
def test_data_made_elsewhere_are_good(name: str, data_dir: Any) -> None:
    assert findings(pysas.load(data_dir / f"{name}.npz")) == {}


@pytest.mark.parametrize("windows", ["every second shorter", "every seventh very short", "every fifth empty"])
def test_pings_that_recorded_less_are_in_order(windows: str) -> None:
    """What was declared as not recorded is neither silence nor another order of pings."""
    pings, n = 150, 960
    x = 0.03 * np.arange(pings) + 0.002 * np.sin(np.arange(pings))
    tx = np.stack([x, 0 * x, 0 * x], axis=1)
    points = np.random.default_rng(4).uniform([0, 9, 0], [4.5, 20, 0], (200, 3))
    raw = pysas.simulate(
        points, np.ones(200), pysas.LFM(100e3, 20e3, 2e-3, "tukey"), tx=tx, rx=tx, fs=40e3, duration=0.024, t0=0.008
    )
    valid = np.tile([0, n - 1], (pings, 1))
    if windows == "every second shorter":
        valid[::2, 1] = n // 4
    elif windows == "every seventh very short":
        valid[::7, 1] = n // 20
    else:
        valid[::5] = [0, -1]
    assert [finding for finding in inspect(raw) if finding.state != "ok"] == []
    told = [finding.name for finding in inspect(raw.replace(valid=valid)) if finding.state != "ok"]
    assert told == (["silent traces"] if windows == "every seventh very short" else [])  # which hold not one echo


def test_speeds_that_jump_are_no_other_order() -> None:
    x = 0.03 * np.arange(150) + 0.002 * np.sin(np.arange(150))
    tx = np.stack([x, 0 * x, 0 * x], axis=1)
    c = 1500 * (1 + 0.003 * np.random.default_rng(0).uniform(-1, 1, 150))
    points = np.array([[1.0, 12, 0], [2.0, 15, 0], [3.0, 18.0, 0], [2.5, 10, 0]])
    raw = pysas.simulate(
        points, np.ones(4), pysas.LFM(100e3, 20e3, 2e-3, "tukey"), tx=tx, rx=tx, fs=40e3, duration=0.024, t0=0.008, c=c
    )
    assert [finding for finding in inspect(raw) if finding.state != "ok"] == []


def test_findings_print_as_the_command_does() -> None:
    assert str(inspect(survey())[0]).startswith("ok    finite samples")
