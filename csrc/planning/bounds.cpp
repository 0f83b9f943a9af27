#include "planning/bounds.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <iterator>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

// for errors 10^-(1 + i/2), made by `python -m bench.interpolation_table`
constexpr std::int64_t guards[] = {5,    8,    22,   27,   45,   68,    108,   159,   262,   404,  642,
                                   1018, 1625, 2572, 4070, 6447, 10213, 16193, 25657, 40675, 64460};

}  // namespace

// Below the table's 1e-11 they grow as they do in it.
std::int64_t guard(double error) {
    constexpr int last = static_cast<int>(std::size(guards)) - 1;
    if (error < 1e-11)
        return static_cast<std::int64_t>(
            std::ceil(static_cast<double>(guards[last]) * std::pow(1e-11 / std::max(error, 1e-12), 0.4)));
    const double index = std::ceil(2 * (-std::log10(error) - 1) - 1e-9);
    return guards[static_cast<int>(std::clamp<double>(index, 0, last))];
}

// Along rays the band's worst frequency, across them the mean over a group's pings. A stage's error of a component
// depends on where between nodes it is read, and stages read at unrelated places: they add as squares. 1.2 is the
// margin of the tolerance sweep.
double tree_error(const TapDesign& taps, std::size_t stages) {
    return 1.2 * std::sqrt(static_cast<double>(stages)) * std::hypot(taps.worst, taps.rms);
}

// The weight's second derivative jumps by (pi/width)^2/2 at both ends of the taper on both sides: from there its
// spectrum falls as that over (2 pi k)^3, in cycles a radian, and the square of the weight is that of 2 (full + 3/8
// width) rad of weight 1. Of frequencies beyond the 1/rate of what rays hold taps miss no more than (1.2 y)^2, where y
// goes from there to 1 at all they hold; of what lies beyond that twice as much as there is.
double held_across(double across, double rate, const Fading& fading) {
    if (!(fading.width > 0)) return rate * across;
    if (!(across < 1e12)) return HUGE_VAL;
    constexpr int steps = 24;
    const double band = across / (2 * pi), jump = pi * pi / (2 * fading.width * fading.width);
    const double weight = 2 * (fading.full + 0.375 * fading.width);
    const auto left = [&](double held) {
        const double first = held / rate - band, last = held - band, step = (last - first) / steps;
        if (!(first > 0)) return HUGE_VAL;
        double sum = 4 / (5 * std::pow(last, 5));
        for (int i = 0; i < steps; ++i) {
            const double y = (i + 0.5) / steps;
            const double square = 1.44 * y * y, at = first + step * (i + 0.5), cube = at * at * at;
            sum += step * square * square / (cube * cube);
        }
        return std::sqrt(8 * sum / weight) * jump / std::pow(2 * pi, 3);
    };
    double low = rate * band, high = 2 * low + rate / fading.width;
    while (left(high) > fading.error && high < 1e12) high *= 2;
    while (high > low * (1 + 1e-3)) {
        const double middle = (low + high) / 2;
        (left(middle) <= fading.error ? high : low) = middle;
    }
    return 2 * pi * high;
}

// They take a twentieth of the budget where 32 are few enough: shorter ones cost more time than they give.
std::int64_t longest_run(double budget, int sums) {
    std::int64_t run = 256;
    while (run > 32 && running_error(run, sums) > 0.05 * budget * (1 + 1e-9)) run /= 2;
    return run;
}

// Relative to the sums' end. Each addition rounds by at most 2^-24 of what there is by then: of equal terms half of the
// end on average. They are worst: then roundings have one sign for as long as the exponent stays. The kernels have one
// sum a part, which rounds twice a term; in simulations of equal random terms it was wrong by 0.17 (rms) to 0.48 terms
// 2^-24.
double running_error(std::int64_t terms, int sums) { return static_cast<double>(terms * sums) * 0x1p-25; }

// W's impulse response falls as 11^2/(pi d^3) = 39/d^3. Of |f| <= band it leaves the more the farther band is from
// 1/2.2: about 1/(1/2.2 - band) samples beside the end add up, without relation rms sqrt(1 + d/5) for d of them.
double ringing(double distance, double band) {
    const double d = std::max(distance, 1.0);
    const double layer = 1 / std::max(1 / 2.2 - band, 1 / d);
    return std::min(0.5, 39 / (d * d * d) * std::sqrt(1 + layer / 5));
}

double hushed(double error, double band) {
    double low = 1, high = 1e7;
    while (high > low * (1 + 1e-6)) {
        const double middle = std::sqrt(low * high);
        (ringing(middle, band) > error ? low : high) = middle;
    }
    return high;
}

}  // namespace pysas
