// Layouts that a tree of sub-apertures may have on a scene, and about what they cost.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "planning/bounds.hpp"
#include "planning/costs.hpp"
#include "planning/scene.hpp"
#include "planning/taps.hpp"

namespace pysas {

// How a tree is cut: groups of at most `length` m, in parts of parts; `spare` of sampling; `clear`: slant range that
// nodes must have from the centre of the longest group, `apart` from those of its parts, m; `ends`: samples that a
// place must lie inside of records; `fading`: of beams, on each level.
struct Layout {
    double length;
    std::vector<int> fans;
    TapDesign taps;
    double spare;
    Fading fading;
    double clear, apart, ends;
};

using Kinds = std::vector<std::pair<std::vector<int>, TapDesign>>;

// Of layouts of the `kinds` (fans, taps), that of the least predicted time, and its seconds on one thread if it served
// all pixels; nothing where none serves any. What is not served costs its share of `direct`, s. `faded`: what a beam's
// taper may be wrong by on all levels.
std::optional<std::pair<Layout, double>> cheapest(const Scene& scene, const Kinds& kinds, const Costs& costs,
                                                  double spare, double faded, double direct);

// A layout with the slant ranges that its nodes must have, whose sensors stand at most `height` up, and its distance
// from records' ends. `error`: for the delays along leaves' rays; `merge`: for each merge; `ends`: for what a record's
// end rings with beyond the band that nodes hold; `ramp`: for a beam's taper along rays.
Layout cleared(const Scene& scene, Layout layout, double height, double error, double merge, double ends, double ramp);

}  // namespace pysas
