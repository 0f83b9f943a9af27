"""Kernels of fast factorised back-projection in Numba: leaves, smoothing, one parent's rays, one tile read. See docs/ffbp.md.

The steps are those of csrc/kernels/factorised.inl; places and phases are in float64, weights and sums in float32. Neighbours
on a ray read neighbours in a child as long as they lie in the same interval: such runs are summed tap by tap, in loops that
LLVM vectorises. Everything here trusts its arguments but places, which are held within a sub-image's rows.
"""

# Types here are inferred by Numba from the arguments; mypy cannot see them.
# mypy: ignore-errors

from __future__ import annotations

import numpy as np
from numba import njit

from pysas.engine._numba import _FAST, NODES, WEIGHTS, _polynomial, sum_blocks, weights_at

ROWS = 32  # rays of a leaf at a time
WIDE = 8  # reals of a row that a read takes, whatever its taps
# columns of a sub-image's place and shape, see tree.py
PLANE, ANGLE, BEAM, STEP = 3, 4, 5, 6
I0, RAYS, STRIDE, OFFSET, RANGE = 0, 1, 2, 3, 4


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _turn(cycles, sines, cosines, re, im):
    """Multiply by exp(2j pi cycles), |cycles| <= 1/2."""
    for m in range(cycles.size):
        t = cycles[m]
        q = t * t
        sine, cosine = t * _polynomial(sines, q), _polynomial(cosines, q)
        a, b = re[m], im[m]
        re[m] = a * cosine - b * sine
        im[m] = a * sine + b * cosine


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _weigh(even, odd, x, out):
    """Weights `out` (taps, place) at places `x`, see tree.Taps."""
    pairs = even.shape[0]
    for p in range(pairs):
        first, second = out[p, : x.size], out[2 * pairs - 1 - p, : x.size]
        e, o = even[p], odd[p]
        if pairs == 3:
            e0, e1, e2, e3 = e[0], e[1], e[2], e[3]
            o0, o1, o2 = o[0], o[1], o[2]
            for m in range(x.size):
                q = x[m] * x[m]
                a = e0 + q * (e1 + q * (e2 + q * e3))
                b = x[m] * (o0 + q * (o1 + q * o2))
                first[m] = a + b
                second[m] = a - b
        else:
            e0, e1, e2, e3, e4 = e[0], e[1], e[2], e[3], e[4]
            o0, o1, o2, o3 = o[0], o[1], o[2], o[3]
            for m in range(x.size):
                q = x[m] * x[m]
                a = e0 + q * (e1 + q * (e2 + q * (e3 + q * e4)))
                b = x[m] * (o0 + q * (o1 + q * (o2 + q * o3)))
                first[m] = a + b
                second[m] = a - b


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _add_product(weight, re, im, out_re, out_im):
    for m in range(weight.size):
        w = weight[m]
        out_re[m] += w * re[m]
        out_im[m] += w * im[m]


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _smooth(filter, source, out):
    """Filter a row; `half` places at each of its ends stay as they are."""
    half = filter.size - 1
    count = source.size - 2 * half
    if count <= 0:
        return
    to, middle = out[half : half + count], source[half : half + count]
    f = filter[0]
    for m in range(count):
        to[m] = f * middle[m]
    for k in range(1, half + 1):
        f = filter[k]
        before, behind = source[half - k : half - k + count], source[half + k : half + k + count]
        for m in range(count):
            to[m] += f * (before[m] + behind[m])


@njit(nogil=True, cache=True)
def smooth_along(shape, ranges, filter, ray, store):
    """Filter one ray of a sub-image along it, in place."""
    begin, end = ranges[shape[RANGE] + ray, 0], ranges[shape[RANGE] + ray, 1]
    if end - begin <= 2 * (filter.size - 1):
        return
    for part in range(2):
        at = shape[OFFSET] + (part * shape[RAYS] + ray) * shape[STRIDE]
        row = store[at + begin : at + end]
        _smooth(filter, row.copy(), row)


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def smooth_across(shape, ranges, filter, begin, end, store):
    """Filter columns [begin, end) of a sub-image across its rays, in place."""
    half, stride = filter.size - 1, shape[STRIDE]
    first, last = shape[RAYS], 0
    for r in range(shape[RAYS]):
        a, b = ranges[shape[RANGE] + r, 0], ranges[shape[RANGE] + r, 1]
        if a < end and b > begin and a < b:
            first = min(first, r)
            last = r + 1
    if last - first <= 2 * half:
        return
    wide = end - begin
    work = np.empty((last - first, wide), dtype=store.dtype)
    for part in range(2):
        at = shape[OFFSET] + part * shape[RAYS] * stride + begin
        for r in range(first, last):
            work[r - first] = store[at + r * stride : at + r * stride + wide]
        for r in range(half, last - first - half):
            to, middle = store[at + (first + r) * stride : at + (first + r) * stride + wide], work[r]
            f = filter[0]
            for m in range(wide):
                to[m] = f * middle[m]
            for k in range(1, half + 1):
                f = filter[k]
                before, behind = work[r - k], work[r + k]
                for m in range(wide):
                    to[m] += f * (before[m] + behind[m])


