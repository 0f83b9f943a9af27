"""The settings of one sum, as they were chosen, and what makes tables of samples by them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pysas.engine import preparation


@dataclass(frozen=True)
class Choices:
    """What the planner settled on.

    precision : "float32" or "float64" of the inner loop; degree, oversampling : of the interpolation; n_fft, n_fine,
    length : transform lengths and samples kept of each trace; margin : of these, on each side of what pixels need;
    taper : samples of smooth cut (Kaiser, beta) at each end; block : pixels per delay polynomial (0: exact delay per
    pixel); near : distance (m) below which delays are exact; trigonometry : terms of the sine polynomial; batch : traces
    prepared at a time; errors : bound of each contribution; run : traces summed in float32 before these sums are added in
    float64, or 0; phases, step, taps : of the filter that makes the coefficients (C++; oversampling is phases/step of the
    samples, or twice that after transforms), or 0 where transforms make them; wide : tables are made of whole records in
    float64, for samples that pixels do not read are bright.
    """

    precision: str
    degree: int
    oversampling: float
    n_fft: int
    n_fine: int
    length: int
    margin: int
    taper: int
    beta: float
    block: int
    near: float
    trigonometry: int
    batch: int
    delay: str
    errors: dict[str, float]
    run: int = 0
    phases: int = 0
    step: int = 0
    taps: int = 0
    wide: bool = False

    @property
    def predicted_error(self) -> float:
        """Sum of the bounds."""
        return float(sum(self.errors.values()))

    def reported(self) -> dict[str, Any]:
        """As `Report` has them."""
        return vars(self) | {"errors": dict(self.errors)}


def reader_of(choices: Choices) -> preparation.Interpolator:
    """What makes coefficients from samples, by transforms as chosen."""
    kind = np.complex64 if choices.precision == "float32" and not choices.wide else np.complex128
    return preparation.interpolator(
        choices.length, choices.n_fft, choices.n_fine, choices.degree, choices.taper, choices.beta, kind
    )
