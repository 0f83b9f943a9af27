// What pixels of a tile's lines weigh for a beam. Included inside a namespace of one instruction set, after the places
// of lines in backprojection.inl.

// How a line's pixels weigh for the beam: alike, by the sine of their angle, or each as it is said.
enum class Shade { none, fading, each };

template <class V, int N>
struct Shades {
    using real = typename V::real;
    Shade of[tile_rows];
    alignas(64) real sine[N][tile_rows];  // `per` times that, in x^0, x^1, ...
    alignas(64) real each[tile_rows][block];
    alignas(64) real faded[tile_rows][block];  // weights of fans that fade, where `count` vectors of a line have them
    Vectors count[tile_rows];
    int dark[tile_rows];                  // of these
    alignas(64) real rise[N][tile_rows];  // what the sine grows by with a pixel's height off the line, in x^0, x^1, ...
};

// Sines of a fan's angles along a tile's lines, of pixels off them too where there is a relief.
template <class V, int N>
void sines(const Terms<typename V::real>& job, const Trace& trace, const Places<V, N>& at, int rows,
           const Relief<V>* relief, Shades<V, N>& out) {
    using D = Double;
    using vec = D::vec;
    const vec per = D::set(job.light.per);
    for (int r = 0; r < rows; r += D::n) {
        vec sine[N], grows[N];
        for (int j = 0; j < N; ++j) {
            const vec x = D::sub(D::load(at.x[j] + r), D::set(trace.tx[0])),
                      y = D::sub(D::load(at.y[j] + r), D::set(trace.tx[1]));
            const vec aside = D::fma(x, D::set(trace.axis[0]), D::mul(y, D::set(trace.axis[1])));
            const vec square = D::fma(x, x, D::mul(y, y));
            const auto sine_at = [&](double height) {
                const vec z = D::add(D::load(at.z[j] + r), D::set(height - trace.tx[2]));
                const vec near = D::mul(per, D::inverse_root(D::fma(z, z, square)));
                return D::mul(D::fma(z, D::set(trace.axis[2]), aside), near);
            };
            sine[j] = sine_at(0);
            if (relief) grows[j] = D::mul(D::set(0.5), D::sub(sine_at(relief->most), sine_at(-relief->most)));
        }
        if (relief) along<N>(job.nodes, grows, 1.0, &out.rise[0][r], tile_rows);
        for (int i = r; i < r + D::n; ++i) out.count[i] = {0, 0};
        along<N>(job.nodes, sine, 1.0, &out.sine[0][r], tile_rows);
    }
}

// Weights of vectors of a line for a fan that fades.
template <class V, int N>
class Fade {
  public:
    using real = typename V::real;
    using vec = typename V::vec;

    explicit Fade(const Light& light) : top_(V::set(static_cast<real>(light.per * light.sine_half))) {
        for (int q = 0; q < ramp_powers; ++q) power_[q] = V::set(static_cast<real>(light.power[q]));
    }

    // Of line `r`, whose pixels have `heights` off it or none; returns how many pixels weigh nothing.
    int operator()(Shades<V, N>& shades, int r, Vectors vectors, int count, const real* x, const real* heights) const {
        Vectors& known = shades.count[r];
        if (known.begin == vectors.begin && known.end == vectors.end) return shades.dark[r];
        known = vectors;
        real* const weight = shades.faded[r];
        const vec zero = V::set(0), one = V::set(1), middle = V::set(shades.sine[0][r]);
        const int last = vectors.end - 1;
        int dark = 0;
        vec c[N - 1];
        for (int q = 0; q < N - 1; ++q) c[q] = V::set(shades.sine[q + 1][r]);
        for (int s = vectors.begin; s <= last; ++s) {
            const vec at = V::load(x + s * V::n);
            vec sine = c[N - 2];
            for (int q = N - 3; q >= 0; --q) sine = V::fma(sine, at, c[q]);
            sine = V::fma(sine, at, middle);
            if (heights) {
                vec grows = V::set(shades.rise[N - 1][r]);
                for (int q = N - 2; q >= 0; --q) grows = V::fma(grows, at, V::set(shades.rise[q][r]));
                sine = V::fma(grows, V::load(heights + s * V::n), sine);
            }
            const vec e = V::max(zero, V::min(one, V::sub(top_, V::abs(sine)))), square = V::mul(e, e);
            // in pairs: half as long a chain as one power after another
            vec w = power_[ramp_powers - 1];
            for (int q = ramp_powers - 3; q >= 0; q -= 2) w = V::fma(w, square, V::fma(power_[q + 1], e, power_[q]));
            V::store(weight + s * V::n, V::mul(w, square));
            // a fan's middle lies between its edges, on a line
            if (!heights && s > vectors.begin && s < last) continue;
            for (int m = s * V::n; m < s * V::n + V::n && m < count; ++m) dark += weight[m] == 0;
        }
        shades.dark[r] = dark;
        return dark;
    }

