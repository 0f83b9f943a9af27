// Bounds: bounds.cpp, core/filters.cpp and the comments below; what things cost: costs.cpp.

#include "planning/settings.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <tuple>

#include "core/kernels.hpp"
#include "core/polynomials.hpp"
#include "core/transforms.hpp"
#include "planning/bounds.hpp"

namespace pysas {
namespace {

constexpr double share_interpolation = 0.85;
// the same of tables of whole records: all they hold may be at the band's edge, where bounds leave no margin
constexpr double share_wide = 0.3;
constexpr double share_wrap = 0.1;  // wrap-round at a record's hard end
constexpr double batch_bytes = 24 << 20;
constexpr int least_taps = 8, longest_filter = 400;
// of a filter at twice the sample rate: as long as double can use, its Kaiser window's error beside what pixels read is
// exp(-pi sqrt(18^2 - 1))
constexpr int wide_taps = 36;
constexpr int sums = 1;  // running sums of a pixel's part

struct Rate {
    int phases, step;
};
constexpr Rate rates[] = {{1, 1}, {3, 2}, {2, 1}, {5, 2}, {3, 1},  {7, 2},
                          {4, 1}, {5, 1}, {6, 1}, {8, 1}, {11, 1}, {16, 1}};

// What kernels are compiled for, see Sizes.
template <class Number>
std::vector<int> listed(const Number& numbers) {
    return {std::begin(numbers), std::end(numbers)};
}
std::vector<int> degrees_of(bool narrow) {
    return narrow ? listed(Sizes<float>::degrees) : listed(Sizes<double>::degrees);
}
std::vector<int> terms_of(bool narrow) { return narrow ? listed(Sizes<float>::terms) : listed(Sizes<double>::terms); }
int nodes_of(bool narrow) { return narrow ? Sizes<float>::nodes : Sizes<double>::nodes; }

// Filters that were designed last: a plan asks for the same ones again and again, and to design them is the slow part.
class Designs {
  public:
    using Key = std::tuple<double, int, int, int, double, int, int>;

    std::shared_ptr<const Filter> get(double band, int degree, int phases, int step, double error, int least,
                                      int most) {
        const Key key{band, degree, phases, step, error, least, most};
        if (auto found = find(key)) return found;
        auto made = std::make_shared<const Filter>(design(band, degree, phases, step, error, least, most));
        keep(key, made);
        return made;
    }

  private:
    static constexpr std::size_t most_filters = 256, most_weights = 1 << 20;

    std::shared_ptr<const Filter> find(const Key& key) {
        const std::lock_guard<std::mutex> lock(mutex_);
        const auto at = std::find_if(kept_.begin(), kept_.end(), [&](const auto& one) { return one.first == key; });
        if (at == kept_.end()) return nullptr;
        std::rotate(at, at + 1, kept_.end());
        return kept_.back().second;
    }

    void keep(const Key& key, const std::shared_ptr<const Filter>& filter) {
        const std::lock_guard<std::mutex> lock(mutex_);
        kept_.emplace_back(key, filter);
        weights_ += filter->weight.size();
        while (kept_.size() > most_filters || (weights_ > most_weights && kept_.size() > 1)) {
            weights_ -= kept_.front().second->weight.size();
            kept_.erase(kept_.begin());
        }
    }

