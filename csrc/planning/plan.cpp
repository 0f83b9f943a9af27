// A plan as the executor takes it, and in words.

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <string>
#include <vector>

#include "core/polynomials.hpp"
#include "core/transforms.hpp"
#include "planning/planner.hpp"
#include "planning/words.hpp"

namespace pysas {
namespace {

constexpr std::int64_t slab = std::int64_t{1} << 16;  // points at a time

// Chebyshev nodes in [-1, 1] and the matrix from values there to coefficients of powers.
Nodes chebyshev(int count) {
    Nodes out{};
    out.count = count;
    for (int j = 0; j < count; ++j) out.at[j] = -std::cos(pi * (2 * j + 1) / (2 * count));
    out.at[count / 2] = 0;
    const std::vector<long double> places(out.at, out.at + count);
    for (int j = 0; j < count; ++j) {  // column j: the polynomial that is 1 at node j and 0 at the others
        std::vector<long double> column(places.size());
        column[static_cast<std::size_t>(j)] = 1;
        monomials(places, column);
        for (int q = 0; q < count; ++q) out.fit[q][j] = static_cast<double>(column[static_cast<std::size_t>(q)]);
    }
    return out;
}

Reader reader_of(const Settings& settings) {
    Reader out;
    out.filter = settings.filter;
    out.length = settings.length;
    out.wide = settings.wide;
    if (settings.n_fft)
        out.cut = Reader::Cut{settings.n_fft, smooth_cut(settings.length, settings.taper, settings.beta)};
    return out;
}

std::string trees_of(const Plan& plan) {
    const PlannedForest& planned = *plan.trees;
    const TapDesign& taps = planned.layout.taps;
    std::string out = "  trees          " + std::to_string(planned.count) + ", over groups of at most " +
                      number(planned.longest, 3) + " m, " + std::to_string(taps.taps.count) + " taps at " +
                      number(taps.rate, 3) + " x the band, nodes every " + number(planned.forest.step, 3) + " m\n";
    std::vector<const GroupTree*> trees;
    std::size_t planes = 0;
    double read = 0, whole = 0;
    for (const Section& section : planned.forest.sections) {
        planes = std::max(planes, section.heights.size());
        for (const GroupTree& tree : section.trees) {
            if (!tree.levels.empty()) trees.push_back(&tree);
            for (std::size_t i = 0; i < tree.read.size(); ++i) {
                const auto pixels = static_cast<double>(section.pixels[i]);
                read += tree.read[i] ? pixels : 0;
                whole += tree.read[i] > by_pixels ? pixels : 0;
            }
        }
    }
    out += "  factorised     " + fixed(100 * planned.share, 1) + " % of the terms, the rest summed directly";
    if (whole > 0) out += "; " + fixed(100 * whole / read, 0) + " % of the reads along lines";
    out += "\n";
    if (planes > 1)
        out += "  relief         pixels read from " + std::to_string(planes) + " planes each, trees for all of them\n";
    if (trees.empty()) return out;
    const std::vector<Level>& levels = trees[trees.size() / 2]->levels;
    for (std::size_t i = 0; i < levels.size(); ++i) {
        const auto count = static_cast<double>(levels[i].count());
        double nodes = 0, beam = 0;
        for (std::size_t k = 0; k < levels[i].range.size(); k += 2)
            nodes += std::max(levels[i].range[k + 1] - levels[i].range[k], 0);
        for (std::size_t k = 5; k < levels[i].place.size(); k += 7) beam += levels[i].place[k] / count;
        out += "    level " + std::to_string(i) + "      " + std::to_string(levels[i].count()) + " sub-images of " +
               number(static_cast<double>(levels[i].span.back()) / count, 3) +
               (i == 0 ? " traces each, " : " sub-images each, ") + number(nodes / count, 3) + " nodes, a ray every " +
               number(beam, 2) + " rad\n";
    }
    return out;
}

}  // namespace

std::int64_t Plan::start(std::size_t trace) const {
    if (settings.n_fft && !settings.taper && !settings.wide) return 0;
    return scene->first[trace] - 1 - settings.margin;
}

bool Plan::wide() const {
    if (!scene->pixels.hears.empty()) return false;  // each row is a sum of few traces
    std::int64_t rounds = (scene->traces() + settings.batch - 1) / settings.batch, most = 0;
    if (trees) {
        for (const Section& section : trees->forest.sections)
            most = std::max(most, static_cast<std::int64_t>(section.trees.size()));
    }
    return scene->survey.single && rounds + most > settings.run / 8;
}

std::int64_t Plan::memory() const {
    const std::int64_t pixels = scene->pixels.size(), item = settings.narrow ? 8 : 16;
    double work = static_cast<double>(settings.batch * settings.length * (settings.filter.degree + 1) * item) *
                  settings.oversampling;
    if (wide()) work += static_cast<double>(16 * pixels);
    // of transforms side by side, at twice the rate, and room for as many
    if (settings.n_fft) work += static_cast<double>(wish.threads * 8 * settings.n_fft * 4 * transform_lanes<float>);
    if (block == 0) work += static_cast<double>(24 * std::min(slab, pixels));
    if (trees) work += 4.5 * static_cast<double>(stores_of(trees->forest, settings.batch));
    return pixels * (scene->survey.single ? 8 : 16) + static_cast<std::int64_t>(work);
}

namespace {

// Between which heights the pixels of tiles lie.
std::vector<double> spans_of(const Image& image) {
    std::vector<double> out;
    for (std::int64_t top = 0; top < image.height; top += tile_rows) {
        for (std::int64_t left = 0; left < image.width; left += image.count) {
            double low = HUGE_VAL, high = -HUGE_VAL;
            for (std::int64_t r = top; r < std::min<std::int64_t>(top + tile_rows, image.height); ++r) {
                for (std::int64_t m = left; m < std::min<std::int64_t>(left + image.count, image.width); ++m) {
                    const double z = image.heights(r, m);
                    low = std::min(low, z);
                    high = std::max(high, z);
                }
            }
            out.insert(out.end(), {low, high});
        }
    }
    return out;
}

}  // namespace

Recipe Plan::recipe() const {
    const Survey& survey = scene->survey;
    Recipe out{};
    out.model = survey.model;
    out.model.rate = settings.oversampling;
    out.model.near = settings.block ? settings.near : std::numeric_limits<double>::infinity();
    out.model.run = static_cast<double>(settings.run);
    out.light = scene->light;
    out.light.quick = settings.quick;
    out.kind = scene->kind;
    out.narrow = settings.narrow;
    out.channels = survey.channels;
    out.traces = survey.traces;
    for (std::size_t i = 0; i < out.traces.size(); ++i) out.traces[i].kept = static_cast<double>(start(i));
    out.weights = survey.weights;
    out.reader = reader_of(settings);
    fit_trigonometry(settings.terms, out.sine, out.cosine);
    out.rise = settings.rise;
    out.nodes = chebyshev(settings.narrow ? Sizes<float>::nodes : Sizes<double>::nodes);
    const Pixels& pixels = scene->pixels;
    out.image.height = pixels.height;
    out.image.width = pixels.width;
    out.image.points = [points = pixels.points](std::int64_t begin, std::int64_t end, double* to) {
        Numbers numbers(static_cast<std::size_t>(end - begin));
        std::iota(numbers.begin(), numbers.end(), begin);
        points(numbers, to);
    };
    out.image.hears = pixels.hears;
    out.image.mask = {pixels.mask.data(), static_cast<std::int64_t>(pixels.mask.size())};
    out.image.count = static_cast<int>(std::min<std::int64_t>(pysas::block, trees ? pixels.width : pixels.size()));
    if (block) {
        out.image.first = pixels.first;
        out.image.step = pixels.step;
        out.image.heights = pixels.heights;
        out.image.count = block;
        if (pixels.heights.z) out.image.spans = spans_of(out.image);
    }
    out.batch = settings.batch;
    out.lattice = survey.lattice;
    if (survey.each) out.views = ViewWeights{survey.channels};
    if (trees) out.forest = &trees->forest;
    return out;
}

std::string Plan::describe(const std::string& shape, std::int64_t more) const {
    const bool factorised = trees || wish.method == Method::ffbp;
    const Settings& s = settings;
    const auto text = [](std::int64_t value) { return std::to_string(value); };
    std::string out = std::string("Plan: ") + (factorised ? "ffbp" : "backprojection") + " of " +
                      text(scene->traces()) + " traces on " + shape + " pixels, tol " + number(wish.tol, 6) + "\n";
    out += "  backend        cpp, " + std::string(s.narrow ? "float32" : "float64") + ", " + text(wish.threads) +
           " threads, batches of " + text(s.batch) + " traces\n";
    out += "  traces         " + text(s.length) + " of " + text(scene->samples()) + " samples" +
           (s.taper ? ", tapered over " + text(s.taper) : "") +
           (s.n_fft ? ", transforms of " + text(s.n_fft) + " and " + text(2 * s.n_fft) : "") + ", a filter of " +
           text(s.filter.taps) + " taps\n";
    out += "  interpolation  degree " + text(s.filter.degree) + " at " + number(s.oversampling, 3) +
           " x the sample rate\n";
    out += "  delay          " + std::string(words_of(scene->kind)) + ", " +
           (s.block ? "polynomials over " + text(s.block) + " pixels, shorter ones below " + number(s.near, 3) + " m"
                    : "exact per pixel") +
           "\n";
    out += "  terms          " + number(static_cast<double>(scene->traces()) * static_cast<double>(scene->wanted), 4) +
           " at most\n";
    if (trees) out += trees_of(*this);
    if (!why_direct.empty()) out += "  direct sum     " + why_direct + "\n";
    if (scene->survey.each) out += "  view angles    every pixel's own: views change their order over the image\n";
    out += "  predicted      error " + number(predicted_error(), 2) + ", time " + number(seconds / wish.threads, 2) +
           " s, memory " + fixed(static_cast<double>(memory() + more) / 0x1p20, 0) + " MB beyond the input";
    return out;
}

}  // namespace pysas
