// Leaves of the tree: sums of a few traces at a sub-image's nodes. Included after factorised.inl.
//
// A node is as far from the next as an interval of the tables is long, so that along a ray a trace's samples keep their
// place in the interval but for a slow drift: the trace's delay less the node's own. Lanes run along the ray and read
// neighbouring intervals, without permutes or gathers; the phase that is left is that of the drift. Across a vector
// both are polynomials of degree 2. Rays that read the same intervals share the loads.

// How a vector of nodes is summed, as what is added to the number of its first interval: nothing where a polynomial
// gives the phase factor; `turning` where every node's own phase must; `breaking` where nodes have their own interval
// too. Rays of equal keys are summed together.
constexpr float turning = 4194304.0F, breaking = 8388608.0F;

// Of one trace, by ray: the drift in intervals at places x of [-1, 1] on the stretch, as `rest` + power[0] x + ...
// after a whole number `base`, and turns of the carrier in its middle. By vector of nodes and ray: first interval,
// position in it and phase factor as polynomials of the lane's place, turns in the vector's middle.
template <class V>
struct Drifts {
    static constexpr int subs = block / V::n;
    alignas(64) float rest[tile_rows], turns[tile_rows], power[4][tile_rows];
    alignas(64) double base[tile_rows];
    alignas(64) float from_first[tile_rows];
    alignas(64) float key[subs][tile_rows], whole[subs][tile_rows], position[subs][3][tile_rows],
        factor[subs][6][tile_rows];
    alignas(64) float cycles[subs][tile_rows];
    const Levels<V>* level;  // weights, or null
};

// Nodes of all rays at the places where delays are exact, and the two-way slant range there in intervals.
struct LeafPlaces {
    alignas(64) double x[5][tile_rows], y[5][tile_rows];
    double own[5], z;
    // ways out of the trace `last`, and their squares
    alignas(64) double there[5][tile_rows], there2[5][tile_rows];
    const Trace* last = nullptr;

    void look_out(const Trace& trace, int rows) {
        const bool same =
            last && last->tx[0] == trace.tx[0] && last->tx[1] == trace.tx[1] && last->tx[2] == trace.tx[2];
        last = &trace;
        if (same) return;
        using D = Double;
        for (int j = 0; j < 5; ++j) {
            for (int r = 0; r < rows; r += D::n) {
                const auto square = way_out(trace, D::load(x[j] + r), D::load(y[j] + r), D::set(z));
                D::store(there2[j] + r, square);
                D::store(there[j] + r, D::root(square));
            }
        }
    }
};

template <class V, Kind K>
void drifts(const LeafJob& job, const Trace& trace, LeafPlaces& at, double ratio, Drifts<V>& out) {
    using D = Double;
    at.look_out(trace, job.rows);
    const Model& model = job.terms->model;
    const double scale = model.fs * model.rate;
    // half an interval: positions are counted from the intervals' middles
    const double origin =
        static_cast<double>(job.image->i0 + job.begin) - ((trace.t0 * model.fs + trace.kept) * model.rate + 0.5);
    const double (*fit)[max_nodes] = job.tree->nodes.fit;
    for (int r = 0; r < job.rows; r += D::n) {
        D::vec value[5];
        for (int j = 0; j < 5; ++j) {
            const auto tau = delay_from<K>(trace, trace.c, D::load(at.there[j] + r), D::load(at.there2[j] + r),
                                           D::load(at.x[j] + r), D::load(at.y[j] + r), D::set(at.z));
            value[j] = D::fma(tau, D::set(scale), D::set(-at.own[j]));
        }
        for (int q = 1; q < 5; ++q) {
            auto sum = D::set(0.0);
            for (int j = 0; j < 5; ++j) {
                if (j != 2) sum = D::fma(D::set(fit[q][j]), D::sub(value[j], value[2]), sum);
            }
            D::store(out.power[q - 1] + r, sum);
        }
        const auto place = D::add(value[2], D::set(origin)), whole = D::floor(D::add(place, D::set(0.5)));
        D::store(out.base + r, whole);
        D::store(out.from_first + r, D::sub(whole, D::set(out.base[0])));
        D::store(out.rest + r, D::sub(place, whole));
        const auto cycles = D::mul(value[2], D::set(ratio));
        D::store(out.turns + r, D::sub(cycles, D::floor(D::add(cycles, D::set(0.5)))));
    }
}