    std::mutex mutex_;
    std::vector<std::pair<Key, std::shared_ptr<const Filter>>> kept_;  // the one used last at the end
    std::size_t weights_ = 0;
};

Designs& designs() {
    static auto* const kept = new Designs;  // never destroyed: threads may plan while the process ends
    return *kept;
}

// Samples kept of every trace, those kept beside what pixels need, the taper at each cut end and its beta.
struct Crop {
    std::int64_t length, margin, taper;
    double beta;
};

// Most samples that pixels ask of any trace, less one.
std::int64_t asked(const Scene& scene) {
    std::int64_t most = 0;
    for (std::size_t i = 0; i < scene.heard.size(); ++i) {
        if (scene.heard[i]) most = std::max(most, scene.last[i] - scene.first[i]);
    }
    return most;
}

// A smooth cut (the integral of a Kaiser window) of g samples leaves a band-limited trace band-limited to within beta =
// pi sqrt((g delta)^2 - 1), delta the free band up to 1/2.2: exp(-beta) is held to a thousandth of the budget, so that
// a point 60 dB above the scene just outside the cut does no harm. It begins `guard` samples away: a record's own end
// that is nearer stays in, with what the low-pass W makes of it.
Crop crop(const Scene& scene, double budget) {
    const Crop whole{scene.samples(), 0, 0, 0};
    const double free = 1 / 2.2 - scene.survey.band;
    if (scene.audible == 0 || free < 0.01) return whole;
    const std::int64_t margin = guard(budget);
    const double beta = std::log(1e3 / budget);
    const auto taper = static_cast<std::int64_t>(std::ceil(std::sqrt(1 + (beta / pi) * (beta / pi)) / free)) + 1;
    const std::int64_t needed = asked(scene) + 2 + 2 * (taper + margin);
    if (static_cast<double>(needed) >= 0.9 * static_cast<double>(scene.samples())) return whole;
    return {needed, margin + taper, taper, beta};
}

// Whether pixels need samples less than `away` from a record's end: there a low-passed trace holds all |f| < 1/2.
bool near_ends(const Scene& scene, std::int64_t away) {
    for (std::size_t i = 0; i < scene.heard.size(); ++i) {
        const Recorded recorded(scene.survey.traces[i]);
        if (scene.heard[i] && (scene.first[i] < recorded.begin + away || scene.last[i] > recorded.end - 1 - away))
            return true;
    }
    return false;
}

// Where pixels need samples near a record's end, traces are low-passed by W first (see pysas.reference.exact), which
// says how that end is read. Its long response needs transforms: one forward, one back to twice the sample rate, where
// |f| <= 1/4 is all there is left for the filter to read. With `wide` whole records go through them; the filter's
// polynomials are wrong by what they themselves read.
bool cut(Settings& s, const Scene& scene, double budget, double wide) {
    const std::int64_t away = guard(share_wrap * budget / std::max(wide, 1.0));
    s.errors.emplace_back("record's ends", share_wrap * budget);
    s.wide = wide > 0;
    s.length = asked(scene) + 4;
    s.margin = s.taper = s.n_fft = 0;
    s.beta = 0;
    if (!s.wide && !near_ends(scene, away)) return false;
    if (!s.wide) {
        const Crop kept = crop(scene, budget);
        s.length = kept.length, s.margin = kept.margin, s.taper = kept.taper, s.beta = kept.beta;
    }
    s.n_fft = fast_length((s.wide ? scene.samples() : s.length) + std::max<std::int64_t>(away, longest_filter));
    return true;
}

// The cheapest filter that reads samples within the budget, or none.
std::shared_ptr<const Filter> cheapest_filter(const Settings& s, const Scene& scene, double budget, const Costs& costs,
                                              const std::vector<Rate>& tried) {
    const double left = std::min((s.wide ? share_wide : share_interpolation) * budget, budget - sum_of(s.errors));
    const double band = s.n_fft > 0 ? 0.25 : scene.survey.band, twice = s.n_fft > 0 ? 2 : 1;
    const int least = s.wide ? wide_taps : least_taps, most = s.wide ? wide_taps : longest_filter;
    std::shared_ptr<const Filter> best;
    double cheapest = std::numeric_limits<double>::infinity();
    for (const int degree : degrees_of(s.narrow)) {
        for (const Rate& rate : tried) {
            // a polynomial's own error, before any filter is made: near-minimax for this phase advance
            const double theta = pi * band * rate.step / rate.phases;
            if (std::pow(theta, degree + 1) / (std::tgamma(degree + 2) * std::pow(2, degree)) > 1.5 * left) continue;
            const auto filter = designs().get(band, degree, rate.phases, rate.step, left, least, most);
            if (filter->error > left) continue;
            const double over = twice * filter->rate();
            const double term = term_ns(scene, costs, s.narrow, s.block, s.near, degree, over);
            const double coefficients = (degree + 1) * static_cast<double>(s.length) * over;
            const double cost =
                static_cast<double>(scene.traces()) * (scene.each * term + coefficients * coefficient_ns(*filter));
            if (cost < cheapest) cheapest = cost, best = filter;
            break;
        }
    }
    return best;
}

// Whether the powers of a fan that fades keep to their share of the budget.
bool fades(const Scene& scene, double budget, bool narrow) {
    return narrow && scene.light.shape == fan && scene.light.terms > 0 &&
           scene.faded <= share_phase * budget * scene.brightness();
}

// A way's length is a quadratic in height through the places in the middle and h above and below. It is wrong by
// its third derivative's sixth, at most 2/(5 r^2) (see choose_delay), times 0.385 h^3; and a polynomial along each of
// the three lines counts 1.25 times. The sine of a fan's angle is linear in height: its second derivative is at most
// 2/r^2 of it, and 1.15/r^2 of what the fan's axis stands upright. h and what a line rises make offsets that round as
// those along lines do.
Rise rise_of(const Scene& scene, double error, bool narrow) {
    const double wave = scene.survey.model.fc / scene.survey.model.c, eps = narrow ? 0x1p-24 : 0x1p-53;
    double upright = 0;
    for (const Trace& trace : scene.survey.traces) upright = std::max(upright, std::abs(trace.axis[2]));
    const double steep = pi / 2 * scene.light.per * (scene.light.sine_half + 0.6 * upright);
    return {std::sqrt(2 * pi * wave * 2 * 1.3 * 0.154 / error), std::sqrt(steep / (error * scene.brightness())),
            error / (2 * pi * wave * eps)};
}

// All but how samples are read.
Settings arithmetic_of(const Scene& scene, double budget, const Costs& costs, double rounding) {
    Settings s{};
    s.narrow = scene.survey.single || budget >= 1e-5 * (1 - 1e-9);
    if (scene.pixels.lined()) {
        const Delay delay = choose_delay(scene, budget, costs, s.narrow, rounding, false);
        s.block = delay.block, s.near = delay.near;
        if (s.block > 0) s.errors = {{"rounding", delay.rounding}, {"delay polynomial", share_phase * budget}};
        s.quick = s.block > 0 && fades(scene, budget, s.narrow);
        if (s.quick) s.errors.emplace_back("beam", scene.faded / scene.brightness() + share_phase * budget);
        if (s.block > 0 && scene.pixels.heights.z) {
            s.rise = rise_of(scene, share_phase * budget, s.narrow);
            s.errors.emplace_back("heights", (s.quick ? 3.25 : 2.25) * share_phase * budget);
        }
    }
    if (s.narrow && s.block == 0) s.errors.emplace_back("rounding", 0x1p-22);
    const double least = s.narrow ? 0x1p-23 : 1e-14;
    double wrong = 0;
    for (const int terms : terms_of(s.narrow)) {
        std::vector<double> sine, cosine;
        s.terms = terms;
        wrong = fit_trigonometry(terms, sine, cosine);
        if (wrong <= std::max(share_phase * budget, least)) break;
    }
    s.errors.emplace_back("sine and cosine", wrong);
    if (s.narrow) {
        s.run = longest_run(budget, sums);
        // and as many batches, of 8 traces at least, as the image may be a sum of
        const std::int64_t batches = std::min((scene.traces() + 7) / 8, s.run / 8);
        s.errors.emplace_back("running sums",
                              running_error(std::min(s.run, scene.traces()), sums) + running_error(batches, 1));
    }
    return s;
}

std::optional<Settings> settings_of(const Scene& scene, double budget, const Costs& costs, double rounding,
                                    const Rate* leaves, double wide) {
    Settings s = arithmetic_of(scene, budget, costs, rounding);
    if (leaves != nullptr) s.errors.emplace_back("drift", share_phase * budget);
    const int twice = cut(s, scene, budget, wide) ? 2 : 1;
    const auto tried = leaves != nullptr ? std::vector<Rate>{{leaves->phases, leaves->step * twice}}
                                         : std::vector<Rate>(std::begin(rates), std::end(rates));
    const auto filter = cheapest_filter(s, scene, budget, costs, tried);
    if (!filter) return std::nullopt;
    s.filter = *filter;
    s.errors.emplace_back("interpolation", filter->error);
    s.oversampling = twice * filter->rate();
    const double size = static_cast<double>(s.length) * s.oversampling * (filter->degree + 1) * (s.narrow ? 8 : 16);
    s.batch = std::max<std::int64_t>(8, static_cast<std::int64_t>(batch_bytes / size) / 8 * 8);
    return s;
}

}  // namespace

double sum_of(const Errors& errors) {
    double sum = 0;
    for (const auto& error : errors) sum += error.second;
    return sum;
}

Settings choose(const Scene& scene, double budget, const Costs& costs, double wide) {
    auto found = settings_of(scene, budget, costs, 3 * share_phase, nullptr, wide);
    // a longer filter and a higher degree reach every budget that is let in
    if (!found) throw std::logic_error("no settings within the budget");
    return *std::move(found);
}

std::optional<Settings> choose_for_leaves(const Scene& scene, double budget, const Costs& costs, int phases, int step,
                                          double wide) {
    const Rate rate{phases, step};
    return settings_of(scene, budget, costs, share_rounding, &rate, wide);
}

// sqrt(r^2 + 2 r u s + s^2) has Taylor coefficients |a_n| <= 2/((2n - 1) r^(n-1)) (Legendre's generating function), so
// the polynomial through n Chebyshev nodes of |s| <= h is wrong by at most 2 h^n/((2n - 1) 2^(n-1) r^(n-1)), for each
// way. The offset from the block's centre, up to `turns` at its ends, rounds three times: rms eps turns/2 over the
// block.
Delay choose_delay(const Scene& scene, double budget, const Costs& costs, bool narrow, double rounding, bool whole) {
    const int nodes = nodes_of(narrow);
    const double wave = scene.survey.model.fc / scene.survey.model.c;
    const double uneven = 4 * pi * wave * scene.pixels.uneven;  // a pixel off its line is off by as much on both ways
    const double eps = narrow ? 0x1p-24 : 0x1p-53;
    Delay best;
    double cheapest = std::numeric_limits<double>::infinity();
    for (const int block : {64, 48, 32, 16, 8}) {
        const int count = even_split(scene.pixels.width, block);
        const double half = scene.step * (count - 1) / 2;
        const double turns = 2 * half * scene.slope * wave;
        const double rounds = pi * turns * eps + 4 * eps + uneven;
        const bool bent = scene.survey.bent && !scene.survey.bent->holds(scene.step, count);
        if (rounds > rounding * budget || bent) continue;
        double near = 2 * half;
        if (half > 0) {
            const double scaled =
                2 * pi * wave * 2 * 1.3 * (2.0 / (2 * nodes - 1)) * std::pow(half, nodes) / std::pow(2, nodes - 1);
            near = std::max(near, std::pow(scaled / (share_phase * budget), 1.0 / (nodes - 1)));
            // the sine of a fan's angle has Taylor coefficients of at most 2/r^n, by Legendre's generating function too
            if (fades(scene, budget, narrow)) {
                const double steep = pi / 2 * scene.light.per * 2 / std::pow(2, nodes - 1);
                near =
                    std::max(near, half * std::pow(steep / (share_phase * budget * scene.brightness()), 1.0 / nodes));
            }
        }
        const double cost = whole ? near : term_ns(scene, costs, narrow, count, near, 3, 2.0);
        if (cost < cheapest) {
            cheapest = cost;
            best = {count, near, rounds};
        }
        if (whole && near <= 0.9 * scene.nearest) break;
    }
    return best;
}

int even_split(std::int64_t length, int block) {
    if (length <= 8) return static_cast<int>(length);
    const std::int64_t blocks = (length + block - 1) / block, count = (length + blocks - 1) / blocks;
    return static_cast<int>(std::min<std::int64_t>(block, (count + 7) / 8 * 8));
}

std::vector<double> smooth_cut(std::int64_t length, std::int64_t taper, double beta) {
    if (taper == 0) return {};
    std::vector<double> rise, out(static_cast<std::size_t>(length), 1.0);
    for (std::int64_t n = 0; n <= taper; ++n) {
        const double x = 2 * static_cast<double>(n) / static_cast<double>(taper) - 1;
        const double kaiser = bessel(beta * std::sqrt(std::max(1 - x * x, 0.0)));
        rise.push_back(kaiser + (rise.empty() ? 0 : rise.back()));
    }
    for (std::int64_t n = 0; n < taper; ++n) {
        const double part = rise[static_cast<std::size_t>(n)] / rise.back();
        out[static_cast<std::size_t>(n)] = out[static_cast<std::size_t>(length - 1 - n)] = part;
    }
    return out;
}

}  // namespace pysas
