#include "planning/crossings.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/polynomials.hpp"

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
    if (!pixels.straight() || end - begin < 2 || pixels.width < 2 || block < 2) return {};
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
    return Parallel{step, down, stretch, block};
}

double turning(const Point& away, const Point& along, double height) {
    const double apart = std::hypot(along.x, along.y), ground = std::hypot(away.x, away.y);
    const double aside = std::abs(away.x * along.y - away.y * along.x) / apart;
    if (!(aside < widest * ground)) return infinite;
    return aside * slant_of(ground, height) / (ground * ground * std::sqrt(ground * ground - aside * aside));
}

void choose_reads(GroupTree& tree, const Group& group, const Tiled& tiled, const Parallel& lines,
                  const Layout& layout) {
    const double* top = tree.levels.back().place.data();
    const double rays = top[5], step = top[6], height = group.centre.z - tiled.plane;
    const double nearest = followed_from(height, step, layout.positions / (pi / layout.taps.rate) * rays);
    const auto each = static_cast<std::size_t>(tiled.each);
    const auto leads = [&](std::size_t tile, const Point& along) {
        if (length(on_ground(along)) > most_nodes * step) return false;
        bool outward = false;
        for (std::size_t k = 0; k < each; ++k) {
            const Point away = on_ground(tiled.corners[each * tile + k] - group.centre);
            if (!(turning(away, along, height) * step <= layout.crossing * rays)) return false;
            if (!(slant_of(length(away), height) >= nearest)) return false;
            const bool out = dot(away, along) > 0;
            if (k > 0 && out != outward) return false;
            outward = out;
        }
        return true;
    };
    for (std::size_t tile = 0; tile < tree.read.size(); ++tile) {
        if (!tree.read[tile]) continue;
        if (lines.column >= least_stretch && leads(tile, lines.down))
            tree.read[tile] = by_columns;
        else if (lines.line >= least_stretch && leads(tile, lines.step))
            tree.read[tile] = by_lines;
    }
}

}  // namespace pysas
