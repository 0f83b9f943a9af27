// The sum over traces for one tile of pixels. Included inside a namespace of one instruction set, after its vector
// types Float and Double.
//
// A line of up to `block` pixels and a trace: the delay is a polynomial through exact delays at Chebyshev nodes
// (float64), carried into the type of the arithmetic as an offset from the block's centre. Per vector of pixels: offset
// in intervals, interval and position in it, phase in turns, the interval's polynomial, one complex multiply-add.

#include "kernels/delay.inl"
#include "kernels/interpolation.inl"
#include "kernels/phase.inl"

template <typename Real>
constexpr Real magic() {  // adding and subtracting it rounds to the nearest integer, which stands in the low bits
    return sizeof(Real) == 4 ? Real(12582912.0) : Real(6755399441055744.0);
}

// Delay polynomials of a tile's lines for one trace.
template <class V, int N>
struct Polynomials {
    static constexpr int subs = block / V::n;
    using real = typename V::real;
    alignas(64) real coefficient[N - 1][tile_rows];  // of x^1 ..., in intervals
    alignas(64) real turns[tile_rows];               // of the carrier at the block's centre
    alignas(64) real shift[subs][tile_rows];         // intervals from `base` to the block's centre
    alignas(64) std::int32_t base[subs][tile_rows];  // first interval that a vector of pixels touches
};

// Pixels of a tile at a block's nodes, and where its vectors of pixels begin and end.
template <class V, int N>
struct Places {
    static constexpr int subs = block / V::n;
    alignas(64) double x[N][tile_rows], y[N][tile_rows], z[N][tile_rows];
    double edge[subs + 1];
    int used;
};

// Fill `out`; returns the most intervals that a vector of pixels spans.
template <class V, int N, Kind K>
double polynomials(const Terms<typename V::real>& job, const Trace& trace, const Places<V, N>& at, int rows,
                   Polynomials<V, N>& out) {
    using D = Double;
    using vec = D::vec;
    const double scale = job.model.fs * job.model.rate;
    // half an interval: positions are counted from the intervals' middles
    const double offset = (trace.t0 * job.model.fs + trace.crop) * job.model.rate + 0.5;
    const double width = at.used > 0 ? at.edge[1] - at.edge[0] : 0.0;
    vec span = D::set(0.0);
    for (int r = 0; r < rows; r += D::n) {
        vec tau[N];
        for (int j = 0; j < N; ++j)
            tau[j] = delay<K>(trace, job.model.c, D::load(at.x[j] + r), D::load(at.y[j] + r), D::load(at.z[j] + r));
        const vec centre = tau[N / 2];
        for (int j = 0; j < N; ++j) tau[j] = D::sub(tau[j], centre);
        vec c[N - 1];
        vec bend = D::set(0.0);
        for (int q = 1; q < N; ++q) {
            vec sum = D::mul(D::set(scale * job.nodes.fit[q][0]), tau[0]);
            for (int j = 1; j < N; ++j) {
                if (j != N / 2) sum = D::fma(D::set(scale * job.nodes.fit[q][j]), tau[j], sum);
            }
            c[q - 1] = sum;
            D::store(out.coefficient[q - 1] + r, sum);
            bend = D::fma(D::set(q * (q - 1.0)), D::abs(sum), bend);
        }
        const vec turns = D::mul(D::set(job.model.fc), centre);
        D::store(out.turns + r, D::sub(turns, D::floor(D::add(turns, D::set(0.5)))));
        const vec u = D::fma(centre, D::set(scale), D::set(-offset));
        const vec low = D::floor(u);
        const vec part = D::sub(u, low);
        // a function whose second derivative is at most `bend` leaves the chord by at most width^2/8 of it
        const vec slack = D::fma(bend, D::set(width * width / 8), D::set(1e-3));
        const auto value = [&](double x) {
            vec sum = c[N - 2];
            for (int q = N - 3; q >= 0; --q) sum = D::fma(sum, D::set(x), c[q]);
            return D::fma(sum, D::set(x), part);
        };
        vec left = value(at.edge[0]);
        for (int s = 0; s < at.used; ++s) {
            const vec right = value(at.edge[s + 1]);
            // no pixel lies before the table, though the bound on where they lie may
            const vec first = D::max(D::floor(D::sub(D::min(left, right), slack)), D::sub(D::set(0.0), low));
            span = D::max(span, D::sub(D::add(D::max(left, right), slack), first));
            D::store(out.shift[s] + r, D::sub(part, first));
            D::store_index(out.base[s] + r, D::add(low, first));
            left = right;
        }
    }
    return D::largest(span);
}

