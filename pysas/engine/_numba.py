"""Back-projection kernels in Numba: the sum over traces for one tile of pixels, without the GIL.

A row of up to BLOCK pixels and a trace make a block. Where the planner allows it a block's delay is a polynomial of degree
4 through exact delays at its five Chebyshev nodes (float64), carried into `real` as an offset from the block's centre;
elsewhere every pixel's delay is exact in float64. Interval number, position in the interval and phase in turns follow per
pixel; `_add_terms` then evaluates the interval's polynomial and adds it to the accumulators for SLOTS traces at a time.
Everything here trusts its arguments. The kernels are specialised by the lengths of the tuples they are given: the number
of coefficient pairs and of sine and cosine terms. They use no `parallel=True`: threads belong to the caller.
"""

# Types here are inferred by Numba from the arguments; mypy cannot see them.
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

from pysas.engine._numba_reach import (
    ACROSS,
    FC,
    FIRST,
    FS,
    FULL_ANGLE,
    HALF_ANGLE,
    INTERVAL,
    KEPT,
    LAST,
    NEAR,
    OUTSIDE,
    RATE,
    RUN,
    RX,
    SHAPE,
    T0,
    TX,
    VELOCITY,
    C,
    beam_weight,
    line_reach,
    off_middle,
    reach,
)
from pysas.engine.traces import BLOCK, MONOSTATIC, NO_BEAM, STOP_AND_HOP
from pysas.model.echoes import EDGE

SLOTS = 4
NODES = 5
WEIGHTS = 5  # places along a block at which its weights are looked up
_FLAGS = ("contract",)
_FAST = {"contract", "nsz"}


def _fma(builder, a, b, c):
    """a b + c, one instruction where the machine has it."""
    return builder.fadd(builder.fmul(a, b, flags=_FLAGS), c, flags=_FLAGS)


