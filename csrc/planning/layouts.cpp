#include "planning/layouts.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <utility>

#include "core/polynomials.hpp"
#include "planning/bounds.hpp"
#include "planning/draw.hpp"
#include "planning/subapertures.hpp"
#include "planning/tiles.hpp"

namespace pysas {
namespace {

constexpr double held = 0.45;  // cycles a sample: nodes for as much hold all that W passes, as taps fail slowly
constexpr std::int64_t sampled = 24, tracked = 64, paced = 256;  // rows and columns, pings that are looked at

using Places = std::vector<Point>;  // seen from above

// Mean phase centres of the traces heard of each ping.
Places track_of(const Scene& scene) {
    Places out;
    const double delay = scene.reception();
    const std::int64_t channels = scene.survey.channels;
    for (std::int64_t first = 0; first < scene.traces(); first += channels) {
        Point sum;
        int count = 0;
        for (std::int64_t i = first; i < first + channels; ++i) {
            if (!scene.heard[static_cast<std::size_t>(i)]) continue;
            const Trace& trace = scene.survey.traces[static_cast<std::size_t>(i)];
            sum = sum + 0.5 * (point(trace.tx) + point(trace.rx) + delay * point(trace.velocity));
            ++count;
        }
        if (count > 0) out.push_back({sum.x / count, sum.y / count, 0});
    }
    return out;
}

Places every(const Places& places, std::int64_t most) {
    const std::size_t apart = std::max<std::size_t>(1, places.size() / static_cast<std::size_t>(most));
    Places out;
    for (std::size_t i = 0; i < places.size(); i += apart) out.push_back(places[i]);
    return out;
}

// Some pixels, the image's edges among them: as many columns of as many rows.
struct Sample {
    std::size_t rows, columns;
    Places at;  // (row, column)