// Add (re + j im)(cosine + j sine) to a vector of pixels.
template <class V>
void add_turned(typename V::vec re, typename V::vec im, typename V::vec sine, typename V::vec cosine,
                typename V::real* to_re, typename V::real* to_im) {
    V::store(to_re, V::fnma(im, sine, V::fma(re, cosine, V::load(to_re))));
    V::store(to_im, V::fma(im, cosine, V::fma(re, sine, V::load(to_im))));
}

// Weights of one trace's terms along a tile's lines, by vector of pixels as polynomials of the lane's place in [-1, 1].
template <class V>
struct Levels {
    static constexpr int subs = block / V::n;
    alignas(64) typename V::real power[subs][3][tile_rows];
};

// Places of a vector's lanes in [-1, 1].
template <class V>
typename V::vec lanes() {
    alignas(64) typename V::real place[V::n];
    for (int i = 0; i < V::n; ++i) place[i] = static_cast<typename V::real>(2.0 * i / (V::n - 1) - 1);
    return V::load(place);
}

template <class V>
void levels(const Weights<typename V::real>& weights, std::int64_t trace, int rows, int count, Levels<V>& out) {
    using real = typename V::real;
    using vec = typename V::vec;
    const real* value = weights.value + trace;
    const std::int64_t n = weights.n_trace;
    alignas(64) real at[weight_nodes][tile_rows];
    if (weights.lines == weight_nodes) {
        for (int j = 0; j < weight_nodes; ++j) {
            for (int r = 0; r < rows; r += V::n) {
                vec sum = V::set(0);
                for (int k = 0; k < weight_nodes; ++k)
                    sum = V::fma(V::load(weights.factor[k] + r), V::set(value[(weight_nodes * k + j) * n]), sum);
                V::store(at[j] + r, sum);
            }
        }
    } else {
        for (int r = 0; r < tile_rows; ++r) {
            for (int j = 0; j < weight_nodes; ++j) at[j][r] = r < rows ? value[(weight_nodes * r + j) * n] : 0;
        }
    }
    const vec half = V::set(real(0.5)), third = V::set(real(4.0 / 3));
    for (int r = 0; r < rows; r += V::n) {
        const vec middle = V::load(at[2] + r);
        const vec even1 = V::fma(half, V::add(V::load(at[1] + r), V::load(at[3] + r)), V::sub(V::set(0), middle));
        const vec even2 = V::fma(half, V::add(V::load(at[0] + r), V::load(at[4] + r)), V::sub(V::set(0), middle));
        const vec odd1 = V::mul(half, V::sub(V::load(at[3] + r), V::load(at[1] + r)));
        const vec odd2 = V::mul(half, V::sub(V::load(at[4] + r), V::load(at[0] + r)));
        const vec p4 = V::mul(third, V::fnma(V::set(4), even1, even2));
        const vec p3 = V::mul(third, V::fnma(V::set(2), odd1, odd2));
        const vec p[weight_nodes] = {middle, V::sub(odd2, p3), V::sub(even2, p4), p3, p4};
        const double length = (count > least_width ? count : least_width) - 1;
        const real wide = static_cast<real>((V::n - 1) / length);
        for (int s = 0; s * V::n < count; ++s) {
            // value, slope and curve in a vector's middle, by dividing by what leads to it again and again
            const vec at = V::set(static_cast<real>((2 * s * V::n + V::n - 1) / length - 1));
            vec q[weight_nodes];
            for (int i = 0; i < weight_nodes; ++i) q[i] = p[i];
            for (int k = 0; k < 3; ++k) {
                for (int i = weight_nodes - 2; i >= k; --i) q[i] = V::fma(q[i + 1], at, q[i]);
            }
            V::store(out.power[s][0] + r, q[0]);
            V::store(out.power[s][1] + r, V::mul(V::set(wide), q[1]));
            V::store(out.power[s][2] + r, V::mul(V::set(wide * wide), q[2]));
        }
    }
}