@njit(nogil=True, cache=True)
def _ground(slant, height):
    """Ground distance at a slant range; 0 where the ground is farther."""
    return np.sqrt(max(slant * slant - height * height, 0.0))


@njit(nogil=True, cache=True)
def leaf(
    place, shape, ranges, begin, end, geometry, model, kind, coefficients, nodes, fit, half, sin_terms, cos_terms, pairs, wave,
    sines, cosines, lattice, axes, store,
):  # fmt: skip
    """Sum nodes [begin, end) of all rays of a leaf, its carrier taken away; `lattice` (y, x, trace) as of Survey, or empty."""
    rays, stride, offset, first = shape[RAYS], shape[STRIDE], shape[OFFSET], shape[RANGE]
    height = place[2] - place[PLANE]
    chosen = np.empty(ROWS, dtype=np.int64)
    ray = 0
    while ray < rays:
        # rays that have nodes here, and what of the stretch they need
        rows, low, high = 0, end, begin
        while rows < ROWS and ray < rays:
            a, b = max(ranges[first + ray, 0], begin), min(ranges[first + ray, 1], end)
            if a < b:
                low, high = min(low, a), max(high, b)
                chosen[rows] = ray
                rows += 1
            ray += 1
        if rows == 0:
            break
        count = high - low
        px, py, node_points = np.empty(rows * count), np.empty(rows * count), np.empty((3, NODES * rows))
        node_points[2] = place[PLANE]
        for r in range(rows):
            angle = place[ANGLE] + chosen[r] * place[BEAM]
            ex, ey = np.cos(angle), np.sin(angle)
            for m in range(count):
                ground = _ground((shape[I0] + low + m) * place[STEP], height)
                px[r * count + m] = place[0] + ground * ex
                py[r * count + m] = place[1] + ground * ey
            for j in range(NODES):
                ground = _ground((shape[I0] + low + (nodes[j] + 1) * (count - 1) / 2) * place[STEP], height)
                node_points[0, j * rows + r] = place[0] + ground * ex
                node_points[1, j * rows + r] = place[1] + ground * ey
        x = np.zeros(count, dtype=store.dtype)
        cycles = np.empty(count, dtype=store.dtype)
        for m in range(count):
            if count > 1:
                x[m] = 2.0 * m / (count - 1) - 1
            turns = -wave * (shape[I0] + low + m) * place[STEP]
            cycles[m] = turns - np.floor(turns + 0.5)
        out = np.zeros((rows, count), dtype=np.complex64)
        weights = np.empty((rows, WEIGHTS, 0), dtype=np.float32)
        if lattice.shape[2]:
            ends = np.empty((2, WEIGHTS * rows))
            for i in range(WEIGHTS * rows):
                angle = place[ANGLE] + chosen[i // WEIGHTS] * place[BEAM]
                ground = _ground((shape[I0] + low + (count - 1) * (i % WEIGHTS) / (WEIGHTS - 1)) * place[STEP], height)
                ends[0, i], ends[1, i] = place[0] + ground * np.cos(angle), place[1] + ground * np.sin(angle)
            weights = weights_at(lattice, axes, ends[0], ends[1]).reshape(rows, WEIGHTS, -1)
        sum_blocks(
            px, py, np.full(rows * count, place[PLANE]), node_points, True, np.ones(rows, dtype=np.bool_), geometry, model,
            kind, coefficients, x, fit, half, sin_terms, cos_terms, pairs, weights, out,
        )  # fmt: skip
        for r in range(rows):
            at = offset + chosen[r] * stride + low
            re, im = store[at : at + count], store[at + rays * stride : at + rays * stride + count]
            for m in range(count):
                re[m] = out[r, m].real
                im[m] = out[r, m].imag
            _turn(cycles, sines, cosines, re, im)


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _cross(angle, aside, height, place, low, interval, x):
    """Rays of a child, as interval and place in it, that lie where a parent's ray crosses its nodes low, low + 1, ..."""
    start, scale = angle / place[BEAM], 1.0 / place[BEAM]
    for m in range(x.size):
        slant = (low + m) * place[STEP]
        # guard nodes nearer than the foot see what they like, within the arcsine's reach
        q = aside / np.sqrt(max(slant * slant - height * height, 9 * aside * aside + 1e-30))
        s = q * q
        # arcsin of |q| < 0.4, to 2e-10
        tail = 945.0 / 42240 + s * (
            10395.0 / 599040 + s * (135135.0 / 9676800 + s * (2027025.0 / 175472640 + s * 34459425.0 / 3530096640))
        )
        p = start + scale * (q + q * s * (1.0 / 6 + s * (3.0 / 40 + s * (15.0 / 336 + s * (105.0 / 3456 + s * tail)))))
        k = np.floor(p)
        interval[m] = np.int32(k)
        x[m] = p - k - 0.5


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _drift(first, along, aside, heights, step, low, wave, interval, x, cycles):
    """Nodes of a child's line where those of the parent's ray lie, as interval less node, and turns between their carriers."""
    inverse, turn = 1.0 / step, wave * step
    away, parent = heights[0] * heights[0] + aside * aside, heights[1] * heights[1]
    for m in range(x.size):
        slant = (first + m) * step
        y = np.sqrt(max(slant * slant - parent, 0.0)) + along
        there = np.sqrt(y * y + away) * inverse
        p = there - low - m
        k = np.floor(p)
        interval[m] = np.int32(k)
        x[m] = p - k - 0.5
        turns = turn * (there - (first + m))
        cycles[m] = turns - np.floor(turns + 0.5)


@njit(nogil=True, cache=True)
def merge(
    place,
    shape,
    ranges,
    store,
    first_ray,
    last_ray,
    places,
    shapes,
    below,
    even,
    odd,
    filter,
    wave,
    sines,
    cosines,
    add,
    smooth,
):
    """Rays [first_ray, last_ray) of a parent from its children, which `below` holds; added to what it holds with `add`.

    A child is read across its rays where the parent's ray crosses its nodes, filtered along, then read along.
    """
    width, half, step = 2 * even.shape[0], filter.size - 1, place[STEP]
    room = shape[STRIDE]
    for c in range(shapes.shape[0]):
        room = max(room, shapes[c, STRIDE])
    interval, x, cycles = np.empty(room, dtype=np.int32), np.empty(room, dtype=store.dtype), np.empty(room, dtype=store.dtype)
    weight = np.empty((width, room), dtype=store.dtype)
    line, even_line = np.zeros((2, room), dtype=store.dtype), np.zeros((2, room), dtype=store.dtype)
    got, total = np.zeros((2, room), dtype=store.dtype), np.zeros((2, room), dtype=store.dtype)
    heights = np.empty(2)
    heights[1] = place[2] - place[PLANE]
    for ray in range(first_ray, last_ray):
        begin, end = ranges[shape[RANGE] + ray, 0], ranges[shape[RANGE] + ray, 1]
        count = end - begin
        if count <= 0:
            continue
        angle = place[ANGLE] + ray * place[BEAM]
        ex, ey = np.cos(angle), np.sin(angle)
        first = shape[I0] + begin
        row = shape[OFFSET] + ray * shape[STRIDE] + begin
        plane = shape[RAYS] * shape[STRIDE]
        if add:
            total[0, :count] = store[row : row + count]
            total[1, :count] = store[row + plane : row + plane + count]
        else:
            total[:, :count] = 0
        for c in range(shapes.shape[0]):
            vx, vy = place[0] - places[c, 0], place[1] - places[c, 1]
            along, aside = vx * ex + vy * ey, vy * ex - vx * ey
            heights[0] = places[c, 2] - places[c, PLANE]
            away = aside * aside + heights[0] * heights[0]
            y0 = _ground(first * step, heights[1]) + along
            y1 = _ground((first + count - 1) * step, heights[1]) + along
            i0, stride, rays = shapes[c, I0], shapes[c, STRIDE], shapes[c, RAYS]
            low = max(i0, np.int64(np.floor(np.sqrt(y0 * y0 + away) / step)) - width // 2 - half)
            high = np.int64(np.floor(np.sqrt(y1 * y1 + away) / step)) + width // 2 + 2 + half
            length = min(high - low, stride - (low - i0))
            if length <= 0:
                continue
            # along the child's rows: what it holds where the parent's ray crosses them
            _cross(angle - places[c, ANGLE], aside, heights[0], places[c], low, interval[:length], x[:length])
            _weigh(even, odd, x[:length], weight)
            line[:, :length] = 0
            m = 0
            while m < length:
                k, begin_run = interval[m], m
                while m < length and interval[m] == k:
                    m += 1
                r = min(max(np.int64(k) - (width // 2 - 1), 0), rays - width)
                for t in range(width):
                    at = shapes[c, OFFSET] + (r + t) * stride + low - i0
                    re, im = at + begin_run, at + rays * stride + begin_run
                    _add_product(
                        weight[t, begin_run:m], below[re : re + m - begin_run], below[im : im + m - begin_run],
                        line[0, begin_run:m], line[1, begin_run:m],
                    )  # fmt: skip
            # smoothed here and not on the child's own rays: the parent's ray crosses them
            for part in range(2):
                _smooth(filter, line[part, :length], even_line[part, :length])
            # along the parent's ray, turned from the child's carrier to the parent's
            _drift(first, along, aside, heights, step, low, wave, interval[:count], x[:count], cycles[:count])
            _weigh(even, odd, x[:count], weight)
            got[:, :count] = 0
            m = 0
            while m < count:
                k, begin_run = interval[m], m
                while m < count and interval[m] == k:
                    m += 1
                shift = np.int64(k) - (width // 2 - 1)
                lo, hi = max(begin_run, -shift), min(m, length - width + 1 - shift)
                if lo >= hi:
                    continue
                for t in range(width):
                    _add_product(
                        weight[t, lo:hi], even_line[0, lo + shift + t : hi + shift + t],
                        even_line[1, lo + shift + t : hi + shift + t], got[0, lo:hi], got[1, lo:hi],
                    )  # fmt: skip
            _turn(cycles[:count], sines, cosines, got[0, :count], got[1, :count])
            for part in range(2):
                a, b = total[part, :count], got[part, :count]
                for m in range(count):
                    a[m] += b[m]
        for part in range(2):
            to = store[row + part * plane : row + part * plane + count]
            if smooth:
                _smooth(filter, total[part, :count], to)
            else:
                to[:] = total[part, :count]


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _locate(place, i0, line, unit, angle, wave, beams, nodes, xb, xn, cycles):
    """Rays and nodes of a sub-image that a line of pixels is read at, and its carrier's turns there."""
    ex, ey = unit
    for m in range(xb.size):
        px, py = line[0] + m * line[3] - place[0], line[1] + m * line[4] - place[1]
        drop = line[2] + m * line[5] - place[2]
        depth, side = px * ex + py * ey, py * ex - px * ey
        q = min(max(side / depth, -0.5), 0.5)
        s = q * q
        # arctan of |q| < 0.35, to 1e-9
        tail = 1.0 / 9 + s * (-1.0 / 11 + s * (1.0 / 13 + s * (-1.0 / 15 + s * (1.0 / 17))))
        bearing = q + q * s * (-1.0 / 3 + s * (1.0 / 5 + s * (-1.0 / 7 + s * tail)))
        slant = np.sqrt(side * side + depth * depth + drop * drop)
        p = (bearing + angle) / place[BEAM]
        k = np.floor(p)
        beams[m] = np.int32(k)
        xb[m] = p - k - 0.5
        p = slant / place[STEP] - i0
        k = np.floor(p)
        nodes[m] = np.int32(k)
        xn[m] = p - k - 0.5
        turns = wave * slant
        cycles[m] = turns - np.floor(turns + 0.5)


@njit(nogil=True, cache=True, fastmath=_FAST, error_model="numpy")
def _gather(store, at, plane, stride, width, across, along):
    """Sum of WIDE nodes of `width` rows, weighted: node by node over all rows first, which LLVM makes vectors of."""
    zero = np.float32(0)
    a0, a1, a2, a3, a4, a5, a6, a7 = zero, zero, zero, zero, zero, zero, zero, zero
    b0, b1, b2, b3, b4, b5, b6, b7 = zero, zero, zero, zero, zero, zero, zero, zero
    for t in range(width):
        w = across[t]
        k = np.uintp(at + t * stride)
        a0 += w * store[k]
        a1 += w * store[k + np.uintp(1)]
        a2 += w * store[k + np.uintp(2)]
        a3 += w * store[k + np.uintp(3)]
        a4 += w * store[k + np.uintp(4)]
        a5 += w * store[k + np.uintp(5)]
        a6 += w * store[k + np.uintp(6)]
        a7 += w * store[k + np.uintp(7)]
        k += np.uintp(plane)
        b0 += w * store[k]
        b1 += w * store[k + np.uintp(1)]
        b2 += w * store[k + np.uintp(2)]
        b3 += w * store[k + np.uintp(3)]
        b4 += w * store[k + np.uintp(4)]
        b5 += w * store[k + np.uintp(5)]
        b6 += w * store[k + np.uintp(6)]
        b7 += w * store[k + np.uintp(7)]
    a0, a1, a2, a3 = a0 * along[0], a1 * along[1], a2 * along[2], a3 * along[3]
    a4, a5, a6, a7 = a4 * along[4], a5 * along[5], a6 * along[6], a7 * along[7]
    b0, b1, b2, b3 = b0 * along[0], b1 * along[1], b2 * along[2], b3 * along[3]
    b4, b5, b6, b7 = b4 * along[4], b5 * along[5], b6 * along[6], b7 * along[7]
    return ((a0 + a4) + (a2 + a6)) + ((a1 + a5) + (a3 + a7)), ((b0 + b4) + (b2 + b6)) + ((b1 + b5) + (b3 + b7))


@njit(nogil=True, cache=True)
def read(place, shape, store, even, odd, wave, sines, cosines, lines, active, out):
    """Add what a sub-image holds at a tile's pixels lines[r, :3] + m lines[r, 3:], on its plane, to `out` (line, pixel)."""
    rows, count = out.shape
    width, rays, stride = 2 * even.shape[0], shape[RAYS], shape[STRIDE]
    # angles are counted from that of the tile's middle
    middle = np.empty(2)
    for i in range(2):
        a, b = lines[0], lines[rows - 1]
        middle[i] = (a[i] + b[i] + (a[3 + i] + b[3 + i]) * (count - 1) / 2) / 2 - place[i]
    away = np.sqrt(middle[0] ** 2 + middle[1] ** 2)
    unit = (middle[0] / away, middle[1] / away)
    angle = np.arctan2(unit[1], unit[0]) - place[ANGLE]
    angle -= 2 * np.pi * np.floor((angle - (rays * place[BEAM] - 2 * np.pi) / 2) / (2 * np.pi))
    beams, nodes = np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32)
    xb, xn, cycles = (
        np.empty(count, dtype=store.dtype),
        np.empty(count, dtype=store.dtype),
        np.empty(count, dtype=store.dtype),
    )
    weight = np.empty((width, count), dtype=store.dtype)
    across, along = np.zeros((count, WIDE), dtype=store.dtype), np.zeros((count, WIDE), dtype=store.dtype)
    re, im = np.empty(count, dtype=store.dtype), np.empty(count, dtype=store.dtype)
    for r in range(rows):
        if not active[r]:
            continue
        _locate(place, shape[I0], lines[r], unit, angle, wave, beams, nodes, xb, xn, cycles)
        _weigh(even, odd, xb, weight)
        across[:, :width] = weight.T
        _weigh(even, odd, xn, weight)
        along[:, :width] = weight.T
        for m in range(count):
            j = min(max(np.int64(beams[m]) - (width // 2 - 1), 0), rays - width)
            i = min(max(np.int64(nodes[m]) - (width // 2 - 1), 0), stride - WIDE)
            re[m], im[m] = _gather(store, shape[OFFSET] + j * stride + i, rays * stride, stride, width, across[m], along[m])
        _turn(cycles, sines, cosines, re, im)
        for m in range(count):
            out[r, m] += complex(re[m], im[m])
