#include "planning/scene.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/light.hpp"
#include "planning/draw.hpp"

namespace pysas {
namespace {

constexpr std::int64_t sampled = 400, sampled_traces = 32;  // by whose pairs shares of the terms are guessed
constexpr double rounded = 1 + 1e-9;  // lengths of lattices and lines, computed in different ways, round by less

// At most `number` of `count` things, one somewhere in each of equal parts, ascending.
Numbers spread_over(std::int64_t number, std::int64_t count, std::uint64_t seed) {
    Draw draw(seed);
    Numbers out;
    const double part = static_cast<double>(count) / static_cast<double>(number);
    for (std::int64_t i = 0; i < number && static_cast<std::int64_t>(out.size()) < count; ++i) {
        const auto place =
            std::min(static_cast<std::int64_t>((static_cast<double>(i) + draw.next()) * part), count - 1);
        if (out.empty() || place > out.back()) out.push_back(place);
    }
    return out;
}

// Numbers of the `places`-th wanted pixels; places ascend.
Numbers wanted_ones(const std::vector<std::uint8_t>& mask, const Numbers& places) {
    if (mask.empty()) return places;
    Numbers out;
    std::int64_t count = 0;
    for (std::size_t i = 0; i < mask.size() && out.size() < places.size(); ++i) {
        if (mask[i] && count++ == places[out.size()]) out.push_back(static_cast<std::int64_t>(i));
    }
    return out;
}

// A place as a whole number, all beyond the record's ends alike: it may be larger than any integer, or no number.
std::int64_t index_of(double place, std::int64_t samples) {
    if (place >= static_cast<double>(samples)) return samples;
    return place > -1 ? static_cast<std::int64_t>(place) : -1;
}

Point over(const Point& p, double length) { return {p.x / length, p.y / length, p.z / length}; }

struct Range {
    double near, far;
};

// Least and largest distance of a point from a box.
Range distances(const Point& p, const Point& low, const Point& high) {
    const Point inside{std::clamp(p.x, low.x, high.x), std::clamp(p.y, low.y, high.y), std::clamp(p.z, low.z, high.z)};
    const auto farther = [](double x, double a, double b) { return std::abs(x - a) > std::abs(x - b) ? a : b; };
    const Point corner{farther(p.x, low.x, high.x), farther(p.y, low.y, high.y), farther(p.z, low.z, high.z)};
    return {length(p - inside), length(p - corner)};
}

// Of the traces that count.
Kind kind_of(const Survey& survey) {
    bool alike = true;
    for (std::size_t i = 0; i < survey.traces.size(); ++i) {
        if (survey.weights[i] == 0.0) continue;
        const Trace& trace = survey.traces[i];
        for (int k = 0; k < 3; ++k) {
            if (trace.velocity[k] != 0) return Kind::moving;
            alike = alike && trace.tx[k] == trace.rx[k];
        }
    }
    return alike ? Kind::monostatic : Kind::stop_and_hop;
}

double longest_step(const Pixels& pixels) {
    double longest = 0;
    for (std::size_t i = 0; i < pixels.step.size(); i += 3) longest = std::max(longest, length(point(&pixels.step[i])));
    return longest;
}

// Largest share of a step along a line that changes the one-way range, over traces and the lines' ends (plus 10 %).
double slope_of(const Pixels& pixels, const std::vector<Trace>& traces, bool monostatic) {
    if (!pixels.lined() || pixels.width == 1) return 0;
    const double places[] = {0, static_cast<double>(pixels.width - 1) / 2, static_cast<double>(pixels.width - 1)};
    double worst = 0;
    for (const std::int64_t i : some_of(pixels.height, 9)) {
        const Point first = point(&pixels.first[static_cast<std::size_t>(3 * i)]);
        const Point step = point(&pixels.step[static_cast<std::size_t>(3 * i)]);
        const Point along = over(step, std::max(length(step), 1e-300));
        for (const double place : places) {
            const Point pixel = first + place * step;
            for (const Trace& trace : traces) {
                for (const double* sensor : {trace.tx, trace.rx}) {
                    const Point away = pixel - point(sensor);
                    worst = std::max(worst, std::abs(dot(away, along)) / std::max(length(away), 1e-9));
                    if (monostatic) break;
                }
            }
        }
    }
    return std::min(1.0, 1.1 * worst);
}

double below(const std::vector<double>& values, double limit) {
    const auto count = std::lower_bound(values.begin(), values.end(), limit) - values.begin();
    return static_cast<double>(count) / static_cast<double>(std::max<std::size_t>(values.size(), 1));
}

}  // namespace

Points points_in_list(const double* list, const Point& origin, std::shared_ptr<const void> keep) {
    return [list, origin, keep = std::move(keep)](const Numbers& numbers, double* out) {
        for (const std::int64_t number : numbers) {
            const double* at = list + 3 * number;
            *out++ = at[0] - origin.x;
            *out++ = at[1] - origin.y;
            *out++ = at[2] - origin.z;
        }
    };
}

Points points_on_map(const double* x, const double* y, const double* height, std::int64_t width, const Point& origin,
                     std::shared_ptr<const void> keep) {
    return [=, keep = std::move(keep)](const Numbers& numbers, double* out) {
        for (const std::int64_t number : numbers) {
            *out++ = x[number % width] - origin.x;
            *out++ = y[number / width] - origin.y;
            *out++ = height[number] - origin.z;
        }
    };
}

Numbers some_of(std::int64_t count, std::int64_t most) {
    Numbers out;
    const std::int64_t number = std::min(count, most);
    const double step = static_cast<double>(count - 1) / static_cast<double>(std::max<std::int64_t>(number - 1, 1));
    for (std::int64_t i = 0; i + 1 < number; ++i)
        out.push_back(static_cast<std::int64_t>(static_cast<double>(i) * step));
    if (number > 0) out.push_back(number > 1 ? count - 1 : 0);
    return out;
}

const char* words_of(Kind kind) {
    return kind == Kind::monostatic ? "monostatic" : kind == Kind::stop_and_hop ? "bistatic" : "moving receivers";
}

Numbers drawn_pixels(const Scene& scene, std::int64_t count, std::uint64_t seed) {
    return wanted_ones(scene.pixels.mask, spread_over(count, scene.wanted, seed));
}

std::vector<Point> places_of(const Pixels& pixels, const Numbers& numbers) {
    std::vector<Point> out;
    if (pixels.straight()) {
        for (const std::int64_t number : numbers) {
            const auto line = static_cast<std::size_t>(number / pixels.width);
            out.push_back(point(&pixels.first[3 * line]) +
                          static_cast<double>(number % pixels.width) * point(&pixels.step[3 * line]));
        }
        return out;
    }
    std::vector<double> places(3 * numbers.size());
    pixels.points(numbers, places.data());
    for (std::size_t i = 0; i < numbers.size(); ++i) out.push_back(point(&places[3 * i]));
    return out;
}

namespace {

// Lines from row to row of pixels at `place`(line, pixel), all alike if `rows` is 1; whether there are any, with some
// length where they are `lying`.
template <typename Place>
bool lay_lines(std::int64_t rows, double largest, bool lying, const Place& place, Pixels& pixels) {
    const std::int64_t width = pixels.width;
    std::vector<double> first, step;
    double worst = 0;
    for (std::int64_t line = 0; line < pixels.height; ++line) {
        const Point begin = place(line, 0), span = place(line, width - 1) - begin;
        double wrong = 0;
        for (std::int64_t k = 0; k < width && line < rows; ++k) {
            const double share = width > 1 ? static_cast<double>(k) / static_cast<double>(width - 1) : 0;
            wrong = std::max(wrong, length(place(line, k) - begin - share * span));
        }
        if (wrong > 1e-9 * length(span) + 1e-15 * largest) return false;
        if (lying && width > 1 && !(length(span) > 0)) return false;
        worst = std::max(worst, wrong);
        const Point one = over(span, static_cast<double>(std::max<std::int64_t>(width - 1, 1)));
        first.insert(first.end(), {begin.x, begin.y, begin.z});
        step.insert(step.end(), {one.x, one.y, one.z});
    }
    pixels.first = std::move(first);
    pixels.step = std::move(step);
    pixels.uneven = worst;
    return true;
}

// Lines less an origin; heights have it themselves.
void about(const Point& origin, Pixels& pixels) {
    const double less[] = {origin.x, origin.y, pixels.heights.z ? 0 : origin.z};
    for (std::size_t i = 0; i < pixels.first.size(); ++i) pixels.first[i] -= less[i % 3];
}

}  // namespace

void find_lines(const double* points, const Point& origin, Pixels& pixels) {
    double largest = 0;
    for (std::int64_t i = 0; i < 3 * pixels.size(); ++i) largest = std::max(largest, std::abs(points[i]));
    const auto at = [&](std::int64_t line, std::int64_t k) { return points + 3 * (line * pixels.width + k); };
    const auto whole = [&](std::int64_t line, std::int64_t k) { return point(at(line, k)); };
    const auto above = [&](std::int64_t line, std::int64_t k) { return Point{at(line, k)[0], at(line, k)[1], 0}; };
    if (!lay_lines(pixels.height, largest, false, whole, pixels)) {
        if (!lay_lines(pixels.height, largest, true, above, pixels)) return;
        pixels.heights = {points + 2, 3 * pixels.width, 3, origin.z};
    }
    about(origin, pixels);
}

void find_lines(const double* x, const double* y, const double* height, const Point& origin, Pixels& pixels) {
    double largest = 0;
    for (std::int64_t k = 0; k < pixels.width; ++k) largest = std::max(largest, std::abs(x[k]));
    for (std::int64_t k = 0; k < pixels.height; ++k) largest = std::max(largest, std::abs(y[k]));
    for (std::int64_t i = 0; i < pixels.size(); ++i) largest = std::max(largest, std::abs(height[i]));
    const auto above = [&](std::int64_t line, std::int64_t k) { return Point{x[k], y[line], 0}; };
    const auto whole = [&](std::int64_t line, std::int64_t k) {
        return Point{x[k], y[line], height[line * pixels.width + k]};
    };
    if (!lay_lines(pixels.height, largest, false, whole, pixels)) {
        if (!lay_lines(1, largest, true, above, pixels)) return;
        pixels.heights = {height, pixels.width, 1, origin.z};
    }
    about(origin, pixels);
}

bool Pixels::hear(std::int64_t traces) const {
    for (std::size_t row = 0; row < hears.size(); row += 2) {
        if (hears[row] < 0 || hears[row] > hears[row + 1] || hears[row + 1] >= traces) return false;
    }
    return true;
}

bool Bent::holds(double step, int count) const {
    // a block's weights are looked up over as many pixels at least
    return step * (std::max(count, least_width) - 1) <= rounded * longest &&
           step * (least_width - 1) <= rounded * vector;
}

namespace {

// Weights that change from pixel to pixel are looked up along lines that lie in a plane.
Pixels weighed(Pixels pixels, const Survey& survey) {
    if (pixels.heights.z && (survey.lattice || survey.each)) {
        pixels.first.clear();
        pixels.step.clear();
        pixels.heights = {};
        pixels.uneven = 0;
    }
    return pixels;
}

}  // namespace

Scene::Scene(Survey given, Pixels image, const Point& bottom, const Point& top)
    : survey(std::move(given)),
      pixels(weighed(std::move(image), survey)),
      low(bottom),
      high(top),
      kind(kind_of(survey)),
      wanted(pixels.mask.empty() ? pixels.size()
                                 : pixels.size() - std::count(pixels.mask.begin(), pixels.mask.end(), std::uint8_t{0})),
      each(static_cast<double>(wanted)),
      nearest(HUGE_VAL),
      farthest(0),
      audible(0),
      light(light_of(survey.model.beam)),
      faded(fit_powers(survey.model.beam, light)),
      step(longest_step(pixels)),
      slope(slope_of(pixels, survey.traces, kind == Kind::monostatic)) {
    const Model& model = survey.model;
    std::vector<std::uint8_t> asked(survey.traces.size(), pixels.hears.empty());
    if (!pixels.hears.empty()) {
        double pairs = 0;
        for (std::size_t row = 0; row < pixels.hears.size(); row += 2) {
            const std::int64_t begin = pixels.hears[row], end = pixels.hears[row + 1] + 1;
            pairs += static_cast<double>(end - begin) * static_cast<double>(pixels.width);
            std::fill(asked.begin() + begin, asked.begin() + end, std::uint8_t{1});
        }
        each = pairs / static_cast<double>(std::max<std::int64_t>(traces(), 1));
    }
    for (std::size_t i = 0; i < survey.traces.size(); ++i) {
        if (survey.weights[i] == 0.0 || !asked[i]) {
            heard.push_back(0);
            first.push_back(0);
            last.push_back(0);
            continue;
        }
        const Trace& trace = survey.traces[i];
        const Range out = distances(point(trace.tx), low, high), back = distances(point(trace.rx), low, high);
        nearest = std::min({nearest, out.near, back.near});
        farthest = std::max({farthest, out.far, back.far});
        const double speed = length(point(trace.velocity));
        const double soon = ((out.near + back.near) / (trace.c + speed) - trace.t0) * model.fs;
        const double late = ((out.far + back.far) / (trace.c - speed) - trace.t0) * model.fs;
        const std::int64_t from = index_of(std::floor(soon), samples()), to = index_of(std::ceil(late), samples());
        const Recorded recorded(trace);
        heard.push_back(recorded.begin < recorded.end && to >= recorded.begin && from < recorded.end);
        audible += heard.back();
        first.push_back(std::max(from, recorded.begin));
        last.push_back(std::min(to, recorded.end - 1));
    }
}

double Scene::within(double distance) const {
    look();
    return distance > nearest ? below(distances_, distance) : 0.0;
}

double Scene::flatter(double limit) const {
    look();
    return below(slopes_, limit);
}

double Scene::lit() const {
    look();
    return lit_;
}

double Scene::brightness() const {
    look();
    return brightness_;
}

void Scene::look() const {
    if (lit_ >= 0) return;
    const Model& model = survey.model;
    const Numbers some = drawn_pixels(*this, sampled, 0);
    const std::vector<Point> places = places_of(pixels, some);
    // a stride might meet one channel alone
    const Numbers picked = some_of(traces(), sampled_traces);
    double power = 0;
    for (std::size_t k = 0; k < some.size(); ++k) {
        const Point pixel = places[k];
        const auto line = static_cast<std::size_t>(some[k] / pixels.width);
        const Point along = step > 0 ? over(point(&pixels.step[3 * line]), step) : Point{};
        for (const std::int64_t i : picked) {
            const Trace& trace = survey.traces[static_cast<std::size_t>(i)];
            const Point there = pixel - point(trace.tx), back = pixel - point(trace.rx);
            const double out = std::max(length(there), 1e-9), home = std::max(length(back), 1e-9);
            const double place = ((out + home) / trace.c - trace.t0) * model.fs;
            if (!(place >= trace.first - edge_samples && place <= trace.last + edge_samples)) continue;
            if (!lights(light, trace, {there.x, there.y, there.z})) continue;
            if (light.terms > 0) {
                const double weight = pysas::brightness(model.beam, trace, {there.x, there.y, there.z});
                power += weight * weight;
            }
            distances_.push_back(std::min(out, home));
            slopes_.push_back(std::abs(dot(there, along) / out + dot(back, along) / home) / 2);
        }
    }
    if (light.terms > 0 && !distances_.empty())
        brightness_ = std::max(std::sqrt(power / static_cast<double>(distances_.size())), 1e-12);
    std::sort(distances_.begin(), distances_.end());
    std::sort(slopes_.begin(), slopes_.end());
    const auto pairs = static_cast<double>(std::max<std::size_t>(some.size() * picked.size(), 1));
    lit_ = static_cast<double>(distances_.size()) / pairs;
}

}  // namespace pysas
