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
