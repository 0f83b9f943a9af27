// A stage of a Fourier transform of sequences side by side: butterflies of radix 2, 3, 4 or 5, whose outputs are
// turned.

// A complex value of each of a vector's sequences.
template <class V>
struct Complex {
    typename V::vec re, im;

    static Complex load(const typename V::real* re, const typename V::real* im, std::int64_t at) {
        return {V::load(re + at), V::load(im + at)};
    }
    Complex operator+(const Complex& b) const { return {V::add(re, b.re), V::add(im, b.im)}; }
    Complex operator-(const Complex& b) const { return {V::sub(re, b.re), V::sub(im, b.im)}; }
    Complex times(typename V::vec a) const { return {V::mul(a, re), V::mul(a, im)}; }
    // this + a b
    Complex plus(typename V::vec a, const Complex& b) const { return {V::fma(a, b.re, re), V::fma(a, b.im, im)}; }
    // this - j b, this + j b
    Complex less_turned(const Complex& b) const { return {V::add(re, b.im), V::sub(im, b.re)}; }
    Complex plus_turned(const Complex& b) const { return {V::sub(re, b.im), V::add(im, b.re)}; }
    void store(typename V::real* to_re, typename V::real* to_im, std::int64_t at) const {
        V::store(to_re + at, re);
        V::store(to_im + at, im);
    }
    // turned by w, real and imaginary
    void store(typename V::real* to_re, typename V::real* to_im, std::int64_t at, const typename V::real* w) const {
        const typename V::vec c = V::set(w[0]), d = V::set(w[1]);
        V::store(to_re + at, V::fnma(im, d, V::mul(re, c)));
        V::store(to_im + at, V::fma(im, c, V::mul(re, d)));
    }
};

// Sums exp(-2 pi j k m / radix) x[m], for k below the radix.
template <class V, int Radix>
struct Butterfly {
    using C = Complex<V>;
    using real = typename V::real;

    static void of(const C (&x)[Radix], C (&y)[Radix]) {
        if constexpr (Radix == 2) {
            y[0] = x[0] + x[1];
            y[1] = x[0] - x[1];
        } else if constexpr (Radix == 3) {
            const C sum = x[1] + x[2], across = (x[1] - x[2]).times(V::set(real(0.86602540378443864676)));
            const C middle = x[0].plus(V::set(real(-0.5)), sum);
            y[0] = x[0] + sum;
            y[1] = middle.less_turned(across);
            y[2] = middle.plus_turned(across);
        } else if constexpr (Radix == 4) {
            const C a = x[0] + x[2], b = x[0] - x[2], c = x[1] + x[3], d = x[1] - x[3];
            y[0] = a + c;
            y[1] = b.less_turned(d);
            y[2] = a - c;
            y[3] = b.plus_turned(d);
        } else {
            const auto c1 = V::set(real(0.30901699437494742410)), s1 = V::set(real(0.95105651629515357212));
            const auto c2 = V::set(real(-0.80901699437494742410)), s2 = V::set(real(0.58778525229247312917));
            const C a = x[1] + x[4], b = x[1] - x[4], c = x[2] + x[3], d = x[2] - x[3];
            const C p = x[0].plus(c1, a).plus(c2, c), q = x[0].plus(c2, a).plus(c1, c);
            const C r = b.times(s1).plus(s2, d), s = b.times(s2).plus(V::set(real(-0.95105651629515357212)), d);
            y[0] = x[0] + a + c;
            y[1] = p.less_turned(r);
            y[2] = q.less_turned(s);
            y[3] = q.plus_turned(s);
            y[4] = p.plus_turned(r);
        }
    }
};

template <class V, int Radix>
void stage_of(const StageJob<typename V::real>& job) {
    const std::int64_t apart = job.parts * job.run;
    for (std::int64_t part = 0; part < job.parts; ++part) {
        const typename V::real* twiddle = job.twiddle + 2 * (Radix - 1) * part;
        for (std::int64_t i = 0; i < job.run; i += V::n) {
            Complex<V> x[Radix], y[Radix];
            for (int k = 0; k < Radix; ++k)
                x[k] = Complex<V>::load(job.from_re, job.from_im, part * job.run + k * apart + i);
            Butterfly<V, Radix>::of(x, y);
            const std::int64_t to = part * job.run * Radix + i;
            y[0].store(job.to_re, job.to_im, to);
            for (int k = 1; k < Radix; ++k) y[k].store(job.to_re, job.to_im, to + k * job.run, twiddle + 2 * (k - 1));
        }
    }
}

template <class V>
void stage(const StageJob<typename V::real>& job) {
    switch (job.radix) {
        case 2:
            return stage_of<V, 2>(job);
        case 3:
            return stage_of<V, 3>(job);
        case 4:
            return stage_of<V, 4>(job);
        default:
            return stage_of<V, 5>(job);
    }
}
