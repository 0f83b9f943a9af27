// Kernels for any processor: short arrays that the compiler turns into whatever vectors its target has.
#include <math.h>

#include "core/kernels.hpp"

namespace pysas::baseline {
namespace {

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
using Eight = Float;
using Double = Plain<double, 4>;
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
