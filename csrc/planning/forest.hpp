// Trees of sub-apertures over an image: which tiles are read from which, and which are summed directly. No choices.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/threads.hpp"
#include "core/trees.hpp"
#include "planning/layouts.hpp"
#include "planning/settings.hpp"
#include "planning/subapertures.hpp"
#include "planning/tiles.hpp"

namespace pysas {

// What trees would do for a layout, judged by some of its groups and tiles: share of the terms that they would serve,
// planes that pixels would be read from, and number of groups.
struct Served {
    double share;
    int planes;
    std::int64_t groups;
};
// How pixels off the planes of sub-images are read: from how many, the relative error that this may cost, and what
// lines of them may.
struct OffPlanes {
    int count;
    double error, lines;
};
// `near`: slant range from which tiles are read.
Served served(const Scene& scene, const std::vector<Tiled>& image, const Layout& layout, double near,
              const OffPlanes& relief);

// What trees do, each as often as a plane asks: terms and nodes of leaves, (node, child) pairs merged, pixels read one
// by one, traces prepared.
struct Work {
    double leaf_terms = 0, leaf_nodes = 0, merged = 0, read = 0;
    std::int64_t traces = 0;
};

struct PlannedForest {
    Forest forest;
    Layout layout;
    Numbers first, last;  // samples that leaves and pixels ask of each trace
    double share;         // of the terms that go through trees
    std::int64_t count;   // of trees: groups over sections and planes
    double longest;       // extent of the longest group, m
};

// A rate of nodes per sample.
struct Rate {
    int phases = 0, step = 1;  // phases 0: none
    double value() const { return static_cast<double>(phases) / step; }
};
// The lowest simple one that is at least `least`, up to what filters step through (max_step).
Rate simple_rate(double least);

// All trees of an image; nothing where no pixel can be read from one (`whole`: not all), or where trees have more nodes
// than the sum has terms. `least`: nodes per sample at least; `poll`: asked once a group.
std::optional<PlannedForest> make_forest(const Scene& scene, const std::vector<Tiled>& image, const Layout& layout,
                                         double near, const OffPlanes& relief, double least, bool whole, Poll& poll,
                                         int threads);

// Counted, but that leaves of a tree are taken to have as many traces each.
Work work_of(const Forest& forest);

// Of trees, of the direct sum of what they leave, and of preparation, s on one thread.
double forest_seconds(const Scene& scene, const PlannedForest& planned, const Settings& settings, const Costs& costs);

}  // namespace pysas
