#include "planning/forest.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "planning/crossings.hpp"
#include "planning/fates.hpp"

namespace pysas {
namespace {

constexpr std::int64_t least_nodes = std::int64_t{1} << 22;  // that trees of any image may have
constexpr std::int64_t judged_groups = 5, judged_tiles = 500;
// traces that are summed in less time than pixels off the plane are read one by one
constexpr std::size_t sooner_direct = 40;
constexpr std::size_t at_once = 16;  // groups whose trees are made side by side, whatever the number of threads

Geometry geometry_of(const Scene& scene) {
    const Survey& survey = scene.survey;
    return {survey.traces.data(), nullptr,     survey.channels,  scene.traces(),
            survey.model,         survey.band, scene.reception()};
}

// Traces of each of the longest groups: of those that are heard and weigh anything.
std::vector<Numbers> cut(const Scene& scene, const std::vector<Point>& centres, double length) {
    Numbers order, pings;
    std::vector<Point> places;
    for (std::size_t i = 0; i < centres.size(); ++i) {
        if (!scene.heard[i] || scene.survey.weights[i] == 0.0) continue;
        order.push_back(static_cast<std::int64_t>(i));
        pings.push_back(static_cast<std::int64_t>(i) / scene.survey.channels);
        places.push_back(centres[i]);
    }
    Geometry geometry = geometry_of(scene);
    geometry.pings = pings.data();
    geometry.count = static_cast<std::int64_t>(order.size());
    auto pieces = cut_track(geometry, places, length);
    for (Numbers& piece : pieces) {
        for (std::int64_t& i : piece) i = order[static_cast<std::size_t>(i)];
    }
    return pieces;
}

// Between nodes, m, before the sub-images' own bands are known.
double first_step(const Scene& scene, const Layout& layout) {
    return scene.survey.model.c / (4 * scene.survey.band * scene.survey.model.fs * layout.taps.rate);
}

// Of those wanted, every so many that about `most` are left; all with 0.
Numbers wanted_tiles(const Tiled& tiled, std::int64_t most) {
    Numbers all, some;
    for (std::size_t i = 0; i < tiled.pixels.size(); ++i) {
        if (tiled.pixels[i] > 0) all.push_back(static_cast<std::int64_t>(i));
    }
    const std::size_t apart = most > 0 ? std::max<std::size_t>(1, all.size() / static_cast<std::size_t>(most)) : 1;
    for (std::size_t i = 0; i < all.size(); i += apart) some.push_back(all[i]);
    return some;
}

std::int64_t pixels_of(const Numbers& pixels, const std::vector<std::uint8_t>& tiles) {
    std::int64_t sum = 0;
    for (std::size_t i = 0; i < tiles.size(); ++i) sum += tiles[i] ? pixels[i] : 0;
    return sum;
}

// Terms that go through trees, of all.
struct Share {
    double through = 0, everything = 0;

    void count(std::size_t traces, const Numbers& pixels, const std::vector<std::uint8_t>& read,
               const std::vector<std::uint8_t>& direct) {
        const auto from_trees = static_cast<double>(pixels_of(pixels, read));
        through += static_cast<double>(traces) * from_trees;
        everything += static_cast<double>(traces) * (from_trees + static_cast<double>(pixels_of(pixels, direct)));
    }
    double value() const { return through / std::max(everything, 1.0); }
};

Stacked planes_of(const Scene& scene, const Tiled& tiled, const std::vector<Group>& groups, const OffPlanes& relief) {
    return tiled.flat ? Stacked{{tiled.plane}} : stack_of(scene, tiled, groups, relief.error, relief.count);
}

// What a group does for one plane of a section's stack.
struct Seen {
    Fates fates;
    double direction = 0;
    std::vector<Reading> readings;  // none: nothing is read
};

struct Layer {
    const Tiled& tiled;
    Stacked planes;
    int number;
    std::vector<Seen> seen;  // by group

