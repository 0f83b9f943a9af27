// The sum over traces for one tile of pixels. Included inside a namespace of one instruction set, after its vector
// types Float and Double.
//
// A line of up to `block` pixels and a trace: the delay is a polynomial through exact delays at Chebyshev nodes
// (float64), carried into the type of the arithmetic as an offset from the block's centre. Per vector of pixels: offset
// in intervals, interval and position in it, phase in turns, the interval's polynomial, one complex multiply-add.

#include "kernels/delay.inl"
#include "kernels/interpolation.inl"
#include "kernels/phase.inl"
#include "kernels/relief.inl"
#include "kernels/weights.inl"

// after those five
#include "kernels/light.inl"

// after that
#include "kernels/exact.inl"

template <typename Real>
constexpr Real magic() {  // adding and subtracting it rounds to the nearest integer, which stands in the low bits
    return sizeof(Real) == 4 ? Real(12582912.0) : Real(6755399441055744.0);
}

// after exact.inl
#include "kernels/polynomials.inl"

// after that
#include "kernels/shades.inl"

// Add one trace's terms of some vectors of a tile's lines, or (`Whole`: a sixth faster) of all of those lines that have
// any. `x`: places of a block's pixels in [-1, 1]; `level`: their weights, or null; `shades`: what they weigh for the
// beam, or null; `relief` and `rises`: their heights off the lines, or null. Returns how many pixels weigh nothing for
// the beam.
template <bool Whole, class V, int N, int D, int T, int W>
std::int64_t add_lines(const TileJob<typename V::real>& tile, const typename V::real* table,
                       const Polynomials<V, N>& poly, const Levels<V>* level, Shades<V, N>* shades,
                       const Relief<V>* relief, const Rises<V, N>& rises, const typename V::real* x,
                       const Vectors* vectors) {
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
        const real* weight = nullptr;
        if (shades && shades->of[r] == Shade::each) weight = shades->each[r];
        if (shades && shades->of[r] == Shade::fading) {
            dark += fade(*shades, r, {begin, end}, tile.count, x, relief ? relief->height[r] : nullptr);
            weight = shades->faded[r];
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
            if (relief) {
                const vec h = V::load(relief->height[r] + s * V::n);
                vec first = V::set(rises.first[N - 1][r]), second = V::set(rises.second[N - 1][r]);
                for (int q = N - 2; q >= 0; --q) {
                    first = V::fma(first, at, V::set(rises.first[q][r]));
                    second = V::fma(second, at, V::set(rises.second[q][r]));
                }
                du = V::fma(V::fma(second, h, first), h, du);
            }
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
// gathered, one register wide or two, whole lines (gathered, one, two or four), and pixels with their own delay.
template <class V, int N>
struct Adders {
    using real = typename V::real;
    using Lines = std::int64_t (*)(const TileJob<real>&, const real*, const Polynomials<V, N>&, const Levels<V>*,
                                   Shades<V, N>*, const Relief<V>*, const Rises<V, N>&, const real*, const Vectors*);
    Lines part[3], whole[4];
    void (*exact)(const TileJob<real>&, const real*, Exact<V>&, int, Vectors);
};

template <class V, int N, int D, int T>
Adders<V, N> adders() {
    constexpr int one = V::windows >= 1 ? 1 : 0, two = V::windows >= 2 ? 2 : 0, four = V::windows >= 4 ? 4 : 0;
    return {{&add_lines<false, V, N, D, T, 0>, &add_lines<false, V, N, D, T, one>, &add_lines<false, V, N, D, T, two>},
            {&add_lines<true, V, N, D, T, 0>, &add_lines<true, V, N, D, T, one>, &add_lines<true, V, N, D, T, two>,
             &add_lines<true, V, N, D, T, four>},
            &add_exact<V, D, T>};
}

// Whether two traces are of one ping, as beams light it.
inline bool alike(const Trace& a, const Trace& b) {
    bool same = true;
    for (int axis = 0; axis < 3; ++axis)
        same =
            same && a.tx[axis] == b.tx[axis] && a.boresight[axis] == b.boresight[axis] && a.axis[axis] == b.axis[axis];
    return same;
}

// Which vectors of a tile's lines are summed, and how many of their pixels weigh anything: what trace `by` found for
// those of its ping.
struct Kept {
    std::int64_t by = -1, count;
    Vectors vectors[tile_rows];
    bool any, whole, shaded;

    void keep(const Vectors* from, std::int64_t pixels, bool some, bool all, bool weighed) {
        for (int r = 0; r < tile_rows; ++r) vectors[r] = from[r];
        count = pixels, any = some, whole = all, shaded = weighed;
    }
    void tell(Vectors* to, std::int64_t& evaluated, bool& all, bool& weighed) const {
        for (int r = 0; r < tile_rows; ++r) to[r] = vectors[r];
        evaluated += count, all = whole, weighed = shaded;
    }
};

template <class V, int N>
void sum_traces(TileJob<typename V::real>& tile, const Relief<V>* relief, const Adders<V, N>& add) {
    using real = typename V::real;
    const Terms<real>& job = *tile.terms;
    const int rows = tile.rows, count = tile.count;
    const double more = relief ? relief->most : 0;  // of pixels off their lines
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
        radius = sphere(corners[0], 2 * rows, centre) + more;
    } else {
        radius = sphere(tile.points, rows * count, centre);
    }

    Runs<real> sums(tile.re, tile.im, rows, job.model.run);
    Polynomials<V, N> poly;
    Rises<V, N> rises;
    WaysOut<N> ways[3];
    std::int64_t measured = -1;  // the trace whose ways out these are
    std::int64_t evaluated = 0;
    Vectors vectors[tile_rows];
    Levels<V> scratch;
    scratch.first = tile.first / V::n;
    const Levels<V>* level = straight && tile.weights ? &scratch : nullptr;
    const Light& light = job.light;
    Shades<V, N> shades;
    Depths depths;
    Exact<V> places;
    Kept kept;
    const auto exactly = [&](std::int64_t number, int r, Vectors some) {
        kept.by = -1;
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
        const bool near = nearest < tile.near, own_ends = heard != Reach::inside || near;
        if (!own_ends && kept.by >= 0 && alike(trace, job.traces[kept.by])) {
            kept.tell(vectors, evaluated, whole, shaded);
            if (!kept.any) continue;
        } else if (lit != Reach::inside || heard != Reach::inside || near) {
            alignas(64) double least[2][tile_rows], most[2][tile_rows];
            const int own = monostatic ? 0 : 1;
            if (own_ends) {
                distances(trace.tx, segments, rows, least[0], most[0]);
                if (!monostatic) distances(trace.rx, segments, rows, least[1], most[1]);
                for (int i = 0; i <= own && relief; ++i) {
                    for (int r = 0; r < rows; ++r) {
                        least[i][r] = least[i][r] > more ? least[i][r] - more : 0;
                        most[i][r] += more;
                    }
                }
            }
            const std::int64_t before_these = evaluated;
            kept.by = own_ends ? -1 : i;
            const bool fades = light.shape == fan && lit != Reach::inside;
            if (fades) sines<V, N>(job, trace, at, rows, relief, shades);
            if (lit != Reach::inside) depths.measure(trace, light, segments, rows, more);
            bool any = false;
            for (int r = 0; r < rows; ++r) {
                if (vectors[r].end == 0) continue;
                const Reach line_lit = lit == Reach::inside ? lit : depths[r];
                const Reach line_heard =
                    heard == Reach::inside
                        ? heard
                        : window(trace, job.model, speed, least[0][r] + least[own][r], most[0][r] + most[own][r]);
                bool far = !near || (least[0][r] >= tile.near && least[own][r] >= tile.near);
                int dark = 0;
                // sines do not know on which side of the fan a pixel lies
                const bool before = light.quick && far && lit != Reach::inside && depths.before[r] > depths.reach[r];
                shades.of[r] = line_lit == Reach::inside ? Shade::none : before ? Shade::fading : Shade::each;
                // weights in double are those of lines
                if (relief && shades.of[r] == Shade::each) far = false;
                const bool quickly = line_lit == Reach::inside || (line_lit == Reach::fading && light.quick);
                if (line_heard != Reach::inside || !quickly || !far) {
                    vectors[r] = {0, 0};
                    if (line_heard == Reach::outside || line_lit == Reach::outside) continue;
                    const auto piece = [&](int s) {
                        return Piece(trace, segments, r, s * V::n + (V::n - 1) / 2.0, (V::n - 1) / 2.0, count, more);
                    };
                    const auto when = [&](int s) {
                        return line_heard == Reach::across ? piece(s).heard(trace, job.model) : line_heard;
                    };
                    const auto run = [&](const auto& where) {
                        return cut<V, N>(trace, light, segments, r, count, far, when, where, shades, dark,
                                         [&](Vectors some) { exactly(i, r, some); });
                    };
                    if (line_lit == Reach::across && fades && far && depths.before[r] > depths.reach[r]) {
                        const Between<V, N> between(light, shades, at, r, segments.half[r] / nearest,
                                                    relief != nullptr);
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
            kept.keep(vectors, evaluated - before_these, any, whole, shaded);
            if (!any) continue;
        } else {
            evaluated += static_cast<std::int64_t>(active) * count;
        }
        if (measured < 0 || !alike(trace, job.traces[measured])) {
            const double heights[] = {0, more, -more};
            for (int k = 0; k < (relief ? 3 : 1); ++k) ways[k].measure(trace, at, heights[k], rows);
            measured = i;
        }
        const double span = polynomials<V, N>(job, trace, at, ways, rows, relief, poly, rises);
        // as many registers as the window of each vector of pixels needs; gathers take any number
        const int wide = span < V::n - 0.5 ? 1 : span < 2 * V::n - 0.5 ? 2 : span < 4 * V::n - 0.5 ? 3 : 0;
        const auto lines = whole ? add.whole[wide] : add.part[wide < 3 ? wide : 0];
        evaluated -= lines(tile, table, poly, level, shaded ? &shades : nullptr, relief, rises, x, vectors);
    }
    sums.finish();
    tile.evaluated = evaluated;
}

// The sphere about a tile's lines.
struct Ball {
    double centre[3], radius;

    template <typename Real>
    explicit Ball(const TileJob<Real>& tile) {
        double ends[2 * tile_rows][3] = {};
        const double more = tile.heights.z ? (tile.high - tile.low) / 2 : 0;
        for (int r = 0; r < tile.rows; ++r) {
            for (int axis = 0; axis < 3; ++axis) {
                ends[2 * r][axis] = tile.lines[6 * r + axis];
                ends[2 * r + 1][axis] = ends[2 * r][axis] + (tile.count - 1) * tile.lines[6 * r + 3 + axis];
            }
            if (tile.heights.z) ends[2 * r][2] = ends[2 * r + 1][2] = (tile.low + tile.high) / 2;
        }
        radius = sphere(ends[0], 2 * tile.rows, centre) * (1 + 1e-12) + more;
    }
    double from(const double sensor[3]) const {
        return norm(centre[0] - sensor[0], centre[1] - sensor[1], centre[2] - sensor[2]);
    }
    bool lit(const Trace& trace, const Light& light) const {
        return lit_of(trace, light, centre, radius, from(trace.tx)) != Reach::outside;
    }
};

template <typename Real>
bool any_lit(const Terms<Real>& job, const Ball& ball) {
    if (job.light.shape == no_beam) return true;
    for (std::int64_t i = 0; i < job.n_trace; ++i) {
        if ((i == 0 || !alike(job.traces[i], job.traces[i - 1])) && ball.lit(job.traces[i], job.light)) return true;
    }
    return false;
}

// Whether halves of a tile's lines cost less: exact delays of what is nearer than lines so long allow cost some twenty
// times a line's polynomial, which halves need twice.
template <class V>
bool in_halves(const TileJob<typename V::real>& tile, const Ball& ball) {
    constexpr std::int64_t times = 20;
    if (tile.count <= V::n || !(tile.near > 0)) return false;
    const Terms<typename V::real>& job = *tile.terms;
    std::int64_t lit = 0, near = 0;
    for (std::int64_t i = 0; i < job.n_trace; ++i) {
        const Trace& trace = job.traces[i];
        if (!ball.lit(trace, job.light)) continue;
        const double there = ball.from(trace.tx), back = ball.from(trace.rx);
        ++lit;
        near += (there < back ? there : back) < tile.near;  // of half its lines at least
    }
    return near * times > lit;
}

// Straight lines, by parts where whole ones are too near for their polynomials: these are wrong by what grows with
// their length as the distance does, or faster.
template <class V, int N>
void sum_lines(TileJob<typename V::real>& tile, const Adders<V, N>& add) {
    using real = typename V::real;
    const Ball ball(tile);
    tile.evaluated = 0;
    if (!any_lit(*tile.terms, ball)) return;
    double lines[6 * tile_rows];
    TileJob<real> whole = tile;
    Relief<V> relief;
    const bool rises = tile.heights.z != nullptr;
    if (rises) {
        for (int i = 0; i < 6 * tile.rows; ++i) lines[i] = tile.lines[i];
        relief.fit(tile.heights, tile.rows, tile.count, lines);
        whole.lines = lines;
        whole.near = relief.near(tile.terms->rise, tile.near);
    }
    if (!in_halves<V>(whole, ball)) {
        sum_traces<V, N>(whole, rises ? &relief : nullptr, add);
        tile.evaluated = whole.evaluated;
        return;
    }
    alignas(64) real re[tile_rows * block], im[tile_rows * block];
    const int half = (tile.count + 2 * V::n - 1) / (2 * V::n) * V::n;
    for (int begin = 0; begin < tile.count; begin += half) {
        TileJob<real> part = tile;
        part.count = tile.count - begin < half ? tile.count - begin : half;
        part.near = tile.near * (half - 1) / (tile.count - 1);
        part.first = tile.first + begin;
        part.heights = tile.heights.from(0, begin);
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
        sum_lines<V, N>(part, add);
        tile.evaluated += part.evaluated;
        for (int r = 0; r < tile.rows; ++r) {
            for (int m = 0; m < part.count; ++m) {
                tile.re[r * block + begin + m] = part.evaluated ? re[r * block + m] : 0;
                tile.im[r * block + begin + m] = part.evaluated ? im[r * block + m] : 0;
            }
        }
    }
}

template <class V>
void sum_tile(TileJob<typename V::real>& tile) {
    using List = Sizes<typename V::real>;
    with_degree<List>(tile.terms->degree, [&](auto degree) {
        constexpr int D = decltype(degree)::value, N = List::nodes;
        const auto add =
            tile.terms->trig == List::terms[0] ? adders<V, N, D, List::terms[0]>() : adders<V, N, D, List::terms[1]>();
        if (tile.lines)
            sum_lines<V, N>(tile, add);
        else
            sum_traces<V, N>(tile, nullptr, add);
    });
}
