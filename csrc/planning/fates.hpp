// Which tiles of an image are read from the sub-image of a group of traces, and which are summed directly.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "planning/layouts.hpp"
#include "planning/subapertures.hpp"
#include "planning/tiles.hpp"

namespace pysas {

// Of tiles by number: silent or not wanted where neither.
struct Fates {
    std::vector<std::uint8_t> read, direct;
};

// Where a plane has points' slant range and place along a group's axis. A group on a line sees the two alike.
class Onto {
  public:
    struct Found {
        Point place;
        double beside;  // the axis, at least
    };

    Onto(const Group& group, double plane);
    // nothing where the plane has no such place
    std::optional<Found> operator()(const Point& p) const;

  private:
    Point centre_, axis_;
    double plane_, across_;
};

// Heights of the planes that pixels are read from by polynomials of height, and how far beside a group's axis they lie
// at least; `alone`: groups are pings, whose middle traces' delays pixels have.
struct Stacked {
    std::vector<double> heights;
    double closest = 0;
    bool alone = false;
    double shift = 0;  // m of slant range by which pixels are read from elsewhere for it
};
// Of `count` planes; none where no distance is enough. `error`: what reading pixels off their planes may cost.
Stacked stack_of(const Scene& scene, const Tiled& tiled, const std::vector<Group>& groups, double error, int count);

// The middle trace of a group of one ping, or -1; and by how much its phase is off that of the group's centre where the
// direction to a pixel turns about the group's axis, rad a rad.
std::int64_t own_of(const Scene& scene, const Group& group);
double own_turn(const Scene& scene, const Group& group);

// Of `tiles`, all of them with pixels wanted, read from `planes` by nodes `step` apart, from slant range `near` on.
Fates fates_of(const Scene& scene, const Group& group, const Tiled& tiled, const Numbers& tiles, const Stacked& planes,
               const Layout& layout, double step, double near);

}  // namespace pysas
