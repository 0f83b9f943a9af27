#include "planning/imaging.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "core/border.hpp"
#include "core/errors.hpp"
#include "core/summation.hpp"
#include "planning/words.hpp"

namespace pysas {
namespace {

constexpr std::int64_t pixels_at_once = 1 << 14;  // of a task
constexpr int apart = 80;               // bits between the traces' largest terms: floats may lose the small ones
constexpr double no_longer = 0x1p-100;  // of the largest term: what sums of floats cannot be trusted below

// Exponents of traces' largest |weight x sample|: the products may be no numbers.
struct Exponents {
    std::optional<int> most, least;
    std::int64_t loudest = -1;

    void add(std::int64_t trace, const std::complex<double>& weight, double peak) {
        const double factor = std::max(std::abs(weight.real()), std::abs(weight.imag()));
        if (factor == 0 || peak == 0) return;
        const int exponent = exponent_of(factor) + exponent_of(peak);
        if (!most || exponent > *most) loudest = trace;
        most = std::max(most.value_or(exponent), exponent);
        least = std::min(least.value_or(exponent), exponent);
    }

    int spread() const { return most ? *most - *least : 0; }
    // The power of two next to the largest term of all traces; 1 where there is none, or where sums in float have room
    // for them as they are: the image need not be looked at once more then.
    double scale() const {
        constexpr int moderate = 20, close = 40;
        if (!most || (std::abs(*most) <= moderate && spread() <= close)) return 1;
        if (*most > 1024)
            throw Error(Code::range, "weights: times samples they reach 2^" + std::to_string(*most - 2) +
                                         ": expected at most 2^1024, the end of float64");
        return std::ldexp(1.0, std::clamp(*most, -1074, 1023));
    }
};

// Largest parts of what tables read of each trace; not finite where the trace is not.
template <typename Sample>
std::vector<double> peaks_of(const Plan& plan, const View<const Sample, 3>& data, const Tick& tick) {
    const auto count = static_cast<std::size_t>(plan.scene->traces());
    std::vector<std::int64_t> begin(count), end(count);
    for (std::size_t i = 0; i < count; ++i) {
        const std::int64_t start = plan.start(i), reach = plan.settings.filter.taps;
        const Recorded recorded(plan.scene->survey.traces[i]);
        begin[i] = std::clamp(start - reach, recorded.begin, recorded.end);
        end[i] = std::clamp(start + plan.settings.length + reach, begin[i], recorded.end);
    }
    std::vector<double> out(count);
    peaks(data, plan.scene->survey.traces.data(), begin.data(), end.data(), out.data(), plan.wish.threads, tick);
    return out;
}

// call(pixel, number) for every pixel, rows side by side on `threads` threads.
template <typename Sample, typename Call>
void every(const View<Sample, 2>& image, int threads, const Call& call) {
    const std::int64_t width = image.shape[1], step = image.stride[1];
    const std::int64_t rows = std::max<std::int64_t>(1, pixels_at_once / std::max<std::int64_t>(width, 1));
    run((image.shape[0] + rows - 1) / rows, threads,
        [&](std::int64_t task) {
            for (std::int64_t i = task * rows; i < std::min(image.shape[0], (task + 1) * rows); ++i) {
                Sample* row = image.data + i * image.stride[0];
                if (step == 1) {  // which compilers take several at a time of
                    for (std::int64_t j = 0; j < width; ++j) call(row[j], i * width + j);
                } else {
                    for (std::int64_t j = 0; j < width; ++j) call(row[j * step], i * width + j);
                }
            }
        },
        {});
}

template <typename Sample>
double largest_of(const View<Sample, 2>& image) {
    double most = 0;
    every(image, 1, [&most](const Sample& p, std::int64_t) {
        most = std::max<double>({most, std::abs(p.real()), std::abs(p.imag())});
    });
    return most;
}

// Multiply sums of `traces` scaled terms by `scale`; what their type costs beyond a tenth of tol, of the image.
template <typename Sample>
double restore(const View<Sample, 2>& image, double scale, std::int64_t traces, double tol, int threads) {
    using value = typename Sample::value_type;
    using limits = std::numeric_limits<value>;
    const int exponent = exponent_of(scale) - 1;
    // a table's readings exceed the samples by a bit or two
    if (exponent + std::log2(static_cast<double>(traces)) + 6 < limits::max_exponent &&
        exponent > limits::min_exponent + 63) {
        if (scale != 1)
            every(image, threads, [factor = static_cast<value>(scale)](Sample& p, std::int64_t) { p *= factor; });
        return 0;
    }
    const double most = largest_of(image);
    if (most == 0) return 0;
    if (std::log2(most) + exponent >= limits::max_exponent) {
        every(image, threads, [](Sample& pixel, std::int64_t) { pixel = 0; });
        throw Error(Code::range, "data: the image reaches 2^" + fixed(std::log2(most) + exponent, 1) +
                                     ": expected less than 2^" + std::to_string(limits::max_exponent) +
                                     ", the end of complex" + std::to_string(8 * sizeof(Sample)) +
                                     ": smaller samples or weights");
    }
    double power = 0;
    every(image, 1, [&](Sample& p, std::int64_t) {
        power += std::norm(std::complex<double>(p.real() / most, p.imag() / most));
        p = Sample(std::ldexp(p.real(), exponent), std::ldexp(p.imag(), exponent));
    });
    // rounding to multiples of the smallest number, evenly spread, of both parts
    const double level = std::sqrt(power / static_cast<double>(image.shape[0] * image.shape[1]));
    const double smallest = limits::min_exponent - limits::digits - exponent - std::log2(most);
    const double lost = std::exp2(std::min(smallest, 1000.0)) / std::sqrt(6.0) / std::max(level, 1e-300);
    return lost > tol / 10 ? std::min(lost, 1.0) : 0;
}

// An image as sums take it: its lines, or one line of points.
template <typename Pixel>
View<Pixel, 2> lines_of(const Recipe& recipe, const View<Pixel, 2>& image) {
    if (recipe.image.lined() || recipe.forest) return image;
    return {image.data, {1, image.shape[0] * image.shape[1]}, {0, image.stride[1]}};
}

}  // namespace

Imaging::Imaging(Plan plan)
    : first_(std::make_shared<const Ready>(std::move(plan))), kernels_(kernels_for(first_->plan.wish.isa)) {}

void Imaging::follow(const Imaging& before) {
    auto work = before.work();
    const std::lock_guard<std::mutex> lock(guard_);
    work_ = std::move(work);
}

std::shared_ptr<const Ready> Imaging::variant(const Verdict& verdict) const {
    const std::pair<bool, double> key{verdict.direct, verdict.wide ? verdict.ends : 0};
    const std::lock_guard<std::mutex> lock(guard_);
    auto& found = others_[key];
    if (found) return found;
    Plan plan = first_->plan;
    if (verdict.direct) {
        if (!plan.wish.leave)
            throw Error(Code::tolerance, "fallback=False, tol=" + number(plan.wish.tol, 6) +
                                             ": samples beside those that pixels read are too bright for trees");
        plan = directly(plan, "samples beside those that pixels read are too bright for trees");
    }
    if (verdict.wide) plan = widely(plan, verdict.ends);
    return found = std::make_shared<const Ready>(std::move(plan));
}

template <typename Sample>
Verdict Imaging::hold(const View<const Sample, 3>& data, const std::uint8_t* used, double scale,
                      const Tick& poll) const {
    const Plan& plan = first_->plan;
    {
        const std::lock_guard<std::mutex> lock(guard_);
        if (!terms_) terms_ = std::make_unique<const SomeTerms>(some_terms(*plan.scene));
    }
    const std::int64_t channels = data.shape[1], samples = data.shape[2];
    const auto squares = [&](const Numbers& trace, const Numbers& place, std::int64_t reach, double unit) {
        std::vector<double> out(trace.size());
        const Places places{trace.data(), place.data(), static_cast<std::int64_t>(trace.size()), reach,
                            plan.scene->survey.traces.data()};
        mean_squares(data, places, unit, out.data(), plan.wish.threads, poll);
        return out;
    };
    const auto record = [&](std::int64_t trace, std::complex<double>* out) {
        const Recorded recorded(plan.scene->survey.traces[static_cast<std::size_t>(trace)]);
        std::fill_n(out, samples, 0.0);
        for (std::int64_t n = recorded.begin; n < recorded.end; ++n)
            out[n] = std::complex<double>(data(trace / channels, trace % channels, n));
    };
    return hold_against(plan, *terms_, {squares, record, used, scale, poll});
}

template <typename Sample>
Done Imaging::operator()(const View<const Sample, 3>& data, const View<Sample, 2>& image, bool whole,
                         const Tick& tick) const {
    const Scene& scene = *first_->plan.scene;
    const Survey& survey = scene.survey;
    if (tick && !tick(0)) throw Error(Code::cancelled, "stopped by the caller");
    const Tick poll = tick ? Tick([&tick](double) { return tick(0); }) : Tick();
    const auto peak = peaks_of(first_->plan, data, poll);
    Done done{first_, {}, {}, 0, 0, 0, -1};
    Exponents exponents;
    std::vector<std::uint8_t> used(peak.size());
    for (std::size_t i = 0; i < peak.size(); ++i) {
        const auto flat = static_cast<std::int64_t>(i);
        if (!(peak[i] <= std::numeric_limits<double>::max())) {
            if (whole)
                throw Error(Code::data, "data: non-finite sample at ping " + std::to_string(flat / survey.channels) +
                                            ", channel " + std::to_string(flat % survey.channels) +
                                            ": expected finite (or nan='mask')");
            done.left_out.push_back(flat);
            continue;
        }
        if (!scene.heard[i] || survey.weights[i] == 0.0) continue;
        used[i] = 1;
        ++done.used;
        exponents.add(flat, survey.weights[i], peak[i]);
    }
    const double scale = exponents.scale();
    if (done.used) {
        const Verdict verdict = hold(data, used.data(), scale, poll);
        done.beside = verdict.beside;
        if (verdict.direct || verdict.wide) done.by = variant(verdict);
    }
    const int threads = first_->plan.wish.threads;
    if (!done.used) {
        every(image, threads, [](Sample& pixel, std::int64_t) { pixel = 0; });
        if (tick && !tick(1)) throw Error(Code::cancelled, "stopped by the caller");
        return done;
    }
    done.totals = sum(*done.by, data, used.data(), scale, image, tick);
    const Plan& plan = done.by->plan;
    if (const auto& mask = scene.pixels.mask; !mask.empty()) {
        every(image, threads, [wanted = mask.data()](Sample& pixel, std::int64_t number) {
            if (!wanted[number]) pixel = 0;
        });
    }
    if (plan.settings.narrow && exponents.spread() > apart && largest_of(image) < no_longer)
        done.loudest = exponents.loudest;
    done.lost = restore(image, scale, done.used, plan.wish.tol, threads);
    if (tick && !tick(1)) throw Error(Code::cancelled, "stopped by the caller");
    return done;
}

// Points are one line: those of an image whose rows do not follow each other, and images of more bits, stand aside.
template <typename Sample>
Totals Imaging::sum(const Ready& ready, const View<const Sample, 3>& data, const std::uint8_t* used, double scale,
                    const View<Sample, 2>& image, const Tick& tick) const {
    const Recipe& recipe = ready.recipe;
    const int threads = ready.plan.wish.threads;
    const auto held = work();  // until the last of its rooms is back
    const auto aside = [&](auto zero) {
        using Pixel = decltype(zero);
        const Room<Pixel> list(static_cast<std::size_t>(image.shape[0] * image.shape[1]), true);
        const View<Pixel, 2> to{list.get(), {image.shape[0], image.shape[1]}, {image.shape[1], 1}};
        const Totals totals = run(recipe, data, used, scale, lines_of(recipe, to), threads, kernels_, *held, tick);
        every(image, threads,
              [from = list.get()](Sample& pixel, std::int64_t number) { pixel = static_cast<Sample>(from[number]); });
        return totals;
    };
    if (sizeof(Sample) == sizeof(std::complex<float>) && ready.plan.wide()) return aside(std::complex<double>());
    const bool dense = image.stride[0] == image.shape[1] * image.stride[1];
    if (!dense && !recipe.image.lined()) return aside(Sample());
    every(image, threads, [](Sample& pixel, std::int64_t) { pixel = 0; });
    return run(recipe, data, used, scale, lines_of(recipe, image), threads, kernels_, *held, tick);
}

template Done Imaging::operator()(const View<const std::complex<float>, 3>&, const View<std::complex<float>, 2>&, bool,
                                  const Tick&) const;
template Done Imaging::operator()(const View<const std::complex<double>, 3>&, const View<std::complex<double>, 2>&,
                                  bool, const Tick&) const;

}  // namespace pysas