// Multiply by what vector `s` of a line weighs.
template <class V>
void weigh(const Levels<V>& level, int s, int r, typename V::vec lane, typename V::vec& sine, typename V::vec& cosine) {
    const auto& power = level.power[s];
    const auto w = V::fma(V::fma(V::set(power[2][r]), lane, V::set(power[1][r])), lane, V::set(power[0][r]));
    sine = V::mul(sine, w);
    cosine = V::mul(cosine, w);
}

// Vectors of a line's pixels.
struct Vectors {
    int begin, end;
};

// Add one trace's terms of some vectors of a tile's lines, or (`Whole`: a sixth faster) of all of those lines that have
// any. `x`: places of a block's pixels in [-1, 1]; `level`: their weights, or null.
template <bool Whole, class V, int N, int D, int T, int W>
void add_lines(const TileJob<typename V::real>& tile, const typename V::real* table, const Polynomials<V, N>& poly,
               const Levels<V>* level, const Phase<V, T> phase, const typename V::real* x, const Vectors* vectors) {
    using real = typename V::real;
    using vec = typename V::vec;
    const Terms<real>& job = *tile.terms;
    // copies: behind a pointer they would be read again after every store
    const std::int64_t stride = job.plane_stride;
    const int rows = tile.rows;
    real *const all_re = tile.re, *const all_im = tile.im;
    const vec ratio = V::set(static_cast<real>(job.model.fc / (job.model.fs * job.model.rate)));
    const vec round = V::set(magic<real>());
    const vec lane = lanes<V>();
    const int used = (tile.count + V::n - 1) / V::n;
    for (int r = 0; r < rows; ++r) {
        if (vectors[r].end == 0) continue;
        const int begin = Whole ? 0 : vectors[r].begin, end = Whole ? used : vectors[r].end;
        vec c[N - 1];
        for (int q = 0; q < N - 1; ++q) c[q] = V::set(poly.coefficient[q][r]);
        const vec turns = V::set(poly.turns[r]);
        // two short loops: in one, the chain from delay to sum is so long that the processor's scheduler, which holds
        // two vectors' instructions, waits for it
        alignas(64) real intervals[block], position[block], cycles[block];
        for (int s = begin; s < end; ++s) {
            const vec at = V::load(x + s * V::n);
            vec du = c[N - 2];
            for (int q = N - 3; q >= 0; --q) du = V::fma(du, at, c[q]);
            du = V::mul(du, at);
            const vec u = V::add(du, V::set(poly.shift[s][r]));
            const vec k = V::add(u, round);
            V::store(intervals + s * V::n, k);
            V::store(position + s * V::n, V::sub(u, V::sub(k, round)));
            const vec ph = V::fma(ratio, du, turns);
            V::store(cycles + s * V::n, V::sub(ph, V::sub(V::add(ph, round), round)));
        }
        for (int s = begin; s < end; ++s) {
            const vec k = V::load(intervals + s * V::n);
            vec sine, cosine, re, im;
            phase(V::load(cycles + s * V::n), sine, cosine);
            if (level) weigh<V>(*level, s, r, lane, sine, cosine);
            read<V, D, W>(table + poly.base[s][r], stride, W == 0 ? V::number(k) : V::bits(k),
                          V::load(position + s * V::n), re, im);
            add_turned<V>(re, im, sine, cosine, all_re + r * block + s * V::n, all_im + r * block + s * V::n);
        }
    }
}

