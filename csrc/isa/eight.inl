// Eight floats of AVX2, for loops whose natural length that is. Included inside a set's namespace.
struct Eight {
    using vec = __m256;
    static vec set(float a) { return _mm256_set1_ps(a); }
    static vec load(const float* p) { return _mm256_loadu_ps(p); }
    static void store(float* p, vec a) { _mm256_storeu_ps(p, a); }
    static vec mul(vec a, vec b) { return _mm256_mul_ps(a, b); }
    static vec fma(vec a, vec b, vec c) { return _mm256_fmadd_ps(a, b, c); }
    static float total(vec a) {
        const __m128 half = _mm_add_ps(_mm256_castps256_ps128(a), _mm256_extractf128_ps(a, 1));
        const __m128 pair = _mm_add_ps(half, _mm_movehl_ps(half, half));
        return _mm_cvtss_f32(_mm_add_ss(pair, _mm_shuffle_ps(pair, pair, 1)));
    }
};
