// Layouts that a tree of sub-apertures may have on a scene, and about what they cost.
#pragma once

#include <optional>
#include <utility>
#include <vector>

#include "planning/bounds.hpp"
#include "planning/costs.hpp"
#include "planning/scene.hpp"
#include "planning/taps.hpp"
#include "planning/tiles.hpp"

namespace pysas {

// Of fans: a part for each ping, which a beam's taper weighs as it is merged; none in leaves then.
constexpr int by_ping = 0;

// Levels that a beam's weights are on, of those with these fans: from the top down to what pings are merged into.
int lit_levels(const std::vector<int>& fans);

// How a tree is cut: groups of at most `length` m, in parts of parts; `spare` of sampling, and `crossing` beyond it:
// the rays that lines of pixels may cross from node to node, and what polynomials of these may be wrong by, rad;
// `clear`: slant range that nodes must have from the centre of the longest group, `apart` from those of its parts, m;
// `ends`: samples that a place must lie inside of records; `fading`: of beams, on each level that has weights.
struct Layout {
    double length;
    std::vector<int> fans;
    TapDesign taps;
    double spare, crossing, positions;
    Fading fading;
    double clear, apart, ends;
};

using Kinds = std::vector<std::pair<std::vector<int>, TapDesign>>;

// A layout, its predicted seconds on one thread if it served all pixels, and with what it does not serve.
struct Option {
    Layout layout;
    double all, cost;
};

// Of layouts of the `kinds` (fans, taps), the cheapest of each length of group that serves any pixel, cheapest first.
// What is not served costs its share of `direct`, s. `lines`: of the image, which may be read whole; or null. `faded`:
// what a beam's taper may be wrong by on all levels.
std::vector<Option> cheapest(const Scene& scene, const Kinds& kinds, const Costs& costs, const Parallel* lines,
                             double spare, double faded, double direct);

// A layout with the slant ranges that its nodes must have, whose sensors stand at most `height` up, and its distance
// from records' ends. `error`: for the delays along leaves' rays; `merge`: for each merge; `ends`: for what a record's
// end rings with beyond the band that nodes hold; `ramp`: for a beam's taper along rays.
Layout cleared(const Scene& scene, Layout layout, double height, double error, double merge, double ends, double ramp);

}  // namespace pysas