// Add trace number `number`'s terms of vectors of line `r` from each pixel's own delay; terms outside the record or the
// beam weigh nothing.
template <class V, int D, int T, Kind K>
std::int64_t add_exact(const TileJob<typename V::real>& tile, std::int64_t number, const typename V::real* table,
                       const Levels<V>* level, const Phase<V, T>& phase, int r, Vectors vectors) {
    using real = typename V::real;
    using W = Double;
    const Terms<real>& job = *tile.terms;
    const Model& model = job.model;
    const Trace& trace = job.traces[number];
    alignas(64) double x[3][block];
    const int begin = vectors.begin * V::n, padded = vectors.end * V::n;  // by the last pixel
    const int end = padded < tile.count ? padded : tile.count;
    for (int m = begin; m < padded; ++m) {
        const int pixel = m < tile.count ? m : tile.count - 1;
        for (int axis = 0; axis < 3; ++axis) {
            x[axis][m] = tile.lines ? tile.lines[6 * r + axis] + pixel * tile.lines[6 * r + 3 + axis]
                                    : tile.points[3 * (r * tile.count + pixel) + axis];
        }
    }
    alignas(64) real position[block], turns[block], weight[block];
    alignas(64) std::int32_t interval[block];
    W::vec counted = W::set(0.0);
    const W::vec half = W::set(0.5);
    for (int m = begin; m < padded; m += W::n) {
        const W::vec px = W::load(x[0] + m), py = W::load(x[1] + m), pz = W::load(x[2] + m);
        const W::vec tau = delay<K>(trace, model.c, px, py, pz);
        const W::vec index = W::mul(W::sub(tau, W::set(trace.t0)), W::set(model.fs));
        W::vec counts = W::mul(W::one_where_le(W::set(0.0), index), W::one_where_le(index, W::set(model.last)));
        if (model.cos_beam > -1.0) {
            const W::vec dx = W::sub(px, W::set(trace.tx[0])), dy = W::sub(py, W::set(trace.tx[1])),
                         dz = W::sub(pz, W::set(trace.tx[2]));
            const W::vec distance = W::sqrt(W::fma(dx, dx, W::fma(dy, dy, W::mul(dz, dz))));
            const W::vec along = W::fma(dx, W::set(trace.boresight[0]),
                                        W::fma(dy, W::set(trace.boresight[1]), W::mul(dz, W::set(trace.boresight[2]))));
            counts = W::mul(counts, W::one_where_le(W::mul(W::set(model.cos_beam), distance), along));
        }
        // where a term does not count the index becomes the first kept sample's, which is in the table
        const W::vec u = W::mul(W::mul(counts, W::sub(index, W::set(trace.crop))), W::set(model.rate));
        const W::vec low = W::floor(u);
        W::store(position + m, W::sub(W::sub(u, low), half));
        W::store_index(interval + m, low);
        const W::vec cycles = W::mul(W::set(model.fc), tau);
        W::store(turns + m, W::sub(cycles, W::floor(W::add(cycles, half))));
        W::store(weight + m, counts);
        if (m + W::n <= tile.count) {
            counted = W::add(counted, counts);
        } else {
            alignas(64) double each[W::n];
            W::store(each, counts);
            for (int i = 0; i < W::n; ++i) each[i] = m + i < tile.count ? each[i] : 0.0;
            counted = W::add(counted, W::load(each));
        }
    }
    if (level) {
        for (int m = begin; m < end; ++m) {
            const auto& power = level->power[m / V::n];
            const double lane = 2.0 * (m % V::n) / (V::n - 1) - 1;
            weight[m] *= power[0][r] + lane * (power[1][r] + lane * power[2][r]);
        }
    } else if (tile.weights) {
        const real* own =
            tile.weights->value + static_cast<std::int64_t>(r) * tile.count * tile.weights->n_trace + number;
        for (int m = begin; m < end; ++m) weight[m] *= own[m * tile.weights->n_trace];
    }
    for (int m = begin; m < end; m += V::n) {
        typename V::vec sine, cosine, re, im;
        phase(V::load(turns + m), sine, cosine);
        std::int32_t first = interval[m], last = first;
        for (int i = 1; i < V::n; ++i) {
            first = interval[m + i] < first ? interval[m + i] : first;
            last = interval[m + i] > last ? interval[m + i] : last;
        }
        for (int i = 0; i < V::n; ++i) interval[m + i] -= first;
        read_within<V, D>(table + first, job.plane_stride, last - first, V::load_index(interval + m),
                          V::load(position + m), re, im);
        const auto w = V::load(weight + m);
        re = V::mul(re, w);
        im = V::mul(im, w);
        add_turned<V>(re, im, sine, cosine, tile.re + r * block + m, tile.im + r * block + m);
    }
    return static_cast<std::int64_t>(W::total(counted));
}

