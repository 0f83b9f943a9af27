#include "planning/levels.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <optional>

#include "core/dispatch.hpp"
#include "core/polynomials.hpp"
#include "core/transforms.hpp"
#include "planning/bounds.hpp"
#include "planning/draw.hpp"

namespace pysas {
namespace {

// Of what is measured beyond a plan's bounds: levels that change within a filter's reach leave more than their mean
// square says, by 2.2 beside the tail of a pulse in a band as wide as the filter allows.
constexpr double unsure = 3.0;
constexpr double excess = 1.25;      // of tol, by which what is known of whole records' tables may exceed it
constexpr double tree_wrong = 2.0;   // errors of a tree beside bright nodes, in those spread evenly over its reach
constexpr double tree_excess = 1.5;  // of tol, by which a tree's may be exceeded: so uncertain is what is measured
constexpr double brighter = 10.0;    // squares of what pixels read: samples elsewhere below that are like any others
constexpr std::int64_t terms_a_block = 64;  // by which shares of a few neighbouring traces' are told
constexpr double nothing = 0.03;            // of the error predicted: the sum of squares hardly changes
constexpr std::int64_t alike_pixels = 8;    // at which what all traces have in common is summed
constexpr std::int64_t end_samples = 3;     // beside a record's first and last that tell how bright it is cut
// errors of float arithmetic in transforms to and fro, rms, in roundings of the rms of what they transform
constexpr double transform_roundings = 6.0;
constexpr double wide_error = 1e-12;     // of a filter at twice the sample rate beside what pixels read
constexpr std::int64_t few_pixels = 64;  // read a bright sample with one part of a filter's reach, not with all in turn
constexpr double peak_error = 2.0;       // of such a part, in the root mean square of all

constexpr std::int64_t lanes = transform_lanes<double>;

double square(double x) { return x * x; }

// Records of n samples low-passed by W, zero-extended to at least twice that, `lanes` of them side by side.
class RecordLowPass {
  public:
    RecordLowPass(std::int64_t n, const Kernels& kernels)
        : n_(n), transform_(fast_length(2 * n)), kernels_(kernels), planes_(static_cast<std::size_t>(4 * room())) {}

    double* re(int lane) { return planes_.data() + lane; }  // of sample 0; the next is lanes further
    double* im(int lane) { return re(lane) + room(); }

    // Power of the low-passed samples: sample i of a lane is at i lanes + lane.
    std::vector<double> power() {
        const std::int64_t size = transform_.size();
        double* const work = planes_.data() + 2 * room();
        const auto spectrum = transform_(kernels_, {re(0), im(0)}, {work, work + room()}, lanes);
        for (std::int64_t k = 0; k < size; ++k) {
            const std::int64_t turns = 2 * k < size ? k : k - size;
            const double share = static_cast<double>(turns) / static_cast<double>(size);
            const double factor = low_pass(share) / static_cast<double>(size);
            for (std::int64_t at = k * lanes; at < (k + 1) * lanes; ++at) {
                spectrum.re[at] *= factor;
                spectrum.im[at] *= factor;
            }
        }
        double* const other = spectrum.re == work ? planes_.data() : work;
        // back: with real and imaginary parts exchanged
        const auto smooth = transform_(kernels_, {spectrum.im, spectrum.re}, {other, other + room()}, lanes);
        std::vector<double> out(static_cast<std::size_t>(n_ * lanes));
        for (std::size_t i = 0; i < out.size(); ++i) out[i] = square(smooth.re[i]) + square(smooth.im[i]);
        return out;
    }

  private:
    std::int64_t room() const { return transform_.size() * lanes; }

    std::int64_t n_;
    Transform<double> transform_;
    const Kernels& kernels_;
    std::vector<double> planes_;
};

// How a plan's data are looked at.
class Look {
  public:
    Look(const Plan& plan, const SomeTerms& terms, const Levels& data)
        : plan_(plan), scene_(*plan.scene), terms_(terms), data_(data) {
        weigh();
        for (std::size_t i = 0; i < terms.trace.size(); ++i) {
            if (!data.used[terms.trace[i]]) continue;
            trace_.push_back(terms.trace[i]);
            place_.push_back(terms.place[i]);
            weight_.push_back(square_[static_cast<std::size_t>(terms.trace[i])] * square(terms.weight[i]));
        }
        if (trace_.empty()) return;
        own_ = std::sqrt(level(1));
        find_ends();
    }

