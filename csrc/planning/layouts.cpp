#include "planning/layouts.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstring>
#include <iterator>
#include <limits>
#include <vector>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

// taps, their rate and the half length of their filter, cheapest first
struct Choice {
    int count;
    double rate;
    int half;
};
constexpr Choice choices[] = {{6, 1.2, 8},  {6, 1.3, 8},   {6, 1.4, 8},  {6, 1.45, 8}, {6, 1.5, 8},
                              {8, 1.4, 10}, {8, 1.45, 10}, {8, 1.5, 10}, {8, 1.6, 10}, {8, 1.75, 10}};
constexpr double share_positions = 0.03;  // of tol, for polynomials of positions in up to so many merges
// of tol, for what records' ends ring with beyond the band of sub-images; it adds to these as squares do
constexpr double share_ends = 0.2;
constexpr double held = 0.45;  // cycles a sample: nodes for as much hold all that W passes, as taps fail slowly
constexpr int most_merges = 4;
constexpr double spare = 1.05;  // sampling beyond the band's own limit, which a short group's band overlaps a little
const std::vector<std::vector<int>> fans = {{},        {2},       {4},          {4, 2},      {4, 4},
                                            {4, 4, 2}, {4, 4, 4}, {4, 4, 4, 2}, {4, 4, 4, 4}};

// ns: a term of a leaf, a node of a leaf beside its terms, a node of a parent for each child, a pixel read; the last
// two with what each tap adds.
struct Costs {
    const char* isa;
    double term, node, merge[2], read[2];
};
constexpr Costs costs[] = {{"avx512", 0.65, 4.0, {1.0, 0.65}, {6.0, 0.7}},
                           {"avx2", 0.9, 4.0, {1.5, 0.6}, {6.5, 0.7}},
                           {"baseline", 4.8, 15.0, {8.0, 1.8}, {15.0, 1.7}}};

// A stage's error of a component depends on where between nodes it is read, and stages read at unrelated places: they
// add as squares. Along rays the band's worst frequency counts, across them the mean over a group's pings. 1.2 is the
// margin of the tolerance sweep.
double tree_error(const TapDesign& taps, std::size_t stages) {
    return 1.2 * std::sqrt(static_cast<double>(stages)) * std::hypot(taps.worst, taps.rms);
}

// What costs depend on: some of the track and some of the image, seen from above.
class Estimate {
  public:
    Estimate(const Geometry& geometry, const Raster& raster, const char* isa) : geometry_(geometry), raster_(raster) {
        for (const Costs& set : costs) {
            if (std::strcmp(set.isa, isa) == 0) costs_ = set;
        }
        pixels_ = static_cast<double>(raster.height) * static_cast<double>(raster.width);
        if (raster.mask)
            pixels_ -= static_cast<double>(std::count(raster.mask, raster.mask + raster.height * raster.width, 0));
        const std::int64_t apart = std::max<std::int64_t>(1, geometry.count / 256);
        for (std::int64_t i = apart; i < geometry.count; i += apart)
            path_ += length(above(place(i) - place(i - apart)));
        centre_ = place(geometry.count / 2);
        line_ = length(point(raster.step)) * static_cast<double>(raster.width);
        // about half a thousand places
        for (const double row : spread(0, static_cast<double>(raster.height - 1), 24)) {
            for (const double column : spread(0, static_cast<double>(raster.width - 1), 24))
                places_.push_back(pixel(static_cast<std::int64_t>(row), column));
        }
        rows_ = raster.height > 1 ? length(above(pixel(raster.height - 1, 0) - pixel(0, 0))) *
                                        static_cast<double>(raster.height) / static_cast<double>(raster.height - 1)
                                  : 0.01;
    }

