// Trees of sub-apertures over an image, as sums go through them: which tiles are read from which, which are summed
// directly, and the sub-images below.
#pragma once

#include <cstdint>
#include <vector>

#include "core/kernels.hpp"

namespace pysas {

using Numbers = std::vector<std::int64_t>;

// The sub-images of all groups of one length, laid out as core/factorised.hpp takes them. Image i is made of what span
// [i] to span[i + 1] number in the level below, or of traces.
struct Level {
    std::vector<double> place;
    Numbers shape, span{0};
    std::vector<std::int32_t> range;

    std::int64_t count() const { return static_cast<std::int64_t>(span.size()) - 1; }
    std::int64_t offset(std::int64_t i) const { return shape[static_cast<std::size_t>(5 * i + 3)]; }
    // floats of a store for images [begin, end)
    std::int64_t room(std::int64_t begin, std::int64_t end) const {
        const std::int64_t* last = shape.data() + 5 * (end - 1);
        return last[3] + 2 * last[1] * last[2] - offset(begin);
    }
};

// How a tile is read from a sub-image: pixel by pixel, or along lines that lead away from it, of one pixel each of all
// its lines or of all pixels of a line.
enum Reads : std::uint8_t { unread, by_pixels, by_columns, by_lines };

// One of the longest groups over a section. Tiles neither read nor summed directly hear nothing of it, or are not
// wanted.
struct GroupTree {
    Numbers traces;                          // flat numbers, in the order of the leaves
    std::vector<std::uint8_t> read, direct;  // tiles; `read`: how
    std::vector<Level> levels;               // leaves first; none where nothing is read
    int lit;                                 // level whose images, each of one ping, a taper weighs as they are merged
                                             // (-1: in leaves)
    double axis[3];                          // of the group
    std::int64_t own = -1;                   // of a group of one ping its middle trace, whose delays pixels read off
                                             // the plane have
};

// Lines [begin, end) of an image and the trees of a horizontal plane that they are read from. Lines that lie on no
// plane are read from a stack of them, polynomials through number `number` of `heights`.
struct Section {
    std::int64_t begin, end;
    bool flat;     // all its pixels lie on the plane
    double plane;  // m
    std::vector<double> heights;
    int number;
    Numbers pixels;   // wanted, of each tile
    int stretch = 0;  // pixels of a column that one polynomial holds for
    double turn = 0;  // rays by which heights may turn what a line of pixels sees
    std::vector<GroupTree> trees;
};

struct Forest {
    Taps taps;
    double step;              // between nodes, m
    int phases, per_samples;  // nodes lie as far apart as the intervals of tables at phases / per_samples of the rate
    double slack;             // what phase factors of leaves may be wrong by
    std::vector<Section> sections;
};

// Traces [begin, end) of a tree at a time, of leaves [first, last): about `most` traces, and whole parents where one
// fits, since what is merged in parts is read and written again.
struct TreeBatch {
    std::int64_t begin, end, first, last;
};
std::vector<TreeBatch> batches_of(const GroupTree& tree, std::int64_t most);

// Whether lines are read from a tree's topmost sub-image, which is not filtered along its rays then; and how many such
// sub-images are kept and read together.
bool along(const GroupTree& tree);
std::int64_t waiting(const GroupTree& tree);

// Floats of the stores that a forest needs at a time: for each level, a batch of leaves or one sub-image above them;
// and of all, those that wait with them.
Numbers rooms_of(const Forest& forest, std::int64_t batch);
std::int64_t stores_of(const Forest& forest, std::int64_t batch);

}  // namespace pysas