    const Point& operator()(std::size_t row, std::size_t column) const { return at[row * columns + column]; }
};

Sample sample_of(const Pixels& pixels) {
    const Numbers rows = some_of(pixels.height, sampled), columns = some_of(pixels.width, sampled);
    Numbers numbers;
    for (const std::int64_t row : rows) {
        for (const std::int64_t column : columns) numbers.push_back(row * pixels.width + column);
    }
    return {rows.size(), columns.size(), places_of(pixels, numbers)};
}

// The value that a share `q` of others lie below, between two of them in proportion.
double quantile(std::vector<double>& values, double q) {
    const double place = q * static_cast<double>(values.size() - 1);
    const auto middle = values.begin() + static_cast<std::ptrdiff_t>(place);
    std::nth_element(values.begin(), middle, values.end());
    const double low = *middle, part = place - std::floor(place);
    const double high = part > 0 ? *std::min_element(middle + 1, values.end()) : low;
    return part < 0.5 ? low + (high - low) * part : high - (high - low) * (1 - part);
}

// Candidates for the longest groups: fractions of the ground distances of the image, at most the track.
std::vector<double> lengths_of(const Places& track, const Sample& sample) {
    std::vector<double> away;
    for (const Point& place : every(track, tracked)) {
        for (const Point& pixel : sample.at) {
            const double x = place.x - pixel.x, y = place.y - pixel.y;
            away.push_back(std::sqrt(x * x + y * y));
        }
    }
    Point low = track.front(), high = low;
    for (const Point& p : track) {
        low = {std::min(low.x, p.x), std::min(low.y, p.y), 0};
        high = {std::max(high.x, p.x), std::max(high.y, p.y), 0};
    }
    const double whole = length(high - low);
    std::vector<double> out;
    for (const double share : {0.0, 0.1}) {
        const double limit = quantile(away, share) / near_lengths;
        for (const double part : {0.95, 0.5, 0.25, 0.12}) out.push_back(std::min(limit * part, whole + 1e-3));
    }
    std::sort(out.begin(), out.end());
    out.erase(std::unique(out.begin(), out.end()), out.end());
    out.erase(out.begin(), std::upper_bound(out.begin(), out.end(), 0.0));
    return out;
}

// The image from the middle one of groups of at most `length` m.
struct Sight {
    double length, groups;
    double served;  // share of the pixels that are far enough away along the ground
    double area;    // of these, over their ground distances, m
    double spread;  // of their bearings, rad
    double depth;   // of their ground distances, m
};

// Mean distance between two edges of a sample, m; a single line is as wide as it is dense.
double extent_of(const Sample& sample, bool down) {
    const std::size_t count = down ? sample.columns : sample.rows;
    double sum = 0;
    for (std::size_t i = 0; i < count; ++i)
        sum += down ? length(sample(sample.rows - 1, i) - sample(0, i))
                    : length(sample(i, sample.columns - 1) - sample(i, 0));
    return sum > 0 ? sum / static_cast<double>(count) : 0.01;
}

std::optional<Sight> sight_of(const Sample& sample, const Point& centre, double area, double path, double longest) {
    const auto pixels = static_cast<double>(sample.at.size());
    double inverse = 0, least = HUGE_VAL, most = -HUGE_VAL;
    std::vector<double> bearings;
    std::complex<double> mean = 0;
    for (const Point& pixel : sample.at) {
        const double x = pixel.x - centre.x, y = pixel.y - centre.y, ground = std::hypot(x, y);
        if (!(ground >= near_lengths * std::min(longest, path))) continue;
        inverse += 1 / std::max(ground, 1e-9);
        least = std::min(least, ground);
        most = std::max(most, ground);
        bearings.push_back(std::atan2(y, x));
        mean += std::polar(1.0, bearings.back());
    }
    if (bearings.empty()) return {};
    double left = HUGE_VAL, right = -HUGE_VAL;
    for (const double bearing : bearings) {
        const double turn = std::arg(std::polar(1.0, bearing - std::arg(mean)));
        left = std::min(left, turn);
        right = std::max(right, turn);
    }
    return Sight{std::min(longest, path) + 1e-6,
                 std::max(1.0, std::ceil(path / longest)),
                 static_cast<double>(bearings.size()) / pixels,
                 area * inverse / pixels,
                 right - left,
                 most - least};
}

// By candidate length, those that serve any pixel.
std::vector<Sight> sights_of(const Scene& scene) {
    const Places track = track_of(scene);
    if (track.empty()) return {};
    const Sample sample = sample_of(scene.pixels);
    const Places paces = every(track, paced);
    double path = 0;
    for (std::size_t i = 1; i < paces.size(); ++i) path += length(paces[i] - paces[i - 1]);
    const double area = extent_of(sample, true) * extent_of(sample, false);  // by its corners' spans
    std::vector<Sight> out;
    for (const double longest : lengths_of(track, sample)) {
        if (auto sight = sight_of(sample, track[track.size() / 2], area, path, longest)) out.push_back(*sight);
    }
    return out;
}

// Predicted time of all groups on one thread.
double seconds_of(const Scene& scene, const Sight& sight, const Layout& layout, const Costs& costs) {
    const Survey& survey = scene.survey;
    const double reach = 2 * layout.taps.reach(), width = layout.taps.taps.count;
    const double rate = layout.taps.rate * layout.spare, half = survey.band * survey.model.fs;
    const double step = survey.model.c / (4 * half * rate), shortest = survey.model.c / (survey.model.fc + half);
    const double mean = sight.area / std::max(sight.spread, 1e-9);  // length of a ray in the image
    const auto nodes = [&](double longest) {
        const double beam = std::min(widest_beam, shortest / (2 * rate * longest));
        return (sight.spread / beam + reach) *
               (std::min(mean + reach * beam * mean, sight.depth + mean) / step + reach);
    };
    double longest = layout.length, parts = 1, work = 0;
    for (const int fan : layout.fans) {
        work += parts * nodes(longest) * fan * (costs.tree.merge[0] + costs.tree.merge[1] * width);
        parts *= fan;
        longest /= fan;
    }
    const double traces = static_cast<double>(scene.audible) / sight.groups / parts;  // of a leaf
    work += nodes(longest) * parts * (traces * costs.tree.term + costs.tree.node);
    const double read = costs.tree.read[0] + costs.tree.read[1] * width;
    return 1e-9 * sight.groups * (work + static_cast<double>(scene.wanted) * sight.served * read);
}

// Slant range from which polynomials of degree 4 along 64 nodes of a ray hold to within `error` rad for the two-way
// delay of what lies `reach` m off the centre, the centre's own taken away, at most `height` up.
//
// Along a ray of constant bearing a sensor at p from the centre is r - p.x/r + (p^2 - (p.x/r)^2)/2r + ... away, where
// x/r has the components sqrt(1 - (height/r)^2) = 1 - sum a_k (height/r)^2k along the ground, a_k > 0, and height/r.
// Polynomials through 5 Chebyshev nodes of |s| <= half are wrong by at most half^5/(5! 2^4) of the fifth derivative, on
// both ways.
double clear_of(const Scene& scene, double height, double reach, double rate, double error) {
    const Model& model = scene.survey.model;
    const double half = 31.5 * model.c / (4 * scene.survey.band * model.fs * rate);
    std::vector<double> series;
    double a = 0.5;
    for (int k = 1; k < 400; ++k) {
        const double even = 2.0 * k;
        series.push_back(a * even * (even + 1) * (even + 2) * (even + 3) * (even + 4));
        a *= (k - 0.5) / (k + 1);
    }
    const auto holds = [&](double slant) {
        const double ratio = std::max(height, 1e-9) / slant, square = ratio * ratio;
        double lateral = 0;
        for (std::size_t k = series.size(); k-- > 0;) lateral = (lateral + series[k]) * square;
        const double fifth =
            reach * lateral / std::pow(slant, 5) + 120 * reach * (height + 2 * reach) / std::pow(slant, 6);
        return 2 * 2 * pi * model.fc / model.c * fifth * std::pow(half, 5) / 1920 <= error;
    };
    double low = std::max(height, 1e-3) * (1 + 1e-6), high = 1e3 * (height + reach + half);
    if (!holds(high)) return std::numeric_limits<double>::infinity();
    if (holds(low)) return low;
    while (high > low * (1 + 1e-6)) {
        const double middle = std::sqrt(low * high);
        (holds(middle) ? high : low) = middle;
    }
    return high;
}

}  // namespace

std::optional<std::pair<Layout, double>> cheapest(const Scene& scene, const Kinds& kinds, const Costs& costs,
                                                  double spare, double direct) {
    std::optional<std::pair<Layout, double>> best;
    double least = 0;
    for (const Sight& sight : sights_of(scene)) {
        for (const auto& [fans, taps] : kinds) {
            const Layout layout{sight.length, fans, taps, spare, 0, 0, 0};
            const double trees = seconds_of(scene, sight, layout, costs);
            const double cost = trees + (1 - sight.served) * direct;
            if (best && !(cost < least)) continue;
            least = cost;
            best = {layout, trees / sight.served};
        }
    }
    return best;
}

Layout cleared(const Scene& scene, Layout layout, double height, double error, double merge, double ends) {
    double baseline = 0;
    for (std::size_t i = 0; i < scene.heard.size(); ++i) {
        const Trace& trace = scene.survey.traces[i];
        if (scene.heard[i]) baseline = std::max(baseline, length(point(trace.tx) - point(trace.rx)));
    }
    double extent = layout.length;
    std::vector<double> away;
    for (const int fan : layout.fans) {
        const double part = extent / fan;
        away.push_back(clear_of(scene, height, (extent - part) / 2, layout.taps.rate, merge));
        extent = part;
    }
    away.push_back(clear_of(scene, height, (extent + baseline) / 2, layout.taps.rate, error));
    layout.clear = away.front();
    layout.apart = away.size() > 1 ? *std::max_element(away.begin() + 1, away.end()) : 0;
    layout.ends = layout.spare * scene.survey.band < held ? hushed(ends, scene.survey.band) : 0;
    return layout;
}

}  // namespace pysas
