// Fast factorised back-projection: sub-images of groups of pings are merged into those of longer groups, and read at
// the image's pixels. Included after backprojection.inl, inside a namespace of one instruction set. See docs/ffbp.md.
//
// Between a parent's ray and a child's polar grid everything is smooth, so positions and phases are polynomials of
// degree 4 through five exact values (float64) on stretches of `block` nodes. Lanes run along the ray: neighbouring
// lanes read neighbouring nodes, without permutes or gathers.

// A polynomial on each of several stretches: value (float64) at the middle node, coefficients of x, x^2, ... after it.
struct Curves {
    double middle[tile_rows];
    float power[4][tile_rows];
};

inline void curve(const Nodes& nodes, const Double::vec (&value)[5], double scale, Curves& out, int at) {
    using D = Double;
    D::store(out.middle + at, D::mul(value[2], D::set(scale)));
    for (int q = 1; q < 5; ++q) {
        D::vec sum = D::set(0.0);
        for (int j = 0; j < 5; ++j) {
            if (j != 2) sum = D::fma(D::set(scale * nodes.fit[q][j]), D::sub(value[j], value[2]), sum);
        }
        D::store(out.power[q - 1] + at, sum);
    }
}

template <class V>
typename V::vec follow(const Curves& curves, int at, typename V::vec x) {
    auto sum = V::set(curves.power[3][at]);
    for (int q = 2; q >= 0; --q) sum = V::fma(sum, x, V::set(curves.power[q][at]));
    return V::mul(sum, x);
}

// Weights of W taps at places x.
template <class V, int W>
void weigh(const Taps& taps, typename V::vec x, typename V::vec (&out)[W]) {
    const auto square = V::mul(x, x);
    for (int p = 0; p < W / 2; ++p) {
        auto even = V::set(taps.even[p][W / 2]);
        for (int q = W / 2 - 1; q >= 0; --q) even = V::fma(even, square, V::set(taps.even[p][q]));
        auto odd = V::set(taps.odd[p][W / 2 - 1]);
        for (int q = W / 2 - 2; q >= 0; --q) odd = V::fma(odd, square, V::set(taps.odd[p][q]));
        odd = V::mul(odd, x);
        out[p] = V::add(even, odd);
        out[W - 1 - p] = V::sub(even, odd);
    }
}

// One vector of nodes read W taps wide, from tap to tap `apart` reals on from `re` and `im`.
template <class V, int W>
void weighed(const typename V::vec (&weight)[W], const float* re, const float* im, std::int64_t apart,
             typename V::vec& out_re, typename V::vec& out_im) {
    out_re = V::mul(weight[0], V::load(re));
    out_im = V::mul(weight[0], V::load(im));
    for (int t = 1; t < W; ++t) {
        out_re = V::fma(weight[t], V::load(re + t * apart), out_re);
        out_im = V::fma(weight[t], V::load(im + t * apart), out_im);
    }
}

// The same at places x of one interval.
template <class V, int W>
void read_here(const Taps& taps, typename V::vec x, const float* re, const float* im, std::int64_t apart,
               typename V::vec& out_re, typename V::vec& out_im) {
    typename V::vec weight[W];
    weigh<V, W>(taps, x, weight);
    weighed<V, W>(weight, re, im, apart, out_re, out_im);
}

// The interval that all nodes of a stretch lie in, if one is sure to: their places are within the sum of powers of
// `rest`.
inline bool one_interval(const Curves& curves, int at, double rest, double& interval) {
    double swing = 1e-4;
    for (int q = 0; q < 4; ++q) swing += curves.power[q][at] < 0 ? -curves.power[q][at] : curves.power[q][at];
    interval = ::floor(rest + 0.5);
    return rest - swing >= interval - 0.5 && rest + swing <= interval + 0.5;
}

