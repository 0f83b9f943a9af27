// The sum over traces for one tile of pixels. Included inside a namespace of one instruction set, after its vector
// types Float and Double.
//
// A line of up to `block` pixels and a trace: the delay is a polynomial through exact delays at Chebyshev nodes
// (float64), carried into the type of the arithmetic as an offset from the block's centre. Per vector of pixels: offset
// in intervals, interval and position in it, phase in turns, the interval's polynomial, one complex multiply-add.

#include "kernels/delay.inl"
#include "kernels/interpolation.inl"
#include "kernels/phase.inl"
#include "kernels/weights.inl"

// after those four
#include "kernels/light.inl"

// after that
#include "kernels/exact.inl"

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

#include "kernels/shades.inl"

// Fill `out`; returns the most intervals that a vector of pixels spans.
template <class V, int N, Kind K>
double polynomials(const Terms<typename V::real>& job, const Trace& trace, const Places<V, N>& at, int rows,
                   Polynomials<V, N>& out) {
    using D = Double;
    using vec = D::vec;
    const double scale = job.model.fs * job.model.rate;
    // half an interval: positions are counted from the intervals' middles
    const double offset = (trace.t0 * job.model.fs + trace.kept) * job.model.rate + 0.5;
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

template <class V, int N>
double polynomials(const Terms<typename V::real>& job, const Trace& trace, const Places<V, N>& at, int rows,
                   Polynomials<V, N>& out) {
    switch (job.kind) {
        case Kind::monostatic:
            return polynomials<V, N, Kind::monostatic>(job, trace, at, rows, out);
        case Kind::stop_and_hop:
            return polynomials<V, N, Kind::stop_and_hop>(job, trace, at, rows, out);
        default:
            return polynomials<V, N, Kind::moving>(job, trace, at, rows, out);
    }
}

// Add one trace's terms of some vectors of a tile's lines, or (`Whole`: a sixth faster) of all of those lines that have
// any. `x`: places of a block's pixels in [-1, 1]; `level`: their weights, or null; `shades`: what they weigh for the
// beam, or null. Returns how many pixels weigh nothing for it.
template <bool Whole, class V, int N, int D, int T, int W>
std::int64_t add_lines(const TileJob<typename V::real>& tile, const typename V::real* table,
                       const Polynomials<V, N>& poly, const Levels<V>* level, const Shades<V, N>* shades,
                       const typename V::real* x, const Vectors* vectors) {
    using real = typename V::real;
    using vec = typename V::vec;
    const Terms<real>& job = *tile.terms;
    const Phase<V, T> phase(job.sine, job.cosine);
    // copies: behind a pointer they would be read again after every store
    const std::int64_t stride = job.plane_stride;
    const int rows = tile.rows;
    real *const all_re = tile.re, *const all_im = tile.im;
    const vec ratio = V::set(static_cast<real>(job.model.fc / (job.model.fs * job.model.rate)));
    const vec round = V::set(magic<real>());
    const vec lane = lanes<V>();
    const Fade<V, N> fade(job.light);
    const int used = (tile.count + V::n - 1) / V::n;
    std::int64_t dark = 0;
    for (int r = 0; r < rows; ++r) {
        if (vectors[r].end == 0) continue;
        const int begin = Whole ? 0 : vectors[r].begin, end = Whole ? used : vectors[r].end;
        alignas(64) real faded[block];
        const real* weight = nullptr;
        if (shades && shades->of[r] == Shade::each) weight = shades->each[r];
        if (shades && shades->of[r] == Shade::fading) {
            dark += fade(*shades, r, {begin, end}, tile.count, x, faded);
            weight = faded;
        }
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
            if (weight) {
                const vec w = V::load(weight + s * V::n);
                sine = V::mul(sine, w);
                cosine = V::mul(cosine, w);
            }
            read<V, D, W>(table + poly.base[s][r], stride, W == 0 ? V::number(k) : V::bits(k),
                          V::load(position + s * V::n), re, im);
            add_turned<V>(re, im, sine, cosine, all_re + r * block + s * V::n, all_im + r * block + s * V::n);
        }
    }
    return dark;
}

// The parts of a sum that polynomials' lengths are compiled into: lines of which some vectors are summed, their windows
// gathered or one register wide, whole lines (gathered, one, two or four), and pixels with their own delay.
template <class V, int N>
struct Adders {
    using real = typename V::real;
    using Lines = std::int64_t (*)(const TileJob<real>&, const real*, const Polynomials<V, N>&, const Levels<V>*,
                                   const Shades<V, N>*, const real*, const Vectors*);
    Lines part[2], whole[4];
    void (*exact)(const TileJob<real>&, const real*, Exact<V>&, int, Vectors);
};

template <class V, int N, int D, int T>
Adders<V, N> adders() {
    constexpr int one = V::windows >= 1 ? 1 : 0, two = V::windows >= 2 ? 2 : 0, four = V::windows >= 4 ? 4 : 0;
    return {{&add_lines<false, V, N, D, T, 0>, &add_lines<false, V, N, D, T, one>},
            {&add_lines<true, V, N, D, T, 0>, &add_lines<true, V, N, D, T, one>, &add_lines<true, V, N, D, T, two>,
             &add_lines<true, V, N, D, T, four>},
            &add_exact<V, D, T>};
}

