#include "planning/forest.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

constexpr double wide = 0.3;             // a tile's radius seen from a group at most, rad
constexpr int most_step = max_step / 2;  // of the samples that tables' filters step by

double speed_of(const Trace& trace) { return length(point(trace.velocity)); }

// The lowest simple number of intervals to a sample that is at least `least`, up to 16; phases 0 where there is none.
void simple_rate(double least, int& phases, int& step) {
    phases = 0;
    if (!(least <= 16)) return;
    for (int s = 1; s <= most_step; ++s) {
        const int p = static_cast<int>(std::ceil(least * s * (1 - 1e-12)));
        if (phases == 0 || p * step < phases * s) {
            phases = p;
            step = s;
        }
    }
}

struct Fates {
    std::vector<std::uint8_t> read, direct;
};

struct Builder {
    const Geometry& geometry;
    const Layout& layout;
    const std::vector<Point>& centres;
    double near;

    // Which tiles are read from a group's sub-image, and which are summed directly.
    Fates fates(const Group& group, const Section& section, double step) const {
        const Model& model = geometry.model;
        const std::size_t tiles = section.pixels.size();
        // nodes that a read depends on lie this much further out or in, and to the sides
        const double taps = layout.taps.reach();
        const double reach = static_cast<double>(layout.fans.size() + 1) * (taps + 4) * step;
        const double height = group.centre.z - section.plane;
        const double least = std::max(slant_of(near_lengths * group.extent, height), layout.clear);
        Fates out{std::vector<std::uint8_t>(tiles), std::vector<std::uint8_t>(tiles)};
        for (std::size_t tile = 0; tile < tiles; ++tile) {
            if (section.pixels[tile] == 0) continue;
            Point middle;
            double radius = 0;
            const Point* corner = &section.corners[4 * tile];
            for (int k = 0; k < 4; ++k) middle = middle + 0.25 * corner[k];
            for (int k = 0; k < 4; ++k) radius = std::max(radius, length(corner[k] - middle));
            const double ground = std::hypot(middle.x - group.centre.x, middle.y - group.centre.y);
            const double away = slant_of(std::max(ground - radius, 0.0), height);
            // across a beam's edge the sum has a step
            bool read = away >= near && away - reach >= least && radius <= wide * ground && model.cos_beam <= -1;
            read = read && group.distance(middle) - radius - reach >= layout.apart;
            bool heard = false;
            const double ends = layout.ends * model.c / model.fs + 2 * taps * step;
            const double spread = 2 * radius + std::max(2 * reach, ends);
            for (const std::int64_t i : group.traces) {
                if (heard && !read) break;
                const Trace& trace = geometry.traces[i];
                const double path = length(middle - point(trace.tx)) + length(middle - point(trace.rx));
                const double speed = speed_of(trace);
                const double low = ((path - spread) / (model.c + speed) - trace.t0) * model.fs;
                const double high = ((path + spread) / (model.c - speed) - trace.t0) * model.fs;
                heard = heard || (high >= -edge_samples && low <= model.last + edge_samples);
                read = read && low >= 0 && high <= model.last;
            }
            out.read[tile] = read;
            out.direct[tile] = heard && !read;
        }
        return out;
    }