// From the stretch to its vectors.
template <class V>
void expand(const LeafJob& job, const Phase<V, 6>& phase, float ratio, std::int64_t room, Drifts<V>& out) {
    constexpr float turn = 6.283185307179586F;
    // half a vector's length, of the stretch's
    constexpr float wide = static_cast<float>(V::n - 1) / (block - 1);
    const auto round = V::set(magic<float>());
    // whether all that unbroken rays read is sure to lie in the table
    double low = out.base[0], high = low;
    for (int r = 1; r < job.rows; ++r) {
        low = out.base[r] < low ? out.base[r] : low;
        high = out.base[r] > high ? out.base[r] : high;
    }
    const bool within = low >= block && high + 3 * block <= static_cast<double>(room) && high - low < 100000;
    for (int s = 0; s * V::n < job.count; ++s) {
        const float middle = static_cast<float>(2 * s * V::n + V::n - 1) / (block - 1) - 1;
        const auto at = V::set(middle);
        for (int r = 0; r < job.rows; r += V::n) {
            typename V::vec c[4];
            for (int q = 0; q < 4; ++q) c[q] = V::load(out.power[q] + r);
            auto drift = V::fma(c[3], at, c[2]);
            drift = V::fma(drift, at, c[1]);
            drift = V::fma(drift, at, c[0]);
            drift = V::mul(drift, at);
            auto slope = V::fma(V::set(4 * middle), c[3], V::mul(V::set(3), c[2]));
            slope = V::fma(slope, at, V::mul(V::set(2), c[1]));
            slope = V::mul(V::fma(slope, at, c[0]), V::set(wide));
            auto curve = V::fma(V::set(6 * middle), c[3], V::mul(V::set(3), c[2]));
            curve = V::mul(V::fma(curve, at, c[1]), V::set(wide * wide));
            const auto place = V::add(drift, V::load(out.rest + r)), whole = V::sub(V::add(place, round), round);
            const auto position = V::sub(place, whole);
            V::store(out.whole[s] + r, whole);
            V::store(out.position[s][0] + r, position);
            V::store(out.position[s][1] + r, slope);
            V::store(out.position[s][2] + r, curve);
            const auto ph = V::fma(V::set(ratio), drift, V::load(out.turns + r));
            const auto cycles = V::sub(ph, V::sub(V::add(ph, round), round));
            V::store(out.cycles[s] + r, cycles);
            typename V::vec sine, cosine;
            phase(cycles, sine, cosine);
            // exp(j (b l + c l^2)) = 1 + j b l + (j c - b^2/2) l^2 + ...
            const auto b = V::mul(V::set(turn * ratio), slope), bent = V::mul(V::set(turn * ratio), curve);
            const auto half = V::mul(V::mul(b, b), V::set(-0.5F));
            V::store(out.factor[s][0] + r, cosine);
            V::store(out.factor[s][1] + r, sine);
            V::store(out.factor[s][2] + r, V::sub(V::set(0), V::mul(b, sine)));
            V::store(out.factor[s][3] + r, V::mul(b, cosine));
            V::store(out.factor[s][4] + r, V::fnma(bent, sine, V::mul(half, cosine)));
            V::store(out.factor[s][5] + r, V::fma(bent, cosine, V::mul(half, sine)));
            if (out.level) {
                // w0 + w1 l + w2 l^2 times the factor, but for cubes of l
                const auto& power = out.level->power[s];
                const auto w0 = V::load(power[0] + r), w1 = V::load(power[1] + r), w2 = V::load(power[2] + r);
                for (int part = 0; part < 2; ++part) {
                    const auto f0 = V::load(out.factor[s][part] + r), f1 = V::load(out.factor[s][2 + part] + r),
                               f2 = V::load(out.factor[s][4 + part] + r);
                    V::store(out.factor[s][part] + r, V::mul(w0, f0));
                    V::store(out.factor[s][2 + part] + r, V::fma(w0, f1, V::mul(w1, f0)));
                    V::store(out.factor[s][4 + part] + r, V::fma(w0, f2, V::fma(w1, f1, V::mul(w2, f0))));
                }
            }
            // what a vector's nodes swing by, and what its factor's polynomial leaves out
            const auto swing = V::add(V::abs(slope), V::abs(curve));
            const auto angle = V::mul(swing, V::set(turn * ratio));
            const auto left = V::fma(V::set(4), V::abs(c[3]), V::abs(c[2]));
            const auto wrong = V::fma(V::mul(left, V::set(wide * wide * wide)), V::set(turn * ratio),
                                      V::mul(V::mul(angle, angle), V::mul(angle, V::set(1.0F / 6))));
            const auto smooth = V::one_where_le(wrong, V::set(job.slack));
            const auto kept = V::mul(V::one_where_le(V::add(V::abs(position), swing), V::set(0.5F)),
                                     V::one_where_le(V::abs(whole), V::set(static_cast<float>(block))));
            const auto number = V::add(whole, V::load(out.from_first + r));
            V::store(out.key[s] + r, V::add(V::fma(V::sub(V::set(1), smooth), V::set(turning), number),
                                            V::mul(V::sub(V::set(1), kept), V::set(breaking))));
        }
        if (within) continue;
        for (int r = 0; r < job.rows; ++r) {
            const double begin = out.base[r] + static_cast<double>(out.whole[s][r]) + s * V::n;
            if (begin < 0 || begin + V::n > static_cast<double>(room)) out.key[s][r] = 2 * breaking;
        }
    }
}

