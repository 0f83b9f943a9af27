// Kernels for AArch64, whose every processor has these 128-bit registers: 8 floats or 4 doubles a vector, in two of
// them, windows of up to two vectors by look-ups of bytes in tables of two or four registers, loads lane by lane
// beyond.
//
// A vector is two registers: what a vector of pixels costs beside its arithmetic (broadcasts, addresses, loops) is paid
// once for both, and a processor that runs instructions in order has two chains to run side by side.
#include <arm_neon.h>
#include <math.h>

#include "core/kernels.hpp"

namespace pysas::neon {
namespace {

template <class Register>
struct Pair {
    Register a, b;
};

// Bytes of the elements whose numbers stand in the low byte of elements of `k`: `low` holds where each byte finds that
// one, `within` which of its element's bytes it is.
template <int Shift>
uint8x16_t bytes_of(uint8x16_t k, const std::uint8_t (&low)[16], const std::uint8_t (&within)[16]) {
    return vsliq_n_u8(vld1q_u8(within), vqtbl1q_u8(k, vld1q_u8(low)), Shift);
}

// Bytes of the table at `p`, W times two registers long. In line, as a pair of registers through a call costs more than
// a look-up.
template <int W>
PYSAS_INLINE Pair<uint8x16_t> look_up(const void* p, Pair<uint8x16_t> at) {
    const auto* const bytes = static_cast<const std::uint8_t*>(p);
    if constexpr (W == 1) {
        const uint8x16x2_t table = vld1q_u8_x2(bytes);
        return {vqtbl2q_u8(table, at.a), vqtbl2q_u8(table, at.b)};
    } else {
        const uint8x16x4_t table = vld1q_u8_x4(bytes);
        return {vqtbl4q_u8(table, at.a), vqtbl4q_u8(table, at.b)};
    }
}

struct Float {
    using real = float;
    using vec = Pair<float32x4_t>;
    using idx = Pair<int32x4_t>;
    static constexpr int n = 8;
    static constexpr int windows = 2;

