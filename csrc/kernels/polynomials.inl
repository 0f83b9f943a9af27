// Delays along a tile's lines as polynomials. Included inside a namespace of one instruction set, after relief.inl.

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

// The polynomial through values at nodes, times `scale`: coefficients of x^0, x^1, ..., `apart` from one to the next.
template <int N, typename Real>
void along(const Nodes& nodes, const Double::vec (&value)[N], double scale, Real* out, int apart) {
    using D = Double;
    D::store(out, D::mul(D::set(scale), value[N / 2]));
    for (int q = 1; q < N; ++q) {
        D::vec sum = D::set(0.0);
        for (int j = 0; j < N; ++j) {
            if (j != N / 2) sum = D::fma(D::set(scale * nodes.fit[q][j]), D::sub(value[j], value[N / 2]), sum);
        }
        D::store(out + q * apart, sum);
    }
}

// What a pixel's height h off a tile's lines adds to its delay: h (first + h second) intervals, each a polynomial along
// the line; and how far from h times its first coefficient that is at most.
template <class V, int N>
struct Rises {
    alignas(64) typename V::real first[N][tile_rows], second[N][tile_rows];
    alignas(64) double middle[tile_rows], swing[tile_rows];

    // Of lines from `r` on, by ways up, down and on the lines.
    void take(const Nodes& nodes, int r, double scale, const Double::vec (&up)[N], const Double::vec (&down)[N],
              const Double::vec (&on)[N]) {
        using D = Double;
        D::vec odd[N], even[N];
        for (int j = 0; j < N; ++j) {
            odd[j] = D::mul(D::set(0.5), D::sub(up[j], down[j]));
            even[j] = D::sub(D::mul(D::set(0.5), D::add(up[j], down[j])), on[j]);
        }
        along<N>(nodes, odd, scale, &first[0][r], tile_rows);
        along<N>(nodes, even, scale, &second[0][r], tile_rows);
        D::store(middle + r, D::mul(D::set(scale), odd[N / 2]));
        for (int i = r; i < r + D::n; ++i) {
            double sum = 0;
            for (int q = 0; q < N; ++q)
                sum += (q > 0 ? ::fabs(static_cast<double>(first[q][i])) : 0.0) +
                       ::fabs(static_cast<double>(second[q][i]));
            swing[i] = 1.01 * sum;
        }
    }
};

// Ways out to a block's nodes, `height` m above the lines, and their squares, which the traces of a ping share.
template <int N>
struct WaysOut {
    alignas(64) double length[N][tile_rows], square[N][tile_rows];

    template <class Places>
    void measure(const Trace& trace, const Places& at, double height, int rows) {
        using D = Double;
        for (int j = 0; j < N; ++j) {
            for (int r = 0; r < rows; r += D::n) {
                const D::vec z = D::add(D::load(at.z[j] + r), D::set(height));
                const D::vec out = way_out(trace, D::load(at.x[j] + r), D::load(at.y[j] + r), z);
                D::store(square[j] + r, out);
                D::store(length[j] + r, D::root(out));
            }
        }
    }
};

// Fill `out`, and `rises` where there is a relief; returns the most intervals that a vector of pixels spans.
template <class V, int N, Kind K>
double polynomials(const Terms<typename V::real>& job, const Trace& trace, const Places<V, N>& at,
                   const WaysOut<N> (&ways)[3], int rows, const Relief<V>* relief, Polynomials<V, N>& out,
                   Rises<V, N>& rises) {
    using D = Double;
    using vec = D::vec;
    const double scale = job.model.fs * job.model.rate;
    // half an interval: positions are counted from the intervals' middles
    const double offset = (trace.t0 * job.model.fs + trace.kept) * job.model.rate + 0.5;
    const double width = at.used > 0 ? at.edge[1] - at.edge[0] : 0.0;
    vec span = D::set(0.0);
    for (int r = 0; r < rows; r += D::n) {
        const auto take = [&](const WaysOut<N>& way, double height, vec(&to)[N]) {
            for (int j = 0; j < N; ++j)
                to[j] = delay_from<K>(trace, trace.c, D::load(way.length[j] + r), D::load(way.square[j] + r),
                                      D::load(at.x[j] + r), D::load(at.y[j] + r),
                                      D::add(D::load(at.z[j] + r), D::set(height)));
        };
        vec tau[N];
        take(ways[0], 0.0, tau);
        if (relief) {
            vec up[N], down[N];
            take(ways[1], relief->most, up);
            take(ways[2], -relief->most, down);
            rises.take(job.nodes, r, scale, up, down, tau);
        }
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
            vec least = D::sub(D::min(left, right), slack), most = D::add(D::max(left, right), slack);
            if (relief) {
                const vec a = D::mul(D::load(rises.middle + r), D::load(relief->low[s] + r)),
                          b = D::mul(D::load(rises.middle + r), D::load(relief->high[s] + r)),
                          swing = D::load(rises.swing + r);
                least = D::add(least, D::sub(D::min(a, b), swing));
                most = D::add(most, D::add(D::max(a, b), swing));
            }
            // no pixel lies before the table, though the bound on where they lie may
            const vec first = D::max(D::floor(least), D::sub(D::set(0.0), low));
            span = D::max(span, D::sub(most, first));
            D::store(out.shift[s] + r, D::sub(part, first));
            D::store_index(out.base[s] + r, D::add(low, first));
            left = right;
        }
    }
    return D::largest(span);
}

template <class V, int N>
double polynomials(const Terms<typename V::real>& job, const Trace& trace, const Places<V, N>& at,
                   const WaysOut<N> (&ways)[3], int rows, const Relief<V>* relief, Polynomials<V, N>& out,
                   Rises<V, N>& rises) {
    switch (job.kind) {
        case Kind::monostatic:
            return polynomials<V, N, Kind::monostatic>(job, trace, at, ways, rows, relief, out, rises);
        case Kind::stop_and_hop:
            return polynomials<V, N, Kind::stop_and_hop>(job, trace, at, ways, rows, relief, out, rises);
        default:
            return polynomials<V, N, Kind::moving>(job, trace, at, ways, rows, relief, out, rises);
    }
}
