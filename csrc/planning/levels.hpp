// Bright samples that pixels do not read: what they would do to an image, measured when data arrive.
//
// A plan's bounds are relative to the samples that arithmetic meets, tol to those that pixels read. The two agree where
// both are alike. They do not beside a bright echo that lies just outside the grid, within the reach of an
// interpolation filter or of a tree's; nor after a record's hard end that cuts something bright, whose low-passed trace
// rings for hundreds of samples.
#pragma once

#include <complex>
#include <cstdint>
#include <functional>
#include <vector>

#include "planning/planner.hpp"
#include "planning/terms.hpp"

namespace pysas {

// What levels are measured from.
struct Levels {
    // mean squares of the 2 reach + 1 samples about places of traces, in units of unit^2, and whole records
    std::function<std::vector<double>(const Numbers& trace, const Numbers& place, std::int64_t reach, double unit)>
        mean_squares;
    std::function<void(std::int64_t trace, std::complex<double>* out)> record;
    const std::uint8_t* used;  // traces that are summed
    double scale;              // of samples, a power of two
    Tick poll;                 // asked now and then, with share 0
};

// What is to be done for some data: nothing, trees left, or tables made from whole records, whose ends are `ends` times
// as bright as what pixels read; and what error bright samples make beyond the bounds even then.
struct Verdict {
    bool direct = false, wide = false;
    double ends = 0, beside = 0;
};
Verdict hold_against(const Plan& plan, const SomeTerms& terms, const Levels& data);

}  // namespace pysas
