"""Circular synthetic aperture sonar: geometry of the views and the analytic point spread function; no engine imported."""

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
from pysas.circular.psf import PointSpread, sigmas_of_width

__all__ = [
    "PointSpread", "angles_for_patch", "asymptotic_energy", "energy", "energy_diffusion", "energy_within",
    "full_view_radius", "resolution", "sigmas_of_width", "track_angle", "view_angle", "view_density", "view_rate",
    "virtual_angles",
]  # fmt: skip
