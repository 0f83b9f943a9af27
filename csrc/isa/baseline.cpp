// Kernels for any processor: 8 floats or 4 doubles a vector, gathers alone.
#include <math.h>

#include <type_traits>
#ifdef __SSE2__
#include <emmintrin.h>
#endif

#include "core/kernels.hpp"

namespace pysas::baseline {
namespace {

#if defined(__GNUC__) || defined(__clang__)

// Vectors of 16 bytes: GCC and Clang have them for any target, in its registers where these are as long and else in
// scalars.
template <typename Real>
struct Half {
    typedef Real vec __attribute__((vector_size(16)));
    using whole = std::conditional_t<sizeof(Real) == 4, std::int32_t, std::int64_t>;
    typedef whole idx __attribute__((vector_size(16)));
    static constexpr int n = 16 / sizeof(Real);
    static constexpr bool single = sizeof(Real) == 4;

    static vec set(Real a) { return a - vec{}; }  // 0 + a would make 0 of -0, and cost an addition
    static vec load(const Real* p) {
        vec a;
        __builtin_memcpy(&a, p, sizeof a);
        return a;
    }
    static void store(Real* p, vec a) { __builtin_memcpy(p, &a, sizeof a); }
    template <typename To>
    static void store(To* p, vec a) {
        for (int i = 0; i < n; ++i) p[i] = static_cast<To>(a[i]);
    }
    static vec sqrt(vec a) {
#ifdef __SSE2__
        if constexpr (!single) return _mm_sqrt_pd(a);  // the library's sets errno, lane by lane
#endif
        for (int i = 0; i < n; ++i) a[i] = ::sqrt(a[i]);
        return a;
    }
    static vec min(vec a, vec b) { return a < b ? a : b; }
    static vec max(vec a, vec b) { return a > b ? a : b; }
    static vec abs(vec a) { return (vec)((idx)a & ~(idx)set(Real(-0.0))); }
    static vec floor(vec a) {
        // adding a number whose neighbours are 1 away, and taking it away again, rounds what is smaller to whole
        // numbers; the rest are whole
        const vec whole = set(single ? Real(8388608.0) : Real(4503599627370496.0));
        const idx sign = (idx)a & (idx)set(Real(-0.0));
        const vec more = (vec)((abs(a) < whole) & ((idx)whole | sign));
        const vec near = (a + more) - more;
        return near - one_where(near > a);
    }
    static vec one_where_le(vec a, vec b) { return one_where(a <= b); }
    static vec one_where_eq(vec a, vec b) { return one_where(a == b); }
    template <class Mask>
    static vec one_where(Mask mask) {
        return (vec)((idx)mask & (idx)set(1));
    }
    // what `magic` added, taken away again: the integer it rounded to
    static idx number(vec a) { return (idx)a - (single ? whole(0x4B400000) : whole(0x4338000000000000)); }
    static idx load_index(const std::int32_t* p) {
        idx k = {};
        for (int i = 0; i < n; ++i) k[i] = p[i];
        return k;
    }
    static vec gather(const Real* p, idx k) {
        if constexpr (single)
            return vec{p[k[0]], p[k[1]], p[k[2]], p[k[3]]};
        else
            return vec{p[k[0]], p[k[1]]};
    }
};

// Two of them: longer vectors of a compiler's, and arrays, go through memory, and with one the loops around a vector
// cost a tenth.
template <typename Real>
struct Pair {
    using real = Real;
    using half = Half<Real>;
    struct vec {
        typename half::vec low, high;
    };
    struct idx {
        typename half::idx low, high;
    };
    static constexpr int n = 2 * half::n;
    static constexpr int windows = 0;

