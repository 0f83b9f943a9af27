#include "planning/subapertures.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

constexpr std::int64_t slack = 80;     // columns behind a row's last node that a vector may touch
constexpr double farthest = 1U << 30;  // number of a node or a ray
constexpr double apart = 0.2;          // rad between bearings at which a group's band is looked at, at most
constexpr double spare_across = 1.02;  // of the band across rays: what is left to bearings and traces in between
// Where the frequency across rays turns, at broadside, the spectrum goes on beyond the highest of them as Airy's
// function does, in units of the cube root of half its second derivative. `overlap_of` such units are sampled as well,
// fewer where the filter with its taps is too short to see them.
constexpr double overlap_reach = 1.6;
double overlap_of(int taps) { return taps == 6 ? 3.0 : 4.3; }

// Of a trace's two-way time at a place `ahead` of a group's centre on the ground: across, along that ground distance's
// arc, and along slant range, of which the ground's is 1/stretch.
struct Slope {
    double lateral, radial;
};

Slope slope_of(const Trace& trace, const Point& place, const Point& ahead, double ground, double stretch) {
    const Point there = place - point(trace.tx), velocity = point(trace.velocity), side{-ahead.y, ahead.x, 0};
    const double way = std::max(pysas::length(there), 1e-9), speed = pysas::length(velocity);
    Point back = place - point(trace.rx);
    if (speed > 0) back = back - ((way + pysas::length(back)) / trace.c) * velocity;
    const Point slope = (1 / way) * there + (1 / std::max(pysas::length(back), 1e-9)) * back;
    return {dot(slope, side) / (trace.c - speed) * ground, dot(slope, ahead) / (trace.c - speed) * stretch};
}

// Traces of which one has a phase as steep as any: those at a group's ends in all directions, and, where transmitter
// and receiver are apart, those whose phases are the steepest at places of the sub-image. All traces are looked at: one
// that differs from its neighbours may be the outermost.
Numbers outermost(const Group& group, const Geometry& geometry, double plane, Span angles, Span grounds) {
    const std::size_t count = group.traces.size();
    if (count <= 4) return group.traces;
    Numbers picked;
    std::vector<Point> sums;
    bool alike = true;
    for (const std::int64_t i : group.traces) {
        const Trace& trace = geometry.traces[i];
        const Point tx = point(trace.tx) - group.centre,
                    rx = point(trace.rx) + geometry.delay * point(trace.velocity) - group.centre;
        sums.push_back(tx + rx);
        alike = alike && dot(tx - rx, tx - rx) == 0;
    }
    const auto pick = [&](const auto& value) {
        std::size_t ends[2] = {};
        double least = HUGE_VAL, most = -HUGE_VAL;
        for (std::size_t i = 0; i < count; ++i) {
            const double at = value(i);
            if (at < least) least = at, ends[0] = i;
            if (at > most) most = at, ends[1] = i;
        }
        picked.insert(picked.end(), ends, ends + 2);
    };
    constexpr int directions = 8;  // of half a turn
    for (int k = 0; k <= directions; ++k) {
        const double angle = pi * k / directions;
        const Point axis = k < directions ? Point{std::cos(angle), std::sin(angle), 0} : Point{0, 0, 1};
        pick([&](std::size_t i) { return dot(sums[i], axis); });
    }
    if (!alike) {
        const double height = group.centre.z - plane;
        const int wide = std::clamp(static_cast<int>(std::ceil((angles.high - angles.low) / (pi / directions))) + 1, 3,
                                    2 * directions + 1);
        std::vector<Slope> slopes(count);
        for (const double angle : spread(angles.low, angles.high, wide)) {
            const Point ahead{std::cos(angle), std::sin(angle), 0};
            for (const double ground : {grounds.low, grounds.high}) {
                const double stretch = slant_of(ground, height) / std::max(ground, 1e-9);
                const Point place = Point{group.centre.x, group.centre.y, plane} + ground * ahead;
                for (std::size_t i = 0; i < count; ++i)
                    slopes[i] = slope_of(geometry.traces[group.traces[i]], place, ahead, ground, stretch);
                pick([&](std::size_t i) { return slopes[i].lateral; });
                pick([&](std::size_t i) { return slopes[i].radial; });
            }
        }
    }
    std::sort(picked.begin(), picked.end());
    picked.erase(std::unique(picked.begin(), picked.end()), picked.end());
    for (auto& i : picked) i = group.traces[static_cast<std::size_t>(i)];
    return picked;
}

// One sub-image to be: where its rays lie and what of them is summed.
struct Node {
    Group group;
    double beam = 0;         // rad between rays
    std::int64_t first = 0;  // number of its first ray, counted from the tree's direction
    Numbers begin, end;      // nodes of each ray; none where they are equal
    std::vector<Node> children;
};