  private:
    static_assert(ramp_powers % 2 == 1, "powers are taken in pairs after the last");
    vec top_, power_[ramp_powers];
};

// Places of some of a line's pixels, the last again beyond it, from a transmitter.
inline void away_from(const Trace& trace, const Segments& lines, int r, int first, int count, Double::vec (&out)[3]) {
    using V = Double;
    alignas(64) static constexpr double number[] = {0, 1, 2, 3, 4, 5, 6, 7};
    static_assert(V::n <= 8, "numbers of all lanes");
    const V::vec pixel = V::min(V::add(V::load(number), V::set(first)), V::set(count - 1));
    for (int axis = 0; axis < 3; ++axis) {
        const double step = count > 1 ? lines.along[axis][r] / (count - 1) : 0.0;
        out[axis] = V::fma(pixel, V::set(step), V::set(lines.begin[axis][r] - trace.tx[axis]));
    }
}

// What the pixels of vector `s` weigh for the beam; returns how many of those that there are weigh nothing.
template <class V>
int shade_each(const Trace& trace, const Light& light, const Segments& lines, int r, int s, int count,
               typename V::real* out) {
    int dark = 0;
    for (int m = s * V::n; m < (s + 1) * V::n; m += Double::n) {
        Double::vec away[3], counts;
        away_from(trace, lines, r, m, count, away);
        const Double::vec weight = brightness(trace, light, away, counts);
        alignas(64) double each[Double::n];
        Double::store(each, counts);
        for (int i = 0; i < Double::n && m + i < count; ++i) dark += each[i] == 0;
        Double::store(out + m, weight);
    }
    return dark;
}

// How vectors of a line lie in a fan, by the sines at their ends: `slack` is what these leave out between them.
template <class V, int N>
struct Between {
    double value[block / V::n + 1], slack, edge, full;

    Between(const Light& light, const Shades<V, N>& shades, const Places<V, N>& at, int r, double nearness, bool relief)
        : edge(light.per * light.sine_half), full(light.per * light.sine_full) {
        double bend = 0;
        for (int q = 1; q < N; ++q) bend += q * (q - 1.0) * ::fabs(static_cast<double>(shades.sine[q][r]));
        const double width = at.edge[1] - at.edge[0];
        // what the polynomial is wrong by on a line half as long as `nearness` of its distance: see settings.cpp
        const double wrong = light.per * 0.125 * nearness * nearness * nearness * nearness * nearness;
        slack = bend * width * width / 8 + wrong + 1e-5 * edge;
        for (int q = 0; q < N && relief; ++q) slack += 1.01 * ::fabs(static_cast<double>(shades.rise[q][r]));
        for (int s = 0; s <= at.used; ++s) {
            double sum = shades.sine[N - 1][r];
            for (int q = N - 3; q >= 0; --q) sum = sum * at.edge[s] + shades.sine[q + 1][r];
            value[s] = sum * at.edge[s] + shades.sine[0][r];
        }
    }
    Reach operator[](int s) const {
        const double a = value[s], b = value[s + 1], left = ::fabs(a), right = ::fabs(b);
        const double least = (a < 0) != (b < 0) ? 0 : left < right ? left : right;
        if (least - slack > edge) return Reach::outside;
        const double most = (left > right ? left : right) + slack;
        return most < full ? Reach::inside : most < edge ? Reach::fading : Reach::across;
    }
};

// Vectors of line `r` that the beam or the record's ends cut, or that is too near for its polynomial: the first run of
// those that its polynomial serves (`far`: if any), while `exact` is given each run of the others. `heard` and `lit`
// tell of a vector. `dark` of the pixels served weigh nothing.
template <class V, int N, class Heard, class Lit, class Exactly>
Vectors cut(const Trace& trace, const Light& light, const Segments& lines, int r, int count, bool far,
            const Heard& heard, const Lit& lit, Shades<V, N>& shades, int& dark, const Exactly& exactly) {
    Vectors kept = {0, 0}, exact = {0, 0};
    for (int s = 0; s * V::n < count; ++s) {
        const Reach h = heard(s), l = lit(s);
        if (h == Reach::outside || l == Reach::outside) continue;
        const bool served = far && h == Reach::inside && (kept.end == 0 || kept.end == s);
        Vectors& run = served ? kept : exact;
        if (!served && run.end > 0 && run.end < s) exactly(run);
        if (run.end < s || run.end == 0) run.begin = s;
        run.end = s + 1;
        if (served && shades.of[r] == Shade::each) {
            typename V::real* to = shades.each[r];
            if (l == Reach::inside)
                V::store(to + s * V::n, V::set(1));
            else
                dark += shade_each<V>(trace, light, lines, r, s, count, to);
        }
    }
    if (exact.end > 0) exactly(exact);
    return kept;
}
