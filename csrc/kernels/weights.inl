// Weights that differ from term to term, along lines. Included inside a namespace of one instruction set, after its
// vector types.

// Weights of one trace's terms along a tile's lines, by vector of pixels as polynomials of the lane's place in [-1, 1].
template <class V>
struct Levels {
    static constexpr int subs = block / V::n;
    alignas(64) typename V::real power[subs][3][tile_rows];
    int first = 0;  // vector that the lines begin with

    const auto& operator[](int s) const { return power[first + s]; }
};

// Places of a vector's lanes in [-1, 1].
template <class V>
typename V::vec lanes() {
    alignas(64) typename V::real place[V::n];
    for (int i = 0; i < V::n; ++i) place[i] = static_cast<typename V::real>(2.0 * i / (V::n - 1) - 1);
    return V::load(place);
}

// From values at weight_nodes places along each line.
template <class V>
void levels(const typename V::real (&at)[weight_nodes][tile_rows], int rows, int count, Levels<V>& out);

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
    levels<V>(at, rows, count, out);
}

template <class V>
void levels(const typename V::real (&at)[weight_nodes][tile_rows], int rows, int count, Levels<V>& out) {
    using real = typename V::real;
    using vec = typename V::vec;
    const vec half = V::set(real(0.5)), third = V::set(real(4.0 / 3));
    for (int r = 0; r < rows; r += V::n) {
        const vec value = V::load(at[2] + r);
        const vec even1 = V::fma(half, V::add(V::load(at[1] + r), V::load(at[3] + r)), V::sub(V::set(0), value));
        const vec even2 = V::fma(half, V::add(V::load(at[0] + r), V::load(at[4] + r)), V::sub(V::set(0), value));
        const vec odd1 = V::mul(half, V::sub(V::load(at[3] + r), V::load(at[1] + r)));
        const vec odd2 = V::mul(half, V::sub(V::load(at[4] + r), V::load(at[0] + r)));
        const vec p4 = V::mul(third, V::fnma(V::set(4), even1, even2));
        const vec p3 = V::mul(third, V::fnma(V::set(2), odd1, odd2));
        const vec p[weight_nodes] = {value, V::sub(odd2, p3), V::sub(even2, p4), p3, p4};
        const double length = (count > least_width ? count : least_width) - 1;
        const real wide = static_cast<real>((V::n - 1) / length);
        for (int s = 0; s * V::n < count; ++s) {
            // value, slope and curve in a vector's middle, by dividing by what leads to it again and again
            const vec middle = V::set(static_cast<real>((2 * s * V::n + V::n - 1) / length - 1));
            vec q[weight_nodes];
            for (int i = 0; i < weight_nodes; ++i) q[i] = p[i];
            for (int k = 0; k < 3; ++k) {
                for (int i = weight_nodes - 2; i >= k; --i) q[i] = V::fma(q[i + 1], middle, q[i]);
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
    const auto& power = level[s];
    const auto w = V::fma(V::fma(V::set(power[2][r]), lane, V::set(power[1][r])), lane, V::set(power[0][r]));
    sine = V::mul(sine, w);
    cosine = V::mul(cosine, w);
}