struct Maker {
    const Geometry& geometry;
    const std::vector<Point>& centres;
    const Layout& layout;
    double plane, direction, step;
    std::int64_t& left;  // floats that may still be used
    double& along;       // highest frequency along any ray so far

    // Between rays that serve readings at bearings and slant ranges, rad. Nodes beside these count too, as far as taps
    // and filter reach, so that the spacing depends on itself: each second try is safe.
    double spacing(const Group& group, Span bearing, Span slant, const Fading& fading, double& highest) const {
        const double height = group.centre.z - plane, reach = layout.taps.reach();
        const double near = ground_from(slant.low, height);
        const Span grounds{std::max(ground_from(slant.low - reach * step, height), near / 2),
                           ground_from(slant.high + reach * step, height)};
        const double rate = layout.taps.rate;
        double beam = 0, outer = 1e-3;
        for (int attempt = 0; attempt < 4; ++attempt) {
            const Bands bands = bands_of(group, geometry, plane,
                                         {direction + bearing.low - outer, direction + bearing.high + outer}, grounds);
            const double sway = std::cbrt(bands.bend / 2), across = std::max(bands.across, 1e-9);
            const double seen = overlap_reach * reach * sway * std::min(widest_beam, pi / (rate * across));
            const double more = overlap_of(layout.taps.taps.count) * std::min(1.0, seen) * sway;
            const double before = beam;
            beam = std::min(widest_beam, pi / held_across(spare_across * across + more, rate, fading));
            if (attempt % 2 == 1) highest = std::max(highest, bands.along);
            if (attempt == 1 && beam >= 0.97 * before) break;
            outer = reach * beam;
        }
        return beam;
    }

    // Rays, and nodes on them, that serve all readings (of slant ranges); false where they are too many.
    bool cover(Node& node, const std::vector<Reading>& readings) const {
        const Taps& taps = layout.taps.taps;
        const int before = taps.count / 2;
        const auto below = [](double x) { return static_cast<std::int64_t>(std::floor(x)); };
        double low = farthest, high = -farthest, deepest = 0;
        for (const Reading& r : readings) {
            low = std::min(low, r.bearing.low / node.beam);
            high = std::max(high, r.bearing.high / node.beam);
            deepest = std::max(deepest, std::abs(r.distance.low) + std::abs(r.distance.high));
        }
        if (!(std::abs(low) < farthest && std::abs(high) < farthest && deepest / step < farthest / 2)) return false;
        node.first = below(low) - before - taps.half;
        const std::int64_t rays = below(high) + before + 2 + taps.half - node.first;
        if (2 * rays * (slack + 16) > left) return false;
        constexpr std::int64_t none = std::int64_t{1} << 40;
        node.begin.assign(static_cast<std::size_t>(rays), none);
        node.end.assign(static_cast<std::size_t>(rays), -none);
        for (const Reading& r : readings) {
            // the filter across rays asks for as many rays beside those that taps read
            const std::int64_t from = below(r.bearing.low / node.beam) - before - taps.half - node.first;
            const std::int64_t to = below(r.bearing.high / node.beam) + before + 1 + taps.half - node.first;
            const std::int64_t begin = below(r.distance.low / step) - before - 1 - taps.half;
            const std::int64_t end = below(r.distance.high / step) + before + 3 + taps.half;
            for (auto ray = static_cast<std::size_t>(from); ray <= static_cast<std::size_t>(to); ++ray) {
                node.begin[ray] = std::min(node.begin[ray], begin);
                node.end[ray] = std::max(node.end[ray], end);
            }
        }
        std::int64_t least = none, most = -none;
        for (std::size_t ray = 0; ray < node.begin.size(); ++ray) {
            if (node.begin[ray] >= node.end[ray]) {
                node.begin[ray] = node.end[ray] = 0;
                continue;
            }
            least = std::min(least, node.begin[ray]);
            most = std::max(most, node.end[ray]);
        }
        if ((most - least + slack + 32) > left / (2 * rays)) return false;
        left -= 2 * rays * (most - least + slack + 32);
        return true;
    }