    static vec set(Real a) { return {half::set(a), half::set(a)}; }
    static vec load(const Real* p) { return {half::load(p), half::load(p + half::n)}; }
    template <typename To>
    static void store(To* p, vec a) {
        half::store(p, a.low);
        half::store(p + half::n, a.high);
    }
    static void store_index(std::int32_t* p, vec a) { store(p, a); }
    static vec add(vec a, vec b) { return {a.low + b.low, a.high + b.high}; }
    static vec sub(vec a, vec b) { return {a.low - b.low, a.high - b.high}; }
    static vec mul(vec a, vec b) { return {a.low * b.low, a.high * b.high}; }
    static vec fma(vec a, vec b, vec c) { return {a.low * b.low + c.low, a.high * b.high + c.high}; }
    static vec fnma(vec a, vec b, vec c) { return {c.low - a.low * b.low, c.high - a.high * b.high}; }
    static vec div(vec a, vec b) { return {a.low / b.low, a.high / b.high}; }
    static vec sqrt(vec a) { return {half::sqrt(a.low), half::sqrt(a.high)}; }
    static vec inverse_root(vec a) { return div(set(1), sqrt(max(a, set(Real(1e-280))))); }
    static vec root(vec a) { return sqrt(a); }
    static vec abs(vec a) { return {half::abs(a.low), half::abs(a.high)}; }
    static vec min(vec a, vec b) { return {half::min(a.low, b.low), half::min(a.high, b.high)}; }
    static vec max(vec a, vec b) { return {half::max(a.low, b.low), half::max(a.high, b.high)}; }
    static vec floor(vec a) { return {half::floor(a.low), half::floor(a.high)}; }
    static vec one_where_le(vec a, vec b) {
        return {half::one_where_le(a.low, b.low), half::one_where_le(a.high, b.high)};
    }
    static vec one_where_eq(vec a, vec b) {
        return {half::one_where_eq(a.low, b.low), half::one_where_eq(a.high, b.high)};
    }
    static Real largest(vec a) {
        const auto both = half::max(a.low, a.high);
        Real most = both[0];
        for (int i = 1; i < half::n; ++i) most = both[i] > most ? both[i] : most;
        return most;
    }
    static Real total(vec a) {
        Real sum = 0;
        for (int i = 0; i < half::n; ++i) sum += a.low[i] + a.high[i];
        return sum;
    }
    static void totals(const vec (&a)[2], const vec (&b)[2], Real* of_a, Real* of_b) {
        for (int k = 0; k < 2; ++k) {
            of_a[k] = total(a[k]);
            of_b[k] = total(b[k]);
        }
    }
    static idx number(vec a) { return {half::number(a.low), half::number(a.high)}; }
    static idx bits(vec a) { return number(a); }
    static idx load_index(const std::int32_t* p) { return {half::load_index(p), half::load_index(p + half::n)}; }
    static vec gather(const Real* p, idx k) { return {half::gather(p, k.low), half::gather(p, k.high)}; }
    template <int W>
    static vec pick(const Real* p, idx k) {
        return gather(p, k);
    }
};

using Float = Pair<float>;
using Double = Pair<double>;

#else  // compilers without such vectors: short arrays

template <typename Real, int N>
struct Lanes {
    Real at[N];
};

template <typename Real, int N>
struct Plain {
    using real = Real;
    using vec = Lanes<Real, N>;
    using idx = Lanes<std::int32_t, N>;
    static constexpr int n = N;
    static constexpr int windows = 0;