    // Nothing where no term is left, or no double holds the squares of both weights and samples.
    bool blind() const { return trace_.empty() || !(std::isfinite(own_) && std::isfinite(loudest_)); }

    // Whether trees would be wrong by more than is left of tol; nothing where that cannot be told.
    std::optional<bool> trees_fail() const {
        const std::int64_t reach = tree_reach();
        const double over = std::sqrt(std::max(level(reach) - square(own_), outside(reach)));
        double rings = 0;
        for (std::size_t i = 0; i < trace_.size(); ++i) {
            // what rings has frequencies that sub-images have no nodes for; pixels nearer to an end do not go through
            // them. Ends about as bright as what pixels read are in the tree's own bounds
            for (int side = 0; side < 2; ++side) {
                const double more = std::max(end(side, i) - brighter * square(own_), 0.0);
                if (more > 0)
                    rings += more * square(ringing(std::max(distance(side, i), static_cast<double>(reach)), band()));
            }
        }
        const double wrong =
            tree_wrong * std::hypot(error("sub-images") * over, std::sqrt(rings / static_cast<double>(trace_.size())));
        if (!std::isfinite(wrong)) return {};
        return wrong > (tree_excess * plan_.wish.budget - plan_.settings.predicted()) * own_;
    }

    struct Measured {
        double error, planned;
    };

    // Error, in units of the data's scale, that a plan's tables make of the terms; and what of it is in its bounds.
    // Errors of a filter are spread over its reach.
    Measured measured(const Plan& plan) const {
        const Settings& s = plan.settings;
        const std::size_t count = trace_.size();
        const double planned = s.wide ? 0 : of(s.errors, "interpolation");
        const std::int64_t reach = (s.n_fft ? (s.filter.taps + 3) / 4 : s.filter.taps / 2) + 1;
        const double beside = square(s.wide ? wide_error : planned);
        // of few pixels it is one part of the reach that all read a bright sample with
        const double uneven = scene_.wanted < few_pixels ? square(peak_error) : 1;
        double sum = beside * uneven * std::max(level(reach), outside(reach)) * static_cast<double>(count);
        sum += ringing_of(plan);
        if (s.n_fft) sum += rounding_of(s);
        if (s.taper) sum += cut_of(plan);
        return {std::sqrt(sum / static_cast<double>(count)), planned + of(s.errors, "record's ends")};
    }

    // How much more power than of unrelated samples a pixel has of what rings at one sample of all traces, at some
    // pixels. A transmit pulse that a record's start cuts is the same in all of them; W rings at about 0.47 of the
    // sample rate.
    double alike() const {
        if (alike_ > 0) return alike_;
        alike_ = 1;
        if (loudest_ <= brighter * square(own_)) return alike_;
        const Model& model = scene_.survey.model;
        const auto pixels = places_of(scene_.pixels, drawn_pixels(scene_, alike_pixels, 1));
        for (const double shift : {-0.47, 0.0, 0.47}) {
            const double frequency = model.fc / model.fs + shift;
            double power = 0, incoherent = 0;
            for (const Point& pixel : pixels) {
                std::complex<double> total = 0;
                for (const std::int64_t i : terms_.heard) {
                    const auto at = static_cast<std::size_t>(i);
                    if (!data_.used[i]) continue;
                    const Trace& trace = scene_.survey.traces[at];
                    const Place place = place_of(scene_, trace, pixel);
                    if (!place.lit) continue;
                    const double turns = frequency * (trace.t0 * model.fs + place.index);
                    total += std::polar(std::sqrt(square_[at]) * place.weight, 2 * pi * (turns - std::floor(turns)));
                    incoherent += square_[at] * square(place.weight);
                }
                power += std::norm(total);
            }
            alike_ = std::max(alike_, power / incoherent);
        }
        return alike_;
    }