    double plane() const { return planes.heights[static_cast<std::size_t>(number)]; }
};

Seen seen_of(const Layer& layer, const Group& group, const Fates& fates) {
    const Tiled& tiled = layer.tiled;
    const auto each = static_cast<std::size_t>(tiled.each);
    Seen out{fates, 0, {}};
    if (layer.number > 0) out.fates.direct.assign(fates.direct.size(), 0);  // once is enough
    const Onto onto(group, layer.plane());
    std::vector<Point> corners;
    for (std::size_t i = 0; i < each * fates.read.size(); ++i) {
        if (fates.read[i / each]) corners.push_back(tiled.flat ? tiled.corners[i] : onto(tiled.corners[i])->place);
    }
    if (!corners.empty()) out.readings = seen_from(group.centre, corners, tiled.each, out.direction);
    for (Reading& reading : out.readings) {
        const double height = group.centre.z - layer.plane();
        const auto moved = [&](double ground, double by) {
            return ground_from(std::max(slant_of(ground, height) + by, std::abs(height)), height);
        };
        reading.distance = {moved(reading.distance.low, -layer.planes.shift),
                            moved(reading.distance.high, layer.planes.shift)};
    }
    return out;
}

struct ForestMaker {
    const Scene& scene;
    const Layout& layout;
    std::vector<Point> centres;
    std::vector<Group> groups;
    std::vector<Layer> layers;
    Poll& poll;
    int threads;
    double turned;  // what heights may turn along lines, rad of phase

    // Adds a section's layers; false where it cannot be read.
    bool look(const Tiled& tiled, double near, const OffPlanes& relief, bool whole) {
        const Numbers tiles = wanted_tiles(tiled, 0);
        if (tiles.empty()) return true;
        const auto planes = planes_of(scene, tiled, groups, relief);
        if (planes.heights.empty()) return false;
        std::vector<Fates> fates(groups.size());
        const auto each = [&](const auto& call) {
            run(
                static_cast<std::int64_t>(groups.size()), threads,
                [&](std::int64_t g) { call(static_cast<std::size_t>(g)); }, poll.tick());
        };
        each([&](std::size_t g) {
            fates[g] = fates_of(scene, groups[g], tiled, tiles, planes, layout, first_step(scene, layout), near);
        });
        for (const Fates& found : fates) {
            if (whole && std::find(found.direct.begin(), found.direct.end(), 1) != found.direct.end()) return false;
        }
        for (std::size_t k = 0; k < planes.heights.size(); ++k) {
            Layer layer{tiled, planes, static_cast<int>(k), std::vector<Seen>(groups.size())};
            each([&](std::size_t g) { layer.seen[g] = seen_of(layer, groups[g], fates[g]); });
            layers.push_back(std::move(layer));
        }
        return true;
    }

    bool reads() const {
        return std::any_of(layers.begin(), layers.end(), [](const Layer& layer) {
            return std::any_of(layer.seen.begin(), layer.seen.end(),
                               [](const Seen& seen) { return !seen.readings.empty(); });
        });
    }

    // For the highest frequency along rays, cycles a metre: tables have as many intervals to a sample.
    Rate rate_for(double along) const {
        const Model& model = scene.survey.model;
        return simple_rate(model.c * layout.taps.rate * layout.spare * (1 + layout.crossing) * along / model.fs);
    }

    // Trees with `rate` nodes per sample, and the highest frequency along their rays; nothing where they have more than
    // about as many nodes as the sum has terms. One spacing for all grids: neighbours along a parent's ray are
    // neighbours on a child's, and intervals of the tables.
    std::optional<PlannedForest> make(const Rate& rate, double& along) const {
        const Model& model = scene.survey.model;
        const double step = model.c * rate.step / (2 * model.fs * rate.phases);
        PlannedForest out{
            {layout.taps.taps, step, rate.phases, rate.step, 0, {}}, layout, scene.first, scene.last, 0, 0, 0};
        std::int64_t left = 0;
        for (const Group& group : groups) left += static_cast<std::int64_t>(group.traces.size()) * scene.wanted;
        left = std::max(left, least_nodes);
        Share share;
        for (const Layer& layer : layers) {
            const Tiled& tiled = layer.tiled;
            Section section{tiled.begin,
                            tiled.end,
                            tiled.flat,
                            layer.plane(),
                            layer.planes.heights,
                            layer.number,
                            tiled.pixels,
                            tiled.lines ? tiled.lines->column : 0,
                            tiled.flat ? 0 : turn_of(layout, turned),
                            {}};
            for (std::size_t begin = 0; begin < groups.size(); begin += at_once) {
                std::vector<Grown> grown(std::min(at_once, groups.size() - begin));
                run(
                    static_cast<std::int64_t>(grown.size()), threads,
                    [&](std::int64_t k) {
                        const std::size_t g = begin + static_cast<std::size_t>(k);
                        grown[static_cast<std::size_t>(k)] = grow(groups[g], layer, layer.seen[g], step, left);
                    },
                    poll.tick());
                for (std::size_t k = 0; k < grown.size(); ++k) {
                    GroupTree& tree = grown[k].tree;
                    const Fates& fates = layer.seen[begin + k].fates;
                    left -= grown[k].nodes;
                    along = std::max(along, grown[k].along);
                    if (grown[k].too_large || left < 0) return {};
                    if (pixels_of(tiled.pixels, fates.read) + pixels_of(tiled.pixels, fates.direct) == 0) continue;
                    if (!tree.levels.empty()) widen(tree, step, out);
                    if (layer.number == 0) share.count(tree.traces.size(), tiled.pixels, tree.read, tree.direct);
                    out.longest = std::max(out.longest, groups[begin + k].extent);
                    ++out.count;
                    section.trees.push_back(std::move(tree));
                }
            }
            if (!section.trees.empty()) out.forest.sections.push_back(std::move(section));
        }
        out.share = share.value();
        return out;
    }