template <class V, int N>
void sum_traces(TileJob<typename V::real>& tile, const Adders<V, N>& add) {
    using real = typename V::real;
    const Terms<real>& job = *tile.terms;
    const int rows = tile.rows, count = tile.count;
    const bool straight = tile.lines != nullptr;
    const bool monostatic = job.kind == Kind::monostatic;

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
            segments.half[r] = ::sqrt(reach2);
        }
        radius = sphere(corners[0], 2 * rows, centre);
    } else {
        radius = sphere(tile.points, rows * count, centre);
    }

    Runs<real> sums(tile.re, tile.im, rows, job.model.run);
    Polynomials<V, N> poly;
    std::int64_t evaluated = 0;
    Vectors vectors[tile_rows];
    Levels<V> scratch;
    scratch.first = tile.first / V::n;
    const Levels<V>* level = straight && tile.weights ? &scratch : nullptr;
    const Light& light = job.light;
    Shades<V, N> shades;
    Depths depths;
    Exact<V> places;
    const auto exactly = [&](std::int64_t number, int r, Vectors some) {
        evaluated += locate<V>(tile, number, level, r, some, places);
        add.exact(tile, job.table + number * job.trace_stride, places, r, some);
    };
    int active = 0;
    for (int r = 0; r < rows; ++r) active += tile.active[r] != 0;
    for (std::int64_t i = 0; i < job.n_trace; ++i) {
        const Trace& trace = job.traces[i];
        const real* table = job.table + i * job.trace_stride;
        const double there = norm(centre[0] - trace.tx[0], centre[1] - trace.tx[1], centre[2] - trace.tx[2]);
        const double back = norm(centre[0] - trace.rx[0], centre[1] - trace.rx[1], centre[2] - trace.rx[2]);
        const Reach lit = lit_of(trace, light, centre, radius, there);
        if (lit == Reach::outside) continue;
        const double out = there > radius ? there - radius : 0.0, home = back > radius ? back - radius : 0.0;
        const double speed = norm(trace.velocity[0], trace.velocity[1], trace.velocity[2]);
        const Reach heard = window(trace, job.model, speed, out + home, there + back + 2 * radius);
        if (heard == Reach::outside) continue;
        const double nearest = out < home ? out : home;
        sums.next();
        if (!straight) {
            for (int r = 0; r < rows; ++r) {
                if (tile.active[r]) exactly(i, r, {0, at.used});
            }
            continue;
        }
        if (level) levels<V>(*tile.weights, i, rows, tile.whole, scratch);
        bool whole = true;  // lines that have any vectors have all
        bool shaded = false;
        for (int r = 0; r < rows; ++r) vectors[r] = {0, tile.active[r] ? at.used : 0};
        const bool near = nearest < tile.near;
        if (lit != Reach::inside || heard != Reach::inside || near) {
            alignas(64) double least[2][tile_rows], most[2][tile_rows];
            const int own = monostatic ? 0 : 1;
            if (heard != Reach::inside || near) {
                distances(trace.tx, segments, rows, least[0], most[0]);
                if (!monostatic) distances(trace.rx, segments, rows, least[1], most[1]);
            }
            const bool fades = light.shape == fan && lit != Reach::inside;
            if (fades) sines<V, N>(job, trace, at, rows, shades);
            if (lit != Reach::inside) depths.measure(trace, light, segments, rows);
            bool any = false;
            for (int r = 0; r < rows; ++r) {
                if (vectors[r].end == 0) continue;
                const Reach line_lit = lit == Reach::inside ? lit : depths[r];
                const Reach line_heard =
                    heard == Reach::inside
                        ? heard
                        : window(trace, job.model, speed, least[0][r] + least[own][r], most[0][r] + most[own][r]);
                const bool far = !near || (least[0][r] >= tile.near && least[own][r] >= tile.near);
                int dark = 0;
                // sines do not know on which side of the fan a pixel lies
                const bool before = light.quick && far && lit != Reach::inside && depths.before[r] > depths.reach[r];
                shades.of[r] = line_lit == Reach::inside ? Shade::none : before ? Shade::fading : Shade::each;
                const bool quickly = line_lit == Reach::inside || (line_lit == Reach::fading && light.quick);
                if (line_heard != Reach::inside || !quickly || !far) {
                    vectors[r] = {0, 0};
                    if (line_heard == Reach::outside || line_lit == Reach::outside) continue;
                    const auto piece = [&](int s) {
                        return Piece(trace, segments, r, s * V::n + (V::n - 1) / 2.0, (V::n - 1) / 2.0, count);
                    };
                    const auto when = [&](int s) {
                        return line_heard == Reach::across ? piece(s).heard(trace, job.model) : line_heard;
                    };
                    const auto run = [&](const auto& where) {
                        return cut<V, N>(trace, light, segments, r, count, far, when, where, shades, dark,
                                         [&](Vectors some) { exactly(i, r, some); });
                    };
                    if (line_lit == Reach::across && fades && far && depths.before[r] > depths.reach[r]) {
                        const Between<V, N> between(light, shades, at, r, segments.half[r] / nearest);
                        vectors[r] = run([&](int s) { return between[s]; });
                    } else {
                        vectors[r] = run(
                            [&](int s) { return line_lit == Reach::across ? piece(s).lit(trace, light) : line_lit; });
                    }
                }
                if (vectors[r].end == 0) continue;
                const int last = vectors[r].end * V::n;
                evaluated += (last < count ? last : count) - vectors[r].begin * V::n - dark;
                any = true;
                shaded = shaded || shades.of[r] != Shade::none;
                whole = whole && vectors[r].begin == 0 && vectors[r].end == at.used;
            }
            if (!any) continue;
        } else {
            evaluated += static_cast<std::int64_t>(active) * count;
        }
        const double span = polynomials<V, N>(job, trace, at, rows, poly);
        // as many registers as the window of each vector of pixels needs; gathers take any number
        const int wide = span < V::n - 0.5 ? 1 : span < 2 * V::n - 0.5 ? 2 : span < 4 * V::n - 0.5 ? 3 : 0;
        const auto lines = whole ? add.whole[wide] : add.part[wide == 1];
        evaluated -= lines(tile, table, poly, level, shaded ? &shades : nullptr, x, vectors);
    }
    sums.finish();
    tile.evaluated = evaluated;
}