template <class V, int N, int D, int T, Kind K>
void sum_traces(TileJob<typename V::real>& tile) {
    using real = typename V::real;
    const Terms<real>& job = *tile.terms;
    const int rows = tile.rows, count = tile.count;
    const bool straight = tile.lines != nullptr;
    const Phase<V, T> phase(job.sine, job.cosine);

    alignas(64) real x[block];
    for (int m = 0; m < block; ++m)
        x[m] = static_cast<real>(m < count ? (count > 1 ? 2.0 * m / (count - 1) - 1 : 0.0) : 1.0);
    Places<V, N> at;
    at.used = (count + V::n - 1) / V::n;
    for (int s = 0; s <= at.used; ++s)
        at.edge[s] = count > 1 && s * V::n < count ? 2.0 * s * V::n / (count - 1) - 1 : 1.0;
    Segments segments;
    double corners[2 * tile_rows][3];
    double centre[3], radius;
    if (straight) {
        for (int r = 0; r < tile_rows; ++r) {
            const double* line = tile.lines + 6 * (r < rows ? r : rows - 1);  // rows beyond the last repeat it
            double reach2 = 0;
            for (int axis = 0; axis < 3; ++axis) {
                const double half = line[3 + axis] * (count - 1) / 2, middle = line[axis] + half;
                double* to = axis == 0 ? &at.x[0][r] : axis == 1 ? &at.y[0][r] : &at.z[0][r];
                for (int j = 0; j < N; ++j) to[j * tile_rows] = middle + job.nodes.at[j] * half;
                corners[2 * r][axis] = middle - half;
                corners[2 * r + 1][axis] = middle + half;
                segments.begin[axis][r] = middle - half;
                segments.along[axis][r] = 2 * half;
                reach2 += half * half;
            }
            segments.scale[r] = reach2 > 0 ? 1 / (4 * reach2) : 0.0;
        }
        radius = sphere(corners[0], 2 * rows, centre);
    } else {
        radius = sphere(tile.points, rows * count, centre);
    }

    for (int i = 0; i < tile_rows * block; ++i) tile.re[i] = tile.im[i] = 0;
    Polynomials<V, N> poly;
    std::int64_t evaluated = 0;
    Vectors vectors[tile_rows];
    Levels<V> scratch;
    const Levels<V>* level = straight && tile.weights ? &scratch : nullptr;
    int active = 0;
    for (int r = 0; r < rows; ++r) active += tile.active[r] != 0;
    for (std::int64_t i = 0; i < job.n_trace; ++i) {
        const Trace& trace = job.traces[i];
        const real* table = job.table + i * job.trace_stride;
        double nearest;
        const Reach where = reach(trace, job.model, centre, radius, nearest);
        if (where == Reach::outside) continue;
        if (!straight) {
            for (int r = 0; r < rows; ++r) {
                if (tile.active[r]) evaluated += add_exact<V, D, T, K>(tile, i, table, level, phase, r, {0, at.used});
            }
            continue;
        }
        if (level) levels<V>(*tile.weights, i, rows, count, scratch);
        bool whole = true;  // lines that have any vectors have all
        for (int r = 0; r < rows; ++r) vectors[r] = {0, tile.active[r] ? at.used : 0};
        if (where == Reach::across || nearest < job.model.near) {
            alignas(64) double least[2][tile_rows], most[2][tile_rows];
            distances(trace.tx, segments, rows, least[0], most[0]);
            if (K != Kind::monostatic) distances(trace.rx, segments, rows, least[1], most[1]);
            const int home = K == Kind::monostatic ? 0 : 1;
            const double speed = norm(trace.velocity[0], trace.velocity[1], trace.velocity[2]);
            bool any = false;
            for (int r = 0; r < rows; ++r) {
                if (vectors[r].end == 0) continue;
                const Reach heard =
                    window(trace, job.model, speed, least[0][r] + least[home][r], most[0][r] + most[home][r]);
                const Reach lit = beam(trace, job.model, segments, r, (count - 1) / 2.0, (count - 1) / 2.0, count);
                const bool far = least[0][r] >= job.model.near && least[home][r] >= job.model.near;
                if (heard != Reach::inside || lit != Reach::inside || !far) {
                    const bool simple = heard == Reach::inside && far;
                    vectors[r] = {0, 0};
                    if (heard == Reach::outside || lit == Reach::outside) continue;
                    Vectors exact = {0, 0};
                    for (int s = 0; s < at.used; ++s) {
                        const Reach part = lit == Reach::inside
                                               ? lit
                                               : beam(trace, job.model, segments, r, s * V::n + (V::n - 1) / 2.0,
                                                      (V::n - 1) / 2.0, count);
                        if (part == Reach::outside) continue;
                        Vectors& run = simple && part == Reach::inside && (vectors[r].end == 0 || vectors[r].end == s)
                                           ? vectors[r]
                                           : exact;
                        if (&run == &exact && run.end > 0 && run.end < s)
                            evaluated += add_exact<V, D, T, K>(tile, i, table, level, phase, r, run);
                        if (run.end < s || run.end == 0) run.begin = s;
                        run.end = s + 1;
                    }
                    if (exact.end > 0) evaluated += add_exact<V, D, T, K>(tile, i, table, level, phase, r, exact);
                }
                if (vectors[r].end == 0) continue;
                const int last = vectors[r].end * V::n;
                evaluated += (last < count ? last : count) - vectors[r].begin * V::n;
                any = true;
                whole = whole && vectors[r].begin == 0 && vectors[r].end == at.used;
            }
            if (!any) continue;
        } else {
            evaluated += static_cast<std::int64_t>(active) * count;
        }
        const double span = polynomials<V, N, K>(job, trace, at, rows, poly);
        constexpr int one = V::windows >= 1 ? 1 : 0, two = V::windows >= 2 ? 2 : 0, four = V::windows >= 4 ? 4 : 0;
        if (!whole && one == 1 && span < V::n - 0.5)
            add_lines<false, V, N, D, T, one>(tile, table, poly, level, phase, x, vectors);
        else if (!whole)
            add_lines<false, V, N, D, T, 0>(tile, table, poly, level, phase, x, vectors);
        else if (one == 1 && span < V::n - 0.5)
            add_lines<true, V, N, D, T, one>(tile, table, poly, level, phase, x, vectors);
        else if (two == 2 && span < 2 * V::n - 0.5)
            add_lines<true, V, N, D, T, two>(tile, table, poly, level, phase, x, vectors);
        else if (four == 4 && span < 4 * V::n - 0.5)
            add_lines<true, V, N, D, T, four>(tile, table, poly, level, phase, x, vectors);
        else
            add_lines<true, V, N, D, T, 0>(tile, table, poly, level, phase, x, vectors);
    }
    tile.evaluated = evaluated;
}

