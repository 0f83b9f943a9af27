// The settings of one sum: the cheapest whose error bounds add up to at most a budget, a share of what is asked.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/filters.hpp"
#include "planning/costs.hpp"
#include "planning/scene.hpp"

namespace pysas {

constexpr double share_phase = 0.05;    // of a budget, each: delay polynomial, sine and cosine
constexpr double share_leaves = 0.35;   // of tol, where sums go through a tree: for the sums of its leaves
constexpr double share_rounding = 0.4;  // of the leaves' share, for float offsets in a block

// Bounds of errors by what makes them, in the order they are told in.
using Errors = std::vector<std::pair<std::string, double>>;
double sum_of(const Errors& errors);

struct Settings {
    bool narrow;       // float arithmetic
    int block;         // pixels to a delay polynomial; 0: every pixel's own delay
    double near;       // distance below which blocks are summed by parts, m
    Rise rise;         // of lines whose pixels have heights of their own
    bool quick;        // weights of fans that fade by their powers, see Light
    int terms;         // of the sine's polynomial
    std::int64_t run;  // traces summed in float before these sums are added up in double; 0: any number
    Filter filter;
    double oversampling;         // intervals per sample: the filter's, or twice that after transforms
    std::int64_t length;         // samples kept of each trace
    std::int64_t margin, taper;  // of these, beside what pixels need; of a smooth cut at each end
    double beta;                 // of the Kaiser window whose integral the cut is
    std::int64_t n_fft;          // of the transforms that low-pass traces before the filter; 0: none
    bool wide;                   // tables are made of whole records in double
    std::int64_t batch;          // traces prepared at a time
    Errors errors;

    double predicted() const { return sum_of(errors); }
};

// `wide`: for data that are bright beside what pixels read, as many times as bright at their records' ends. Throws
// std::logic_error where there are none.
Settings choose(const Scene& scene, double budget, const Costs& costs, double wide = 0);

// The same with tables of phases / step intervals per sample, as leaves take them, or nothing where no filter makes
// them within the budget.
std::optional<Settings> choose_for_leaves(const Scene& scene, double budget, const Costs& costs, int phases, int step,
                                          double wide = 0);

// Length of a block and the distance from which its delay polynomial holds; block 0 where only exact delays keep to
// the budget.
struct Delay {
    int block = 0;
    double near = 0, rounding = 0;
};

// The cheapest; `rounding`: share of the budget for float offsets. With `whole` the longest that holds for all pixels,
// spheres about tiles reaching nearer than those.
Delay choose_delay(const Scene& scene, double budget, const Costs& costs, bool narrow, double rounding, bool whole);

// A window whose first and last `taper` samples rise and fall as a Kaiser window's integral; none without taper.
std::vector<double> smooth_cut(std::int64_t length, std::int64_t taper, double beta);

// Pixels per block, at most `block`: blocks of equal size, a multiple of 8 where the line is long.
int even_split(std::int64_t length, int block);

}  // namespace pysas
