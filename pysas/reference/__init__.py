"""Independent answers that validate the engines; none of them imports an engine."""

from pysas.reference import bounds, ftcg, rasters
from pysas.reference.chirp_scaling import chirp_scaling
from pysas.reference.correlation import correlation
from pysas.reference.direct import exact
from pysas.reference.fourier_image import fourier_image
from pysas.reference.frames import Frame, FrameSolution, Sampling
from pysas.reference.gridding import Gaussian, Gridding, KaiserBessel, Synthesis, pipe_menon, voronoi
from pysas.reference.looks import Looks, looks
from pysas.reference.micronavigation import displaced_phase_centres
from pysas.reference.motion import motion_compensate
from pysas.reference.nufft import nufft
from pysas.reference.omega_k import omega_k
from pysas.reference.one_way import one_way
from pysas.reference.one_way_curved import map_to_line
from pysas.reference.one_way_polar import one_way_polar
from pysas.reference.phase_centres import phase_centres
from pysas.reference.range_doppler import range_doppler
from pysas.reference.regularise import Enhanced, enhance, noise_level
from pysas.reference.sharpening import focus_gradient

__all__ = [
    "Enhanced", "Frame", "FrameSolution", "Gaussian", "Gridding", "KaiserBessel", "Looks", "Sampling", "Synthesis", "bounds",
    "chirp_scaling", "correlation", "displaced_phase_centres", "enhance", "exact", "focus_gradient", "fourier_image", "ftcg",
    "looks", "map_to_line", "motion_compensate", "noise_level", "nufft", "omega_k", "one_way", "one_way_polar", "phase_centres",
    "pipe_menon", "range_doppler", "rasters", "voronoi",
]  # fmt: skip
