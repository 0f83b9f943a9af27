#include "planning/costs.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "planning/settings.hpp"

namespace pysas {
namespace {

constexpr double all = std::numeric_limits<double>::infinity();

// ns of one thread beside others: a term, each of its coefficients, a line of a block for each trace, a term with its
// own exact delay, each of its coefficients. Lanes of a vector of floats. Registers that may hold what a vector of
// pixels reads, with the cost of a coefficient in times that of one; the last: gathers. A tree: a term of a leaf, a
// node of a leaf beside its terms, a node of a parent for each child, a pixel read; the last two with what each tap
// adds.
// clang-format off
constexpr Costs known[] = {
    {"avx512",
     0.35, 0.06, 8.0, 2.7, 0.12,
     16, {{1, 1.0}, {2, 1.3}, {4, 2.0}, {all, 8.0}},
     {0.65, 4.0, {1.0, 0.65}, {6.0, 0.7}}},
    {"avx2",
     0.5, 0.085, 9.5, 3.3, 0.1,
     8, {{1, 1.0}, {2, 2.2}, {all, 6.5}, {all, 6.5}},
     {0.9, 4.0, {1.5, 0.6}, {6.5, 0.7}}},
    {"baseline",
     1.5, 0.25, 25.0, 10.5, 1.1,
     8, {{all, 1.0}, {all, 1.0}, {all, 1.0}, {all, 1.0}},
     {1.7, 7.5, {8.0, 1.8}, {15.0, 1.7}}},
    // not measured: avx2's by the instructions that a sum's terms and coefficients take beside that one's, with
    // look-ups in more than two registers counted twice: docs/performance.md
    {"neon",
     1.07, 0.2, 20.0, 7.0, 0.25,
     8, {{1, 1.0}, {2, 1.4}, {all, 3.1}, {all, 3.1}},
     {1.9, 8.5, {3.2, 1.3}, {14.0, 1.5}}},
};
// clang-format on

// A term where a beam leaves out or weakens some, in those where it does not: blocks that it lights in part, weights by
// powers or, where these do not serve, each in double.
constexpr double lit_cost = 1.45, faded_cost = 3.0;

// a coefficient, what a tap of its filter adds, a point of the transforms before
constexpr double made_ns = 1.2, filter_ns = 0.05, transform_ns = 5.5;

}  // namespace

const Costs& costs_of(const char* isa) {
    for (const Costs& costs : known) {
        if (std::strcmp(costs.isa, isa) == 0) return costs;
    }
    return known[2];
}

double term_ns(const Scene& scene, const Costs& costs, bool narrow, int block, double near, int degree,
               double oversampling, double part) {
    const double wide = narrow ? 1 : 2;
    const double own = wide * (costs.exact + costs.gathered * (degree + 1));
    if (block == 0) return own;
    const double lanes = costs.lanes / wide, padded = std::ceil(block / lanes) * lanes / block;
    // intervals that a vector of pixels spans, broadside to it
    const double span = lanes * scene.step * 2 * scene.survey.model.fs / scene.survey.model.c * oversampling;
    double before = 0, mean = 0;
    for (const Costs::Window& window : costs.windows) {
        const double below =
            std::isinf(window.registers) ? 1 : scene.flatter((window.registers * lanes - 1) / std::max(span, 1e-9));
        mean += (below - before) * window.times;
        before = below;
    }
    const double each = costs.coefficient * (degree + 1) * mean;
    // lines of which any pixel is that near are summed by halves, which cost twice what their number adds, and where a
    // vector is too long pixel by pixel
    const auto nearer = [&](double count) {
        return std::min(1.0, scene.within((near + block * scene.step / 2) * count / block) / part);
    };
    // polynomials in height too where pixels have any
    double count = block, lines = scene.pixels.heights.z ? 2 : 1;
    for (double more = lines; count > lanes; count /= 2) lines += 2 * more * nearer(count) * block / count;
    const double share = nearer(count);
    return share * own + (1 - share) * (wide * padded * ((scene.pixels.heights.z ? 1.2 : 1) * costs.term + each) +
                                        costs.line * lines / block);
}

double coefficient_ns(const Filter& filter) { return made_ns + filter_ns * filter.taps; }

double prepare_seconds(const Settings& settings, std::int64_t traces) {
    const double coefficients =
        static_cast<double>(settings.length) * settings.oversampling * (settings.filter.degree + 1);
    const double points = 3 * static_cast<double>(settings.n_fft);  // forward, and back to twice the rate
    const double made = coefficients * coefficient_ns(settings.filter) + transform_ns * points;
    return static_cast<double>(traces) * made * 1e-9;
}

double sum_seconds(const Scene& scene, const Settings& settings, const Costs& costs, double part) {
    if (part <= 0) return 0;
    const double term = term_ns(scene, costs, settings.narrow, settings.block, settings.near, settings.filter.degree,
                                settings.oversampling, part);
    const double beam = scene.light.shape == no_beam                                     ? 1.0
                        : scene.light.terms > 0 && !settings.quick && settings.block > 0 ? faded_cost
                                                                                         : lit_cost;
    return beam * part * scene.lit() * static_cast<double>(scene.traces()) * scene.each * term * 1e-9;
}

}  // namespace pysas