// Rays [first, last) whose nodes of vector `s` all read the intervals at `planes`.
template <class V, int D, bool Turning>
void add_run(const float* planes, std::int64_t stride, const Phase<V, 6>& phase, float ratio, const Drifts<V>& drift,
             int s, int first, int last, typename V::vec lane, float* re, float* im) {
    typename V::vec c[2 * (D + 1)];
    for (int i = 0; i < 2 * (D + 1); ++i) c[i] = V::load(planes + i * stride);
    const float (*position)[tile_rows] = drift.position[s];
    const float (*factor)[tile_rows] = drift.factor[s];
    const auto round = V::set(magic<float>());
    for (int r = first; r < last; ++r) {
        const auto moved = V::mul(V::fma(V::set(position[2][r]), lane, V::set(position[1][r])), lane);
        const auto t = V::add(moved, V::set(position[0][r]));
        auto a = c[2 * D], b = c[2 * D + 1];
        for (int q = D - 1; q >= 0; --q) {
            a = V::fma(a, t, c[2 * q]);
            b = V::fma(b, t, c[2 * q + 1]);
        }
        typename V::vec sine, cosine;
        if constexpr (Turning) {
            const auto ph = V::fma(V::set(ratio), moved, V::set(drift.cycles[s][r]));
            phase(V::sub(ph, V::sub(V::add(ph, round), round)), sine, cosine);
            if (drift.level) weigh<V>(*drift.level, s, r, lane, sine, cosine);
        } else {
            cosine = V::fma(V::fma(V::set(factor[4][r]), lane, V::set(factor[2][r])), lane, V::set(factor[0][r]));
            sine = V::fma(V::fma(V::set(factor[5][r]), lane, V::set(factor[3][r])), lane, V::set(factor[1][r]));
        }
        add_turned<V>(a, b, sine, cosine, re + r * block, im + r * block);
    }
}

// One vector of one ray whose nodes change intervals, or lie beyond the table's ends, where what they get does not
// matter.
template <class V, int D>
void add_breaking(const LeafJob& job, const float* table, const Phase<V, 6>& phase, float ratio, const Drifts<V>& drift,
                  int s, int r, typename V::vec lane) {
    const std::int64_t stride = job.terms->plane_stride;
    const auto round = V::set(magic<float>());
    // the vector's middle lies in interval `start` + its place
    const double limit = 1e9, from = drift.base[r] < -limit ? -limit : drift.base[r] > limit ? limit : drift.base[r];
    const auto start = static_cast<std::int64_t>(from) + static_cast<std::int64_t>(drift.whole[s][r]) + s * V::n;
    const auto moved = V::mul(V::fma(V::set(drift.position[s][2][r]), lane, V::set(drift.position[s][1][r])), lane);
    const auto u = V::add(moved, V::set(drift.position[s][0][r])), k = V::sub(V::add(u, round), round);
    alignas(64) float each[V::n];
    alignas(64) std::int32_t index[V::n];
    V::store(each, k);
    for (int i = 0; i < V::n; ++i) {
        const std::int64_t place = start + i + static_cast<std::int64_t>(each[i]);
        index[i] = static_cast<std::int32_t>(place < 0 ? 0 : place >= stride ? stride - 1 : place);
    }
    const auto ph = V::fma(V::set(ratio), moved, V::set(drift.cycles[s][r]));
    typename V::vec sine, cosine, a, b;
    phase(V::sub(ph, V::sub(V::add(ph, round), round)), sine, cosine);
    if (drift.level) weigh<V>(*drift.level, s, r, lane, sine, cosine);
    read<V, D, 0>(table, stride, V::load_index(index), V::sub(u, k), a, b);
    add_turned<V>(a, b, sine, cosine, job.re + r * block + s * V::n, job.im + r * block + s * V::n);
}

// Weights of a leaf's traces for a beam that fades, along all rays; traces of a ping have the same.
template <class V>
struct Fading {
    Shine<V> shine;
    int count;
    const Trace* last = nullptr;