@intrinsic
def _polynomial(typingctx, coefficients, x):
    """sum_q coefficients[q] x^q, unrolled as Horner in x^2 over pairs: half the latency of plain Horner, which bounds it."""

    def codegen(context, builder, signature, args):
        x = args[1]
        values = cgutils.unpack_tuple(builder, args[0], signature.args[0].count)

        square = builder.fmul(x, x)
        total = None
        for q in range((len(values) - 1) // 2 * 2, -1, -2):
            pair = _fma(builder, values[q + 1], x, values[q]) if q + 1 < len(values) else values[q]
            total = pair if total is None else _fma(builder, total, square, pair)
        return total

    return x(coefficients, x), codegen


@intrinsic
def _add_terms(typingctx, pairs, coefficients, interval, t2, cosines, sines, m, sums, first):
    """Add SLOTS traces' terms of pixel `m` of a block to its eight partial sums, sums[first + 8 m ...].

    A row of `coefficients` holds an interval's complex polynomial coefficients (c0, c1), (c2, c3), ... One vector of four
    reals is a pair: even powers in the lower half, odd ones in the upper. With w = pair0 + t^2 (pair1 + ...), the sample is
    w_even + t w_odd; `cosines` holds (cos, t cos) and `sines` (sin, t sin), so each is one multiply-add on all four.
    Written as vectors because LLVM does not find this form in scalar code; the vectors are legal on every target.
    """
    count = pairs.count
    signature = types.void(pairs, coefficients, interval, t2, cosines, sines, m, sums, first)

    def codegen(context, builder, signature, args):
        _, rows, k, squares, cc, ss, pixel, acc, origin = (
            None if i == 0 else context.make_array(t)(context, builder, value=a).data if isinstance(t, types.Array) else a
            for i, (t, a) in enumerate(zip(signature.args, args, strict=True))
        )
        real = context.get_value_type(signature.args[1].dtype)
        size = context.get_abi_sizeof(real)
        word, index = ir.IntType(32), pixel.type
        quad, double = ir.VectorType(real, 4), ir.VectorType(real, 2)

        def const(n):
            return ir.Constant(index, n)

        def load(pointer, offset, kind):
            value = builder.load(builder.bitcast(builder.gep(pointer, [offset]), ir.PointerType(kind)))
            value.align = size
            return value

        def spread(value, kind, pattern):
            mask = ir.Constant(ir.VectorType(word, 4), pattern)
            return builder.shuffle_vector(value, ir.Constant(kind, ir.Undefined), mask)

        place = builder.add(builder.mul(pixel, const(8)), origin)
        halves = [load(acc, place, quad), load(acc, builder.add(place, const(4)), quad)]
        for slot in range(SLOTS):
            at = builder.add(pixel, const(slot * BLOCK))
            row = builder.mul(builder.sext(builder.load(builder.gep(k, [at])), index), const(4 * count))
            w = load(rows, builder.add(row, const(4 * (count - 1))), quad)
            if count > 1:
                square = builder.load(builder.gep(squares, [at]))
                square = builder.insert_element(ir.Constant(quad, ir.Undefined), square, ir.Constant(word, 0))
                square = spread(square, quad, [0, 0, 0, 0])
                for q in range(count - 2, -1, -1):
                    w = _fma(builder, w, square, load(rows, builder.add(row, const(4 * q)), quad))
            twice = builder.mul(at, const(2))
            for half, factors in enumerate((cc, ss)):
                factor = spread(load(factors, twice, double), double, [0, 0, 1, 1])
                halves[half] = _fma(builder, w, factor, halves[half])
        for half, value in enumerate(halves):
            pointer = builder.bitcast(builder.gep(acc, [builder.add(place, const(4 * half))]), ir.PointerType(quad))
            builder.store(value, pointer).align = size
        return context.get_dummy_value()

    return signature, codegen


@njit(nogil=True, cache=True, fastmath=_FAST)
def _delays(kind, g, x, y, z, count, out):
    """Two-way travel times, s. Moving: the positive root of (c^2 - v^2) tau^2 - 2 (c D - d.v) tau + D^2 - d^2 = 0."""
    c = g[C]
    tx, ty, tz = g[TX], g[TX + 1], g[TX + 2]
    rx, ry, rz = g[RX], g[RX + 1], g[RX + 2]
    if kind == MONOSTATIC:
        scale = 2.0 / c
        for i in range(count):
            out[i] = scale * np.sqrt((x[i] - tx) ** 2 + (y[i] - ty) ** 2 + (z[i] - tz) ** 2)
    elif kind == STOP_AND_HOP:
        scale = 1.0 / c
        for i in range(count):
            there = np.sqrt((x[i] - tx) ** 2 + (y[i] - ty) ** 2 + (z[i] - tz) ** 2)
            out[i] = scale * (there + np.sqrt((x[i] - rx) ** 2 + (y[i] - ry) ** 2 + (z[i] - rz) ** 2))
    else:
        vx, vy, vz = g[VELOCITY], g[VELOCITY + 1], g[VELOCITY + 2]
        a = c * c - (vx * vx + vy * vy + vz * vz)
        inverse = 1.0 / a
        for i in range(count):
            there2 = (x[i] - tx) ** 2 + (y[i] - ty) ** 2 + (z[i] - tz) ** 2
            dx, dy, dz = x[i] - rx, y[i] - ry, z[i] - rz
            b = c * np.sqrt(there2) - (dx * vx + dy * vy + dz * vz)
            out[i] = inverse * (b + np.sqrt(b * b + a * (dx * dx + dy * dy + dz * dz - there2)))


@njit(nogil=True, cache=True, fastmath=_FAST, inline="always")
def _factors(m, t, turns, sin_terms, cos_terms, cosines, sines):
    """Store (cos, t cos) and (sin, t sin) of a phase in turns within [-1/2, 1/2] as pair number `m`."""
    q = turns * turns
    sine = turns * _polynomial(sin_terms, q)
    cosine = _polynomial(cos_terms, q)
    # unsigned places: a signed one may count from the end, which costs a test and the vectors
    even, odd = np.uintp(2 * m), np.uintp(2 * m + 1)
    cosines[even] = cosine
    cosines[odd] = cosine * t
    sines[even] = sine
    sines[odd] = sine * t


@njit(nogil=True, cache=True, fastmath=_FAST)
def _block(x, c0, c1, c2, c3, c4, base, turns, ratio, half, sin_terms, cos_terms, at, interval, t2, cosines, sines):
    """Interval, squared position and phase factors of a block's pixels from its delay polynomial (in `real`).

    Written from place `at` on: slices of arrays would cost more than the arithmetic they save.
    """
    for m in range(x.size):
        xm = x[m]
        du = xm * ((c1 + xm * c2) + (xm * xm) * (c3 + xm * c4))
        u = c0 + du
        low = np.floor(u)
        interval[np.uintp(at + m)] = base + np.int32(low)
        t = u - low - half
        t2[np.uintp(at + m)] = t * t
        ph = turns + ratio * du
        _factors(at + m, t, ph - np.floor(ph + half), sin_terms, cos_terms, cosines, sines)


@njit(nogil=True, cache=True, fastmath=_FAST)
def _exact_block(kind, g, model, x, y, z, tau, part, sin_terms, cos_terms, at, interval, t2, cosines, sines):
    """The same from each pixel's own delay in float64; terms outside the record or the beam get weight 0, others that of the
    beam. Counts terms.

    `part` (2, BLOCK) of `real` carries position and phase from the float64 loop to the short one.
    """
    count = x.size
    _delays(kind, g, x, y, z, count, tau)
    first = np.int32(g[INTERVAL])
    terms = 0
    shape, half, full = model[SHAPE], model[HALF_ANGLE], model[FULL_ANGLE]
    beam_cosine, beam_sine, tapered = np.cos(half), np.sin(half), full < half
    for m in range(count):
        index = (tau[m] - g[T0]) * model[FS]
        counts = index >= g[FIRST] - EDGE and index <= g[LAST] + EDGE
        weight = 1.0
        if shape != NO_BEAM:
            sine, cosine, side = off_middle(shape, g, x[m] - g[TX], y[m] - g[TX + 1], z[m] - g[TX + 2])
            # sin(alpha - half) <= 0; cosines would not tell small angles apart
            counts = counts and side and sine * beam_cosine <= cosine * beam_sine
            if counts and tapered:
                weight = beam_weight(sine, cosine, full, half)
        terms += counts
        u = (min(max(index, g[FIRST]), g[LAST]) - g[KEPT]) * model[RATE] if counts else 0.0
        low = np.floor(u)
        interval[np.uintp(at + m)] = first + np.int32(low)
        position = u - low - 0.5
        part[0, m] = position
        t2[np.uintp(at + m)] = position * position
        turns = model[FC] * tau[m]
        part[1, m] = turns - np.floor(turns + 0.5)
        tau[m] = weight if counts else 0.0
    for m in range(count):
        _factors(at + m, part[0, m], part[1, m], sin_terms, cos_terms, cosines, sines)
    if terms < count or tapered:
        for m in range(count):
            if tau[m] < 1.0:
                for place in range(2 * (at + m), 2 * (at + m) + 2):
                    cosines[place] *= tau[m]
                    sines[place] *= tau[m]
    return terms


@njit(nogil=True, cache=True)
def _sphere(x, y, z):
    """Centre and radius of a sphere that holds all points."""
    centre = np.array([(x.min() + x.max()) / 2, (y.min() + y.max()) / 2, (z.min() + z.max()) / 2])
    radius = 0.0
    for i in range(x.size):
        radius = max(radius, (x[i] - centre[0]) ** 2 + (y[i] - centre[1]) ** 2 + (z[i] - centre[2]) ** 2)
    return centre, np.sqrt(radius) * (1 + 1e-12)


@njit(nogil=True, cache=True)
def _polynomials(kind, g, model, fit, nodes, tau, poly, start):
    """Delay polynomials of all blocks of a tile for one trace: `poly` (6, block) real, `start` (block,) interval number.

    poly[0..4]: intervals after `start` at x in [-1, 1]; poly[5]: turns of phase at the block's centre.
    """
    rows = start.size
    _delays(kind, g, nodes[0], nodes[1], nodes[2], NODES * rows, tau)
    scale = model[FS] * model[RATE]
    offset = (g[T0] * model[FS] + g[KEPT]) * model[RATE]
    fc, first = model[FC], np.int32(g[INTERVAL])
    for r in range(rows):
        u = tau[2 * rows + r] * scale - offset
        low = np.floor(u)
        start[r] = first + np.int32(low)
        poly[0, r] = u - low
        turns = fc * tau[2 * rows + r]
        poly[5, r] = turns - np.floor(turns + 0.5)
    for q in range(1, NODES):
        a, b, d, e = scale * fit[q, 0], scale * fit[q, 1], scale * fit[q, 3], scale * fit[q, 4]
        for r in range(rows):
            centre = tau[2 * rows + r]
            near = a * (tau[r] - centre) + b * (tau[rows + r] - centre)
            poly[q, r] = near + d * (tau[3 * rows + r] - centre) + e * (tau[4 * rows + r] - centre)


@njit(nogil=True, cache=True, inline="always")
def _between(place, first, step, n):
    """First of the four of n lattice places that a cubic goes through at `place`, and the factors of their values."""
    u = min(max((place - first) / step, 0.0), n - 1.0)
    begin = min(max(int(u) - 1, 0), n - 4)
    a = u - begin
    b, c, d = a - 1, a - 2, a - 3
    return begin, (-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6)


@njit(nogil=True, cache=True, fastmath=_FAST)
def weights_at(lattice, axes, x, y):
    """Weights (place, trace) at places x, y off a lattice (y, x, trace) of first place and steps `axes`: cubics."""
    out = np.zeros((x.size, lattice.shape[2]), dtype=lattice.dtype)
    for p in range(x.size):
        left, along = _between(x[p], axes[0], axes[2], lattice.shape[1])
        top, across = _between(y[p], axes[1], axes[3], lattice.shape[0])
        to = out[p]
        for j in range(4):
            for i in range(4):
                factor = lattice.dtype.type(across[j] * along[i])
                value = lattice[top + j, left + i]
                for k in range(to.size):
                    to[k] += factor * value[k]
    return out


@njit(nogil=True, cache=True, fastmath=_FAST)
def _weigh(weights, straight, x, at, cosines, sines):
    """Multiply a slot's factors by weights at five places along a block, or at every pixel."""
    third = x.dtype.type(4.0 / 3.0)
    p0, p1, p2, p3, p4 = third, third, third, third, third
    if straight:
        p0 = weights[2]
        even1, even2 = (weights[1] + weights[3]) / 2 - p0, (weights[0] + weights[4]) / 2 - p0
        odd1, odd2 = (weights[3] - weights[1]) / 2, (weights[4] - weights[0]) / 2
        p4, p3 = third * (even2 - 4 * even1), third * (odd2 - 2 * odd1)
        p2, p1 = even2 - p4, odd2 - p3
    for m in range(x.size):
        if straight:
            w = p0 + x[m] * (p1 + x[m] * (p2 + x[m] * (p3 + x[m] * p4)))
        else:
            w = weights[m]
        pair = 2 * (at + m)
        cosines[pair] *= w
        cosines[pair + 1] *= w
        sines[pair] *= w
        sines[pair + 1] *= w


@njit(nogil=True, cache=True)
def sum_blocks(
    px, py, pz, node_points, straight, active, geometry, model, kind, coefficients, x, fit, half, sin_terms, cos_terms, pairs,
    weights, out,
):  # fmt: skip
    """Add all traces of a batch to blocks of pixels (block * count,); returns how many terms.

    node_points : (3, NODES * block), node j of block b at j * blocks + b, where the delay polynomials are exact (used when
    `straight`). weights : (block, WEIGHTS, trace) where `straight`, at places evenly spaced along a block; (block, count,
    trace) elsewhere; no traces: every term weighs 1. The rest as in `sum_tile`.
    """
    rows, count = out.shape
    centre, radius = _sphere(px, py, pz)

    traces = np.empty(geometry.shape[0], dtype=np.int64)
    place = np.empty(geometry.shape[0], dtype=np.int64)
    near = np.empty(geometry.shape[0], dtype=np.bool_)
    found = 0
    for trace in range(geometry.shape[0]):
        where, nearest = reach(geometry[trace], model, centre, radius)
        if where != OUTSIDE:
            traces[found], place[found], near[found] = trace, where, nearest < model[NEAR]
            found += 1

    sums = np.zeros(rows * 8 * count, dtype=x.dtype)
    interval = np.zeros(SLOTS * BLOCK, dtype=np.int32)
    t2 = np.zeros(SLOTS * BLOCK, dtype=x.dtype)
    cosines = np.zeros(SLOTS * 2 * BLOCK, dtype=x.dtype)
    sines = np.zeros(SLOTS * 2 * BLOCK, dtype=x.dtype)
    poly = np.empty((SLOTS, NODES + 1, rows), dtype=x.dtype)
    start = np.empty((SLOTS, rows), dtype=np.int32)
    part = np.empty((2, BLOCK), dtype=x.dtype)
    tau = np.empty(max(BLOCK, NODES * rows))
    ratio = x.dtype.type(model[FC] / (model[FS] * model[RATE]))
    terms = 0
    run, totals = int(model[RUN]), np.zeros(0)
    for group in range(0, found, SLOTS):
        if run > 0 and group > 0 and group % run == 0:  # a running sum rounds by its length
            if totals.size == 0:
                totals = np.zeros(sums.size)
            for i in range(sums.size):
                totals[i] += sums[i]
                sums[i] = 0
        filled = min(SLOTS, found - group)
        for slot in range(filled):
            i = group + slot
            if straight and not near[i]:
                _polynomials(kind, geometry[traces[i]], model, fit, node_points, tau, poly[slot], start[slot])
        for r in range(rows):
            if not active[r]:
                continue
            used = False
            for slot in range(SLOTS):
                at = slot * BLOCK
                where, exact, i = OUTSIDE, False, group + slot
                if slot < filled:
                    where, exact = place[i], not straight or near[i]
                    if where == ACROSS and not exact:
                        lo, hi = r * count, (r + 1) * count
                        where = line_reach(geometry[traces[i]], model, px[lo:hi], py[lo:hi], pz[lo:hi])
                        exact = where == ACROSS
                if where == OUTSIDE:
                    interval[at : at + BLOCK] = 0
                    cosines[2 * at : 2 * (at + BLOCK)] = 0
                    sines[2 * at : 2 * (at + BLOCK)] = 0
                    continue
                used = True
                if exact:
                    lo, hi = r * count, (r + 1) * count
                    terms += _exact_block(
                        kind, geometry[traces[i]], model, px[lo:hi], py[lo:hi], pz[lo:hi], tau, part, sin_terms, cos_terms,
                        at, interval, t2, cosines, sines,
                    )  # fmt: skip
                else:
                    terms += count
                    _block(
                        x, poly[slot, 0, r], poly[slot, 1, r], poly[slot, 2, r], poly[slot, 3, r], poly[slot, 4, r],
                        start[slot, r], poly[slot, 5, r], ratio, half, sin_terms, cos_terms, at, interval, t2, cosines, sines,
                    )  # fmt: skip
                if weights.shape[2]:
                    _weigh(weights[r, :, traces[i]], straight, x, at, cosines, sines)
            if used:
                for m in range(count):
                    _add_terms(pairs, coefficients, interval, t2, cosines, sines, m, sums, r * 8 * count)
    for r in range(rows):
        for m in range(count):
            place = 8 * (r * count + m)
            a = sums[place : place + 8]
            if totals.size:
                b = totals[place : place + 8]
                re, im = b[0] + b[2] - b[5] - b[7], b[1] + b[3] + b[4] + b[6]
                out[r, m] += complex(re + (a[0] + a[2] - a[5] - a[7]), im + (a[1] + a[3] + a[4] + a[6]))
            else:
                out[r, m] += complex(a[0] + a[2] - a[5] - a[7], a[1] + a[3] + a[4] + a[6])
    return terms


@njit(nogil=True, cache=True)
def sum_tile(
    coords, blocks, straight, active, geometry, model, kind, coefficients, x, nodes, fit, half, sin_terms, cos_terms, pairs,
    lattice, axes, out,
):  # fmt: skip
    """Add all traces of a batch to one tile of pixels.

    Parameters
    ----------
    coords : (block * count, 3) float64, or (0, 3)
        Pixels; when empty, block b is the line blocks[b, :3] + m blocks[b, 3:], m = 0 .. count - 1.
    blocks : (block, 6) float64
        First pixel and step of each block (used when `straight`).
    straight : bool
        Blocks are evenly spaced lines: polynomials may be used.
    active : (block,) bool
        Blocks with any pixel to image.
    geometry, model : (trace, real) and (real,) float64
        Reals of traces.TRACE and traces.MODEL.
    coefficients : (interval * 4 * len(pairs),) real
    x, nodes, fit : (count,) real, (NODES,) and (NODES, NODES) float64
        Positions in a block in [-1, 1], Chebyshev nodes, node values to monomials.
    half : real
        0.5 in the type of the arithmetic.
    sin_terms, cos_terms, pairs : tuples
    lattice, axes : (y, x, trace) float32, weights of the terms, or no traces; its first place and steps, x, y, dx, dy; or
        (block, count, trace), each pixel's own, and nothing
    out : (block, count) complex
        Added to.

    Returns
    -------
    int
        Terms summed.
    """
    rows, count = out.shape
    size = rows * count
    px, py, pz = np.empty(size), np.empty(size), np.empty(size)
    if coords.shape[0]:
        for i in range(size):
            px[i], py[i], pz[i] = coords[i, 0], coords[i, 1], coords[i, 2]
    else:
        for r in range(rows):
            for m in range(count):
                px[r * count + m] = blocks[r, 0] + m * blocks[r, 3]
                py[r * count + m] = blocks[r, 1] + m * blocks[r, 4]
                pz[r * count + m] = blocks[r, 2] + m * blocks[r, 5]
    node_points = np.empty((3, NODES * rows))
    for j in range(NODES):
        for r in range(rows):
            for axis in range(3):
                middle = blocks[r, axis] + blocks[r, 3 + axis] * (count - 1) / 2
                node_points[axis, j * rows + r] = middle + nodes[j] * blocks[r, 3 + axis] * (count - 1) / 2
    weights = np.empty((rows, WEIGHTS, 0), dtype=lattice.dtype)
    if axes.size == 0:
        weights = lattice
    elif lattice.shape[2]:
        if straight:
            ends = np.empty((2, WEIGHTS * rows))
            for r in range(rows):
                for j in range(WEIGHTS):
                    along = (count - 1) * j / (WEIGHTS - 1)
                    for axis in range(2):
                        ends[axis, WEIGHTS * r + j] = blocks[r, axis] + along * blocks[r, 3 + axis]
            weights = weights_at(lattice, axes, ends[0], ends[1]).reshape(rows, WEIGHTS, -1)
        else:
            weights = weights_at(lattice, axes, px, py).reshape(rows, count, -1)
    return sum_blocks(
        px, py, pz, node_points, straight, active, geometry, model, kind, coefficients, x, fit, half, sin_terms, cos_terms,
        pairs, weights, out,
    )  # fmt: skip