    static vec set(float a) { return {vdupq_n_f32(a), vdupq_n_f32(a)}; }
    static vec load(const float* p) { return {vld1q_f32(p), vld1q_f32(p + 4)}; }
    static void store(float* p, vec x) {
        vst1q_f32(p, x.a);
        vst1q_f32(p + 4, x.b);
    }
    static vec add(vec x, vec y) { return {vaddq_f32(x.a, y.a), vaddq_f32(x.b, y.b)}; }
    static vec sub(vec x, vec y) { return {vsubq_f32(x.a, y.a), vsubq_f32(x.b, y.b)}; }
    static vec mul(vec x, vec y) { return {vmulq_f32(x.a, y.a), vmulq_f32(x.b, y.b)}; }
    static vec fma(vec x, vec y, vec z) { return {vfmaq_f32(z.a, x.a, y.a), vfmaq_f32(z.b, x.b, y.b)}; }
    static vec fnma(vec x, vec y, vec z) { return {vfmsq_f32(z.a, x.a, y.a), vfmsq_f32(z.b, x.b, y.b)}; }
    static vec abs(vec x) { return {vabsq_f32(x.a), vabsq_f32(x.b)}; }
    static vec min(vec x, vec y) { return {vminnmq_f32(x.a, y.a), vminnmq_f32(x.b, y.b)}; }
    static vec max(vec x, vec y) { return {vmaxnmq_f32(x.a, y.a), vmaxnmq_f32(x.b, y.b)}; }
    static vec one_where(uint32x4_t a, uint32x4_t b) {
        const uint32x4_t one = vreinterpretq_u32_f32(vdupq_n_f32(1.0F));
        return {vreinterpretq_f32_u32(vandq_u32(a, one)), vreinterpretq_f32_u32(vandq_u32(b, one))};
    }
    static vec one_where_le(vec x, vec y) { return one_where(vcleq_f32(x.a, y.a), vcleq_f32(x.b, y.b)); }
    static vec one_where_eq(vec x, vec y) { return one_where(vceqq_f32(x.a, y.a), vceqq_f32(x.b, y.b)); }
    static idx bits(vec x) { return {vreinterpretq_s32_f32(x.a), vreinterpretq_s32_f32(x.b)}; }
    static idx number(vec x) {
        const int32x4_t magic = vdupq_n_s32(0x4B400000);
        return {vsubq_s32(bits(x).a, magic), vsubq_s32(bits(x).b, magic)};
    }
    static idx load_index(const std::int32_t* p) { return {vld1q_s32(p), vld1q_s32(p + 4)}; }
    static PYSAS_INLINE float32x4_t gather_four(const float* p, int32x4_t k) {
        float32x4_t out = vld1q_dup_f32(p + vgetq_lane_s32(k, 0));
        out = vld1q_lane_f32(p + vgetq_lane_s32(k, 1), out, 1);
        out = vld1q_lane_f32(p + vgetq_lane_s32(k, 2), out, 2);
        return vld1q_lane_f32(p + vgetq_lane_s32(k, 3), out, 3);
    }
    static PYSAS_INLINE vec gather(const float* p, idx k) { return {gather_four(p, k.a), gather_four(p, k.b)}; }
    static uint8x16_t bytes(int32x4_t k) {
        static constexpr std::uint8_t low[16] = {0, 0, 0, 0, 4, 4, 4, 4, 8, 8, 8, 8, 12, 12, 12, 12};
        static constexpr std::uint8_t within[16] = {0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3};
        return bytes_of<2>(vreinterpretq_u8_s32(k), low, within);
    }
    template <int W>
    static PYSAS_INLINE vec pick(const float* p, idx k) {
        const auto found = look_up<W>(p, {bytes(k.a), bytes(k.b)});
        return {vreinterpretq_f32_u8(found.a), vreinterpretq_f32_u8(found.b)};
    }
    // sums of x[0] and x[1], and of y[0] and y[1]
    static void totals(const vec (&x)[2], const vec (&y)[2], float* of_x, float* of_y) {
        const auto four = [](vec v) { return vaddq_f32(v.a, v.b); };
        const float32x4_t sums = vpaddq_f32(vpaddq_f32(four(x[0]), four(x[1])), vpaddq_f32(four(y[0]), four(y[1])));
        vst1_f32(of_x, vget_low_f32(sums));
        vst1_f32(of_y, vget_high_f32(sums));
    }
};

struct Double {
    using real = double;
    using vec = Pair<float64x2_t>;
    using idx = Pair<int64x2_t>;
    static constexpr int n = 4;
    static constexpr int windows = 2;