template <class V, int N, int D, int T>
void sum_kind(TileJob<typename V::real>& tile) {
    switch (tile.terms->kind) {
        case Kind::monostatic:
            return sum_traces<V, N, D, T, Kind::monostatic>(tile);
        case Kind::stop_and_hop:
            return sum_traces<V, N, D, T, Kind::stop_and_hop>(tile);
        case Kind::moving:
            return sum_traces<V, N, D, T, Kind::moving>(tile);
    }
}

template <class V, int N, int D, int Few, int Many>
void sum_trig(TileJob<typename V::real>& tile) {
    if (tile.terms->trig <= Few)
        sum_kind<V, N, D, Few>(tile);
    else
        sum_kind<V, N, D, Many>(tile);
}

// Polynomial lengths by type: few enough to compile, dense enough to lose little.
template <class V>
void sum_tile(TileJob<typename V::real>& tile) {
    if constexpr (sizeof(typename V::real) == 4) {
        switch (tile.terms->degree) {
            case 1:
                return sum_trig<V, 5, 1, 5, 6>(tile);
            case 2:
                return sum_trig<V, 5, 2, 5, 6>(tile);
            case 3:
                return sum_trig<V, 5, 3, 5, 6>(tile);
            case 4:
                return sum_trig<V, 5, 4, 5, 6>(tile);
            case 5:
                return sum_trig<V, 5, 5, 5, 6>(tile);
            default:
                return sum_trig<V, 5, 7, 5, 6>(tile);
        }
    } else {
        switch (tile.terms->degree) {
            case 3:
                return sum_trig<V, 7, 3, 8, 10>(tile);
            case 5:
                return sum_trig<V, 7, 5, 8, 10>(tile);
            case 7:
                return sum_trig<V, 7, 7, 8, 10>(tile);
            default:
                return sum_trig<V, 7, 9, 8, 10>(tile);
        }
    }
}