    // A group's tree, its nodes, and the highest frequency along its rays; `too_large`: it would have more than are
    // left.
    struct Grown {
        GroupTree tree;
        std::int64_t nodes = 0;
        double along = 0;
        bool too_large = false;
    };

    Grown grow(const Group& group, const Layer& layer, const Seen& seen, double step, std::int64_t left) const {
        const Tiled& tiled = layer.tiled;
        const Point& axis = group.axis;
        Grown out{{group.traces, seen.fates.read, seen.fates.direct, {}, -1, {axis.x, axis.y, axis.z}}};
        if (layer.planes.alone) out.tree.own = own_of(scene, group);
        if (seen.readings.empty()) return out;
        std::int64_t floats = 2 * left;
        Subtree below = make_subtree(group, geometry_of(scene), centres, layout, layer.plane(), seen.direction,
                                     seen.readings, step, floats);
        out.too_large = below.levels.empty();
        for (const Level& level : below.levels) out.nodes += nodes_of(level);
        out.along = below.along;
        if (out.too_large) return out;
        out.tree.traces = std::move(below.traces);
        out.tree.levels = std::move(below.levels);
        // of levels from the top, the one below those that have weights
        const auto lit = static_cast<std::size_t>(lit_levels(layout.fans));
        if (lit < out.tree.levels.size()) out.tree.lit = static_cast<int>(out.tree.levels.size() - 1 - lit);
        if (tiled.lines && layout.crossing > 0)
            choose_reads(out.tree, group, tiled, layer.plane(), *tiled.lines, layout, turned,
                         layer.planes.alone ? own_turn(scene, group) : 0);
        if (!tiled.flat && layer.planes.heights.size() == 1 && group.traces.size() <= sooner_direct) {
            for (std::size_t i = 0; i < out.tree.read.size(); ++i) {
                if (out.tree.read[i] != by_pixels) continue;
                out.tree.read[i] = unread;
                out.tree.direct[i] = 1;
            }
            if (!along(out.tree)) out.tree.levels.clear();
        }
        return out;
    }

    static std::int64_t nodes_of(const Level& level) {
        std::int64_t sum = 0;
        for (std::size_t i = 0; i < level.range.size(); i += 2) sum += std::max(level.range[i + 1] - level.range[i], 0);
        return sum;
    }

    // Samples that a tree's leaves ask of their traces, whatever the image asks.
    void widen(const GroupTree& tree, double step, PlannedForest& out) const {
        const Model& model = scene.survey.model;
        const Level& leaves = tree.levels.front();
        for (std::size_t i = 0; i < static_cast<std::size_t>(leaves.count()); ++i) {
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
                const Trace& trace = scene.survey.traces[number];
                const double apart = length(point(trace.tx) - centre) + length(point(trace.rx) - centre);
                const double speed = length(point(trace.velocity));
                const double begin = std::max(2 * low - apart, 0.0) / (trace.c + speed) - trace.t0;
                const double end = (2 * high + apart) / (trace.c - speed) - trace.t0;
                const double from = std::clamp(std::floor(begin * model.fs), trace.first, trace.last),
                             to = std::clamp(std::ceil(end * model.fs), trace.first, trace.last);
                out.first[number] = std::min(out.first[number], static_cast<std::int64_t>(from));
                out.last[number] = std::max(out.last[number], static_cast<std::int64_t>(to));
            }
        }
    }
};

bool less(const Rate& a, const Rate& b) { return std::int64_t{a.phases} * b.step < std::int64_t{b.phases} * a.step; }

}  // namespace

