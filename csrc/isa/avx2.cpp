// Kernels for AVX2 and FMA: 8 floats or 4 doubles a vector, windows of up to two vectors by permutes, gathers beyond.
#include <immintrin.h>
#include <math.h>

#include "core/kernels.hpp"

namespace pysas::avx2 {
namespace {

struct Float {
    using real = float;
    using vec = __m256;
    using idx = __m256i;
    static constexpr int n = 8;
    static constexpr int windows = 2;

    static vec set(float a) { return _mm256_set1_ps(a); }
    static vec load(const float* p) { return _mm256_loadu_ps(p); }
    static void store(float* p, vec a) { _mm256_storeu_ps(p, a); }
    static vec add(vec a, vec b) { return _mm256_add_ps(a, b); }
    static vec sub(vec a, vec b) { return _mm256_sub_ps(a, b); }
    static vec mul(vec a, vec b) { return _mm256_mul_ps(a, b); }
    static vec fma(vec a, vec b, vec c) { return _mm256_fmadd_ps(a, b, c); }
    static vec fnma(vec a, vec b, vec c) { return _mm256_fnmadd_ps(a, b, c); }
    static vec abs(vec a) { return _mm256_andnot_ps(set(-0.0F), a); }
    static vec min(vec a, vec b) { return _mm256_min_ps(a, b); }
    static vec max(vec a, vec b) { return _mm256_max_ps(a, b); }
    static vec one_where_le(vec a, vec b) { return _mm256_and_ps(_mm256_cmp_ps(a, b, _CMP_LE_OQ), set(1.0F)); }
    static vec one_where_eq(vec a, vec b) { return _mm256_and_ps(_mm256_cmp_ps(a, b, _CMP_EQ_OQ), set(1.0F)); }
    static idx bits(vec a) { return _mm256_castps_si256(a); }
    static idx number(vec a) { return _mm256_sub_epi32(bits(a), _mm256_set1_epi32(0x4B400000)); }
    static idx load_index(const std::int32_t* p) { return _mm256_loadu_si256(reinterpret_cast<const __m256i*>(p)); }
    static vec gather(const float* p, idx k) { return _mm256_i32gather_ps(p, k, 4); }
    template <int W>
    static vec pick(const float* p, idx k) {
        const vec low = _mm256_permutevar8x32_ps(load(p), k);
        if constexpr (W == 1) return low;
        const vec high = _mm256_permutevar8x32_ps(load(p + 8), k);
        return _mm256_blendv_ps(low, high, _mm256_castsi256_ps(_mm256_slli_epi32(k, 28)));
    }
};

#include "isa/eight.inl"

struct Double {
    using real = double;
    using vec = __m256d;
    using idx = __m256i;
    static constexpr int n = 4;
    static constexpr int windows = 2;

    static vec set(double a) { return _mm256_set1_pd(a); }
    static vec load(const double* p) { return _mm256_loadu_pd(p); }
    static void store(double* p, vec a) { _mm256_storeu_pd(p, a); }
    static void store(float* p, vec a) { _mm_storeu_ps(p, _mm256_cvtpd_ps(a)); }
    static void store_index(std::int32_t* p, vec a) {
        _mm_storeu_si128(reinterpret_cast<__m128i*>(p), _mm256_cvtpd_epi32(a));
    }
    static vec add(vec a, vec b) { return _mm256_add_pd(a, b); }
    static vec sub(vec a, vec b) { return _mm256_sub_pd(a, b); }
    static vec mul(vec a, vec b) { return _mm256_mul_pd(a, b); }
    static vec fma(vec a, vec b, vec c) { return _mm256_fmadd_pd(a, b, c); }
    static vec fnma(vec a, vec b, vec c) { return _mm256_fnmadd_pd(a, b, c); }
    static vec div(vec a, vec b) { return _mm256_div_pd(a, b); }
    static vec sqrt(vec a) { return _mm256_sqrt_pd(a); }
    static vec inverse_root(vec a) { return div(set(1.0), sqrt(max(a, set(1e-280)))); }
    static vec root(vec a) { return sqrt(a); }
    static vec abs(vec a) { return _mm256_andnot_pd(set(-0.0), a); }
    static vec min(vec a, vec b) { return _mm256_min_pd(a, b); }
    static vec max(vec a, vec b) { return _mm256_max_pd(a, b); }
    static vec floor(vec a) { return _mm256_floor_pd(a); }
    static vec one_where_le(vec a, vec b) { return _mm256_and_pd(_mm256_cmp_pd(a, b, _CMP_LE_OQ), set(1.0)); }
    static double largest(vec a) {
        double each[n];
        store(each, a);
        const double x = each[0] > each[1] ? each[0] : each[1], y = each[2] > each[3] ? each[2] : each[3];
        return x > y ? x : y;
    }
    static double total(vec a) {
        double each[n];
        store(each, a);
        return each[0] + each[1] + each[2] + each[3];
    }
    static idx bits(vec a) { return _mm256_castpd_si256(a); }
    static idx number(vec a) { return _mm256_sub_epi64(bits(a), _mm256_set1_epi64x(0x4338000000000000)); }
    static idx load_index(const std::int32_t* p) {
        return _mm256_cvtepi32_epi64(_mm_loadu_si128(reinterpret_cast<const __m128i*>(p)));
    }
    static vec gather(const double* p, idx k) { return _mm256_i64gather_pd(p, k, 8); }
    // there is no permute of doubles by a vector of places: halves of doubles are permuted as floats
    static vec permute(const double* p, idx halves) {
        return _mm256_castps_pd(_mm256_permutevar8x32_ps(_mm256_castpd_ps(load(p)), halves));
    }
    template <int W>
    static vec pick(const double* p, idx k) {
        const idx even = _mm256_slli_epi64(k, 1);
        const idx halves =
            _mm256_or_si256(_mm256_blend_epi32(even, _mm256_slli_epi64(k, 33), 0xAA), _mm256_set1_epi64x(0x100000000));
        const vec low = permute(p, halves);
        if constexpr (W == 1) return low;
        return _mm256_blendv_pd(low, permute(p + 4, halves), _mm256_castsi256_pd(_mm256_slli_epi64(k, 61)));
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
const Kernels kernels{"avx2",         &sum_tile<Float>, &sum_tile<Double>,     &filter<Float>, &filter<Double>,
                      &leaf<Float>,   &smooth<Float>,   &smooth_across<Float>, &merge<Float>,  &read_pixels<Float>,
                      &column<Float>, &stage<Eight>,    &stage<Four>};

}  // namespace pysas::avx2
