// Lines of pixels that lead away from a group, which are read from its sub-image as a whole.
#pragma once

#include <optional>

#include "core/trees.hpp"
#include "planning/layouts.hpp"
#include "planning/scene.hpp"
#include "planning/subapertures.hpp"
#include "planning/tiles.hpp"

namespace pysas {

constexpr int least_stretch = 16;  // pixels of a line that one polynomial holds for: a vector's lanes

// Of lines [begin, end), if they are; `block` of their pixels have a polynomial, and `rounding` is what float positions
// may be wrong by, relative.
std::optional<Parallel> parallel_of(const Scene& scene, std::int64_t begin, std::int64_t end, int block,
                                    double rounding);

// How fast the bearing changes with the slant range along a line, rad a metre, at a place seen from a centre `height`
// above; infinite where the line does not lead away.
double turning(const Point& away, const Point& along, double height);

// How tiles that a group's tree reads are read: along lines where these cross at most `layout.crossing` rays from node
// to node, and polynomials of the rays that they cross are wrong by at most `layout.positions` rad of phase; of a map
// where heights turn what the group sees by at most `turned` rad of phase. `own`: rad a metre that a ping's own trace
// is off by as heights change by as much as it is away.
void choose_reads(GroupTree& tree, const Group& group, const Tiled& tiled, double plane, const Parallel& lines,
                  const Layout& layout, double turned, double own);

// Rays that heights of a map may turn what one line of pixels sees, of `turned` rad of phase.
double turn_of(const Layout& layout, double turned);

}  // namespace pysas
