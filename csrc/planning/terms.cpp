#include "planning/terms.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/light.hpp"
#include "planning/draw.hpp"

namespace pysas {
namespace {

constexpr std::int64_t drawn = 4096;                                     // pixels whose terms are looked at
constexpr std::int64_t fewest = 1 << 10, most = 1 << 12, one_of = 2000;  // terms looked at; of those between, one of

std::int64_t clipped(double place, const Trace& trace) {
    return static_cast<std::int64_t>(std::clamp(place, trace.first - 1, trace.last + 1));
}

// Least and largest place that a pixel in the image's box reads: at its nearest point, and in a corner.
void edges_of(const Scene& scene, std::int64_t number, std::int64_t& least, std::int64_t& largest) {
    const Trace& trace = scene.survey.traces[static_cast<std::size_t>(number)];
    const double low[3] = {scene.low.x, scene.low.y, scene.low.z}, high[3] = {scene.high.x, scene.high.y, scene.high.z};
    double nearest[3], first = std::numeric_limits<double>::infinity(), last = -first;
    for (int axis = 0; axis < 3; ++axis)
        nearest[axis] = std::clamp((trace.tx[axis] + trace.rx[axis]) / 2, low[axis], high[axis]);
    const auto look = [&](const Point& pixel) {
        const double index = place_of(scene, trace, pixel).index;
        first = std::min(first, index);
        last = std::max(last, index);
    };
    look(point(nearest));
    for (int k = 0; k < 8; ++k) look({k & 1 ? high[0] : low[0], k & 2 ? high[1] : low[1], k & 4 ? high[2] : low[2]});
    least = clipped(std::floor(first), trace);
    largest = clipped(std::ceil(last), trace);
}

}  // namespace

Place place_of(const Scene& scene, const Trace& trace, const Point& pixel) {
    const Model& model = scene.survey.model;
    const Point away = pixel - point(trace.tx);
    const double out = length(away);
    double back = out;
    if (scene.kind != Kind::monostatic) {
        // of receivers that have moved: twice again is enough
        for (int turn = 0; turn < (scene.kind == Kind::moving ? 3 : 1); ++turn) {
            const double late = scene.kind == Kind::moving ? (out + back) / trace.c : 0;
            back = length(pixel - point(trace.rx) - late * point(trace.velocity));
        }
    }
    const double index = ((out + back) / trace.c - trace.t0) * model.fs;
    const double to[3] = {away.x, away.y, away.z};
    const bool lit = index >= trace.first && index <= trace.last && lights(scene.light, trace, to);
    return {index, lit, lit ? brightness(model.beam, trace, to) : 0};
}

SomeTerms some_terms(const Scene& scene) {
    SomeTerms out;
    if (scene.wanted == 0) return out;
    for (std::int64_t i = 0; i < scene.traces(); ++i) {
        if (!scene.heard[static_cast<std::size_t>(i)]) continue;
        out.heard.push_back(i);
        out.least.push_back(0);
        out.largest.push_back(0);
        edges_of(scene, i, out.least.back(), out.largest.back());
    }
    const auto heard = static_cast<double>(out.heard.size());
    const auto pixels = places_of(scene.pixels, drawn_pixels(scene, drawn, 1));
    const double all = static_cast<double>(scene.traces()) * static_cast<double>(scene.wanted) / one_of;
    const double count = std::clamp(all, static_cast<double>(fewest), static_cast<double>(most));
    const auto each = static_cast<std::size_t>(
        std::max(1.0, std::min(static_cast<double>(pixels.size()), std::ceil(count / std::max(heard, 1.0)))));
    std::vector<std::size_t> turn(pixels.size());
    std::iota(turn.begin(), turn.end(), std::size_t{0});
    Draw draw(2);
    for (std::size_t i = turn.size(); i > 1; --i) std::swap(turn[i - 1], turn[draw.below(i)]);
    for (std::size_t i = 0; i < out.heard.size(); ++i) {
        const Trace& trace = scene.survey.traces[static_cast<std::size_t>(out.heard[i])];
        for (std::size_t k = 0; k < each; ++k) {
            // pixels in turn: neighbouring traces have different ones
            const Place place = place_of(scene, trace, pixels[turn[(i * each + k) % turn.size()]]);
            if (!place.lit) continue;
            out.trace.push_back(out.heard[i]);
            out.place.push_back(static_cast<std::int64_t>(std::nearbyint(place.index)));
            out.weight.push_back(place.weight);
        }
    }
    return out;
}

}  // namespace pysas
