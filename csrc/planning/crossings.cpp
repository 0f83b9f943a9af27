#include "planning/crossings.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/columns.hpp"
#include "core/polynomials.hpp"
#include "planning/fates.hpp"

namespace pysas {
namespace {

constexpr double infinite = std::numeric_limits<double>::infinity();
constexpr double widest = 0.28;   // sine of the angle between a line and the rays that it crosses, at most
constexpr double most_nodes = 3;  // to a pixel: what lies between is read too
constexpr double even = 1e-9;     // of the distance between ends: what lines may be off

Point on_ground(const Point& p) { return {p.x, p.y, 0}; }

// Slant range from which the polynomials of degree 4 that kernels have of a line's bearing along `block` nodes, through
// Chebyshev's five, are wrong by at most `error` rad for a line that is as oblique as any there. A stretch begins up to
// `before` nodes ahead of a tile; those nearer than the filter reaches are not read.
double followed_from(double height, double step, double error) {
    constexpr int before = 30, filter = 15, nodes = 5;
    const auto wrong = [&](double slant) {
        const double aside = widest * ground_from(slant, height), first = slant - before * step;
        const auto bearing = [&](double node) {  // as kernels have it, guard nodes within the arcsine's reach
            const double range = first + node * step, ground2 = range * range - height * height;
            return std::asin(aside / std::sqrt(std::max(ground2, 9 * aside * aside)));
        };
        const auto place = [&](int j) {
            return (1 - std::cos(pi * (2 * j + 1) / (2 * nodes)) / std::cos(pi / (2 * nodes))) / 2 * (block - 1);
        };
        double most = 0;
        for (int node = before - filter; node < block; node += 3) {
            const double range = first + node * step;
            double found = 0;
            for (int j = 0; j < nodes; ++j) {
                double share = 1;
                for (int k = 0; k < nodes; ++k)
                    if (k != j) share *= (node - place(k)) / (place(j) - place(k));
                found += share * bearing(place(j));
            }
            if (!(range > height)) return infinite;
            most = std::max(most, std::abs(found - std::asin(std::min(aside / ground_from(range, height), 1.0))));
        }
        return most;
    };
    double low = std::max(height, 0.0) + before * step, high = 1e9;
    while (high > low * (1 + 1e-3)) {
        const double middle = std::sqrt(low * high);
        (wrong(middle) <= error ? high : low) = middle;
    }
    return high;
}

}  // namespace

std::optional<Parallel> parallel_of(const Scene& scene, std::int64_t begin, std::int64_t end, int block,
                                    double rounding) {
    const Pixels& pixels = scene.pixels;
    if (!pixels.lined() || end - begin < 2 || pixels.width < 2 || block < 2) return {};
    const auto first = [&](std::int64_t i) { return point(pixels.first.data() + 3 * i); };
    const Point step = point(pixels.step.data() + 3 * begin), whole = first(end - 1) - first(begin);
    const Point down = 1.0 / static_cast<double>(end - 1 - begin) * whole;
    const double wave = scene.survey.model.fc / scene.survey.model.c, eps = 0x1p-24;
    const double slack =
        std::min(even * (length(whole) + static_cast<double>(pixels.width) * length(step)), rounding / (4 * pi * wave));
    for (std::int64_t i = begin; i < end; ++i) {
        const Point off = first(i) - first(begin) - static_cast<double>(i - begin) * down;
        const Point other = point(pixels.step.data() + 3 * i) - step;
        if (length(off) + static_cast<double>(pixels.width) * length(other) > slack) return {};
    }
    const double apart = length(on_ground(down)), along = length(on_ground(step));
    if (!(apart > 0 && along > 0)) return {};
    // as long as a line's block, whose polynomials hold, and rounded as little
    const double turns = (rounding / eps - 4) / pi;
    const double most = std::min((block - 1) * along / apart, turns / (wave * apart)) * (1 + 1e-9);
    const int stretch = static_cast<int>(std::min<double>(pysas::block, 1 + std::floor(std::max(most, 0.0))));
    return Parallel{step, down, stretch, block, end - begin, pixels.width, block};
}

double turning(const Point& away, const Point& along, double height) {
    const double apart = std::hypot(along.x, along.y), ground = std::hypot(away.x, away.y);
    const double aside = std::abs(away.x * along.y - away.y * along.x) / apart;
    if (!(aside < widest * ground)) return infinite;
    return aside * slant_of(ground, height) / (ground * ground * std::sqrt(ground * ground - aside * aside));
}

// Of the phase that heights may turn, what a line's bend on the plane may take.
constexpr double bends = 0.25;

double turn_of(const Layout& layout, double turned) { return (1 - bends) * turned * layout.taps.rate / pi; }

namespace {

// Whether pixels of a map are seen as lines of constant slope, or between two such lines: those `along` of boxes, by
// their corners, of `count` pixels.
//
// Where a range is met along a line that is y long on the ground, H below, it moves by H/y of what the height is off
// by, and the place along the group's axis by the cosine of the angle between axis and line of that. Half way between
// two lines the phase's square is left, as of any linear interpolation. On the plane a line of slope s, Z off it, bends
// by (2 H Z + 2 s H y + (s y)^2)/y^3. What a ping's own trace is off by, as q/r of heights, is read through three
// places along the line and as many between its two slopes.
//
// Slopes that face the group shorten that line along the ray and not beside it: by `shorter`.
bool slopes(const Group& group, const Onto& onto, double plane, const std::vector<Point>& corners, const Point& along,
            std::int64_t count, double edge, double own, double turned, double& shorter) {
    const double apart = length(on_ground(along)), across = std::hypot(group.axis.x, group.axis.y);
    double low = HUGE_VAL, high = -HUGE_VAL, ground = HUGE_VAL, beside = HUGE_VAL, below = 0, off = 0;
    for (const Point& corner : corners) {
        const Point away = corner - group.centre;
        low = std::min(low, corner.z);
        high = std::max(high, corner.z);
        ground = std::min(ground, std::abs(away.x * along.x + away.y * along.y) / apart);
        beside = std::min(beside, onto(corner)->beside);
        below = std::max(below, std::abs(away.z));
        off = std::max(off, std::abs(corner.z - plane));
    }
    const double rise = high - low, run = static_cast<double>(count - 1) * apart, slope = rise / run;
    if (!(count > 1 && rise <= 3 * run && 2 * rise * below <= run * ground)) return false;
    shorter = std::min(shorter, 1 - slope * below / ground);
    const double cosine = std::abs(group.axis.x * along.x + group.axis.y * along.y) / (apart * across),
                 upright = std::abs(group.axis.z) / across;
    const double turn = 2 * rise * (cosine * below / ground + upright) / beside * edge;
    const double bend = 2 * below * off + 2 * slope * below * ground + slope * slope * ground * ground;
    const double longest = std::max(run, 16 * apart), part = longest / (2 * ground);
    const double bent = cosine * bend / (ground * ground * ground) * longest * longest / 8 / beside * edge;
    const double traced =
        own / beside * (0.385 * off * part * part * part + rise * rise * rise / (60 * beside * beside));
    return turn * turn / 8 <= (1 - bends) * turned && bent + traced <= bends * turned;
}

}  // namespace

void choose_reads(GroupTree& tree, const Group& group, const Tiled& tiled, double plane, const Parallel& lines,
                  const Layout& layout, double turned, double own) {
    const double* top = tree.levels.back().place.data();
    const double rays = top[5], step = top[6], height = group.centre.z - plane, edge = pi / (layout.taps.rate * rays);
    const double nearest = followed_from(height, step, layout.positions / edge);
    const auto each = static_cast<std::size_t>(tiled.each);
    const Onto onto(group, plane);
    const auto leads = [&](std::int64_t tile, const Point& along, double shorter) {
        if (length(on_ground(along)) > most_nodes * step) return false;
        bool outward = false;
        for (std::size_t k = 0; k < each; ++k) {
            const Point& corner = tiled.corners[each * static_cast<std::size_t>(tile) + k];
            const Point away = on_ground((tiled.flat ? corner : onto(corner)->place) - group.centre);
            const Point ray = (1 / length(away)) * away, straight = dot(on_ground(along), ray) * ray;
            const Point seen = along - (1 - shorter) * straight;
            if (!(turning(away, seen, height) * step <= layout.crossing * rays)) return false;
            if (!(slant_of(length(away), height) >= nearest)) return false;
            const bool out = dot(away, along) > 0;
            if (k > 0 && out != outward) return false;
            outward = out;
        }
        return true;
    };
    // of tiles alone, and with those that are read at once, `apart` tiles from one to the next
    const auto even = [&](std::int64_t tile, const Point& along, std::int64_t number, std::int64_t apart,
                          std::int64_t pixels, std::int64_t left) {
        const std::int64_t count = read_at_once(pixels);
        const std::int64_t before = number % count, behind = std::min((left - 1) / pixels, count - 1 - before);
        double shorter = 1;
        const auto holds = [&](std::int64_t begin, std::int64_t end) {
            std::vector<Point> corners;
            for (std::int64_t t = tile + begin * apart; t <= tile + end * apart; t += apart) {
                const auto from = tiled.corners.begin() + static_cast<std::ptrdiff_t>(each) * t;
                corners.insert(corners.end(), from, from + static_cast<std::ptrdiff_t>(each));
            }
            const std::int64_t some = std::min(pixels * (end - begin + 1), left - begin * pixels);
            return std::all_of(corners.begin(), corners.end(), [&](const Point& p) { return onto(p).has_value(); }) &&
                   slopes(group, onto, plane, corners, along, some, edge, own, turned, shorter);
        };
        const bool held = tiled.flat || (holds(0, 0) && (count == 1 || holds(-before, behind)));
        return held && leads(tile, along, shorter);
    };
    const std::int64_t across = lines.across();
    for (std::int64_t tile = 0; tile < static_cast<std::int64_t>(tree.read.size()); ++tile) {
        std::uint8_t& read = tree.read[static_cast<std::size_t>(tile)];
        if (!read) continue;
        if (lines.column >= least_stretch &&
            even(tile, lines.down, tile / across, across, tile_rows, lines.rows_from(tile)))
            read = by_columns;
        else if (lines.line >= least_stretch &&
                 even(tile, lines.step, tile % across, 1, lines.block, lines.pixels_from(tile)))
            read = by_lines;
    }
}

}  // namespace pysas