    Fading(const LeafJob& job, const double* cosine, const double* sine) : count(job.count) {
        const SubImage& image = *job.image;
        shine.z = image.plane;
        const int width = job.count > least_width ? job.count : least_width;
        for (int j = 0; j < weight_nodes; ++j) {
            const double node = static_cast<double>(image.i0 + job.begin) + j * (width - 1.0) / (weight_nodes - 1);
            const double ground = ground_of(node * image.step, image.centre[2] - image.plane);
            for (int r = 0; r < tile_rows; ++r) {
                shine.x[j][r] = image.centre[0] + ground * cosine[r];
                shine.y[j][r] = image.centre[1] + ground * sine[r];
            }
        }
    }

    void operator()(const Trace& trace, const Light& light, int rows, Levels<V>& out) {
        if (last && alike(trace, *last)) return;
        last = &trace;
        shine(trace, light, rows, count, out);
    }
};

template <class V, int D>
void leaf_traces(LeafJob& job) {
    const Terms<float>& terms = *job.terms;
    const SubImage& image = *job.image;
    const Model& model = terms.model;
    const Phase<V, 6> phase(job.tree->sine, job.tree->cosine);
    const int rows = job.rows;
    const double height = image.centre[2] - image.plane, ratio = model.fc / (model.fs * model.rate);
    LeafPlaces at;
    at.z = image.plane;
    double cosine[tile_rows], sine[tile_rows];
    for (int r = 0; r < tile_rows; ++r) {
        const double angle = image.angle0 + static_cast<double>(job.rays[r < rows ? r : rows - 1]) * image.dangle;
        cosine[r] = ::cos(angle);
        sine[r] = ::sin(angle);
    }
    for (int j = 0; j < 5; ++j) {
        const double node = static_cast<double>(image.i0 + job.begin) + (job.tree->nodes.at[j] + 1) * (block - 1) / 2;
        const double ground = ground_of(node * image.step, height);
        at.own[j] = node;  // an interval of twice the slant range
        for (int r = 0; r < tile_rows; ++r) {
            at.x[j][r] = image.centre[0] + ground * cosine[r];
            at.y[j][r] = image.centre[1] + ground * sine[r];
        }
    }
    const auto lane = lanes<V>();
    Runs<float> sums(job.re, job.im, rows, model.run);
    Drifts<V> drift;
    Levels<V> level;
    const bool fades = job.fades;
    Fading<V> fading(job, cosine, sine);
    drift.level = job.weights || fades ? &level : nullptr;
    const int used = (job.count + V::n - 1) / V::n;
    for (std::int64_t i = 0; i < terms.n_trace; ++i) {
        sums.next();
        const float* table = terms.table + i * terms.trace_stride;
        const Trace& trace = terms.traces[i];
        if (terms.kind == Kind::monostatic)
            drifts<V, Kind::monostatic>(job, trace, at, ratio, drift);
        else if (terms.kind == Kind::stop_and_hop)
            drifts<V, Kind::stop_and_hop>(job, trace, at, ratio, drift);
        else
            drifts<V, Kind::moving>(job, trace, at, ratio, drift);
        if (fades)
            fading(trace, terms.light, rows, level);
        else if (drift.level)
            levels<V>(*job.weights, i, rows, job.count, level);
        expand<V>(job, phase, static_cast<float>(ratio), terms.plane_stride, drift);
        for (int s = 0; s < used; ++s) {
            const float* key = drift.key[s];
            float *re = job.re + s * V::n, *im = job.im + s * V::n;
            for (int r = 0; r < rows;) {
                if (key[r] > breaking - turning / 2) {
                    add_breaking<V, D>(job, table, phase, static_cast<float>(ratio), drift, s, r++, lane);
                    continue;
                }
                int last = r + 1;
                while (last < rows && key[last] == key[r]) ++last;
                const float* planes = table + static_cast<std::int64_t>(drift.base[r]) +
                                      static_cast<std::int64_t>(drift.whole[s][r]) + s * V::n;
                if (key[r] < turning / 2)
                    add_run<V, D, false>(planes, terms.plane_stride, phase, static_cast<float>(ratio), drift, s, r,
                                         last, lane, re, im);
                else
                    add_run<V, D, true>(planes, terms.plane_stride, phase, static_cast<float>(ratio), drift, s, r, last,
                                        lane, re, im);
                r = last;
            }
        }
    }
    sums.finish();
}

template <class V>
void leaf(LeafJob& job) {
    with_degree<Sizes<float>>(job.terms->degree, [&](auto degree) { leaf_traces<V, decltype(degree)::value>(job); });
}
