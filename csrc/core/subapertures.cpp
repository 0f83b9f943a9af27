#include "core/subapertures.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

constexpr std::int64_t slack = 80;     // columns behind a row's last node that a vector may touch
constexpr double farthest = 1U << 30;  // number of a node or a ray

struct Axes {
    Point axis[3];  // by variance, least first
};

// Axes of a cloud of points about the origin: eigenvectors of its covariance by Jacobi's rotations.
Axes axes_of(const std::vector<Point>& points) {
    double a[3][3] = {}, v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    Point mean;
    for (const Point& p : points) mean = mean + (1 / static_cast<double>(points.size())) * p;
    for (const Point& p : points) {
        const double d[3] = {p.x - mean.x, p.y - mean.y, p.z - mean.z};
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) a[i][j] += d[i] * d[j];
        }
    }
    for (int sweep = 0; sweep < 12; ++sweep) {
        for (const auto& pair : {std::pair<int, int>{0, 1}, {0, 2}, {1, 2}}) {
            const int p = pair.first, q = pair.second;
            if (!(std::abs(a[p][q]) > 1e-300)) continue;
            const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
            const double t = (theta < 0 ? -1 : 1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
            const double c = 1 / std::sqrt(t * t + 1), s = t * c;
            for (int k = 0; k < 3; ++k) {
                const double left = a[k][p], right = a[k][q];
                a[k][p] = c * left - s * right;
                a[k][q] = s * left + c * right;
            }
            for (int k = 0; k < 3; ++k) {
                const double left = a[p][k], right = a[q][k];
                a[p][k] = c * left - s * right;
                a[q][k] = s * left + c * right;
            }
            for (auto& row : v) {
                const double left = row[p], right = row[q];
                row[p] = c * left - s * right;
                row[q] = s * left + c * right;
            }
        }
    }
    int order[3] = {0, 1, 2};
    std::stable_sort(order, order + 3, [&](int i, int j) { return a[i][i] < a[j][j]; });
    Axes out;
    for (int i = 0; i < 3; ++i) out.axis[i] = {v[0][order[i]], v[1][order[i]], v[2][order[i]]};
    return out;
}

