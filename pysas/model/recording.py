"""A recording: real pass-band samples as a converter gave them, with the geometry and sampling that `Echoes` need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from pysas._checks import FloatArray
from pysas.model.beam import Beam
from pysas.model.pulse import LFM


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """Real samples of a survey; a point at travel time tau contributes Re[p(t - tau) exp(2j pi fc (t - tau))].

    What is given is checked when it becomes `Echoes`.

    Parameters
    ----------
    samples : (ping, channel, sample) or (ping, sample) integers or floats
        Pass-band samples.
    fs : float
        Their rate, Hz.
    fc, bandwidth : float
        Frequency to demodulate at and two-sided band about it that is kept, Hz.
    tx : (ping, 3)
        Transmitter at the instant of transmission, m.
    rx : (ping, channel, 3), or (ping, 3) for (ping, sample) samples
        Receivers at the instant of transmission, m.
    c : float or (ping,), optional
        Speed of sound, m/s. None: that of air at `air_temperature`.
    air_temperature : (ping,), optional
        Degrees Celsius.
    t0 : float or (ping,)
        Time of sample 0 after the start of transmission, s: less what the recorder's filters delay.
    velocity : (ping, 3) or (ping, channel, 3), optional
        Of the receivers until the echo arrives, m/s. None: they stand.
    pulse : LFM, optional
        Transmitted pulse.
    compressed : bool
        True: an echo peaks at its travel time. False: it begins there.
    beam : Beam, optional
        None: omnidirectional.
    ping_time : (ping,), optional
        Time of each transmission, s.
    attrs : mapping
        Anything else.
    """

    samples: npt.NDArray[np.integer[Any]] | npt.NDArray[np.floating[Any]]
    fs: float
    fc: float
    bandwidth: float
    tx: FloatArray
    rx: FloatArray
    c: float | FloatArray | None = None
    air_temperature: FloatArray | None = None
    t0: float | FloatArray = 0.0
    velocity: FloatArray | None = None
    pulse: LFM | None = None
    compressed: bool = False
    beam: Beam | None = None
    ping_time: FloatArray | None = None
    attrs: Mapping[str, Any] = field(default_factory=dict)
