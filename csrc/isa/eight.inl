// Eight floats or four doubles of AVX2, for loops whose natural length that is. Included inside a set's namespace.
struct Eight {
    using real = float;
    using vec = __m256;
    static constexpr int n = 8;
    static vec set(float a) { return _mm256_set1_ps(a); }
    static vec load(const float* p) { return _mm256_loadu_ps(p); }
    static void store(float* p, vec a) { _mm256_storeu_ps(p, a); }
    static vec add(vec a, vec b) { return _mm256_add_ps(a, b); }
    static vec sub(vec a, vec b) { return _mm256_sub_ps(a, b); }
    static vec mul(vec a, vec b) { return _mm256_mul_ps(a, b); }
    static vec fma(vec a, vec b, vec c) { return _mm256_fmadd_ps(a, b, c); }
    static vec fnma(vec a, vec b, vec c) { return _mm256_fnmadd_ps(a, b, c); }
    // sums of a[0] and a[1], and of b[0] and b[1]
    static void totals(const vec (&a)[2], const vec (&b)[2], float* of_a, float* of_b) {
        const vec four = _mm256_hadd_ps(_mm256_hadd_ps(a[0], a[1]), _mm256_hadd_ps(b[0], b[1]));
        const __m128 sums = _mm_add_ps(_mm256_castps256_ps128(four), _mm256_extractf128_ps(four, 1));
        _mm_storel_pi(reinterpret_cast<__m64*>(of_a), sums);
        _mm_storeh_pi(reinterpret_cast<__m64*>(of_b), sums);
    }
};

struct Four {
    using real = double;
    using vec = __m256d;
    static constexpr int n = 4;
    static vec set(double a) { return _mm256_set1_pd(a); }
    static vec load(const double* p) { return _mm256_loadu_pd(p); }
    static void store(double* p, vec a) { _mm256_storeu_pd(p, a); }
    static vec add(vec a, vec b) { return _mm256_add_pd(a, b); }
    static vec sub(vec a, vec b) { return _mm256_sub_pd(a, b); }
    static vec mul(vec a, vec b) { return _mm256_mul_pd(a, b); }
    static vec fma(vec a, vec b, vec c) { return _mm256_fmadd_pd(a, b, c); }
    static vec fnma(vec a, vec b, vec c) { return _mm256_fnmadd_pd(a, b, c); }
};
