// Reading a trace's table: the polynomial of an interval, its coefficients picked from a window in registers (W vectors
// wide, `planes` at its first interval) or gathered from anywhere (W = 0).

template <class V, int D, int W>
PYSAS_INLINE void read(const typename V::real* planes, std::int64_t stride, typename V::idx k, typename V::vec t,
                       typename V::vec& re, typename V::vec& im) {
    const auto coefficient = [&](int plane) {
        const typename V::real* p = planes + plane * stride;
        if constexpr (W == 0)
            return V::gather(p, k);
        else
            return V::template pick<W>(p, k);
    };
    re = coefficient(2 * D);
    im = coefficient(2 * D + 1);
    for (int q = D - 1; q >= 0; --q) {
        re = V::fma(re, t, coefficient(2 * q));
        im = V::fma(im, t, coefficient(2 * q + 1));
    }
}

// The same, of intervals 0 to `most` from `planes` on.
template <class V, int D>
void read_within(const typename V::real* planes, std::int64_t stride, int most, typename V::idx k, typename V::vec t,
                 typename V::vec& re, typename V::vec& im) {
    if (V::windows >= 1 && most < V::n)
        read<V, D, (V::windows >= 1 ? 1 : 0)>(planes, stride, k, t, re, im);
    else if (V::windows >= 2 && most < 2 * V::n)
        read<V, D, (V::windows >= 2 ? 2 : 0)>(planes, stride, k, t, re, im);
    else
        read<V, D, 0>(planes, stride, k, t, re, im);
}