    // Mean square of what pixels read of whole records low-passed by W: what rings of bright samples elsewhere
    // included.
    double low_passed() const {
        const std::int64_t n = scene_.samples();
        // terms by the traces that are smoothed side by side
        std::vector<std::size_t> begin;
        Numbers lane;
        for (std::size_t i = 0; i < trace_.size(); ++i) {
            const bool fresh = i == 0 || trace_[i] != trace_[i - 1];
            lane.push_back(i == 0 ? 0 : (lane.back() + (fresh ? 1 : 0)) % lanes);
            if (fresh && lane.back() == 0) begin.push_back(i);
        }
        begin.push_back(trace_.size());
        std::vector<double> sums(begin.size() - 1);
        const Kernels& kernels = kernels_for(plan_.wish.isa);
        run(
            static_cast<std::int64_t>(sums.size()), plan_.wish.threads,
            [&](std::int64_t task) {
                const auto part = static_cast<std::size_t>(task);
                RecordLowPass smooth(n, kernels);
                std::vector<std::complex<double>> record(static_cast<std::size_t>(n));
                for (std::size_t i = begin[part]; i < begin[part + 1]; ++i) {
                    if (i > begin[part] && trace_[i] == trace_[i - 1]) continue;
                    data_.record(trace_[i], record.data());
                    const auto number = static_cast<int>(lane[i]);
                    for (std::int64_t k = 0; k < n; ++k) {
                        smooth.re(number)[k * lanes] = record[static_cast<std::size_t>(k)].real() / unit_;
                        smooth.im(number)[k * lanes] = record[static_cast<std::size_t>(k)].imag() / unit_;
                    }
                }
                const auto power = smooth.power();
                for (std::size_t i = begin[part]; i < begin[part + 1]; ++i)
                    sums[part] += weight_[i] * power[static_cast<std::size_t>(place_[i] * lanes + lane[i])];
            },
            data_.poll);
        return std::accumulate(sums.begin(), sums.end(), 0.0) / static_cast<double>(trace_.size());
    }

    double own() const { return own_; }
    double loudest() const { return loudest_; }

    static double of(const Errors& errors, const char* name) {
        for (const auto& [key, value] : errors) {
            if (key == name) return value;
        }
        return 0;
    }

  private:
    const Trace& trace_of(std::int64_t i) const { return scene_.survey.traces[static_cast<std::size_t>(i)]; }
    double band() const { return scene_.survey.band; }
    double error(const char* name) const { return of(plan_.settings.errors, name); }

    // Squares of weights in units of the largest used, a power of two, by which the samples' unit is divided.
    void weigh() {
        double largest = 0;
        const auto& weights = scene_.survey.weights;
        for (std::size_t i = 0; i < weights.size(); ++i) {
            if (data_.used[i]) largest = std::max({largest, std::abs(weights[i].real()), std::abs(weights[i].imag())});
        }
        int top = 0;
        std::frexp(largest, &top);
        using limits = std::numeric_limits<double>;
        unit_ = std::clamp(std::ldexp(data_.scale, -top), limits::min(), limits::max());
        for (const auto& w : weights)
            square_.push_back(square(std::ldexp(w.real(), -top)) + square(std::ldexp(w.imag(), -top)));
    }

    // Mean over the terms of the mean squares of samples within `reach` of them, weighed.
    double level(std::int64_t reach) const {
        const auto found = data_.mean_squares(trace_, place_, reach, unit_);
        double sum = 0;
        for (std::size_t i = 0; i < found.size(); ++i) sum += weight_[i] * found[i];
        return sum / static_cast<double>(found.size());
    }

    // Twice the mean squares of samples at the first and the last end of all used traces, weighed.
    void find_ends() {
        for (std::int64_t i = 0; i < scene_.traces(); ++i) {
            if (data_.used[i]) used_.push_back(i);
        }
        for (int side = 0; side < 2; ++side) {
            ends_[side].assign(static_cast<std::size_t>(scene_.traces()), 0);
            Numbers places;
            for (const std::int64_t i : used_) {
                const Recorded recorded(trace_of(i));
                places.push_back(side ? recorded.end - 1 : recorded.begin);
            }
            const auto found = data_.mean_squares(used_, places, end_samples, unit_);
            for (std::size_t i = 0; i < used_.size(); ++i) {
                const auto at = static_cast<std::size_t>(used_[i]);
                const double half = static_cast<double>(2 * end_samples + 1) / (end_samples + 1);
                ends_[side][at] = square_[at] * found[i] * 2 * half;
                loudest_ = std::max(loudest_, ends_[side][at]);
                if (!std::isfinite(ends_[side][at])) loudest_ = std::numeric_limits<double>::infinity();
            }
        }
    }

    double end(int side, std::size_t term) const { return ends_[side][static_cast<std::size_t>(trace_[term])]; }
    double distance(int side, std::size_t term) const {
        const Recorded recorded(trace_of(trace_[term]));
        return static_cast<double>(side ? recorded.end - 1 - place_[term] : place_[term] - recorded.begin);
    }

