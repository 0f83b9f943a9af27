#include "planning/layouts.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <utility>

#include "core/light.hpp"
#include "core/polynomials.hpp"
#include "planning/bounds.hpp"
#include "planning/crossings.hpp"
#include "planning/draw.hpp"
#include "planning/subapertures.hpp"
#include "planning/tiles.hpp"

namespace pysas {
namespace {

constexpr double most_crossing = 0.045;  // rays that lines of pixels may cross from node to node
constexpr double held = 0.45;  // cycles a sample: nodes for as much hold all that W passes, as taps fail slowly
constexpr std::int64_t sampled = 24, tracked = 64, paced = 256;  // rows and columns, pings that are looked at

using Places = std::vector<Point>;  // seen from above

// Of each ping of which traces are heard: their mean phase centre, and the first of them.
struct Track {
    Places at;
    std::vector<const Trace*> trace;
    double array = 0;  // length of a ping's phase centres at most, m

    explicit Track(const Scene& scene) {
        const double delay = scene.reception();
        const std::int64_t channels = scene.survey.channels;
        for (std::int64_t first = 0; first < scene.traces(); first += channels) {
            Point sum, begin;
            int count = 0;
            double away = 0;
            for (std::int64_t i = first; i < first + channels; ++i) {
                if (!scene.heard[static_cast<std::size_t>(i)]) continue;
                const Trace& one = scene.survey.traces[static_cast<std::size_t>(i)];
                const Point centre = 0.5 * (point(one.tx) + point(one.rx) + delay * point(one.velocity));
                if (count++ == 0) trace.push_back(&one), begin = centre;
                sum = sum + centre;
                away = std::max(away, length(centre - begin));
            }
            if (count > 0) at.push_back({sum.x / count, sum.y / count, 0});
            array = std::max(array, away);
        }
    }
};

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

// Candidates for the longest groups: fractions of the ground distances of the image, at most the track; and `apart`, if
// any.
std::vector<double> lengths_of(const Places& track, const Sample& sample, double apart) {
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
    if (apart > 0) out.push_back(apart);
    std::sort(out.begin(), out.end());
    out.erase(std::unique(out.begin(), out.end()), out.end());
    out.erase(out.begin(), std::upper_bound(out.begin(), out.end(), 0.0));
    return out;
}

// The image from the middle one of groups of at most `length` m.
struct Sight {
    double length, groups;
    double lit;                   // share of the pixels that its beams light
    double served;                // share of these that are far enough away along the ground
    double area;                  // of these, over their ground distances, m
    double spread;                // of their bearings, rad
    std::vector<double> turning;  // of lines of pixels there, rad a metre of range, sorted
    double depth;                 // of their ground distances, m
    double pings, array;          // pings in all; length of one's phase centres, m
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

std::optional<Sight> sight_of(const Scene& scene, const Sample& sample, const Track& track, const Parallel* lines,
                              double area, double path, double longest) {
    const Point& centre = track.at[track.at.size() / 2];
    const Trace& middle = *track.trace[track.at.size() / 2];
    const auto pixels = static_cast<double>(sample.at.size());
    double inverse = 0, least = HUGE_VAL, most = -HUGE_VAL, lit = 0;
    std::vector<double> bearings, turns;
    std::complex<double> mean = 0;
    for (const Point& pixel : sample.at) {
        const Point away = pixel - point(middle.tx);
        if (!lights(scene.light, middle, {away.x, away.y, away.z})) continue;
        ++lit;
        const double x = pixel.x - centre.x, y = pixel.y - centre.y, ground = std::hypot(x, y);
        if (!(ground >= near_lengths * std::min(longest, path))) continue;
        inverse += 1 / std::max(ground, 1e-9);
        least = std::min(least, ground);
        most = std::max(most, ground);
        bearings.push_back(std::atan2(y, x));
        mean += std::polar(1.0, bearings.back());
        if (!lines) continue;
        const double height = middle.tx[2] - pixel.z;
        const double down = lines->column < least_stretch ? HUGE_VAL : turning({x, y, 0}, lines->down, height),
                     step = lines->line < least_stretch ? HUGE_VAL : turning({x, y, 0}, lines->step, height);
        turns.push_back(std::min(down, step));
    }
    if (bearings.empty()) return {};
    std::sort(turns.begin(), turns.end());
    double left = HUGE_VAL, right = -HUGE_VAL;
    for (const double bearing : bearings) {
        const double turn = std::arg(std::polar(1.0, bearing - std::arg(mean)));
        left = std::min(left, turn);
        right = std::max(right, turn);
    }
    return Sight{std::min(longest, path) + 1e-6,
                 std::max(1.0, std::ceil(path / longest)),
                 lit / pixels,
                 static_cast<double>(bearings.size()) / lit,
                 area * inverse / pixels,
                 right - left,
                 std::move(turns),
                 most - least,
                 static_cast<double>(track.at.size()),
                 track.array};
}

// By candidate length, those that serve any pixel.
std::vector<Sight> sights_of(const Scene& scene, const Parallel* lines) {
    const Track track(scene);
    if (track.at.empty()) return {};
    const Sample sample = sample_of(scene.pixels);
    const Places paces = every(track.at, paced);
    double path = 0;
    for (std::size_t i = 1; i < paces.size(); ++i) path += length(paces[i] - paces[i - 1]);
    const double area = extent_of(sample, true) * extent_of(sample, false);  // by its corners' spans
    // the array of a ping lies on a line, and sees any heights alike
    const bool alone = scene.pixels.heights.z && scene.survey.channels > 1 && track.at.size() > 1;
    const double apart = alone ? 0.9 * path / static_cast<double>(track.at.size() - 1) : 0;
    std::vector<Sight> out;
    for (const double longest : lengths_of(track.at, sample, apart)) {
        if (auto sight = sight_of(scene, sample, track, lines, area, path, longest)) out.push_back(*sight);
    }
    return out;
}

// Predicted time of all groups on one thread.
double seconds_of(const Scene& scene, const Sight& sight, const Layout& layout, const Costs& costs) {
    const Survey& survey = scene.survey;
    const double reach = 2 * layout.taps.reach(), width = layout.taps.taps.count;
    const double rate = layout.taps.rate * layout.spare * (1 + layout.crossing), half = survey.band * survey.model.fs;
    const double step = survey.model.c / (4 * half * rate), shortest = survey.model.c / (survey.model.fc + half);
    const double mean = sight.area / std::max(sight.spread, 1e-9);  // length of a ray in the image
    const auto apart = [&](double longest, bool fades) {
        return std::min(widest_beam, pi / held_across(2 * pi * longest / shortest, layout.taps.rate,
                                                      fades ? layout.fading : Fading{}));
    };
    bool fades = true;
    const auto nodes = [&](double longest) {
        const double beam = apart(longest, fades);
        return (sight.spread / beam + reach) *
               (std::min(mean + reach * beam * mean, sight.depth + mean) / step + reach);
    };
    double longest = layout.length, parts = 1, work = 0;
    for (const int fan : layout.fans) {
        const double children = fan == by_ping ? std::max(1.0, sight.pings / sight.groups / parts) : fan;
        work += parts * nodes(longest) * children * (costs.tree.merge[0] + costs.tree.merge[1] * width);
        parts *= children;
        if (fan == by_ping) fades = false;
        longest = fan == by_ping ? sight.array : longest / fan;
    }
    const double traces = static_cast<double>(scene.audible) / sight.groups / parts;  // of a leaf
    work += nodes(longest) * parts * (traces * costs.tree.term + costs.tree.node);
    const auto crossed = static_cast<double>(std::upper_bound(sight.turning.begin(), sight.turning.end(),
                                                              layout.crossing * apart(layout.length, true) / step) -
                                             sight.turning.begin());
    const double lines =
        layout.crossing > 0 ? crossed / static_cast<double>(std::max<std::size_t>(sight.turning.size(), 1)) : 0;
    const double read = (scene.pixels.heights.z ? relief_cost : 1) * (costs.tree.read[0] + costs.tree.read[1] * width) *
                        (1 - (1 - line_cost) * lines);
    return 1e-9 * sight.groups * (work + static_cast<double>(scene.wanted) * sight.lit * sight.served * read);
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

// Slant ranges from which a beam's weights keep to `error` along the rays of all levels, and of leaves of `extent` m.
//
// Along a ray of a plane `height` below the direction turns by height/(r ground) a metre, and by off/r^2 for a
// transmitter that lies `off` the centre. A cone's angle changes by as much at most; a fan's, off the plane across a
// level axis, by tan(angle) height^2/(r ground^2) alone, to which an axis' upright part z adds: its sine is a sum of
// the level part's, which goes with ground/r, and z height/r. The jumps of the weight's second derivative leave (see
// held_across) a^2/(16 pi width^2 k^2) beyond the band that nodes have to spare, +-k cycles a metre; and leaves read
// their weights off quartics through five places along 64 nodes, which miss 0.0153 of the jump times the square of half
// their length times a.
struct Faded {
    double all, leaf;
};
Faded faded_from(const Scene& scene, const Layout& layout, double height, double baseline, double extent,
                 double error) {
    const Model& model = scene.survey.model;
    const double width = model.beam.half_angle - model.beam.full_angle,
                 band = 2 * scene.survey.band * model.fs / model.c;
    const double half = 31.5 * model.c / (4 * scene.survey.band * model.fs * layout.taps.rate);
    const double spare = (layout.spare - 1) * band, jump = pi * pi / (2 * width * width);
    const auto levels = static_cast<double>(lit_levels(layout.fans));
    double upright = 0;
    for (const Trace& trace : scene.survey.traces) upright = std::max(upright, std::abs(trace.axis[2]));
    const auto from = [&](double off, double a2) {  // of the largest a^2 that is allowed
        double low = std::max(height, 1e-3) * (1 + 1e-6), high = 1e9;
        const auto holds = [&](double r) {
            const double ground2 = r * r - height * height, turn = height / (r * std::sqrt(ground2));
            const double level = (scene.light.sine_half + upright * height / r) * height * height / (r * ground2);
            const double flat = (level + upright * height / (r * r)) / std::max(scene.light.cosine_half, 1e-12);
            const double a = (scene.light.shape == fan ? std::min(turn, flat) : turn) + off / (r * r);
            return a * a <= a2;
        };
        if (holds(low)) return low;
        while (high > low * (1 + 1e-6)) {
            const double middle = std::sqrt(low * high);
            (holds(middle) ? high : low) = middle;
        }
        return high;
    };
    return {from(layout.length / 2 + baseline, error / 2 / levels * 16 * pi * width * width * spare * spare),
            from(extent / 2 + baseline, error / 2 / (0.0153 * jump * half * half))};
}

}  // namespace

int lit_levels(const std::vector<int>& fans) {
    const auto pings = std::find(fans.begin(), fans.end(), by_ping);
    return static_cast<int>(pings - fans.begin()) + 1;
}

std::vector<Option> cheapest(const Scene& scene, const Kinds& kinds, const Costs& costs, const Parallel* lines,
                             double spare, double faded, double direct) {
    std::vector<Option> out;
    const Beam& beam = scene.survey.model.beam;
    for (const Sight& sight : sights_of(scene, lines)) {
        const std::vector<double> crossings =
            sight.turning.empty() ? std::vector<double>{0} : std::vector<double>{0, most_crossing};
        std::optional<Option> best;
        for (const auto& [fans, taps] : kinds) {
            const Fading fading =
                faded > 0 ? Fading{beam.half_angle - beam.full_angle, beam.full_angle, faded / lit_levels(fans)}
                          : Fading{};
            for (const double crossing : crossings) {
                const Layout layout{sight.length, fans, taps, spare, crossing, 0, fading, 0, 0, 0};
                const double trees = seconds_of(scene, sight, layout, costs);
                const double cost = trees + (1 - sight.served) * direct;
                if (!best || cost < best->cost) best = {layout, trees / sight.served, cost};
            }
        }
        if (best) out.push_back(*best);
    }
    std::stable_sort(out.begin(), out.end(), [](const Option& a, const Option& b) { return a.cost < b.cost; });
    return out;
}

Layout cleared(const Scene& scene, Layout layout, double height, double error, double merge, double ends, double ramp) {
    double baseline = 0;
    for (std::size_t i = 0; i < scene.heard.size(); ++i) {
        const Trace& trace = scene.survey.traces[i];
        if (scene.heard[i]) baseline = std::max(baseline, length(point(trace.tx) - point(trace.rx)));
    }
    const double array = 2 * Track(scene).array;  // its first channel need not be its end
    double extent = layout.length, weighed = 0;
    std::vector<double> away;
    for (const int fan : layout.fans) {
        const double part = fan == by_ping ? array : extent / fan, least = fan == by_ping ? 0 : part;
        away.push_back(clear_of(scene, height, (extent - least) / 2, layout.taps.rate, merge));
        if (fan == by_ping) weighed = extent;
        extent = part;
    }
    if (weighed == 0) weighed = extent;
    away.push_back(clear_of(scene, height, (extent + baseline) / 2, layout.taps.rate, error));
    layout.clear = away.front();
    layout.apart = away.size() > 1 ? *std::max_element(away.begin() + 1, away.end()) : 0;
    if (scene.light.terms > 0) {
        const auto [all, leaf] = faded_from(scene, layout, height, baseline, weighed, ramp);
        const bool top = lit_levels(layout.fans) == 1;
        layout.clear = std::max(layout.clear, top ? std::max(all, leaf) : all);
        layout.apart = std::max(layout.apart, top ? 0 : leaf);
    }
    layout.ends = layout.spare * scene.survey.band < held ? hushed(ends, scene.survey.band) : 0;
    return layout;
}

}  // namespace pysas
