// Kernels for AVX-512 F, DQ, BW and VL: 16 floats or 8 doubles a vector, windows of up to four vectors by permutes.
#include <immintrin.h>
#include <math.h>

#include "core/kernels.hpp"

namespace pysas::avx512 {
namespace {

struct Float {
    using real = float;
    using vec = __m512;
    using idx = __m512i;
    static constexpr int n = 16;
    static constexpr int windows = 4;

    static vec set(float a) { return _mm512_set1_ps(a); }
    static vec load(const float* p) { return _mm512_loadu_ps(p); }
    static void store(float* p, vec a) { _mm512_storeu_ps(p, a); }
    static vec add(vec a, vec b) { return _mm512_add_ps(a, b); }
    static vec sub(vec a, vec b) { return _mm512_sub_ps(a, b); }
    static vec mul(vec a, vec b) { return _mm512_mul_ps(a, b); }
    static vec fma(vec a, vec b, vec c) { return _mm512_fmadd_ps(a, b, c); }
    static vec fnma(vec a, vec b, vec c) { return _mm512_fnmadd_ps(a, b, c); }
    static vec abs(vec a) { return _mm512_abs_ps(a); }
    static vec min(vec a, vec b) { return _mm512_min_ps(a, b); }
    static vec max(vec a, vec b) { return _mm512_max_ps(a, b); }
    static vec one_where_le(vec a, vec b) {
        return _mm512_maskz_mov_ps(_mm512_cmp_ps_mask(a, b, _CMP_LE_OQ), set(1.0F));
    }
    static vec one_where_eq(vec a, vec b) {
        return _mm512_maskz_mov_ps(_mm512_cmp_ps_mask(a, b, _CMP_EQ_OQ), set(1.0F));
    }
    static idx bits(vec a) { return _mm512_castps_si512(a); }
    static idx number(vec a) { return _mm512_sub_epi32(bits(a), _mm512_set1_epi32(0x4B400000)); }
    static idx load_index(const std::int32_t* p) { return _mm512_loadu_si512(p); }
    static vec gather(const float* p, idx k) { return _mm512_i32gather_ps(k, p, 4); }
    template <int W>
    static vec pick(const float* p, idx k) {
        if constexpr (W == 1) return _mm512_permutexvar_ps(k, load(p));
        if constexpr (W == 2) return _mm512_permutex2var_ps(load(p), k, load(p + 16));
        const vec low = _mm512_permutex2var_ps(load(p), k, load(p + 16));
        const vec high = _mm512_permutex2var_ps(load(p + 32), k, load(p + 48));
        return _mm512_mask_blend_ps(_mm512_test_epi32_mask(k, _mm512_set1_epi32(32)), low, high);
    }
};

#include "isa/eight.inl"

struct Double {
    using real = double;
    using vec = __m512d;
    using idx = __m512i;
    static constexpr int n = 8;
    static constexpr int windows = 4;

    static vec set(double a) { return _mm512_set1_pd(a); }
    static vec load(const double* p) { return _mm512_loadu_pd(p); }
    static void store(double* p, vec a) { _mm512_storeu_pd(p, a); }
    static void store(float* p, vec a) { _mm256_storeu_ps(p, _mm512_cvtpd_ps(a)); }
    static void store_index(std::int32_t* p, vec a) {
        _mm256_storeu_si256(reinterpret_cast<__m256i*>(p), _mm512_cvtpd_epi32(a));
    }
    static vec add(vec a, vec b) { return _mm512_add_pd(a, b); }
    static vec sub(vec a, vec b) { return _mm512_sub_pd(a, b); }
    static vec mul(vec a, vec b) { return _mm512_mul_pd(a, b); }
    static vec fma(vec a, vec b, vec c) { return _mm512_fmadd_pd(a, b, c); }
    static vec fnma(vec a, vec b, vec c) { return _mm512_fnmadd_pd(a, b, c); }
    static vec div(vec a, vec b) { return _mm512_div_pd(a, b); }
    static vec sqrt(vec a) { return _mm512_sqrt_pd(a); }
    // 1 / sqrt and sqrt to within a few roundings, by Newton's method from 14 bits: a sixth of the time of the
    // instructions. Squares below 1e-280 are taken for that.
    static vec inverse_root(vec a) {
        a = max(a, set(1e-280));
        const vec half = mul(a, set(0.5));
        vec y = _mm512_rsqrt14_pd(a);
        for (int i = 0; i < 2; ++i) y = mul(y, fnma(mul(half, y), y, set(1.5)));
        return y;
    }
    static vec root(vec a) { return mul(a, inverse_root(a)); }
    static vec abs(vec a) { return _mm512_abs_pd(a); }
    static vec min(vec a, vec b) { return _mm512_min_pd(a, b); }
    static vec max(vec a, vec b) { return _mm512_max_pd(a, b); }
    static vec floor(vec a) { return _mm512_roundscale_pd(a, _MM_FROUND_TO_NEG_INF | _MM_FROUND_NO_EXC); }
    static vec one_where_le(vec a, vec b) {
        return _mm512_maskz_mov_pd(_mm512_cmp_pd_mask(a, b, _CMP_LE_OQ), _mm512_set1_pd(1.0));
    }
    static double largest(vec a) { return _mm512_reduce_max_pd(a); }
    static double total(vec a) { return _mm512_reduce_add_pd(a); }
    static idx bits(vec a) { return _mm512_castpd_si512(a); }
    static idx number(vec a) { return _mm512_sub_epi64(bits(a), _mm512_set1_epi64(0x4338000000000000)); }
    static idx load_index(const std::int32_t* p) {
        return _mm512_cvtepi32_epi64(_mm256_loadu_si256(reinterpret_cast<const __m256i*>(p)));
    }
    static vec gather(const double* p, idx k) { return _mm512_i64gather_pd(k, p, 8); }
    template <int W>
    static vec pick(const double* p, idx k) {
        if constexpr (W == 1) return _mm512_permutexvar_pd(k, load(p));
        if constexpr (W == 2) return _mm512_permutex2var_pd(load(p), k, load(p + 8));
        const vec low = _mm512_permutex2var_pd(load(p), k, load(p + 8));
        const vec high = _mm512_permutex2var_pd(load(p + 16), k, load(p + 24));
        return _mm512_mask_blend_pd(_mm512_test_epi64_mask(k, _mm512_set1_epi64(16)), low, high);
    }
};

#include "kernels/backprojection.inl"
#include "kernels/factorised.inl"
#include "kernels/filter.inl"
#include "kernels/leaf.inl"
#include "kernels/lines.inl"
#include "kernels/reading.inl"
#include "kernels/relief_lines.inl"
#include "kernels/transform.inl"

}  // namespace

extern const Kernels kernels;
const Kernels kernels{"avx512",       &sum_tile<Float>, &sum_tile<Double>,     &filter<Float>, &filter<Double>,
                      &leaf<Float>,   &smooth<Float>,   &smooth_across<Float>, &merge<Float>,  &read_pixels<Float>,
                      &column<Float>, &stage<Eight>,    &stage<Four>};

}  // namespace pysas::avx512