// One vector of nodes read W taps wide at places `position` from interval `base` on; nodes lie `apart` reals from tap
// to tap. Lanes whose intervals differ are read interval by interval.
template <class V, int W>
void read_taps(const Taps& taps, typename V::vec position, std::int64_t base, std::int64_t least, std::int64_t most,
               const float* re, const float* im, std::int64_t apart, typename V::vec& out_re, typename V::vec& out_im) {
    const auto round = V::set(magic<float>());
    const auto interval = V::sub(V::add(position, round), round);
    const auto x = V::sub(position, interval);
    alignas(64) float each[V::n];
    V::store(each, interval);
    const float first = each[0], last = each[V::n - 1];
    const float low = first < last ? first : last, high = first < last ? last : first;
    const auto within = [&](float k) {
        const std::int64_t from = base + static_cast<std::int64_t>(k);
        return from < least ? least : from > most ? most : from;
    };
    typename V::vec weight[W];
    weigh<V, W>(taps, x, weight);
    if (low == high) {
        const std::int64_t from = within(low);
        weighed<V, W>(weight, re + from * apart, im + from * apart, apart, out_re, out_im);
        return;
    }
    if (high == low + 1 && within(high) == within(low) + 1) {  // one tap more, and none of the others read twice
        const auto behind = V::one_where_eq(interval, V::set(high)), before = V::sub(V::set(1), behind);
        typename V::vec each_weight[W + 1];
        each_weight[0] = V::mul(before, weight[0]);
        for (int t = 1; t < W; ++t) each_weight[t] = V::fma(behind, weight[t - 1], V::mul(before, weight[t]));
        each_weight[W] = V::mul(behind, weight[W - 1]);
        const std::int64_t from = within(low);
        weighed<V, W + 1>(each_weight, re + from * apart, im + from * apart, apart, out_re, out_im);
        return;
    }
    out_re = out_im = V::set(0);
    for (float k = low; k <= high; k += 1) {
        const std::int64_t from = within(k);
        typename V::vec sum_re, sum_im;
        weighed<V, W>(weight, re + from * apart, im + from * apart, apart, sum_re, sum_im);
        const auto here = V::one_where_eq(interval, V::set(k));
        out_re = V::fma(here, sum_re, out_re);
        out_im = V::fma(here, sum_im, out_im);
    }
}

// Places of a stretch's nodes in [-1, 1].
template <class V>
typename V::vec place_of(int m) {
    alignas(64) float x[V::n];
    for (int i = 0; i < V::n; ++i) x[i] = static_cast<float>(2.0 * (m + i) / (block - 1) - 1);
    return V::load(x);
}

template <class V>
struct Stretch {
    typename V::vec x[block / V::n];
    Stretch() {
        for (int s = 0; s < block / V::n; ++s) x[s] = place_of<V>(s * V::n);
    }
};

// Ground distance at a slant range; 0 where the ground is farther.
inline double ground_of(double range, double height) {
    const double square = range * range - height * height;
    return square > 0 ? ::sqrt(square) : 0.0;
}

inline std::int64_t nearest_below(double x) { return static_cast<std::int64_t>(::floor(x)); }

// arcsin of |q| < 0.4, to 2e-10
inline Double::vec arcsine(Double::vec q) {
    using D = Double;
    constexpr double c[] = {1.0 / 6,
                            3.0 / 40,
                            15.0 / 336,
                            105.0 / 3456,
                            945.0 / 42240,
                            10395.0 / 599040,
                            135135.0 / 9676800,
                            2027025.0 / 175472640,
                            34459425.0 / 3530096640.0};
    const auto square = D::mul(q, q);
    auto sum = D::set(c[8]);
    for (int i = 7; i >= 0; --i) sum = D::fma(sum, square, D::set(c[i]));
    return D::fma(D::mul(sum, square), q, q);
}

// arctan of |q| < 0.35, to 1e-9
inline Double::vec arctangent(Double::vec q) {
    using D = Double;
    const auto square = D::mul(q, q);
    auto sum = D::set(1.0 / 17);
    for (int i = 15; i >= 3; i -= 2) sum = D::fma(sum, square, D::set((i / 2 % 2 ? -1.0 : 1.0) / i));
    return D::fma(D::mul(sum, square), q, q);
}

// Filter `U` vectors side by side: one alone waits for its own sums.
template <class V, int U>
void smooth_some(const Taps& taps, const float* in, std::int64_t apart, float* out) {
    typename V::vec sum[U];
    const auto middle = V::set(taps.filter[0]);
    for (int u = 0; u < U; ++u) sum[u] = V::mul(middle, V::load(in + u * V::n));
    for (int k = 1; k <= taps.half; ++k) {
        const auto weight = V::set(taps.filter[k]);
        const float *before = in - k * apart, *behind = in + k * apart;
        for (int u = 0; u < U; ++u)
            sum[u] = V::fma(weight, V::add(V::load(before + u * V::n), V::load(behind + u * V::n)), sum[u]);
    }
    for (int u = 0; u < U; ++u) V::store(out + u * V::n, sum[u]);
}

