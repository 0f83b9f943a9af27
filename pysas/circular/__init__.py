"""Circular synthetic aperture sonar: geometry and weights of the views, plain sums, the analytic point spread function,
deconvolution.

No engine is imported here: the point spread function is one of the answers that validate the engines.
"""

from pysas.circular.deconvolution import naive, transfer, wave_atom, wave_atom_expansion, wave_atom_kernel, wiener
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
from pysas.circular.points import Scatterers, fit_points, synthesise
from pysas.circular.psf import PointSpread, sigmas_of_width
from pysas.circular.views import arc_weights, view_angles, view_weights

__all__ = [
    "PointSpread", "Scatterers", "angles_for_patch", "arc_weights", "asymptotic_energy", "energy", "energy_diffusion",
    "energy_within", "fit_points", "full_view_radius", "naive", "resampled_sum", "resolution", "sigmas_of_width",
    "synthesise", "track_angle", "transfer", "view_angle", "view_angles", "view_density", "view_rate", "view_weights",
    "virtual_angles", "wave_atom", "wave_atom_expansion", "wave_atom_kernel", "weighted_sum", "wiener",
]  # fmt: skip