// Whether halves of a tile's lines cost less: exact delays of what is nearer than lines so long allow cost some twenty
// times a line's polynomial, which halves need twice.
template <class V>
bool in_halves(const TileJob<typename V::real>& tile) {
    constexpr std::int64_t times = 20;
    if (!tile.lines || tile.count <= V::n || !(tile.near > 0)) return false;
    const Terms<typename V::real>& job = *tile.terms;
    double ends[2 * tile_rows][3], centre[3];
    for (int r = 0; r < tile.rows; ++r) {
        for (int axis = 0; axis < 3; ++axis) {
            ends[2 * r][axis] = tile.lines[6 * r + axis];
            ends[2 * r + 1][axis] = tile.lines[6 * r + axis] + (tile.count - 1) * tile.lines[6 * r + 3 + axis];
        }
    }
    const double radius = sphere(ends[0], 2 * tile.rows, centre);
    std::int64_t lit = 0, near = 0;
    for (std::int64_t i = 0; i < job.n_trace; ++i) {
        const Trace& trace = job.traces[i];
        const double there = norm(centre[0] - trace.tx[0], centre[1] - trace.tx[1], centre[2] - trace.tx[2]);
        if (lit_of(trace, job.light, centre, radius, there) == Reach::outside) continue;
        const double back = norm(centre[0] - trace.rx[0], centre[1] - trace.rx[1], centre[2] - trace.rx[2]);
        ++lit;
        near += (there < back ? there : back) < tile.near + radius;
    }
    return near * times > lit;
}

// By parts of its lines where whole ones are too near for their polynomials: these are wrong by what grows with their
// length as the distance does, or faster.
template <class V, int N>
void sum_parts(TileJob<typename V::real>& tile, const Adders<V, N>& add) {
    if (!in_halves<V>(tile)) return sum_traces<V, N>(tile, add);
    using real = typename V::real;
    alignas(64) real re[tile_rows * block], im[tile_rows * block];
    double lines[6 * tile_rows];
    const int half = (tile.count + 2 * V::n - 1) / (2 * V::n) * V::n;
    tile.evaluated = 0;
    for (int begin = 0; begin < tile.count; begin += half) {
        TileJob<real> part = tile;
        part.count = tile.count - begin < half ? tile.count - begin : half;
        part.near = tile.near * (half - 1) / (tile.count - 1);
        part.first = tile.first + begin;
        for (int r = 0; r < tile.rows; ++r) {
            for (int axis = 0; axis < 3; ++axis) {
                const double step = tile.lines[6 * r + 3 + axis];
                lines[6 * r + axis] = tile.lines[6 * r + axis] + begin * step;
                lines[6 * r + 3 + axis] = step;
            }
        }
        part.lines = lines;
        part.re = re;
        part.im = im;
        sum_parts<V, N>(part, add);
        tile.evaluated += part.evaluated;
        for (int r = 0; r < tile.rows; ++r) {
            for (int m = 0; m < part.count; ++m) {
                tile.re[r * block + begin + m] = re[r * block + m];
                tile.im[r * block + begin + m] = im[r * block + m];
            }
        }
    }
}

template <class V>
void sum_tile(TileJob<typename V::real>& tile) {
    using List = Sizes<typename V::real>;
    with_degree<List>(tile.terms->degree, [&](auto degree) {
        constexpr int D = decltype(degree)::value, N = List::nodes;
        sum_parts<V, N>(tile, tile.terms->trig == List::terms[0] ? adders<V, N, D, List::terms[0]>()
                                                                 : adders<V, N, D, List::terms[1]>());
    });
}
