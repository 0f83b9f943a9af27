"""Circular synthetic aperture sonar: geometry and weights of the views, plain sums, the analytic point spread function.

No engine is imported here: the point spread function is one of the answers that validate the engines.
"""

from pysas.circular.energy import asymptotic_energy, energy, energy_diffusion, energy_within, resolution
from pysas.circular.geometry import (
    angles_for_patch,
    full_view_radius,
    track_angle,
    view_angle,
    view_density,
    view_rate,
    virtual_angles,
)
from pysas.circular.imaging import resampled_sum, weighted_sum
from pysas.circular.psf import PointSpread, sigmas_of_width
from pysas.circular.views import arc_weights, view_angles, view_weights

__all__ = [
    "PointSpread", "angles_for_patch", "arc_weights", "asymptotic_energy", "energy", "energy_diffusion", "energy_within",
    "full_view_radius", "resampled_sum", "resolution", "sigmas_of_width", "track_angle", "view_angle", "view_angles",
    "view_density", "view_rate", "view_weights", "virtual_angles", "weighted_sum",
]  # fmt: skip
