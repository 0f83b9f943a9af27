// Short filters that turn samples into polynomial coefficients, designed until their measured error is small enough.
#pragma once

#include <cstdint>
#include <vector>

namespace pysas {

// Modified Bessel function I0 of a window's shape.
double bessel(double x);

// Interval k = phases m + phase of the over-sampled axis begins at sample k step / phases. Its polynomial in the
// position t in [-1/2, 1/2] from the middle has the coefficients sum over taps of weight[(phase taps + tap) (degree +
// 1) + q] times the sample step m + first[phase] + tap.
struct Filter {
    int degree = 0, phases = 1, step = 1, taps = 0;
    double error = 0;  // largest error over the frequencies asked for, of a unit component
    std::vector<double> weight;
    std::vector<std::int64_t> first;

    double rate() const { return static_cast<double>(phases) / step; }
};

// A filter of `least` to `most` taps for components |f| <= band (cycles per sample), the shortest tried whose error is
// at most `error`, else the last one: look at its `error`.
Filter design(double band, int degree, int phases, int step, double error, int least, int most);

}  // namespace pysas
