#include "planning/taps.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <vector>

#include "core/filters.hpp"
#include "core/polynomials.hpp"

namespace pysas {
namespace {

constexpr int places = 17, frequencies = 33;

// x that minimises |A x - b| for A of `n` columns stored one after the other; A and b are overwritten. Householder's
// reflections: the columns are cosines of neighbouring harmonics over less than half a period, so that normal equations
// would lose half the digits.
std::vector<double> least_squares(std::vector<std::vector<double>>& a, std::vector<double>& b) {
    const std::size_t n = a.size(), m = b.size();
    std::vector<double> diagonal(n), x(n);
    for (std::size_t k = 0; k < n; ++k) {
        auto& v = a[k];
        double norm2 = 0;
        for (std::size_t i = k; i < m; ++i) norm2 += v[i] * v[i];
        diagonal[k] = v[k] > 0 ? -std::sqrt(norm2) : std::sqrt(norm2);
        v[k] -= diagonal[k];
        const double scale = norm2 - diagonal[k] * (v[k] + diagonal[k]);  // half of |v|^2
        const auto reflect = [&](std::vector<double>& to) {
            double sum = 0;
            for (std::size_t i = k; i < m; ++i) sum += v[i] * to[i];
            for (std::size_t i = k; i < m; ++i) to[i] -= sum / scale * v[i];
        };
        for (std::size_t j = k + 1; j < n; ++j) reflect(a[j]);
        reflect(b);
    }
    for (std::size_t k = n; k-- > 0;) {
        x[k] = b[k];
        for (std::size_t j = k + 1; j < n; ++j) x[k] -= a[j][k] * x[j];
        x[k] /= diagonal[k];
    }
    return x;
}

// Everything but the window, which is tried in many shapes.
struct Bench {
    int count, half;
    std::vector<double> nodes, x, f, edge;
    std::vector<std::complex<double>> turns;  // (f, x, tap)
    std::vector<double> cosines;              // (half + 1, f)

    Bench(int count, double rate, int half) : count(count), half(half) {
        for (int j = 0; j <= count; ++j) nodes.push_back(std::cos(pi * (j + 0.5) / (count + 1)) / 2);
        for (int i = 0; i < places; ++i) x.push_back(static_cast<double>(i) / (places - 1) - 0.5);
        for (int i = 0; i < frequencies; ++i) {
            // densest at the band's edge: the error's last extremum lies within 2 % of it
            const double share = std::sin(pi / 2 * i / (frequencies - 1));
            f.push_back(0.5 / rate * share);
            edge.push_back(std::pow(1.02 - share * share, -0.25));
        }
        for (const double frequency : f) {
            for (const double place : x) {
                for (int t = 0; t < count; ++t)
                    turns.push_back(std::polar(1.0, 2 * pi * (offset(t) - place) * frequency));
            }
        }
        for (int k = 0; k <= half; ++k) {
            for (const double frequency : f) cosines.push_back((k == 0 ? 1 : 2) * std::cos(2 * pi * frequency * k));
        }
    }

    double offset(int tap) const { return tap - (count - 1) / 2.0; }

    // Coefficients of each tap, powers of the place.
    std::vector<std::vector<double>> powers(double beta) const {
        std::vector<std::vector<double>> out;
        for (int t = 0; t < count; ++t) {
            std::vector<double> values;
            for (const double node : nodes) {
                const double z = 2 * (offset(t) - node) / count;
                values.push_back(bessel(beta * std::sqrt(std::max(1 - z * z, 0.0))) / bessel(beta));
            }
            monomials(nodes, values);
            out.push_back(values);
        }
        return out;
    }

    // The filter that suits the taps, and the error that is left.
    std::vector<double> fit(const std::vector<std::vector<double>>& powers, double& worst, double& rms) const {
        std::vector<std::complex<double>> sums;  // (f, x)
        for (std::size_t i = 0; i < f.size(); ++i) {
            for (std::size_t j = 0; j < x.size(); ++j) {
                std::complex<double> sum = 0;
                for (std::size_t t = 0; t < powers.size(); ++t) {
                    double weight = 0;
                    for (std::size_t q = powers[t].size(); q-- > 0;) weight = weight * x[j] + powers[t][q];
                    sum += weight * turns[(i * x.size() + j) * powers.size() + t];
                }
                sums.push_back(sum);
            }
        }
        std::vector<std::vector<double>> rows;
        std::vector<double> wanted;
        for (std::size_t k = 0; k <= static_cast<std::size_t>(half); ++k) {
            std::vector<double> column;
            for (std::size_t i = 0; i < sums.size(); ++i) {
                const std::size_t at = i / x.size();
                const auto value = edge[at] * cosines[k * f.size() + at] * sums[i];
                column.push_back(value.real());
                column.push_back(value.imag());
            }
            rows.push_back(std::move(column));
        }
        for (std::size_t i = 0; i < sums.size(); ++i) {
            wanted.push_back(edge[i / x.size()]);
            wanted.push_back(0);
        }
        const auto filter = least_squares(rows, wanted);
        double squares = 0;
        worst = 0;
        for (std::size_t i = 0; i < sums.size(); ++i) {
            double response = 0;
            for (std::size_t k = 0; k < filter.size(); ++k)
                response += filter[k] * cosines[k * f.size() + i / x.size()];
            const double error = std::abs(response * sums[i] - 1.0);
            worst = std::max(worst, error);
            squares += error * error;
        }
        rms = std::sqrt(squares / static_cast<double>(sums.size()));
        return filter;
    }
};

}  // namespace

TapDesign design_taps(int count, double rate, int half) {
    const Bench bench(count, rate, half);
    TapDesign best;
    for (int i = 0; i < 15; ++i) {
        const auto powers = bench.powers((1.7 + 0.04 * i) * count);
        double worst, rms;
        const auto filter = bench.fit(powers, worst, rms);
        if (i > 0 && worst >= best.worst) continue;
        best = {{}, rate, worst, rms};
        Taps& taps = best.taps;
        taps.count = count;
        taps.half = half;
        const auto width = static_cast<std::size_t>(count);
        for (std::size_t p = 0; p < width / 2; ++p) {  // taps p and width - 1 - p mirror each other
            const auto &a = powers[p], &b = powers[width - 1 - p];
            for (std::size_t q = 0; q <= width; ++q) {
                if (q % 2 == 0)
                    taps.even[p][q / 2] = static_cast<float>((a[q] + b[q]) / 2);
                else
                    taps.odd[p][q / 2] = static_cast<float>((a[q] - b[q]) / 2);
            }
        }
        for (std::size_t q = 0; q <= width; ++q) {
            for (std::size_t t = 0; t < width; ++t) taps.tap[q][t] = static_cast<float>(powers[t][q]);
        }
        for (std::size_t k = 0; k < filter.size(); ++k) taps.filter[k] = static_cast<float>(filter[k]);
    }
    return best;
}

}  // namespace pysas