template <class V>
void smooth(const Taps& taps, const float* in, float* out, std::int64_t count) {
    constexpr int many = 4;
    std::int64_t m = 0;
    for (; m + (many - 1) * V::n < count; m += many * V::n) smooth_some<V, many>(taps, in + m, 1, out + m);
    for (; m < count; m += V::n) smooth_some<V, 1>(taps, in + m, 1, out + m);
}

template <class V, int U>
void smooth_columns(const Taps& taps, float* plane, std::int64_t stride, std::int64_t first, std::int64_t last,
                    float* work) {
    constexpr int wide = U * V::n;
    for (std::int64_t r = first; r < last; ++r) {
        for (int u = 0; u < wide; u += V::n) V::store(work + (r - first) * wide + u, V::load(plane + r * stride + u));
    }
    for (std::int64_t r = first + taps.half; r < last - taps.half; ++r)
        smooth_some<V, U>(taps, work + (r - first) * wide, wide, plane + r * stride);
}

template <class V>
void smooth_across(const Taps& taps, float* plane, std::int64_t stride, std::int64_t first, std::int64_t last,
                   std::int64_t begin, std::int64_t end, float* work) {
    constexpr int many = block / V::n;
    std::int64_t m = begin;
    for (; m + block <= end; m += block) smooth_columns<V, many>(taps, plane + m, stride, first, last, work);
    for (; m < end; m += V::n) smooth_columns<V, 1>(taps, plane + m, stride, first, last, work);
}

// What a sub-image holds where a straight line on its plane crosses its arcs: nodes `low` on, in stretches of a block.
struct Crossed {
    std::int64_t low, stretches;
};

// Rooms of a line: what lies across rays, and the same filtered along the line.
struct LineRooms {
    float *line_re, *line_im, *even_re, *even_im;
    std::int64_t room;

    LineRooms(float* work, std::int64_t room)
        : line_re(work), line_im(work + room), even_re(work + 2 * room), even_im(work + 3 * room), room(room) {}
};

// A line at `angle` to the sub-image's first ray that passes its centre `aside` m off, between two slant ranges. It is
// filtered here and not along the rays: the line crosses them.
template <class V, int W>
Crossed cross_rays(const Tree& tree, const SubImage& image, double angle, double aside, double first, double last,
                   const LineRooms& rooms) {
    using D = Double;
    const Taps& taps = *tree.taps;
    const Stretch<V> stretch;
    const double step = image.step, height = image.centre[2] - image.plane;
    const int half = taps.half;
    std::int64_t low = nearest_below(first / step) - W / 2 - half;
    low = low < image.i0 ? image.i0 : low;
    low -= (low - image.i0) % 16;  // rows begin on lines of the cache
    const std::int64_t high = nearest_below(last / step) + W / 2 + 2 + half;
    std::int64_t stretches = (high - low + block - 1) / block;
    const std::int64_t there = (image.stride - (low - image.i0)) / block, fit = rooms.room / block;
    stretches = stretches > there ? there : stretches;
    stretches = stretches > fit ? fit : stretches;
    if (stretches <= 0) return {low, 0};
    Curves place;
    for (std::int64_t s = 0; s < stretches; s += tile_rows) {
        const int some = static_cast<int>(stretches - s < tile_rows ? stretches - s : tile_rows);
        for (int i = 0; i < some; i += D::n) {
            D::vec value[5];
            alignas(64) double at[D::n];
            for (int j = 0; j < 5; ++j) {
                for (int l = 0; l < D::n; ++l) {
                    const double node =
                        static_cast<double>(low + (s + i + l) * block) + (tree.nodes.at[j] + 1) * (block - 1) / 2;
                    at[l] = node * step;
                }
                const auto range = D::load(at);
                const auto ground2 = D::sub(D::mul(range, range), D::set(height * height));
                // guard nodes nearer than the foot see what they like, within the arcsine's reach
                value[j] = arcsine(D::mul(D::set(aside), D::inverse_root(D::max(ground2, D::set(9 * aside * aside)))));
            }
            curve(tree.nodes, value, 1 / image.dangle, place, i);
        }
        for (int i = 0; i < some; ++i) {
            const double middle = place.middle[i] + angle / image.dangle - 0.5;
            const std::int64_t base = nearest_below(middle + 0.5);
            const auto rest = V::set(static_cast<float>(middle - static_cast<double>(base)));
            const std::int64_t to = (s + i) * block, column = low + to - image.i0;
            double interval;
            if (one_interval(place, i, middle - static_cast<double>(base), interval)) {
                std::int64_t ray = base + static_cast<std::int64_t>(interval) - (W / 2 - 1);
                ray = ray < 0 ? 0 : ray > image.rays - W ? image.rays - W : ray;
                const auto rest_here = V::set(static_cast<float>(middle - static_cast<double>(base) - interval));
                const float *a = image.re + ray * image.stride + column, *b = image.im + ray * image.stride + column;
                for (int m = 0; m < block; m += V::n) {
                    typename V::vec re, im;
                    read_here<V, W>(taps, V::add(follow<V>(place, i, stretch.x[m / V::n]), rest_here), a + m, b + m,
                                    image.stride, re, im);
                    V::store(rooms.line_re + to + m, re);
                    V::store(rooms.line_im + to + m, im);
                }
                continue;
            }
            for (int m = 0; m < block; m += V::n) {
                const auto position = V::add(follow<V>(place, i, stretch.x[m / V::n]), rest);
                typename V::vec re, im;
                read_taps<V, W>(taps, position, base - (W / 2 - 1), 0, image.rays - W, image.re + column + m,
                                image.im + column + m, image.stride, re, im);
                V::store(rooms.line_re + to + m, re);
                V::store(rooms.line_im + to + m, im);
            }
        }
    }
    const std::int64_t length = stretches * block;
    smooth<V>(taps, rooms.line_re + half, rooms.even_re + half, length - 2 * half);
    smooth<V>(taps, rooms.line_im + half, rooms.even_im + half, length - 2 * half);
    return {low, stretches};
}

