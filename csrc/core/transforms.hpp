// Discrete Fourier transforms of lengths 2^a 3^b 5^c, and the low-pass W that says how a record's end is read.
#pragma once

#include <complex>
#include <cstdint>
#include <vector>

#include "core/kernels.hpp"

namespace pysas {

// The least length of at least `n` that there are transforms for.
std::int64_t fast_length(std::int64_t n);

// W at a frequency in cycles per sample: 1 up to 1/2.2, falling as cos^2 to 0 at 1/2.
double low_pass(double frequency);

// exp(2 pi j k / n), exact to double's last digit.
std::complex<double> root_of_unity(std::int64_t k, std::int64_t n);

// Sums over m of x[m] exp(-2 pi j k m / n), of several sequences side by side: value m of all `lanes` sequences, a
// multiple of transform_lanes, lies at re + m lanes, im + m lanes. Sums with exp(+2 pi j k m / n) are had by handing
// over imaginary parts as real ones and the other way round.
template <typename Real>
class Transform {
  public:
    struct Planes {
        Real *re, *im;
    };

    // Throws std::logic_error for a length that has other factors.
    explicit Transform(std::int64_t n);

    std::int64_t size() const { return n_; }
    // Both `data` and `work` have n values of all lanes and lose what they held; returns where the sums are.
    Planes operator()(const Kernels& kernels, Planes data, Planes work, std::int64_t lanes) const;

  private:
    struct Stage {
        int radix;
        std::int64_t parts;         // of the sequences left, each `radix` as long as the next stage's
        std::vector<Real> twiddle;  // (parts, radix - 1, 2)
    };

    std::int64_t n_;
    std::vector<Stage> stages_;
};

}  // namespace pysas
