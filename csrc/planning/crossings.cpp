#include "planning/crossings.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

constexpr double infinite = std::numeric_limits<double>::infinity();
constexpr double widest = 0.28;    // sine of the angle between a line and the rays that it crosses, at most
constexpr double most_nodes = 3;   // to a pixel: what lies between is read too
constexpr int least_stretch = 16;  // a vector's lanes
constexpr double even = 1e-9;      // of the distance between ends: what lines may be off

Point on_ground(const Point& p) { return {p.x, p.y, 0}; }

}  // namespace

std::optional<Parallel> parallel_of(const Scene& scene, std::int64_t begin, std::int64_t end, int block,
                                    double rounding) {
    const Pixels& pixels = scene.pixels;
    if (!pixels.straight() || end - begin < 2 || pixels.width < 2 || block < 2) return {};
    const auto first = [&](std::int64_t i) { return point(pixels.first.data() + 3 * i); };
    const Point step = point(pixels.step.data() + 3 * begin), whole = first(end - 1) - first(begin);
    const Point down = 1.0 / static_cast<double>(end - 1 - begin) * whole;
    const double slack = even * (length(whole) + static_cast<double>(pixels.width) * length(step));
    for (std::int64_t i = begin; i < end; ++i) {
        const Point off = first(i) - first(begin) - static_cast<double>(i - begin) * down;
        const Point other = point(pixels.step.data() + 3 * i) - step;
        if (length(off) + static_cast<double>(pixels.width) * length(other) > slack) return {};
    }
    const double apart = length(on_ground(down)), along = length(on_ground(step));
    if (!(apart > 0 && along > 0)) return {};
    // as long as a line's block, whose polynomials hold, and rounded as little
    const double wave = scene.survey.model.fc / scene.survey.model.c, eps = 0x1p-24;
    const double turns = (rounding / eps - 4) / pi;
    const double most = std::min((block - 1) * along / apart, turns / (wave * apart)) * (1 + 1e-9);
    const int stretch = static_cast<int>(std::min<double>(pysas::block, 1 + std::floor(std::max(most, 0.0))));
    return Parallel{step, down, stretch < least_stretch ? 0 : stretch};
}

double turning(const Point& away, const Point& along, double height) {
    const double apart = std::hypot(along.x, along.y), ground = std::hypot(away.x, away.y);
    const double aside = std::abs(away.x * along.y - away.y * along.x) / apart;
    if (!(aside < widest * ground)) return infinite;
    return aside * slant_of(ground, height) / (ground * ground * std::sqrt(ground * ground - aside * aside));
}

void choose_reads(GroupTree& tree, const Group& group, const Tiled& tiled, const Parallel& lines, double crossing) {
    const double* top = tree.levels.back().place.data();
    const double rays = top[5], step = top[6], height = group.centre.z - tiled.plane;
    const auto each = static_cast<std::size_t>(tiled.each);
    const auto leads = [&](std::size_t tile, const Point& along) {
        if (length(on_ground(along)) > most_nodes * step) return false;
        bool outward = false;
        for (std::size_t k = 0; k < each; ++k) {
            const Point away = on_ground(tiled.corners[each * tile + k] - group.centre);
            if (!(turning(away, along, height) * step <= crossing * rays)) return false;
            const bool out = dot(away, along) > 0;
            if (k > 0 && out != outward) return false;
            outward = out;
        }
        return true;
    };
    for (std::size_t tile = 0; tile < tree.read.size(); ++tile) {
        if (!tree.read[tile]) continue;
        if (lines.stretch > 0 && leads(tile, lines.down))
            tree.read[tile] = by_columns;
        else if (leads(tile, lines.step))
            tree.read[tile] = by_lines;
    }
}

}  // namespace pysas