    // Samples to each side of a term's that the nodes read for it hold.
    std::int64_t tree_reach() const {
        const Forest& forest = plan_.trees->forest;
        const auto stages = static_cast<double>(plan_.trees->layout.fans.size() + 1);
        const double rate = static_cast<double>(forest.phases) / forest.per_samples;
        return static_cast<std::int64_t>(std::ceil(stages * plan_.trees->layout.taps.reach() / rate));
    }

    // Mean square, over the terms, of bright samples within `reach` of them just outside what pixels read, in all
    // traces. A term near an edge reaches up to `reach` samples beyond, one in 2 reach + 1 each; how many terms are so
    // near is told by some of the terms, of blocks of neighbouring traces.
    double outside(std::int64_t reach) const {
        const std::int64_t half = reach / 2;
        const auto heard = static_cast<std::int64_t>(terms_.heard.size());
        std::vector<double> bright[2];
        Numbers kept;
        for (std::int64_t i = 0; i < heard; ++i) {
            if (data_.used[terms_.heard[static_cast<std::size_t>(i)]]) kept.push_back(i);
        }
        bool any = false;
        for (int side = 0; side < 2; ++side) {
            const Numbers& edge = side ? terms_.largest : terms_.least;
            Numbers trace, place;
            for (const std::int64_t i : kept) {
                trace.push_back(terms_.heard[static_cast<std::size_t>(i)]);
                place.push_back(edge[static_cast<std::size_t>(i)] + (side ? half + 1 : -half - 1));
            }
            const auto found = data_.mean_squares(trace, place, half, unit_);
            const double share = static_cast<double>(2 * half + 1) / static_cast<double>(2 * reach + 1);
            for (std::size_t i = 0; i < found.size(); ++i) {
                const double level = square_[static_cast<std::size_t>(trace[i])] * found[i] * share;
                bright[side].push_back(std::max(level - brighter * square(own_), 0.0));
                any = any || bright[side].back() > 0;
            }
        }
        if (!any) return 0;
        const auto count = static_cast<std::int64_t>(terms_.trace.size());
        const std::int64_t blocks = std::max<std::int64_t>(1, std::min(count / terms_a_block, heard));
        const auto block_of = [&](std::int64_t rank) { return static_cast<std::size_t>(rank * blocks / heard); };
        const auto size = static_cast<std::size_t>(blocks);
        std::vector<double> traces(size), terms(size), near[2] = {std::vector<double>(size), std::vector<double>(size)};
        for (std::int64_t i = 0; i < heard; ++i) ++traces[block_of(i)];
        for (std::int64_t i = 0; i < count; ++i) {
            const auto at = static_cast<std::size_t>(i);
            const std::int64_t rank =
                std::lower_bound(terms_.heard.begin(), terms_.heard.end(), terms_.trace[at]) - terms_.heard.begin();
            const std::size_t b = block_of(rank);
            ++terms[b];
            near[0][b] += terms_.place[at] - terms_.least[static_cast<std::size_t>(rank)] <= reach;
            near[1][b] += terms_.largest[static_cast<std::size_t>(rank)] - terms_.place[at] <= reach;
        }
        double total = 0;
        for (int side = 0; side < 2; ++side) {
            for (std::size_t i = 0; i < kept.size(); ++i) {
                const std::size_t b = block_of(kept[i]);  // the likely number of terms so near, of each trace
                total += (near[side][b] + 1) * terms[b] / (terms[b] + 2) / traces[b] * bright[side][i];
            }
        }
        return total / static_cast<double>(count);
    }

    // What records' ends ring with at the terms.
    double ringing_of(const Plan& plan) const {
        const Settings& s = plan.settings;
        const double least = square(nothing * plan.settings.predicted() * own_);
        const auto traces = static_cast<double>(scene_.traces());
        double sum = 0;
        for (int side = 0; side < 2; ++side) {
            double nearest = std::numeric_limits<double>::infinity(), most_cut = 0, bright = 0, cut = 0;
            std::vector<double> rings;
            for (std::size_t i = 0; i < trace_.size(); ++i) {
                double away = distance(side, i);
                // what is not cut away is read as it is, and comes round behind the other end
                if (s.n_fft && keeps_end(plan, side, trace_[i])) away = static_cast<double>(s.n_fft) - away;
                nearest = std::min(nearest, away);
                most_cut = std::max(most_cut, end(side, i));
                rings.push_back(away);
            }
            if (square(ringing(nearest, band())) * most_cut * traces <= least) continue;
            for (std::size_t i = 0; i < trace_.size(); ++i) {
                const double ring = square(ringing(rings[i], band()));
                cut += end(side, i) * ring;
                bright += std::max(end(side, i) - brighter * square(own_), 0.0) * ring;
            }
            sum += cut;
            if (bright / static_cast<double>(trace_.size()) * traces > least) sum += (alike() - 1) * bright;
        }
        return sum;
    }