    // A node for readings at bearings and slant ranges, and all below it; false where the tree grows too large.
    bool make(Node& node, Group group, std::vector<Reading> readings, std::size_t depth) const {
        node.group = std::move(group);
        const double infinite = std::numeric_limits<double>::infinity();
        Span bearing{infinite, -infinite}, slant{infinite, -infinite};
        for (const Reading& r : readings) {
            bearing = {std::min(bearing.low, r.bearing.low), std::max(bearing.high, r.bearing.high)};
            slant = {std::min(slant.low, r.distance.low), std::max(slant.high, r.distance.high)};
        }
        const bool fades = static_cast<int>(depth) < lit_levels(layout.fans);
        node.beam = spacing(node.group, bearing, slant, fades ? layout.fading : Fading{}, along);
        if (!cover(node, readings)) return false;
        if (depth == layout.fans.size()) return true;
        const int fan = layout.fans[depth];
        for (Numbers& traces : fan == by_ping ? split_by_ping(node.group, geometry) : split(node.group, fan)) {
            Group part = make_group(std::move(traces), centres);
            auto theirs = seen_by(node, part.centre);
            node.children.emplace_back();
            if (!make(node.children.back(), std::move(part), std::move(theirs), depth + 1)) return false;
        }
        return true;
    }

    // Where a child at `centre` is read for a node's own nodes: the ends of its rays.
    std::vector<Reading> seen_by(const Node& node, const Point& centre) const {
        const double height = node.group.centre.z - plane, lower = centre.z - plane;
        const Point offset = node.group.centre - centre;
        std::vector<Reading> out;
        for (std::size_t i = 0; i < node.begin.size(); ++i) {
            if (node.begin[i] >= node.end[i]) continue;
            const double bearing = static_cast<double>(node.first + static_cast<std::int64_t>(i)) * node.beam;
            const double ray = direction + bearing, cosine = std::cos(ray), sine = std::sin(ray);
            const double ahead = offset.x * cosine + offset.y * sine, aside = offset.y * cosine - offset.x * sine;
            Span at{}, range{};
            for (const std::int64_t end : {node.begin[i], node.end[i] - 1}) {
                const double away = ground_from(static_cast<double>(end) * step, height);
                const double ground = std::max(std::hypot(away + ahead, aside), 1e-9);
                const double seen = bearing + std::asin(std::clamp(aside / ground, -1.0, 1.0));
                const double slant = slant_of(ground, lower);
                const bool fresh = end == node.begin[i];
                at = {fresh ? seen : std::min(at.low, seen), fresh ? seen : std::max(at.high, seen)};
                range = {fresh ? slant : std::min(range.low, slant), fresh ? slant : std::max(range.high, slant)};
            }
            out.push_back({at, range});
        }
        return out;
    }

    Level level(const std::vector<const Node*>& nodes) const {
        Level out;
        std::int64_t offset = 0, rays = 0;
        for (const Node* node : nodes) {
            std::int64_t i0 = std::numeric_limits<std::int64_t>::max(), last = std::numeric_limits<std::int64_t>::min();
            for (std::size_t i = 0; i < node->begin.size(); ++i) {
                if (node->begin[i] >= node->end[i]) continue;
                i0 = std::min(i0, node->begin[i]);
                last = std::max(last, node->end[i]);
            }
            std::int64_t stride = (last - i0 + slack + 15) / 16 * 16;
            if (stride % 512 == 0) stride += 16;  // rows must not share cache sets
            const Point& c = node->group.centre;
            const auto count = static_cast<std::int64_t>(node->begin.size());
            const double angle = direction + static_cast<double>(node->first) * node->beam;
            out.place.insert(out.place.end(), {c.x, c.y, c.z, plane, angle, node->beam, step});
            out.shape.insert(out.shape.end(), {i0, count, stride, offset, rays});
            for (std::size_t i = 0; i < node->begin.size(); ++i) {
                const bool used = node->begin[i] < node->end[i];
                out.range.push_back(static_cast<std::int32_t>(used ? node->begin[i] - i0 : 0));
                out.range.push_back(static_cast<std::int32_t>(used ? node->end[i] - i0 : 0));
            }
            offset += 2 * count * stride;
            rays += count;
            const std::size_t parts = node->children.empty() ? node->group.traces.size() : node->children.size();
            out.span.push_back(out.span.back() + static_cast<std::int64_t>(parts));
        }
        return out;
    }
};

}  // namespace

std::vector<double> spread(double low, double high, int count) {
    std::vector<double> out;
    for (int i = 0; i < count; ++i) out.push_back(low + (high - low) * i / (count - 1));
    return out;
}

double slant_of(double ground, double height) { return std::sqrt(ground * ground + height * height); }

double ground_from(double slant, double height) { return std::sqrt(std::max(slant * slant - height * height, 0.0)); }

