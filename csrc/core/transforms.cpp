// Stockham's algorithm: each stage reads one plane and writes another, in an order that needs no sorting at the end.
// Vectors lie along the lanes (kernels/transform.inl).

#include "core/transforms.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <string>
#include <utility>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

std::vector<int> radices(std::int64_t n) {
    std::vector<int> found;
    std::int64_t left = n;
    for (const int radix : {5, 3, 4, 2}) {
        for (; left > 1 && left % radix == 0; left /= radix) found.push_back(radix);
    }
    if (n < 1 || left != 1) throw std::logic_error("no transform of length " + std::to_string(n));
    return found;
}

}  // namespace

std::int64_t fast_length(std::int64_t n) {
    std::int64_t best = std::numeric_limits<std::int64_t>::max();
    for (std::int64_t five = 1;; five *= 5) {
        for (std::int64_t three = five;; three *= 3) {
            std::int64_t size = three;
            while (size < n) size *= 2;
            best = std::min(best, size);
            if (three >= n) break;
        }
        if (five >= n) return best;
    }
}

double low_pass(double frequency) {
    const double low = 1 / 2.2, edge = (std::abs(frequency) - low) / (0.5 - low);
    const double c = std::cos(pi / 2 * std::min(std::max(edge, 0.0), 1.0));
    return c * c;
}

std::complex<double> root_of_unity(std::int64_t k, std::int64_t n) {
    k = ((k % n) + n) % n;
    // by the nearest multiple of a quarter turn: angles of at most an eighth of one lose nothing
    const std::int64_t quarter = (8 * k + n) / (2 * n);
    const double angle = 2 * pi * (static_cast<double>(4 * k - quarter * n) / (4 * static_cast<double>(n)));
    const double c = std::cos(angle), s = std::sin(angle);
    switch (quarter % 4) {
        case 0:
            return {c, s};
        case 1:
            return {-s, c};
        case 2:
            return {-c, -s};
        default:
            return {s, -c};
    }
}

template <typename Real>
Transform<Real>::Transform(std::int64_t n) : n_(n) {
    std::int64_t left = n;
    for (const int radix : radices(n)) {
        Stage stage{radix, left / radix, {}};
        for (std::int64_t p = 0; p < stage.parts; ++p) {
            for (int j = 1; j < radix; ++j) {
                const auto turn = root_of_unity(-p * j, left);
                stage.twiddle.push_back(static_cast<Real>(turn.real()));
                stage.twiddle.push_back(static_cast<Real>(turn.imag()));
            }
        }
        left = stage.parts;
        stages_.push_back(std::move(stage));
    }
}

template <typename Real>
typename Transform<Real>::Planes Transform<Real>::operator()(const Kernels& kernels, Planes data, Planes work,
                                                             std::int64_t lanes) const {
    std::int64_t run = lanes;  // values side by side: those of sequences that the stages before have split
    for (const Stage& stage : stages_) {
        const StageJob<Real> job{data.re,     data.im,     work.re, work.im, stage.twiddle.data(),
                                 stage.radix, stage.parts, run};
        if constexpr (sizeof(Real) == 4)
            kernels.stage_single(job);
        else
            kernels.stage_double(job);
        run *= stage.radix;
        std::swap(data, work);
    }
    return data;
}

template class Transform<float>;
template class Transform<double>;

}  // namespace pysas