    // Candidates for the longest groups, m: fractions of the ground distances of the image, at most the track.
    std::vector<double> lengths() const {
        std::vector<double> away;
        Point low = place(0), high = low;
        const std::int64_t apart = std::max<std::int64_t>(1, geometry_.count / 64);
        for (std::int64_t i = 0; i < geometry_.count; ++i) {
            const Point p = place(i);
            low = {std::min(low.x, p.x), std::min(low.y, p.y), 0};
            high = {std::max(high.x, p.x), std::max(high.y, p.y), 0};
            if (i % apart != 0) continue;
            for (const Point& pixel : places_) away.push_back(length(above(pixel - p)));
        }
        std::sort(away.begin(), away.end());
        const double track = length(above(high - low));
        std::vector<double> out;
        for (const double distance : {away.front(), away[away.size() / 10]}) {
            for (const double part : {0.95, 0.5, 0.25, 0.12}) {
                const double value = std::min(distance / near_lengths * part, track + 1e-3);
                if (value > 0 && std::find(out.begin(), out.end(), value) == out.end()) out.push_back(value);
            }
        }
        return out;
    }

    // Nanoseconds of all groups on one thread, from a group in the middle of the track.
    double operator()(const Layout& layout) const {
        const Model& model = geometry_.model;
        const double longest = std::min(layout.length, path_);
        const double groups = std::max(1.0, std::ceil(path_ / layout.length));
        double served = 0, inverse = 0, nearest = HUGE_VAL, farthest = 0;
        std::vector<double> bearings;
        std::complex<double> mean = 0;
        for (const Point& p : places_) {
            const Point away = above(p - centre_);
            const double ground = length(away);
            if (ground < near_lengths * longest || ground <= 0) continue;
            served += 1 / static_cast<double>(places_.size());
            inverse += 1 / (ground * static_cast<double>(places_.size()));
            nearest = std::min(nearest, ground);
            farthest = std::max(farthest, ground);
            bearings.push_back(std::atan2(away.y, away.x));
            mean += std::polar(1.0, bearings.back());
        }
        if (bearings.empty()) return std::numeric_limits<double>::infinity();
        double left = 0, right = 0;
        for (const double bearing : bearings) {
            const double turn = std::remainder(bearing - std::arg(mean), 2 * pi);
            left = std::min(left, turn);
            right = std::max(right, turn);
        }
        const double span = right - left, depth = farthest - nearest;
        const double along = rows_ * line_ * inverse / std::max(span, 1e-9);  // mean length of a ray in the image
        const double rate = layout.taps.rate * layout.spare, reach = 2 * layout.taps.reach();
        const double step = model.c / (4 * geometry_.half_band() * rate);
        const double shortest = model.c / (model.fc + geometry_.half_band());
        const auto nodes = [&](double extent) {
            const double beam = std::min(widest_beam, shortest / (2 * rate * extent));
            return (span / beam + reach) * (std::min(along + reach * beam * along, depth + along) / step + reach);
        };
        const double width = layout.taps.taps.count;
        double extent = longest + 1e-6, parts = 1, work = 0;
        for (const int fan : layout.fans) {
            work += parts * nodes(extent) * fan * (costs_.merge[0] + costs_.merge[1] * width);
            parts *= fan;
            extent /= fan;
        }
        const auto traces = static_cast<double>(geometry_.count);
        work += nodes(extent) * parts * (traces / groups / parts * costs_.term + costs_.node);
        return groups * (work + pixels_ * served * (costs_.read[0] + costs_.read[1] * width)) +
               traces * pixels_ * (1 - served) * costs_.term;
    }

  private:
    static Point above(const Point& p) { return {p.x, p.y, 0}; }
    Point place(std::int64_t trace) const {
        const Trace& t = geometry_.traces[trace];
        return 0.5 * (point(t.tx) + point(t.rx) + geometry_.delay * point(t.velocity));
    }
    Point pixel(std::int64_t line, double column) const {
        return point(raster_.first + 3 * line) + column * point(raster_.step + 3 * line);
    }

    const Geometry& geometry_;
    const Raster& raster_;
    Costs costs_ = costs[0];
    double pixels_ = 0, path_ = 0, line_ = 0, rows_ = 0;
    Point centre_;
    std::vector<Point> places_;
};

