#include "core/polynomials.hpp"

#include <algorithm>
#include <cmath>
#include <functional>

namespace pysas {
namespace {

// Coefficients in q of the polynomial through f at the Chebyshev nodes of [0, 1/4], and its largest error, times
// `scale`.
double fit(std::vector<double>& out, int count, const std::function<double(double)>& f,
           const std::function<double(double)>& scale) {
    std::vector<long double> at, values;
    for (int j = 0; j < count; ++j) {
        at.push_back(0.125L - 0.125L * std::cos(static_cast<long double>(pi) * (2 * j + 1) / (2 * count)));
        values.push_back(f(static_cast<double>(at.back())));
    }
    monomials(at, values);
    out.assign(values.begin(), values.end());
    double worst = 0;
    for (int i = 0; i <= 400; ++i) {
        const double q = 0.25 * i / 400;
        double sum = 0;
        for (std::size_t j = out.size(); j-- > 0;) sum = sum * q + out[j];
        worst = std::max(worst, std::abs(sum - f(q)) * scale(q));
    }
    return worst;
}

}  // namespace

double fit_trigonometry(int terms, std::vector<double>& sine, std::vector<double>& cosine) {
    const auto root = [](double q) { return std::sqrt(q); };
    const double s =
        fit(sine, terms, [&](double q) { return q > 0 ? std::sin(2 * pi * root(q)) / root(q) : 2 * pi; }, root);
    const double c =
        fit(cosine, terms + 1, [&](double q) { return std::cos(2 * pi * root(q)); }, [](double) { return 1.0; });
    return std::max(s, c);
}

}  // namespace pysas
