// The kernel g(time) is a sinc under a Kaiser window; each filter tap's coefficients are those of the polynomial
// through g's values at Chebyshev nodes of the interval. Sums of taps then read every in-band component as its own
// Chebyshev interpolant, which is within a factor two of the best polynomial of the degree.

#include "core/filters.hpp"

#include <algorithm>
#include <cmath>
#include <complex>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

double sinc(double x) { return std::abs(x) < 1e-9 ? 1.0 : std::sin(pi * x) / (pi * x); }

// The degree + 1 Chebyshev nodes of [-1/2, 1/2].
std::vector<double> node_places(int degree) {
    std::vector<double> at(static_cast<std::size_t>(degree) + 1);
    for (int j = 0; j <= degree; ++j)
        at[static_cast<std::size_t>(j)] = -0.5 * std::cos(pi * (2 * j + 1) / (2 * (degree + 1)));
    return at;
}

double measure(const Filter& filter, double band) {
    constexpr int steps = 16;
    const int places = 2 * filter.degree + 3;
    double worst = 0;
    for (int phase = 0; phase < filter.phases; ++phase) {
        const auto ph = static_cast<std::size_t>(phase);
        const double middle = (phase + 0.5) * filter.step / filter.phases;
        for (int i = 0; i <= steps; ++i) {
            const double f = band * i / steps;  // the kernel is real: -f is as wrong as f
            std::vector<std::complex<double>> response(static_cast<std::size_t>(filter.degree) + 1);
            auto turn = std::polar(1.0, 2 * pi * f * (static_cast<double>(filter.first[ph]) - middle));
            const auto next = std::polar(1.0, 2 * pi * f);
            for (int tap = 0; tap < filter.taps; ++tap, turn *= next) {
                for (int q = 0; q <= filter.degree; ++q) {
                    const auto place = (ph * static_cast<std::size_t>(filter.taps) + static_cast<std::size_t>(tap)) *
                                           (static_cast<std::size_t>(filter.degree) + 1) +
                                       static_cast<std::size_t>(q);
                    response[static_cast<std::size_t>(q)] += filter.weight[place] * turn;
                }
            }
            for (int j = 0; j <= places; ++j) {
                const double t = static_cast<double>(j) / places - 0.5;
                std::complex<double> value = 0;
                for (std::size_t q = response.size(); q-- > 0;) value = value * t + response[q];
                const auto wanted = std::polar(1.0, 2 * pi * f * t / filter.rate());
                worst = std::max(worst, std::abs(value - wanted));
            }
        }
    }
    return worst;
}

Filter make(double band, int degree, int phases, int step, int taps) {
    Filter filter;
    filter.degree = degree;
    filter.phases = phases;
    filter.step = step;
    filter.taps = taps;
    const double half = taps / 2.0;
    const double shape = 2 * pi * half * (0.5 - band);
    const double beta = shape > pi ? std::sqrt(shape * shape - pi * pi) : 0.0;
    const double norm = bessel(beta);
    const auto kernel = [&](double time) {
        const double x = time / half;
        if (std::abs(x) >= 1) return 0.0;
        return sinc(time) * bessel(beta * std::sqrt(1 - x * x)) / norm;
    };
    const auto at = node_places(degree);
    for (int phase = 0; phase < phases; ++phase) {
        const double middle = (phase + 0.5) * step / phases;
        const auto first = static_cast<std::int64_t>(std::floor(middle)) - taps / 2 + 1;
        filter.first.push_back(first);
        for (int tap = 0; tap < taps; ++tap) {
            std::vector<double> values(at.size());
            for (std::size_t j = 0; j < at.size(); ++j) {
                values[j] = kernel(middle + at[j] * step / phases - static_cast<double>(first + tap));
            }
            monomials(at, values);
            filter.weight.insert(filter.weight.end(), values.begin(), values.end());
        }
    }
    filter.error = measure(filter, band);
    return filter;
}

}  // namespace

// By its power series, which converges for all arguments used here.
double bessel(double x) {
    double term = 1, sum = 1;
    for (int k = 1; k < 500 && term > 1e-17 * sum; ++k) {
        term *= (x / (2 * k)) * (x / (2 * k));
        sum += term;
    }
    return sum;
}

Filter design(double band, int degree, int phases, int step, double error, int least, int most) {
    // what the polynomials lack cannot be mended by more taps: stop where they gain nothing
    int taps = least;
    Filter best = make(band, degree, phases, step, taps);
    while (best.error > error && taps < most) {
        taps += 4;
        if (taps > most) taps = most / 2 * 2;
        Filter longer = make(band, degree, phases, step, taps);
        const bool settled = taps > 24 && longer.error > 0.98 * best.error && longer.error < 1.02 * best.error;
        best = std::move(longer);
        if (settled) break;
    }
    return best;
}

}  // namespace pysas
