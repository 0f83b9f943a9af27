// Bounds of the errors that arithmetic makes, by what makes them.
#pragma once

#include <cstddef>
#include <cstdint>

#include "planning/taps.hpp"

namespace pysas {

// Zeros that keep wrap-round below `error`, 1e-12 at least.
std::int64_t guard(double error);
// Of a tree's interpolation in `stages` of it.
double tree_error(const TapDesign& taps, std::size_t stages);
// Taper of a beam over `width` rad beside `full` rad of weight 1, and what it may leave of terms on one level of a
// tree, as the mean over their bearings; width 0: none.
struct Fading {
    double width = 0, full = 0, error = 0;
};
// The highest frequency that rays must hold, rad a rad, for taps of a `rate` where that of traces is `across` and their
// weights fade.
double held_across(double across, double rate, const Fading& fading);
// Traces that `sums` running sums in float a pixel may have before they are added to sums in double, and what they
// lose.
std::int64_t longest_run(double budget, int sums);
double running_error(std::int64_t terms, int sums);
// Bound of what W makes of a record's end `distance` samples away, relative to the samples there; and the distance at
// which that is at most `error`.
double ringing(double distance, double band);
double hushed(double error, double band);

}  // namespace pysas