// Slant range from which polynomials of degree 4 along 64 nodes of a ray hold to within `error` rad for the two-way
// delay of what lies `reach` m off the centre, the centre's own taken away.
//
// Along a ray of constant bearing a sensor at p from the centre is r - p.x/r + (p^2 - (p.x/r)^2)/2r + ... away, where
// x/r has the components sqrt(1 - (h/r)^2) = 1 - sum a_k (h/r)^2k along the ground, a_k > 0, and h/r, at a height h.
// Polynomials through 5 Chebyshev nodes of |s| <= half are wrong by at most half^5/(5! 2^4) of the fifth derivative, on
// both ways.
double clear_of(const Geometry& geometry, double height, double reach, double rate, double error) {
    const Model& model = geometry.model;
    const double half = 31.5 * model.c / (4 * geometry.half_band() * rate);
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
        const double wrong = 2 * 2 * pi * model.fc / model.c * fifth * std::pow(half, 5) / 1920;
        return wrong <= error;
    };
    double low = std::max(height, 1e-3) * (1 + 1e-6), high = 1e3 * (height + reach + half);
    if (!holds(high)) return std::numeric_limits<double>::infinity();
    if (holds(low)) return low;
    while (high > low * 1.001) {
        const double middle = std::sqrt(low * high);
        (holds(middle) ? high : low) = middle;
    }
    return high;
}

// Samples from a record's end at which what rings of samples there is at most `error` of them, see bounds.ringing in
// Python.
double hushed(double error, double band) {
    double d = 1;
    const auto rings = [&] {
        const double layer = 1 / std::max(1 / 2.2 - band, 1 / d);
        return std::min(0.5, 39 / (d * d * d) * std::sqrt(1 + layer / 5));
    };
    while (rings() > error) d *= 1.01;
    return d;
}

}  // namespace

Layout cleared(const Geometry& geometry, const Raster& raster, Layout layout, double tol) {
    double height = 0, apart = 0, extent = layout.length;
    for (std::int64_t i = 0; i < geometry.count; ++i) {
        const Point tx = point(geometry.traces[i].tx), rx = point(geometry.traces[i].rx);
        height = std::max(height, std::max(std::abs(tx.z - raster.first[2]), std::abs(rx.z - raster.first[2])));
        apart = std::max(apart, length(tx - rx));
    }
    const double error = share_drift * share_leaves * tol;
    std::vector<double> away;
    for (const int fan : layout.fans) {
        away.push_back(clear_of(geometry, height, extent * (1 - 1.0 / fan) / 2, layout.taps.rate,
                                share_positions / most_merges * tol));
        extent /= fan;
    }
    away.push_back(clear_of(geometry, height, (extent + apart) / 2, layout.taps.rate, error));
    layout.clear = away.front();
    layout.apart = away.size() > 1 ? *std::max_element(away.begin() + 1, away.end()) : 0;
    layout.ends = layout.spare * geometry.band < held ? hushed(share_ends * tol, geometry.band) : 0;
    return layout;
}

std::optional<Layout> choose_layout(const Geometry& geometry, const Raster& raster, double tol, const char* isa) {
    const Estimate estimate(geometry, raster, isa);
    const auto lengths = estimate.lengths();
    std::vector<TapDesign> designs;
    std::optional<Layout> best;
    double cheapest = std::numeric_limits<double>::infinity();
    for (const auto& parts : fans) {
        const std::size_t stages = parts.size() + 1;
        const TapDesign* taps = nullptr;
        for (std::size_t i = 0; i < std::size(choices) && !taps; ++i) {
            if (i == designs.size()) designs.push_back(design_taps(choices[i].count, choices[i].rate, choices[i].half));
            const double error = std::hypot(tree_error(designs[i], stages), share_ends * tol);
            if (error <= (1 - share_leaves - share_positions) * tol) taps = &designs[i];
        }
        if (!taps) continue;
        for (const double longest : lengths) {
            const Layout layout{longest, parts, *taps, spare, 0, 0, 0};
            const double cost = estimate(layout);
            if (cost >= cheapest) continue;
            cheapest = cost;
            best = layout;
        }
    }
    return best;
}

}  // namespace pysas