// Some of a group's traces, those at its ends in all directions among them.
Numbers outermost(const Group& group, const Geometry& geometry) {
    const auto count = static_cast<std::int64_t>(group.traces.size());
    if (count <= 16) return group.traces;
    std::vector<Point> offset;
    for (const std::int64_t i : group.traces) {
        const Trace& trace = geometry.traces[i];
        offset.push_back(0.5 * (point(trace.tx) + point(trace.rx)) - group.centre);
    }
    const Axes axes = axes_of(offset);
    Numbers picked;
    for (const Point& axis : axes.axis) {
        const auto less = [&](const Point& a, const Point& b) { return dot(a, axis) < dot(b, axis); };
        const auto ends = std::minmax_element(offset.begin(), offset.end(), less);
        picked.push_back(ends.first - offset.begin());
        picked.push_back(ends.second - offset.begin());
    }
    for (std::int64_t i = 0; i < count; i += count / 6) picked.push_back(i);
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

struct Grower {
    const Geometry& geometry;
    const std::vector<Point>& centres;
    const Layout& layout;
    double plane, direction, step;
    std::int64_t& left;  // floats that may still be used

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
    bool grow(Node& node, Group group, std::vector<Reading> readings, std::size_t depth) const {
        node.group = std::move(group);
        const double height = node.group.centre.z - plane;
        const double infinite = std::numeric_limits<double>::infinity();
        Span bearing{infinite, -infinite}, slant{infinite, -infinite};
        for (const Reading& r : readings) {
            bearing = {std::min(bearing.low, r.bearing.low), std::max(bearing.high, r.bearing.high)};
            slant = {std::min(slant.low, r.distance.low), std::max(slant.high, r.distance.high)};
        }
        const auto angles = spread(direction + bearing.low, direction + bearing.high, 9);
        const auto grounds = spread(ground_from(slant.low, height), ground_from(slant.high, height), 3);
        const double across = bands_of(node.group, geometry, plane, angles, grounds).across;
        node.beam = std::min(widest_beam, 1 / (2 * layout.taps.rate * layout.spare * std::max(across, 1e-9)));
        if (!cover(node, readings)) return false;
        if (depth == layout.fans.size()) return true;
        for (Numbers& traces : split(node.group, layout.fans[depth])) {
            Group part = make_group(std::move(traces), centres);
            auto theirs = seen_by(node, part.centre);
            node.children.emplace_back();
            if (!grow(node.children.back(), std::move(part), std::move(theirs), depth + 1)) return false;
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

std::vector<Point> phase_centres(const Geometry& geometry) {
    std::vector<Point> out;
    for (std::int64_t i = 0; i < geometry.count; ++i) {
        const Trace& trace = geometry.traces[i];
        out.push_back(0.5 * (point(trace.tx) + point(trace.rx) + geometry.delay * point(trace.velocity)));
    }
    return out;
}

Group make_group(Numbers traces, const std::vector<Point>& centres) {
    Group out;
    std::vector<Point> offset;
    for (const std::int64_t i : traces) offset.push_back(centres[static_cast<std::size_t>(i)]);
    Point middle;
    for (const Point& p : offset) middle = middle + (1 / static_cast<double>(offset.size())) * p;
    for (Point& p : offset) p = p - middle;
    const Point axis = axes_of(offset).axis[2];
    for (const Point& p : offset) out.along.push_back(dot(p, axis));
    const auto ends = std::minmax_element(out.along.begin(), out.along.end());
    out.centre = middle + (*ends.first + *ends.second) / 2 * axis;
    out.extent = *ends.second - *ends.first;
    out.traces = std::move(traces);
    return out;
}

std::vector<Numbers> cut_track(const Geometry& geometry, const std::vector<Point>& centres, double length) {
    // traces come ping by ping
    std::vector<Point> middle;
    Numbers first;
    for (std::int64_t i = 0; i < geometry.count;) {
        std::int64_t end = i;
        Point sum;
        for (; end < geometry.count && geometry.pings[end] == geometry.pings[i]; ++end)
            sum = sum + centres[static_cast<std::size_t>(end)];
        middle.push_back((1 / static_cast<double>(end - i)) * sum);
        first.push_back(i);
        i = end;
    }
    first.push_back(geometry.count);
    std::vector<double> path{0};
    for (std::size_t i = 1; i < middle.size(); ++i)
        path.push_back(path.back() + pysas::length(middle[i] - middle[i - 1]));
    const double whole = std::max(path.back(), 1e-300), pieces = std::max(1.0, std::ceil(path.back() / length));
    std::vector<Numbers> out;
    double current = -1;
    for (std::size_t i = 0; i < middle.size(); ++i) {
        const double number = std::min(std::floor(path[i] / whole * pieces), pieces - 1);
        if (number != current) out.emplace_back();
        current = number;
        for (std::int64_t k = first[i]; k < first[i + 1]; ++k) out.back().push_back(k);
    }
    return out;
}

std::vector<Numbers> split(const Group& group, int fan) {
    const double low = *std::min_element(group.along.begin(), group.along.end());
    std::vector<Numbers> parts(static_cast<std::size_t>(fan));
    for (std::size_t i = 0; i < group.traces.size(); ++i) {
        const double share = (group.along[i] - low) / std::max(group.extent, 1e-300);
        parts[static_cast<std::size_t>(std::min(static_cast<int>(share * fan), fan - 1))].push_back(group.traces[i]);
    }
    parts.erase(std::remove_if(parts.begin(), parts.end(), [](const Numbers& part) { return part.empty(); }),
                parts.end());
    return parts;
}

// A trace's echo of base-band frequency f at two-way time tau varies as exp(2j pi ((fc + f) tau - fc tau_0)), tau_0
// that of the centre: the gradient of its phase, with f = +-B/2.
Bands bands_of(const Group& group, const Geometry& geometry, double plane, const std::vector<double>& angles,
               const std::vector<double>& grounds) {
    const Model& model = geometry.model;
    const double half = geometry.half_band(), height = group.centre.z - plane;
    double across = 0, along = 0;
    for (const std::int64_t i : outermost(group, geometry)) {
        const Trace& trace = geometry.traces[i];
        const double speed = pysas::length(point(trace.velocity));
        for (const double angle : angles) {
            const Point out{std::cos(angle), std::sin(angle), 0}, side{-out.y, out.x, 0};
            for (const double ground : grounds) {
                const Point place = Point{group.centre.x, group.centre.y, plane} + ground * out;
                const Point there = place - point(trace.tx), back = place - point(trace.rx);
                const Point slope = (1 / std::max(pysas::length(there), 1e-9)) * there +
                                    (1 / std::max(pysas::length(back), 1e-9)) * back;
                const double radial = dot(slope, out) / (model.c - speed) * slant_of(ground, height) /
                                      std::max(ground, 1e-9);  // along slant range
                const double lateral = dot(slope, side) / (model.c - speed) * ground;
                across = std::max(across, std::abs(lateral));
                along = std::max(along, half * std::abs(radial) + model.fc * std::abs(radial - 2 / model.c));
            }
        }
    }
    return {across * (model.fc + half), along};
}

std::vector<Reading> seen_from(const Point& centre, const std::vector<Point>& corners, const Numbers& tiles,
                               double& direction) {
    std::vector<double> angles;
    for (const std::int64_t tile : tiles) {
        Point middle;
        for (int k = 0; k < 4; ++k) middle = middle + 0.25 * (corners[static_cast<std::size_t>(4 * tile + k)] - centre);
        angles.push_back(std::atan2(middle.y, middle.x));
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
    for (std::size_t i = 0; i < tiles.size(); ++i) {
        const double bearing = std::remainder(angles[i] - direction, 2 * pi);
        const double cosine = std::cos(angles[i]), sine = std::sin(angles[i]);
        const double infinite = std::numeric_limits<double>::infinity();
        Reading reading{{infinite, -infinite}, {infinite, -infinite}};
        for (int k = 0; k < 4; ++k) {
            const Point away = corners[static_cast<std::size_t>(4 * tiles[i] + k)] - centre;
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

FlatLevels flatten(const std::vector<Level>& levels) {
    FlatLevels out;
    for (const Level& level : levels) {
        out.place.insert(out.place.end(), level.place.begin(), level.place.end());
        out.shape.insert(out.shape.end(), level.shape.begin(), level.shape.end());
        out.span.insert(out.span.end(), level.span.begin(), level.span.end());
        out.range.insert(out.range.end(), level.range.begin(), level.range.end());
        out.count.push_back(level.count());
    }
    return out;
}

Subtree plant(const Group& group, const Geometry& geometry, const std::vector<Point>& centres, const Layout& layout,
              double plane, double direction, std::vector<Reading> readings, double step, std::int64_t& left) {
    const double height = group.centre.z - plane;
    for (Reading& r : readings) r.distance = {slant_of(r.distance.low, height), slant_of(r.distance.high, height)};
    const Grower grower{geometry, centres, layout, plane, direction, step, left};
    Node root;
    Subtree out;
    if (!grower.grow(root, group, std::move(readings), 0)) return out;
    std::vector<const Node*> nodes{&root};
    while (true) {
        out.levels.push_back(grower.level(nodes));
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
