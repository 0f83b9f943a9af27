// From samples to a trace's table: every coefficient of every interval is a short sum over samples.

// A vector's lanes are places a step apart, of which each phase makes one interval: their intervals lie side by side,
// so that what a run of places stores stays in the first-level cache.
template <class V, int D>
void filter_degree(const FilterJob<typename V::real>& job) {
    using real = typename V::real;
    using vec = typename V::vec;
    constexpr int planes = 2 * (D + 1);
    const std::int64_t places = (job.intervals + job.phases - 1) / job.phases;
    for (std::int64_t m = 0; m < places; m += V::n) {
        for (int phase = 0; phase < job.phases; ++phase) {
            const std::int64_t count = (job.intervals - phase + job.phases - 1) / job.phases;
            if (m >= count) break;
            const real* weight = job.weight + static_cast<std::int64_t>(phase) * job.taps * (D + 1);
            const std::int64_t start = job.origin + job.first[phase];
            std::int64_t part = start % job.step, from = start / job.step + m;
            vec sum[planes];
            for (int i = 0; i < planes; ++i) sum[i] = V::set(0);
            for (int tap = 0; tap < job.taps; ++tap) {
                const vec re = V::load(job.re[part] + from), im = V::load(job.im[part] + from);
                for (int q = 0; q <= D; ++q) {
                    const vec w = V::set(weight[tap * (D + 1) + q]);
                    sum[2 * q] = V::fma(re, w, sum[2 * q]);
                    sum[2 * q + 1] = V::fma(im, w, sum[2 * q + 1]);
                }
                if (++part == job.step) part = 0, ++from;
            }
            const int kept = static_cast<int>(count - m < V::n ? count - m : V::n);
            for (int i = 0; i < planes; ++i) {
                real* to = job.out + i * job.plane_stride + m * job.phases + phase;
                if (job.phases == 1 && kept == V::n) {
                    V::store(to, sum[i]);
                    continue;
                }
                alignas(64) real each[V::n];
                V::store(each, sum[i]);
                for (int j = 0; j < kept; ++j) to[j * job.phases] = each[j];
            }
        }
    }
}

template <class V>
void filter(const FilterJob<typename V::real>& job) {
    with_degree<FilterSizes>(job.degree, [&](auto degree) { filter_degree<V, decltype(degree)::value>(job); });
}
