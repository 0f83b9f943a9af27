"""Phase history: what each ping heard at equally spaced frequencies, as radars and stepped-frequency sonars record it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pysas._checks import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class PhaseHistory:
    """The model is samples[p, k] = sum over scatterers of a exp(-2j pi f[p, k] (tau[p] - reference[p])).

    tau is the two-way travel time by way of a scatterer and f[p, k] = first[p] + k step[p].

    Parameters
    ----------
    samples : (ping, K) complex64 or complex128
        Responses.
    first, step : (ping,)
        Frequency of sample 0 and the steps to the others, Hz.
    tx, rx : (ping, 3)
        Transmitter at transmission; receiver at transmission, m.
    reference : (ping,)
        Two-way travel time to which each ping's phase is referred, s.
    c : float
        Propagation speed, m/s.
    velocity : (ping, 3), optional
        Of the receivers until the echo arrives, m/s. None: they stand.
    ping_time : (ping,), optional
        Time of each transmission, s.
    attrs : mapping
        Anything else.
    """

    samples: ComplexArray
    first: FloatArray
    step: FloatArray
    tx: FloatArray
    rx: FloatArray
    reference: FloatArray
    c: float
    velocity: FloatArray | None = None
    ping_time: FloatArray | None = None
    attrs: Mapping[str, Any] = field(default_factory=dict)