    template <class F>
    static vec each(F f) {
        vec out;
        for (int i = 0; i < N; ++i) out.at[i] = f(i);
        return out;
    }
    static vec set(Real a) {
        return each([&](int) { return a; });
    }
    static vec load(const Real* p) {
        return each([&](int i) { return p[i]; });
    }
    template <typename To>
    static void store(To* p, vec a) {
        for (int i = 0; i < N; ++i) p[i] = static_cast<To>(a.at[i]);
    }
    static void store_index(std::int32_t* p, vec a) { store(p, a); }
    static vec add(vec a, vec b) {
        return each([&](int i) { return a.at[i] + b.at[i]; });
    }
    static vec sub(vec a, vec b) {
        return each([&](int i) { return a.at[i] - b.at[i]; });
    }
    static vec mul(vec a, vec b) {
        return each([&](int i) { return a.at[i] * b.at[i]; });
    }
    static vec fma(vec a, vec b, vec c) {
        return each([&](int i) { return a.at[i] * b.at[i] + c.at[i]; });
    }
    static vec fnma(vec a, vec b, vec c) {
        return each([&](int i) { return c.at[i] - a.at[i] * b.at[i]; });
    }
    static vec div(vec a, vec b) {
        return each([&](int i) { return a.at[i] / b.at[i]; });
    }
    static vec sqrt(vec a) {
        return each([&](int i) { return ::sqrt(a.at[i]); });
    }
    static vec inverse_root(vec a) {
        return each([&](int i) { return 1 / ::sqrt(a.at[i] > Real(1e-280) ? a.at[i] : Real(1e-280)); });
    }
    static vec root(vec a) { return sqrt(a); }
    static vec abs(vec a) {
        return each([&](int i) { return a.at[i] < 0 ? -a.at[i] : a.at[i]; });
    }
    static vec min(vec a, vec b) {
        return each([&](int i) { return a.at[i] < b.at[i] ? a.at[i] : b.at[i]; });
    }
    static vec max(vec a, vec b) {
        return each([&](int i) { return a.at[i] > b.at[i] ? a.at[i] : b.at[i]; });
    }
    static vec floor(vec a) {
        return each([&](int i) { return ::floor(a.at[i]); });
    }
    static vec one_where_le(vec a, vec b) {
        return each([&](int i) { return Real(a.at[i] <= b.at[i]); });
    }
    static vec one_where_eq(vec a, vec b) {
        return each([&](int i) { return Real(a.at[i] == b.at[i]); });
    }
    static Real largest(vec a) {
        Real most = a.at[0];
        for (int i = 1; i < N; ++i) most = a.at[i] > most ? a.at[i] : most;
        return most;
    }
    static Real total(vec a) {
        Real sum = 0;
        for (int i = 0; i < N; ++i) sum += a.at[i];
        return sum;
    }
    static void totals(const vec (&a)[2], const vec (&b)[2], Real* of_a, Real* of_b) {
        for (int k = 0; k < 2; ++k) {
            of_a[k] = total(a[k]);
            of_b[k] = total(b[k]);
        }
    }
    // what `magic` added, taken away again: the integer it rounded to
    static idx number(vec a) {
        constexpr Real magic = sizeof(Real) == 4 ? Real(12582912.0) : Real(6755399441055744.0);
        idx out;
        for (int i = 0; i < N; ++i) out.at[i] = static_cast<std::int32_t>(a.at[i] - magic);
        return out;
    }
    static idx bits(vec a) { return number(a); }
    static idx load_index(const std::int32_t* p) {
        idx out;
        for (int i = 0; i < N; ++i) out.at[i] = p[i];
        return out;
    }
    static vec gather(const Real* p, idx k) {
        return each([&](int i) { return p[k.at[i]]; });
    }
    template <int W>
    static vec pick(const Real* p, idx k) {
        return gather(p, k);
    }
};

using Float = Plain<float, 8>;
using Double = Plain<double, 4>;

#endif

using Eight = Float;
using Four = Double;

#include "kernels/backprojection.inl"
#include "kernels/factorised.inl"
#include "kernels/filter.inl"
#include "kernels/leaf.inl"
#include "kernels/lines.inl"
#include "kernels/reading.inl"
#include "kernels/relief_lines.inl"
#include "kernels/transform.inl"

}  // namespace

const Kernels kernels{"baseline",     &sum_tile<Float>, &sum_tile<Double>,     &filter<Float>, &filter<Double>,
                      &leaf<Float>,   &smooth<Float>,   &smooth_across<Float>, &merge<Float>,  &read_pixels<Float>,
                      &column<Float>, &stage<Eight>,    &stage<Four>};

}  // namespace pysas::baseline
