// Terms whose delay no polynomial holds: every pixel's own, in float64. Included inside a namespace of one instruction
// set.

// Vectors of a line's pixels.
struct Vectors {
    int begin, end;
};

// Some pixels' own places in a trace's table: interval, position in it, turns of the carrier, and what the term weighs.
template <class V>
struct Exact {
    alignas(64) typename V::real position[block], turns[block], weight[block];
    alignas(64) std::int32_t interval[block];
};

// Of vectors of line `r` and trace number `number`; terms outside the record or the beam weigh nothing. Returns how
// many do not.
template <class V, Kind K>
std::int64_t locate(const TileJob<typename V::real>& tile, std::int64_t number, const Levels<V>* level, int r,
                    Vectors vectors, Exact<V>& out) {
    using real = typename V::real;
    using W = Double;
    const Model& model = tile.terms->model;
    const Light& light = tile.terms->light;
    const Trace& trace = tile.terms->traces[number];
    alignas(64) double x[3][block];
    const int begin = vectors.begin * V::n, padded = vectors.end * V::n;  // by the last pixel
    const int end = padded < tile.count ? padded : tile.count;
    const Heights& heights = tile.heights;
    for (int m = begin; m < padded; ++m) {
        const int pixel = m < tile.count ? m : tile.count - 1;
        for (int axis = 0; axis < 3; ++axis) {
            x[axis][m] = tile.lines ? tile.lines[6 * r + axis] + pixel * tile.lines[6 * r + 3 + axis]
                                    : tile.points[3 * (r * tile.count + pixel) + axis];
        }
        if (heights.z) x[2][m] = heights(r, pixel);
    }
    W::vec counted = W::set(0.0);
    const W::vec half = W::set(0.5), first = W::set(trace.first), last = W::set(trace.last);
    const W::vec before = W::set(trace.first - edge_samples), behind = W::set(trace.last + edge_samples);
    for (int m = begin; m < padded; m += W::n) {
        const W::vec px = W::load(x[0] + m), py = W::load(x[1] + m), pz = W::load(x[2] + m);
        const W::vec tau = delay<K>(trace, trace.c, px, py, pz);
        const W::vec index = W::mul(W::sub(tau, W::set(trace.t0)), W::set(model.fs));
        W::vec counts = W::mul(W::one_where_le(before, index), W::one_where_le(index, behind));
        W::vec weight = W::set(1.0);
        if (light.shape != no_beam) {
            const W::vec away[3] = {W::sub(px, W::set(trace.tx[0])), W::sub(py, W::set(trace.tx[1])),
                                    W::sub(pz, W::set(trace.tx[2]))};
            W::vec within;
            weight = brightness(trace, light, away, within);
            counts = W::mul(counts, within);
        }
        // where a term does not count the index becomes the first kept sample's, which is in the table
        const W::vec read = W::max(first, W::min(index, last));
        const W::vec u = W::mul(W::mul(counts, W::sub(read, W::set(trace.kept))), W::set(model.rate));
        const W::vec low = W::floor(u);
        W::store(out.position + m, W::sub(W::sub(u, low), half));
        W::store_index(out.interval + m, low);
        const W::vec cycles = W::mul(W::set(model.fc), tau);
        W::store(out.turns + m, W::sub(cycles, W::floor(W::add(cycles, half))));
        W::store(out.weight + m, W::mul(counts, weight));
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
            const auto& power = (*level)[m / V::n];
            const double lane = 2.0 * (m % V::n) / (V::n - 1) - 1;
            out.weight[m] *= power[0][r] + lane * (power[1][r] + lane * power[2][r]);
        }
    } else if (tile.weights) {
        const real* own =
            tile.weights->value + static_cast<std::int64_t>(r) * tile.count * tile.weights->n_trace + number;
        for (int m = begin; m < end; ++m) out.weight[m] *= own[m * tile.weights->n_trace];
    }
    return static_cast<std::int64_t>(W::total(counted));
}

template <class V>
std::int64_t locate(const TileJob<typename V::real>& tile, std::int64_t number, const Levels<V>* level, int r,
                    Vectors vectors, Exact<V>& out) {
    switch (tile.terms->kind) {
        case Kind::monostatic:
            return locate<V, Kind::monostatic>(tile, number, level, r, vectors, out);
        case Kind::stop_and_hop:
            return locate<V, Kind::stop_and_hop>(tile, number, level, r, vectors, out);
        default:
            return locate<V, Kind::moving>(tile, number, level, r, vectors, out);
    }
}

// Add what `locate` found.
template <class V, int D, int T>
void add_exact(const TileJob<typename V::real>& tile, const typename V::real* table, Exact<V>& at, int r,
               Vectors vectors) {
    const Terms<typename V::real>& job = *tile.terms;
    const Phase<V, T> phase(job.sine, job.cosine);
    for (int m = vectors.begin * V::n; m < vectors.end * V::n && m < tile.count; m += V::n) {
        typename V::vec sine, cosine, re, im;
        phase(V::load(at.turns + m), sine, cosine);
        std::int32_t* interval = at.interval + m;
        std::int32_t first = interval[0], last = first;
        for (int i = 1; i < V::n; ++i) {
            first = interval[i] < first ? interval[i] : first;
            last = interval[i] > last ? interval[i] : last;
        }
        for (int i = 0; i < V::n; ++i) interval[i] -= first;
        read_within<V, D>(table + first, job.plane_stride, last - first, V::load_index(interval),
                          V::load(at.position + m), re, im);
        const auto w = V::load(at.weight + m);
        re = V::mul(re, w);
        im = V::mul(im, w);
        add_turned<V>(re, im, sine, cosine, tile.re + r * block + m, tile.im + r * block + m);
    }
}
