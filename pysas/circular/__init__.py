"""Circular synthetic aperture sonar: geometry of the views; no engine is imported here."""

from pysas.circular.geometry import (
    angles_for_patch,
    full_view_radius,
    track_angle,
    view_angle,
    view_density,
    view_rate,
    virtual_angles,
)

__all__ = [
    "angles_for_patch", "full_view_radius", "track_angle", "view_angle", "view_density", "view_rate", "virtual_angles",
]  # fmt: skip