    bool keeps_end(const Plan& plan, int side, std::int64_t trace) const {
        const Settings& s = plan.settings;
        if (!s.taper) return true;
        const std::int64_t start = scene_.first[static_cast<std::size_t>(trace)] - 1 - s.margin;
        const Recorded recorded(trace_of(trace));
        return side ? start + s.length - s.taper >= recorded.end : start + s.taper <= recorded.begin;
    }

    // What transforms round.
    double rounding_of(const Settings& s) const {
        const std::int64_t n = scene_.samples();
        const auto found = data_.mean_squares(used_, Numbers(used_.size(), n / 2), n, unit_);
        std::vector<double> power(static_cast<std::size_t>(scene_.traces()));
        for (std::size_t i = 0; i < used_.size(); ++i)
            power[static_cast<std::size_t>(used_[i])] =
                found[i] * static_cast<double>(2 * n + 1) / static_cast<double>(n);
        const double unit = transform_roundings * (s.narrow && !s.wide ? 0x1p-24 : 0x1p-53);
        double sum = 0;
        for (std::size_t i = 0; i < trace_.size(); ++i)
            sum += square(unit) * weight_[i] * power[static_cast<std::size_t>(trace_[i])];
        return sum;
    }

    // What smooth cuts leave out of the band.
    double cut_of(const Plan& plan) const {
        const Settings& s = plan.settings;
        double sum = 0;
        for (const std::int64_t place : {-1 - s.margin, -1 - s.margin + s.length - s.taper}) {
            Numbers middle;
            for (const std::int64_t trace : trace_)
                middle.push_back(scene_.first[static_cast<std::size_t>(trace)] + place + s.taper / 2);
            const auto found = data_.mean_squares(trace_, middle, s.taper / 2 + 1, unit_);
            for (std::size_t i = 0; i < found.size(); ++i) sum += std::exp(-2 * s.beta) * weight_[i] * found[i];
        }
        return sum;
    }

    const Plan& plan_;
    const Scene& scene_;
    const SomeTerms& terms_;
    const Levels& data_;
    std::vector<double> square_;  // of all traces' weights
    double unit_ = 1;
    Numbers used_, trace_, place_;  // traces; terms of them
    std::vector<double> weight_, ends_[2];
    double own_ = 0, loudest_ = 0;
    mutable double alike_ = 0;
};

}  // namespace

Verdict hold_against(const Plan& asked, const SomeTerms& terms, const Levels& data) {
    Verdict out;
    const Look look(asked, terms, data);
    if (look.blind()) return out;
    const double own = look.own(), budget = asked.wish.budget;
    Plan plan = asked;
    if (plan.trees) {
        const auto fails = look.trees_fail();
        if (!fails) return out;
        if (*fails) {
            out.direct = true;
            plan = directly(plan, {});
        }
    }
    auto found = look.measured(plan);
    if (!std::isfinite(found.error)) return {};
    if (found.error <= (found.planned + (budget - plan.settings.predicted()) / unsure) * own) return out;
    out.wide = true;
    const double ends = own > 0 ? std::sqrt(look.loudest() * look.alike()) / own : 1e12;
    out.ends = std::pow(10.0, std::ceil(std::log10(std::clamp(ends, 1.0, 1e12))));  // few plans do for all data
    plan = widely(plan, out.ends);
    out.direct = out.direct || (asked.trees && !plan.trees);
    found = look.measured(plan);
    const double limit = found.planned + excess * budget - plan.settings.predicted();
    double level = own;
    if (found.error > limit * own)  // what rings at the pixels is in the image as well
        level = std::sqrt(std::max(look.low_passed() - square(found.error), square(own)));
    if (found.error <= limit * level || level == 0 || !std::isfinite(found.error / level)) return out;
    out.beside = found.error / level;
    return out;
}

}  // namespace pysas