// What a beam's taper leaves of a trace at weight_nodes places of several stretches of nodes.
template <class V>
struct Shine {
    alignas(64) double x[weight_nodes][tile_rows], y[weight_nodes][tile_rows];
    double z;

    void operator()(const Trace& trace, const Light& light, int rows, int count, Levels<V>& out) const {
        using D = Double;
        alignas(64) float at[weight_nodes][tile_rows];
        for (int j = 0; j < weight_nodes; ++j) {
            for (int r = 0; r < rows; r += D::n) {
                const D::vec away[3] = {D::sub(D::load(x[j] + r), D::set(trace.tx[0])),
                                        D::sub(D::load(y[j] + r), D::set(trace.tx[1])), D::set(z - trace.tx[2])};
                D::vec counts;
                D::store(at[j] + r, brightness(trace, light, away, counts, false));
            }
        }
        levels<V>(at, rows, count, out);
    }
};

template <class V, int W>
void merge_taps(const MergeJob& job) {
    using D = Double;
    const Tree& tree = *job.tree;
    const Taps& taps = *tree.taps;
    const SubImage& parent = *job.parent;
    const Phase<V, 6> phase(tree.sine, tree.cosine);
    const Stretch<V> stretch;
    const auto round = V::set(magic<float>());
    const std::int64_t begin = parent.range[2 * job.ray], end = parent.range[2 * job.ray + 1];
    if (end <= begin) return;
    const std::int64_t count = end - begin;
    const double angle = parent.angle0 + static_cast<double>(job.ray) * parent.dangle, step = parent.step;
    const double ex = ::cos(angle), ey = ::sin(angle), height = parent.centre[2] - parent.plane;
    const double start = static_cast<double>(parent.i0 + begin) * step;
    const LineRooms rooms(job.work, job.room);
    // sums grow where they stay; the last vectors run on into what nobody reads
    const std::int64_t row = job.ray * parent.stride + begin;
    float *const sum_re = parent.re + row, *const sum_im = parent.im + row;
    const int half = taps.half;
    bool fresh = !job.add;
    Shine<V> shine;
    shine.z = parent.plane;
    Levels<V> level;
    const auto lane = lanes<V>();
    const auto wave = V::set(static_cast<float>(tree.wave * step));
    Curves drift;
    for (std::int64_t c = 0; c < job.n_child; ++c) {
        const SubImage& child = job.children[c];
        const double vx = parent.centre[0] - child.centre[0], vy = parent.centre[1] - child.centre[1];
        const double along = vx * ex + vy * ey, aside = vy * ex - vx * ey;
        const double child_height = child.centre[2] - child.plane;
        const double away2 = aside * aside + child_height * child_height;
        const auto seen = [&](double range) {
            const double y = ground_of(range, height) + along;
            return ::sqrt(y * y + aside * aside + child_height * child_height);
        };
        const auto [low, stretches] = cross_rays<V, W>(tree, child, angle - child.angle0, aside, seen(start),
                                                       seen(start + static_cast<double>(count - 1) * step), rooms);
        if (stretches <= 0) continue;
        const float *const even_re = rooms.even_re, *const even_im = rooms.even_im;
        // along the parent's ray, turned from the child's carrier to the parent's
        for (std::int64_t s = 0; s * block < count; s += tile_rows) {
            const std::int64_t left = (count - s * block + block - 1) / block;
            const int some = static_cast<int>(left < tile_rows ? left : tile_rows);
            for (int i = 0; i < some; i += D::n) {
                D::vec where[5];
                alignas(64) double at[D::n];
                for (int j = 0; j < 5; ++j) {
                    for (int l = 0; l < D::n; ++l) {
                        at[l] = start +
                                (static_cast<double>((s + i + l) * block) + (tree.nodes.at[j] + 1) * (block - 1) / 2) *
                                    step;
                    }
                    const auto range = D::load(at), square = D::mul(range, range);
                    const auto ground = D::root(D::max(D::sub(square, D::set(height * height)), D::set(0.0)));
                    const auto y = D::add(ground, D::set(along));
                    where[j] = D::sub(D::root(D::fma(y, y, D::set(away2))), range);
                }
                curve(tree.nodes, where, 1 / step, drift, i);
            }
            if (job.lit) {
                for (int j = 0; j < weight_nodes; ++j) {
                    for (int i = 0; i < tile_rows; ++i) {
                        const double node = static_cast<double>((s + (i < some ? i : 0)) * block) +
                                            j * (block - 1.0) / (weight_nodes - 1);
                        const double ground = ground_of(start + node * step, height);
                        shine.x[j][i] = parent.centre[0] + ground * ex;
                        shine.y[j][i] = parent.centre[1] + ground * ey;
                    }
                }
                shine(*job.lit[c], *job.light, some, block, level);
            }
            for (int i = 0; i < some; ++i) {
                const std::int64_t to = (s + i) * block;
                const double middle = drift.middle[i] - 0.5 + static_cast<double>(parent.i0 + begin - low);
                const std::int64_t base = nearest_below(middle + 0.5);
                const auto rest = V::set(static_cast<float>(middle - static_cast<double>(base)));
                const double cycles = drift.middle[i] * step * tree.wave;
                const auto turned = V::set(static_cast<float>(cycles - ::floor(cycles + 0.5)));
                double interval;
                const bool fixed = one_interval(drift, i, middle - static_cast<double>(base), interval);
                std::int64_t first = base + static_cast<std::int64_t>(interval) - (W / 2 - 1) + to;
                const std::int64_t most = job.room - W - block;  // lanes behind the ray's end read what nobody wants
                first = first < 0 ? 0 : first > most ? most : first;
                const auto rest_here = V::set(static_cast<float>(middle - static_cast<double>(base) - interval));
                for (int m = 0; m < block; m += V::n) {
                    const auto x = stretch.x[m / V::n];
                    const auto moved = follow<V>(drift, i, x);
                    typename V::vec re, im, sine, cosine;
                    const std::int64_t column = to + m;
                    if (fixed)
                        read_here<V, W>(taps, V::add(moved, rest_here), even_re + first + m, even_im + first + m, 1, re,
                                        im);
                    else
                        read_taps<V, W>(taps, V::add(moved, rest), base - (W / 2 - 1) + column, 0, job.room - W - V::n,
                                        even_re, even_im, 1, re, im);
                    const auto ph = V::fma(moved, wave, turned);
                    phase(V::sub(ph, V::sub(V::add(ph, round), round)), sine, cosine);
                    if (job.lit) weigh<V>(level, m / V::n, i, lane, sine, cosine);
                    if (fresh) {
                        V::store(sum_re + column, V::fnma(im, sine, V::mul(re, cosine)));
                        V::store(sum_im + column, V::fma(im, cosine, V::mul(re, sine)));
                    } else {
                        add_turned<V>(re, im, sine, cosine, sum_re + column, sum_im + column);
                    }
                }
            }
        }
        fresh = false;
    }
    for (std::int64_t m = 0; fresh && m < count; ++m) sum_re[m] = sum_im[m] = 0;
    if (!job.smooth) return;
    smooth<V>(taps, sum_re + half, rooms.line_re, count - 2 * half);
    smooth<V>(taps, sum_im + half, rooms.line_im, count - 2 * half);
    for (std::int64_t m = 0; m < count - 2 * half; ++m) {
        sum_re[half + m] = rooms.line_re[m];
        sum_im[half + m] = rooms.line_im[m];
    }
}

template <class V>
void merge(const MergeJob& job) {
    if (job.tree->taps->count == 6)
        merge_taps<V, 6>(job);
    else
        merge_taps<V, 8>(job);
}