    // Samples that a tree's leaves ask of their traces, whatever the image asks.
    void widen(const GroupTree& tree, double step, Forest& forest) const {
        const Model& model = geometry.model;
        const Level& leaves = tree.levels.front();
        for (std::size_t i = 0; i + 1 < leaves.span.size(); ++i) {
            const std::int64_t* shape = leaves.shape.data() + 5 * i;
            std::int64_t least = shape[2], most = 0;
            for (std::int64_t r = shape[4]; r < shape[4] + shape[1]; ++r) {
                const std::int32_t* ends = leaves.range.data() + 2 * r;
                if (ends[0] >= ends[1]) continue;
                least = std::min<std::int64_t>(least, ends[0]);
                most = std::max<std::int64_t>(most, ends[1]);
            }
            const Point centre = point(leaves.place.data() + 7 * i);
            const double low = static_cast<double>(shape[0] + least - 1) * step,
                         high = static_cast<double>(shape[0] + most + 1) * step;
            for (std::int64_t k = leaves.span[i]; k < leaves.span[i + 1]; ++k) {
                const auto number = static_cast<std::size_t>(tree.traces[static_cast<std::size_t>(k)]);
                const Trace& trace = geometry.traces[number];
                const double apart = length(point(trace.tx) - centre) + length(point(trace.rx) - centre);
                const double speed = speed_of(trace);
                const double begin = std::max(2 * low - apart, 0.0) / (model.c + speed) - trace.t0;
                const double end = (2 * high + apart) / (model.c - speed) - trace.t0;
                const double from = std::clamp(std::floor(begin * model.fs), 0.0, model.last),
                             to = std::clamp(std::ceil(end * model.fs), 0.0, model.last);
                forest.first[number] = std::min(forest.first[number], static_cast<std::int64_t>(from));
                forest.last[number] = std::max(forest.last[number], static_cast<std::int64_t>(to));
            }
        }
    }
};

Numbers chosen(const std::vector<std::uint8_t>& tiles) {
    Numbers out;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
        if (tiles[i]) out.push_back(static_cast<std::int64_t>(i));
    }
    return out;
}

}  // namespace

std::optional<Section> section_of(const Raster& raster) {
    Section out{raster.first[2], {}, {}};
    for (std::int64_t i = 0; i < raster.height; ++i) {
        if (raster.first[3 * i + 2] != out.plane || raster.step[3 * i + 2] != 0) return {};
    }
    const Tiling tiling(raster);
    for (std::int64_t number = 0; number < tiling.count(); ++number) {
        const Tiling::Tile tile = tiling.at(number);
        std::int64_t pixels = 0;
        for (std::int64_t line = tile.top; line < tile.bottom; ++line) {
            const std::uint8_t* mask = raster.mask ? raster.mask + line * raster.width : nullptr;
            pixels += mask ? (tile.right - tile.left) - std::count(mask + tile.left, mask + tile.right, 0)
                           : tile.right - tile.left;
        }
        out.pixels.push_back(pixels);
        for (const std::int64_t line : {tile.top, tile.bottom - 1}) {
            for (const std::int64_t pixel : {tile.left, tile.right - 1})
                out.corners.push_back(point(raster.first + 3 * line) +
                                      static_cast<double>(pixel) * point(raster.step + 3 * line));
        }
    }
    return out;
}