// A trace's echo of base-band frequency f at two-way time tau varies as exp(2j pi ((fc + f) tau - fc tau_0)), tau_0
// that of the centre: the gradient of its phase, with f = +-B/2. Between the bearings looked at it exceeds what is
// found there by at most an eighth of its second derivative times their distance squared.
Bands bands_of(const Group& group, const Geometry& geometry, double plane, Span angles, Span grounds) {
    const Model& model = geometry.model;
    const double half = geometry.half_band(), height = group.centre.z - plane;
    const int count = std::max(5, static_cast<int>(std::ceil(std::min((angles.high - angles.low) / apart, 64.0))) + 1);
    const double step = (angles.high - angles.low) / (count - 1);
    std::vector<Point> out;
    for (const double angle : spread(angles.low, angles.high, count))
        out.push_back({std::cos(angle), std::sin(angle), 0});
    Bands bands{0, 0, 0};
    for (const std::int64_t i : outermost(group, geometry, plane, angles, grounds)) {
        for (const double ground : spread(grounds.low, grounds.high, 3)) {
            const double stretch = slant_of(ground, height) / std::max(ground, 1e-9);
            double before[2] = {0, 0};
            for (int k = 0; k < count; ++k) {
                const Point& ahead = out[static_cast<std::size_t>(k)];
                const Point place = Point{group.centre.x, group.centre.y, plane} + ground * ahead;
                const auto [lateral, radial] = slope_of(geometry.traces[i], place, ahead, ground, stretch);
                bands.across = std::max(bands.across, std::abs(lateral));
                bands.along =
                    std::max(bands.along, half * std::abs(radial) + model.fc * std::abs(radial - 2 / model.c));
                if (k > 1) bands.bend = std::max(bands.bend, std::abs(lateral - 2 * before[1] + before[0]));
                before[0] = before[1];
                before[1] = lateral;
            }
        }
    }
    const double turns = 2 * pi * (model.fc + half);
    bands.across = turns * (bands.across + bands.bend / 8);
    bands.bend = turns * bands.bend / (step * step);
    return bands;
}

std::vector<Reading> seen_from(const Point& centre, const std::vector<Point>& corners, int each, double& direction) {
    const auto number = static_cast<std::size_t>(each);
    std::vector<double> angles;
    for (std::size_t first = 0; first < corners.size(); first += number) {
        Point sum;
        for (std::size_t k = first; k < first + number; ++k) sum = sum + (corners[k] - centre);
        angles.push_back(std::atan2(sum.y, sum.x));
    }
    // the direction opposite the widest gap between the tiles
    auto ordered = angles;
    std::sort(ordered.begin(), ordered.end());
    double widest = -1;
    for (std::size_t i = 0; i < ordered.size(); ++i) {
        const double next = i + 1 < ordered.size() ? ordered[i + 1] : ordered[0] + 2 * pi;
        if (next - ordered[i] <= widest) continue;
        widest = next - ordered[i];
        direction = ordered[i] + widest / 2 + pi;
    }
    std::vector<Reading> out;
    for (std::size_t i = 0; i < angles.size(); ++i) {
        const double turn = std::fmod(angles[i] - direction + pi, 2 * pi);
        const double bearing = (turn < 0 ? turn + 2 * pi : turn) - pi;
        const double cosine = std::cos(angles[i]), sine = std::sin(angles[i]);
        Reading reading{{HUGE_VAL, -HUGE_VAL}, {HUGE_VAL, -HUGE_VAL}};
        for (std::size_t k = number * i; k < number * (i + 1); ++k) {
            const Point away = corners[k] - centre;
            const double depth = away.x * cosine + away.y * sine, side = away.y * cosine - away.x * sine;
            const double own = std::atan2(side, depth), ground = std::hypot(away.x, away.y);
            reading.bearing = {std::min(reading.bearing.low, bearing + own),
                               std::max(reading.bearing.high, bearing + own)};
            // an edge may pass nearer than its ends
            reading.distance = {std::min(reading.distance.low, std::min(ground, depth)),
                                std::max(reading.distance.high, ground)};
        }
        out.push_back(reading);
    }
    return out;
}

Subtree make_subtree(const Group& group, const Geometry& geometry, const std::vector<Point>& centres,
                     const Layout& layout, double plane, double direction, std::vector<Reading> readings, double step,
                     std::int64_t& left) {
    const double height = group.centre.z - plane;
    for (Reading& r : readings) r.distance = {slant_of(r.distance.low, height), slant_of(r.distance.high, height)};
    Subtree out;
    const Maker maker{geometry, centres, layout, plane, direction, step, left, out.along};
    Node root;
    if (!maker.make(root, group, std::move(readings), 0)) return out;
    std::vector<const Node*> nodes{&root};
    while (true) {
        out.levels.push_back(maker.level(nodes));
        if (nodes.front()->children.empty()) break;
        std::vector<const Node*> below;
        for (const Node* node : nodes) {
            for (const Node& child : node->children) below.push_back(&child);
        }
        nodes = std::move(below);
    }
    for (const Node* leaf : nodes)
        out.traces.insert(out.traces.end(), leaf->group.traces.begin(), leaf->group.traces.end());
    std::reverse(out.levels.begin(), out.levels.end());
    return out;
}

}  // namespace pysas
