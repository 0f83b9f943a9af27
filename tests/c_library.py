"""The C library through ctypes, as its tests and the fuzz of the promise call it: structs as in pysas.h, and one call."""

import ctypes
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

import pysas

i64, f64, pointer = ctypes.c_int64, ctypes.c_double, ctypes.c_void_p


class Survey(ctypes.Structure):
    _fields_ = (
        [("struct_size", ctypes.c_size_t), ("n_ping", i64), ("n_channel", i64), ("n_sample", i64)]
        + [(name, f64) for name in ("fs", "fc", "bandwidth", "c", "t0")]
        + [(name, pointer) for name in ("ping_t0", "tx", "rx", "velocity", "weights", "boresight")]
        + [("beam_half_angle", f64), ("beam_shape", ctypes.c_int32), ("beam_taper", f64), ("beam_axis", pointer)]
        + [("ping_c", pointer), ("valid", pointer)]
    )


class Grid(ctypes.Structure):
    _fields_ = [
        ("struct_size", ctypes.c_size_t), ("height", i64), ("width", i64), ("first", f64 * 3), ("along", f64 * 3),
        ("down", f64 * 3), ("points", pointer), ("mask", pointer),
    ]  # fmt: skip


PROGRESS = ctypes.CFUNCTYPE(ctypes.c_int, f64, pointer)


class Options(ctypes.Structure):
    _fields_ = [
        ("struct_size", ctypes.c_size_t), ("tol", f64), ("dtype", ctypes.c_int32), ("threads", ctypes.c_int32),
        ("isa", ctypes.c_char_p), ("progress", PROGRESS), ("user", pointer), ("method", ctypes.c_int32),
    ]  # fmt: skip


@cache
def library():
    """The library that the package ships, with the types of what it returns."""
    found = ctypes.CDLL(pysas.get_library())
    found.pysas_strerror.restype = ctypes.c_char_p
    found.pysas_plan_execute.argtypes = [pointer] * 5
    found.pysas_plan_destroy.argtypes = [pointer]
    found.pysas_plan_destroy.restype = None
    for name in ("factorised_share", "seconds", "error"):
        number = getattr(found, f"pysas_plan_{name}")
        number.argtypes, number.restype = [pointer], f64
    found.pysas_plan_describe.argtypes = [pointer, ctypes.c_char_p, ctypes.c_size_t]
    found.pysas_plan_describe.restype = ctypes.c_size_t
    return found


def structs(echoes, grid, tol, keep, points=False):
    """The three structs, or two without a grid; arrays they point to are kept alive in `keep`."""

    def at(values):
        if values is None:
            return None
        keep.append(np.ascontiguousarray(values))
        return keep[-1].ctypes.data

    survey = Survey(
        ctypes.sizeof(Survey), echoes.n_ping, echoes.n_channel, echoes.n_sample, echoes.fs, echoes.fc,
        echoes.occupied_bandwidth, echoes.mean_speed, 0.0, at(echoes.start_time), at(echoes.tx), at(echoes.receivers),
        at(echoes.receiver_velocity),
    )  # fmt: skip
    survey.ping_c = None if isinstance(echoes.c, float) else at(echoes.speeds)
    survey.valid = None if echoes.valid is None else at(np.asarray(echoes.windows, dtype=np.int64))
    dtype = 0 if echoes.dtype == np.complex64 else 1
    options = Options(ctypes.sizeof(Options), tol, dtype, 2)
    if grid is None:
        return survey, None, options
    corner = grid.coordinates(np.array([0, 1, grid.shape[1]]))
    lines = Grid(ctypes.sizeof(Grid), *grid.shape)
    lines.first[:], lines.along[:], lines.down[:] = corner[0], corner[1] - corner[0], corner[2] - corner[0]
    if points:
        lines.points = at(grid.coordinates())
    if grid.mask is not None:
        lines.mask = at(grid.mask)
    return survey, lines, options


@dataclass(frozen=True)
class Call:
    """What a call came to: its code, the image (none with a code) and the share that went through trees."""

    code: int
    image: Any = None
    factorised_share: float = 0.0


def call(echoes, grid, tol, method=0, isa="", threads=2, weights=None):
    """Image any grid: by lines where it is these to the bit, else by the list of its points."""
    keep = []
    flat = grid.coordinates().reshape(-1, grid.shape[-1], 3)
    down = flat[1, 0] - flat[0, 0] if len(flat) > 1 else np.zeros(3)
    along = flat[0, 1] - flat[0, 0] if flat.shape[1] > 1 else np.zeros(3)
    even = flat[0, 0] + np.arange(flat.shape[1])[:, None] * along + np.arange(len(flat))[:, None, None] * down
    lines = Grid(ctypes.sizeof(Grid), *flat.shape[:2])
    lines.first[:], lines.along[:], lines.down[:] = flat[0, 0], along, down
    if not np.array_equal(even, flat):
        keep.append(np.ascontiguousarray(flat))
        lines.points = keep[-1].ctypes.data
    if grid.mask is not None:
        keep.append(np.ascontiguousarray(grid.mask, np.uint8))
        lines.mask = keep[-1].ctypes.data
    survey, _, options = structs(echoes, None, tol, keep)
    if weights is not None:
        survey.weights = weights.ctypes.data
    if echoes.beam is not None:
        beam = echoes.beam
        for name, value in (("boresight", beam.boresight), ("beam_axis", beam.axis)):
            if value is None:
                continue
            directions = np.broadcast_to(value, (echoes.n_ping, 3))
            keep.append(np.ascontiguousarray(directions / np.linalg.norm(directions, axis=1, keepdims=True)))
            setattr(survey, name, keep[-1].ctypes.data)
        survey.beam_half_angle, survey.beam_taper, survey.beam_shape = beam.half_angle, beam.taper, beam.shape == "fan"
    options.method, options.isa, options.threads = method, isa.encode() or None, threads
    plan = pointer()
    code = library().pysas_plan_create(*map(ctypes.byref, (survey, lines, options)), ctypes.byref(plan))
    if code:
        return Call(code)
    data = echoes.traces
    step = (i64 * 3)(*(s // data.itemsize for s in data.strides))
    out = np.full(flat.shape[:2], np.nan, dtype=echoes.dtype)
    code = library().pysas_plan_execute(plan, data.ctypes.data, ctypes.cast(step, pointer), out.ctypes.data, None)
    share = library().pysas_plan_factorised_share(plan)
    library().pysas_plan_destroy(plan)
    return Call(code, None if code else out.reshape(grid.shape), share)
