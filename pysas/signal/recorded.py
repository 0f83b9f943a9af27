"""Recordings of real samples turned into echoes: demodulated, with the speed of sound of their medium."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from pysas import _checks
from pysas._checks import FloatArray
from pysas.model.echoes import Echoes
from pysas.model.recording import Recording
from pysas.signal.baseband import demodulate

_COLDEST, _HOTTEST = -100.0, 100.0  # degrees Celsius that a thermometer in air shows


@_checks.usual_errors
def demodulated(recording: Recording) -> Echoes:
    """The same survey in complex base-band, with `t0` as it was, at the rate that `demodulate` finds for the band.

    Raises
    ------
    ValueError, TypeError
        What `demodulate` and `Echoes` do not take; neither or both of `c` and `air_temperature`.

    Notes
    -----
    O(n log n) time a trace of n samples; the result and blocks of about 32 MB in memory.
    """
    c, temperature = recording.c, recording.air_temperature
    if c is None and temperature is not None:
        c = speed_in_air(temperature)
    elif c is None or temperature is not None:
        raise TypeError("c, air_temperature: expected one of the two")
    data, rate = demodulate(recording.samples, recording.fs, recording.fc, recording.bandwidth, t0=recording.t0)
    return Echoes(
        data, fs=rate, fc=recording.fc, tx=recording.tx, rx=recording.rx, c=c, t0=recording.t0, velocity=recording.velocity,
        bandwidth=min(recording.bandwidth, rate / 1.1), pulse=recording.pulse, compressed=recording.compressed,
        beam=recording.beam, ping_time=recording.ping_time, attrs=recording.attrs,
    )  # fmt: skip


def speed_in_air(temperature: npt.ArrayLike) -> FloatArray:
    """Speed of sound in air, m/s, at `temperature` (ping,) in degrees Celsius: 331.6 + 0.61 T.

    The first-order formula by which the AirSAS data's published images are made (getAirSpeed.m, model 0; T. E. Blanford et
    al.). From 10 to 25 degrees it is within 0.1 % of O. Cramer's equation (JASA 93, 1993) at 50 % humidity, within 0.2 % of it
    in dry air.
    """
    found = _checks.reals("air_temperature", temperature, [("ping",)], ("ping",))
    wrong = (found < _COLDEST) | (found > _HOTTEST)
    if wrong.any():
        ping = int(np.argmax(wrong))
        raise ValueError(f"air_temperature: {found[ping]:g} at ping {ping}: expected {_COLDEST:g} to {_HOTTEST:g} Celsius")
    return 331.6 + 0.61 * found