std::optional<Forest> make_forest(const Geometry& geometry, const std::vector<Section>& sections, const Layout& layout,
                                  double near, double rate, std::int64_t most) {
    const Model& model = geometry.model;
    const auto centres = phase_centres(geometry);
    const Builder builder{geometry, layout, centres, near};
    std::vector<Group> groups;
    for (Numbers& traces : cut_track(geometry, centres, layout.length))
        groups.push_back(make_group(std::move(traces), centres));
    // one node spacing for all grids: neighbours along a parent's ray are neighbours on a child's
    double highest = 1e-9;
    const double spacing = model.c / (4 * geometry.half_band() * layout.taps.rate);
    std::vector<Fates> fates;
    for (const Section& section : sections) {
        for (const Group& group : groups) {
            fates.push_back(builder.fates(group, section, spacing));
            const Numbers tiles = chosen(fates.back().read);
            if (tiles.empty()) continue;
            double direction = 0, far = 0, close = HUGE_VAL, left = HUGE_VAL, right = -HUGE_VAL;
            for (const Reading& r : seen_from(group.centre, section.corners, tiles, direction)) {
                left = std::min(left, r.bearing.low);
                right = std::max(right, r.bearing.high);
                close = std::min(close, r.distance.low);
                far = std::max(far, r.distance.high);
            }
            highest = std::max(
                highest,
                bands_of(group, geometry, section.plane, {direction + left, direction + right}, {close, far}).along);
        }
    }
    // and as long as a table's intervals, of which there are a simple number to a sample
    Forest out{layout.taps, 0, 0, 1, {}, {}, {}, 0};
    simple_rate(std::max(rate, model.c * layout.taps.rate * layout.spare * highest / model.fs), out.phases,
                out.per_samples);
    if (out.phases == 0) return {};
    out.step = model.c * out.per_samples / (2 * model.fs * out.phases);
    const auto count = static_cast<std::size_t>(geometry.count);
    out.first.assign(count, static_cast<std::int64_t>(model.last));
    out.last.assign(count, 0);
    double through = 0, everything = 0, along = 0;
    std::int64_t room = most;
    for (std::size_t s = 0; s < sections.size(); ++s) {
        const Section& section = sections[s];
        for (std::size_t g = 0; g < groups.size(); ++g) {
            Fates& fate = fates[s * groups.size() + g];
            const Numbers tiles = chosen(fate.read), others = chosen(fate.direct);
            if (tiles.empty() && others.empty()) continue;
            GroupTree tree{s, groups[g].traces, std::move(fate.read), std::move(fate.direct), {}};
            double read = 0, direct = 0;
            for (const std::int64_t tile : tiles)
                read += static_cast<double>(section.pixels[static_cast<std::size_t>(tile)]);
            for (const std::int64_t tile : others)
                direct += static_cast<double>(section.pixels[static_cast<std::size_t>(tile)]);
            if (!tiles.empty()) {
                double direction = 0;
                auto readings = seen_from(groups[g].centre, section.corners, tiles, direction);
                Subtree below = make_subtree(groups[g], geometry, centres, layout, section.plane, direction,
                                             std::move(readings), out.step, room);
                if (below.levels.empty()) return {};
                along = std::max(along, below.along);
                tree.traces = std::move(below.traces);
                tree.levels = std::move(below.levels);
                builder.widen(tree, out.step, out);
            }
            const auto traces = static_cast<double>(tree.traces.size());
            through += traces * read;
            everything += traces * (read + direct);
            out.trees.push_back(std::move(tree));
        }
    }
    if (through == 0) return {};
    // the groups' parts, and nodes beside what is read, may ask for more
    int phases = 0, per_samples = 1;
    simple_rate(model.c * layout.taps.rate * layout.spare * along / model.fs, phases, per_samples);
    if (phases == 0) return {};
    const double needed = static_cast<double>(phases) / per_samples;
    if (needed * out.per_samples > out.phases * (1 + 1e-9))
        return make_forest(geometry, sections, layout, near, needed, most);
    out.share = through / everything;
    return out;
}

std::vector<TreeBatch> batches_of(const GroupTree& tree, std::int64_t most) {
    std::vector<TreeBatch> out;
    if (tree.levels.empty()) {
        const auto count = static_cast<std::int64_t>(tree.traces.size());
        for (std::int64_t i = 0; i < count; i += most) out.push_back({i, std::min(i + most, count), 0, 0});
        return out;
    }
    const Numbers& span = tree.levels[0].span;
    // the last number at which `ends` are at most `limit`
    const auto fitting = [](const Numbers& ends, std::int64_t limit) {
        return std::upper_bound(ends.begin(), ends.end(), limit) - ends.begin() - 1;
    };
    for (std::int64_t leaf = 0; leaf < tree.levels[0].count();) {
        const std::int64_t begin = span[static_cast<std::size_t>(leaf)];
        std::int64_t last = std::max(leaf + 1, fitting(span, begin + most));
        if (tree.levels.size() > 1) {
            const Numbers& parents = tree.levels[1].span;
            const std::int64_t whole = parents[static_cast<std::size_t>(fitting(parents, last))];
            if (whole > leaf) last = whole;
        }
        out.push_back({begin, span[static_cast<std::size_t>(last)], leaf, last});
        leaf = last;
    }
    return out;
}

}  // namespace pysas