    static vec set(double a) { return {vdupq_n_f64(a), vdupq_n_f64(a)}; }
    static vec load(const double* p) { return {vld1q_f64(p), vld1q_f64(p + 2)}; }
    static void store(double* p, vec x) {
        vst1q_f64(p, x.a);
        vst1q_f64(p + 2, x.b);
    }
    static void store(float* p, vec x) { vst1q_f32(p, vcvt_high_f32_f64(vcvt_f32_f64(x.a), x.b)); }
    static void store_index(std::int32_t* p, vec x) {
        vst1q_s32(p, vqmovn_high_s64(vqmovn_s64(vcvtnq_s64_f64(x.a)), vcvtnq_s64_f64(x.b)));
    }
    static vec add(vec x, vec y) { return {vaddq_f64(x.a, y.a), vaddq_f64(x.b, y.b)}; }
    static vec sub(vec x, vec y) { return {vsubq_f64(x.a, y.a), vsubq_f64(x.b, y.b)}; }
    static vec mul(vec x, vec y) { return {vmulq_f64(x.a, y.a), vmulq_f64(x.b, y.b)}; }
    static vec fma(vec x, vec y, vec z) { return {vfmaq_f64(z.a, x.a, y.a), vfmaq_f64(z.b, x.b, y.b)}; }
    static vec fnma(vec x, vec y, vec z) { return {vfmsq_f64(z.a, x.a, y.a), vfmsq_f64(z.b, x.b, y.b)}; }
    static vec div(vec x, vec y) { return {vdivq_f64(x.a, y.a), vdivq_f64(x.b, y.b)}; }
    static vec sqrt(vec x) { return {vsqrtq_f64(x.a), vsqrtq_f64(x.b)}; }
    static vec inverse_root(vec x) { return div(set(1.0), sqrt(max(x, set(1e-280)))); }
    static vec root(vec x) { return sqrt(x); }
    static vec abs(vec x) { return {vabsq_f64(x.a), vabsq_f64(x.b)}; }
    static vec min(vec x, vec y) { return {vminnmq_f64(x.a, y.a), vminnmq_f64(x.b, y.b)}; }
    static vec max(vec x, vec y) { return {vmaxnmq_f64(x.a, y.a), vmaxnmq_f64(x.b, y.b)}; }
    static vec floor(vec x) { return {vrndmq_f64(x.a), vrndmq_f64(x.b)}; }
    static vec one_where_le(vec x, vec y) {
        const uint64x2_t one = vreinterpretq_u64_f64(vdupq_n_f64(1.0));
        return {vreinterpretq_f64_u64(vandq_u64(vcleq_f64(x.a, y.a), one)),
                vreinterpretq_f64_u64(vandq_u64(vcleq_f64(x.b, y.b), one))};
    }
    static double largest(vec x) { return vmaxnmvq_f64(vmaxnmq_f64(x.a, x.b)); }
    static double total(vec x) { return vaddvq_f64(vaddq_f64(x.a, x.b)); }
    static idx bits(vec x) { return {vreinterpretq_s64_f64(x.a), vreinterpretq_s64_f64(x.b)}; }
    static idx number(vec x) {
        const int64x2_t magic = vdupq_n_s64(0x4338000000000000);
        return {vsubq_s64(bits(x).a, magic), vsubq_s64(bits(x).b, magic)};
    }
    static idx load_index(const std::int32_t* p) {
        const int32x4_t four = vld1q_s32(p);
        return {vmovl_s32(vget_low_s32(four)), vmovl_high_s32(four)};
    }
    static float64x2_t gather_two(const double* p, int64x2_t k) {
        return vld1q_lane_f64(p + vgetq_lane_s64(k, 1), vld1q_dup_f64(p + vgetq_lane_s64(k, 0)), 1);
    }
    static PYSAS_INLINE vec gather(const double* p, idx k) { return {gather_two(p, k.a), gather_two(p, k.b)}; }
    static uint8x16_t bytes(int64x2_t k) {
        static constexpr std::uint8_t low[16] = {0, 0, 0, 0, 0, 0, 0, 0, 8, 8, 8, 8, 8, 8, 8, 8};
        static constexpr std::uint8_t within[16] = {0, 1, 2, 3, 4, 5, 6, 7, 0, 1, 2, 3, 4, 5, 6, 7};
        return bytes_of<3>(vreinterpretq_u8_s64(k), low, within);
    }
    template <int W>
    static PYSAS_INLINE vec pick(const double* p, idx k) {
        const auto found = look_up<W>(p, {bytes(k.a), bytes(k.b)});
        return {vreinterpretq_f64_u8(found.a), vreinterpretq_f64_u8(found.b)};
    }
};

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

extern const Kernels kernels;
const Kernels kernels{"neon",         &sum_tile<Float>, &sum_tile<Double>,     &filter<Float>, &filter<Double>,
                      &leaf<Float>,   &smooth<Float>,   &smooth_across<Float>, &merge<Float>,  &read_pixels<Float>,
                      &column<Float>, &stage<Eight>,    &stage<Four>};

}  // namespace pysas::neon
