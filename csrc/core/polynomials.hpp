// From a polynomial's values to its coefficients, for filters, phases and delays.
#pragma once

#include <cstddef>
#include <vector>

namespace pysas {

constexpr double pi = 3.14159265358979323846;

// Turn the values at the places `at` of the polynomial through them into its coefficients of 1, x, x^2, ...
template <typename Number>
void monomials(const std::vector<Number>& at, std::vector<Number>& values) {
    const std::size_t n = at.size();
    for (std::size_t level = 1; level < n; ++level) {  // Newton's divided differences
        for (std::size_t j = n - 1; j >= level; --j) values[j] = (values[j] - values[j - 1]) / (at[j] - at[j - level]);
    }
    for (std::size_t j = n - 1; j-- > 0;) {
        for (std::size_t q = j; q + 1 < n; ++q) values[q] -= at[j] * values[q + 1];
    }
}

// Coefficients in turns^2 of sin(2 pi t)/t (`terms`) and cos(2 pi t) (one more) on |t| <= 1/2, and their error.
double fit_trigonometry(int terms, std::vector<double>& sine, std::vector<double>& cosine);

}  // namespace pysas
