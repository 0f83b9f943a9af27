// A tree of sub-apertures for each of the longest groups of traces, the tiles of the image read from it, and those
// summed directly. The same as pysas/planning/forest.py makes; choices are made by the caller (planning/layouts.hpp).
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/summation.hpp"
#include "planning/subapertures.hpp"

namespace pysas {

// Lines of an image that lie on one horizontal plane, as the tiles they are cut into.
struct Section {
    double plane;
    std::vector<Point> corners;  // 4 for each tile
    Numbers pixels;              // wanted, of each tile
};

// The section of a raster whose lines are straight; nothing if they do not lie on one horizontal plane.
std::optional<Section> section_of(const Raster& raster);

// One of the longest groups. Tiles neither read nor summed directly hear nothing of it, or are not wanted.
struct GroupTree {
    std::size_t section;
    Numbers traces;
    std::vector<std::uint8_t> read, direct;  // tiles
    std::vector<Level> levels;               // leaves first; none where nothing is read
};

struct Forest {
    TapDesign taps;
    double step;              // between nodes, m
    int phases, per_samples;  // nodes lie as far apart as the intervals of tables at phases / per_samples of the rate
    std::vector<GroupTree> trees;
    Numbers first, last;  // samples that leaves ask of each trace; none where last < first
    double share;         // of the terms that go through trees
};

// Tiles are read from slant range `near` on; nodes are as far apart as intervals of tables at `rate` times the samples'
// or more. Nothing if no tile can be read, or if trees would hold more than `most` floats.
std::optional<Forest> make_forest(const Geometry& geometry, const std::vector<Section>& sections, const Layout& layout,
                                  double near, double rate, std::int64_t most);

// Traces [begin, end) of a tree at a time, of leaves [first, last): about `most` traces, and whole parents where one
// fits, since what is merged in parts is read and written again.
struct TreeBatch {
    std::int64_t begin, end, first, last;
};
std::vector<TreeBatch> batches_of(const GroupTree& tree, std::int64_t most);

}  // namespace pysas