Served served(const Scene& scene, const std::vector<Tiled>& image, const Layout& layout, double near,
              const OffPlanes& relief) {
    const auto centres = phase_centres(geometry_of(scene));
    auto pieces = cut(scene, centres, layout.length);
    const auto count = static_cast<std::int64_t>(pieces.size()),
               apart = std::max<std::int64_t>(1, count / judged_groups);
    std::vector<Group> groups;
    for (std::int64_t i = count / judged_groups / 2; i < count; i += apart)
        groups.push_back(make_group(std::move(pieces[static_cast<std::size_t>(i)]), centres));
    Share share;
    std::size_t deepest = 1;
    for (const Tiled& tiled : image) {
        if (!tiled.any()) continue;
        const auto planes = planes_of(scene, tiled, groups, relief);
        if (planes.heights.empty()) return {0, 1, count};
        deepest = std::max(deepest, planes.heights.size());
        const Numbers some = wanted_tiles(tiled, judged_tiles);
        for (const Group& group : groups) {
            const Fates fates = fates_of(scene, group, tiled, some, planes, layout, first_step(scene, layout), near);
            share.count(group.traces.size(), tiled.pixels, fates.read, fates.direct);
        }
    }
    return {share.value(), static_cast<int>(deepest), count};
}

Rate simple_rate(double least) {
    constexpr int most_step = max_step / 2;  // a filter steps through its rate also after doubling
    constexpr double most = 1e6;
    Rate best;
    if (!(least <= most)) return best;
    for (int step = 1; step <= most_step; ++step) {
        const Rate rate{std::max(1, static_cast<int>(std::ceil(least * step * (1 - 1e-12)))), step};
        if (best.phases == 0 || less(rate, best)) best = rate;
    }
    return best;
}

std::optional<PlannedForest> make_forest(const Scene& scene, const std::vector<Tiled>& image, const Layout& layout,
                                         double near, const OffPlanes& relief, double least, bool whole, Poll& poll,
                                         int threads) {
    const Survey& survey = scene.survey;
    ForestMaker maker{scene, layout, phase_centres(geometry_of(scene)), {}, {}, poll, threads, relief.lines};
    for (Numbers& piece : cut(scene, maker.centres, layout.length))
        maker.groups.push_back(make_group(std::move(piece), maker.centres));
    for (const Tiled& tiled : image) {
        if (!maker.look(tiled, near, relief, whole)) return {};
    }
    if (!maker.reads()) return {};
    const Rate given = simple_rate(least);
    Rate rate = maker.rate_for(2 / survey.model.c * survey.band * survey.model.fs);
    if (less(rate, given)) rate = given;
    while (rate.phases > 0) {
        double along = 0;
        auto planned = maker.make(rate, along);
        const Rate needed = maker.rate_for(along);
        if (!planned || (needed.phases > 0 && !less(rate, needed))) return planned;
        // the groups' parts, and nodes beside what is read, ask for more
        rate = needed;
    }
    return {};
}

Work work_of(const Forest& forest) {
    Work work;
    for (const Section& section : forest.sections) {
        for (const GroupTree& tree : section.trees) {
            const auto traces = static_cast<std::int64_t>(tree.traces.size());
            work.traces += traces;
            if (tree.levels.empty()) continue;
            const auto count = [&](std::size_t i) { return static_cast<double>(tree.levels[i].count()); };
            const auto nodes = [&](std::size_t i) {
                return static_cast<double>(ForestMaker::nodes_of(tree.levels[i]));
            };
            work.leaf_nodes += nodes(0);
            work.leaf_terms += nodes(0) * static_cast<double>(traces) / count(0);
            for (std::size_t i = 1; i < tree.levels.size(); ++i) work.merged += nodes(i) * count(i - 1) / count(i);
            for (std::size_t i = 0; i < tree.read.size(); ++i) {
                const double pixels = tree.read[i] ? static_cast<double>(section.pixels[i]) : 0;
                work.read += tree.read[i] > by_pixels ? line_cost * pixels : pixels;
            }
        }
    }
    return work;
}

double forest_seconds(const Scene& scene, const PlannedForest& planned, const Settings& settings, const Costs& costs) {
    const Work work = work_of(planned.forest);
    const double width = planned.layout.taps.taps.count;
    const auto& tree = costs.tree;
    const bool flat = std::all_of(planned.forest.sections.begin(), planned.forest.sections.end(),
                                  [](const Section& section) { return section.flat; });
    const double merge = tree.merge[0] + tree.merge[1] * width;
    const double read = (tree.read[0] + tree.read[1] * width) * (flat ? 1.0 : relief_cost);
    const double trees =
        work.leaf_terms * tree.term + work.leaf_nodes * tree.node + work.merged * merge + work.read * read;
    return trees * 1e-9 + sum_seconds(scene, settings, costs, 1 - planned.share) +
           prepare_seconds(settings, work.traces);
}

}  // namespace pysas
