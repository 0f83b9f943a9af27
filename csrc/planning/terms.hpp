// Some of a scene's terms: where pixels read their traces.
#pragma once

#include <cstdint>

#include "planning/scene.hpp"

namespace pysas {

struct Place {
    double index;
    bool lit;
    double weight;
};
// Where a pixel reads a trace, samples, to within a sample; whether it does, and what it weighs for the beam then.
Place place_of(const Scene& scene, const Trace& trace, const Point& pixel);

// Some of a scene's terms: flat numbers of their traces, the samples nearest to where pixels read them, and what they
// weigh for the beam; all traces that pixels hear, and the least and the largest place that any pixel can read of each.
struct SomeTerms {
    Numbers trace, place;
    std::vector<double> weight;
    Numbers heard, least, largest;
};
SomeTerms some_terms(const Scene& scene);

}  // namespace pysas
