// Sine and cosine of a phase in turns within [-1/2, 1/2], two short polynomials in turns^2, and what they turn.

template <class V, int T>
struct Phase {
    typename V::vec sine[T], cosine[T + 1];

    explicit Phase(const double* s, const double* c) {
        for (int q = 0; q < T; ++q) sine[q] = V::set(static_cast<typename V::real>(s[q]));
        for (int q = 0; q <= T; ++q) cosine[q] = V::set(static_cast<typename V::real>(c[q]));
    }

    void operator()(typename V::vec turns, typename V::vec& s, typename V::vec& c) const {
        const auto square = V::mul(turns, turns);
        auto a = sine[T - 1];
        for (int q = T - 2; q >= 0; --q) a = V::fma(a, square, sine[q]);
        auto b = cosine[T];
        for (int q = T - 1; q >= 0; --q) b = V::fma(b, square, cosine[q]);
        s = V::mul(turns, a);
        c = b;
    }
};

// Add (re + j im)(cosine + j sine) to a vector of pixels.
template <class V>
void add_turned(typename V::vec re, typename V::vec im, typename V::vec sine, typename V::vec cosine,
                typename V::real* to_re, typename V::real* to_im) {
    V::store(to_re, V::fnma(im, sine, V::fma(re, cosine, V::load(to_re))));
    V::store(to_im, V::fma(im, cosine, V::fma(re, sine, V::load(to_im))));
}

// A tile's sums in `Real`, of `run` traces at most, and in double of those: what a sum rounds grows with its length.
template <typename Real>
struct Runs {
    alignas(64) double total_re[tile_rows * block], total_im[tile_rows * block];
    Real *re, *im;
    int size;
    std::int64_t run, summed = 0;
    bool any = false;

    Runs(Real* re, Real* im, int rows, double run)
        : re(re), im(im), size(rows * block), run(static_cast<std::int64_t>(run)) {
        for (int i = 0; i < tile_rows * block; ++i) re[i] = im[i] = 0;
    }
    static void move(Real* from, double* to, int size, bool any) {
        for (int i = 0; i < size; ++i) {
            to[i] = any ? to[i] + static_cast<double>(from[i]) : static_cast<double>(from[i]);
            from[i] = 0;
        }
    }
    void move() {
        move(re, total_re, size, any);
        move(im, total_im, size, any);
        any = true;
    }
    // Before a trace is added.
    void next() {
        if (summed == run && run > 0) {
            move();
            summed = 0;
        }
        ++summed;
    }
    // After the last.
    void finish() {
        if (!any) return;
        move();
        for (int i = 0; i < size; ++i) {
            re[i] = static_cast<Real>(total_re[i]);
            im[i] = static_cast<Real>(total_im[i]);
        }
    }
};
