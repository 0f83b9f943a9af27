// Part of test_core: transforms against sums written out, and recipes whose answers must agree.

#include <algorithm>
#include <cmath>
#include <complex>
#include <functional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "core/dispatch.hpp"
#include "core/errors.hpp"
#include "core/polynomials.hpp"
#include "core/recipe.hpp"
#include "core/room.hpp"
#include "core/summation.hpp"
#include "core/transforms.hpp"
#include "planning/crossings.hpp"
#include "tests/check.hpp"

namespace {

using namespace pysas;
using Single = std::complex<float>;

template <typename Real>
void sums_of(std::int64_t n, double error) {
    constexpr std::int64_t lanes = 2 * transform_lanes<Real>;
    const Transform<Real> transform(n);
    for (const auto& set : levels()) {
        std::vector<Real> room(static_cast<std::size_t>(4 * n * lanes));
        Real* const at = room.data();
        for (std::int64_t i = 0; i < 2 * n * lanes; ++i)
            at[i] = static_cast<Real>(std::sin(0.7 * double(i * i % 1009)));
        const std::vector<Real> in(room);
        const auto out =
            transform(kernels_for(set), {at, at + n * lanes}, {at + 2 * n * lanes, at + 3 * n * lanes}, lanes);
        double wrong = 0, all = 0;
        for (std::int64_t lane = 0; lane < lanes; lane += 3) {
            for (std::int64_t k = 0; k < n; ++k) {
                std::complex<double> sum = 0;
                for (std::int64_t m = 0; m < n; ++m) {
                    const auto place = static_cast<std::size_t>(m * lanes + lane);
                    sum += std::complex<double>(in[place], in[place + static_cast<std::size_t>(n * lanes)]) *
                           root_of_unity(-k * m, n);
                }
                wrong += std::norm(sum - std::complex<double>(out.re[k * lanes + lane], out.im[k * lanes + lane]));
                all += std::norm(sum);
            }
        }
        CHECK(wrong <= error * error * all);
    }
}

void transforms_are_sums() {
    for (const std::int64_t n : {1, 2, 3, 4, 5, 8, 30, 125, 144, 360}) {
        sums_of<float>(n, 3e-7);
        sums_of<double>(n, 1e-15);
    }
    CHECK(fast_length(1) == 1 && fast_length(7) == 8 && fast_length(121) == 125 && fast_length(4097) == 4320);
    bool caught = false;
    try {
        const Transform<float> none(13);
    } catch (const std::logic_error&) {
        caught = true;
    }
    CHECK(caught);
}

constexpr std::int64_t pings = 24, samples = 400, height = 5, width = 70;

Recipe recipe() {
    Recipe out{};
    out.model = {1500, 30e3, 20e3, 0, double(samples - 1), {pysas::no_beam, 0, 0}, 0, 0};
    out.kind = Kind::monostatic;
    out.narrow = true;
    out.channels = 1;
    out.batch = 10;
    for (std::int64_t i = 0; i < pings; ++i) {
        Trace trace{};
        trace.c = 1500;
        trace.last = double(samples - 1);
        trace.tx[0] = trace.rx[0] = 0.1 * double(i) - 1.2;
        trace.tx[1] = trace.rx[1] = -8;
        out.traces.push_back(trace);
        out.weights.emplace_back(1, 0.1 * double(i));
    }
    out.reader.filter = design(0.3, 3, 2, 1, 1e-4, 8, 60);
    out.reader.length = samples;
    out.model.rate = 2;
    fit_trigonometry(5, out.sine, out.cosine);
    out.nodes.count = Sizes<float>::nodes;
    for (int j = 0; j < out.nodes.count; ++j) {
        out.nodes.at[j] = j == 2 ? 0.0 : -std::cos(pi * (2 * j + 1) / 10);
    }
    for (std::size_t j = 0; j < 5; ++j) {
        std::vector<double> at(out.nodes.at, out.nodes.at + 5), column(5);
        column[j] = 1;
        monomials(at, column);
        for (std::size_t q = 0; q < 5; ++q) out.nodes.fit[q][j] = column[q];
    }
    out.image.height = height;
    out.image.width = width;
    out.image.count = 16;
    for (std::int64_t i = 0; i < height; ++i) {
        for (const double x : {-0.7, 0.02 * double(i), 0.0}) out.image.first.push_back(x);
        for (const double x : {0.02, 0.0, 0.0}) out.image.step.push_back(x);
    }
    return out;
}

std::vector<Single> image_of(const Recipe& recipe, int threads, const Tick& tick = {}, double* terms = nullptr) {
    std::vector<Single> data(pings * samples), image(height * width);
    for (std::int64_t i = 0; i < pings * samples; ++i) {
        const auto n = double(i % samples);
        data[static_cast<std::size_t>(i)] = std::polar(1.0F, static_cast<float>(0.3 * n + 0.2 * std::sin(0.1 * n)));
    }
    std::vector<std::uint8_t> used(pings, 1);
    used[3] = 0;
    const bool straight = recipe.image.lined();
    const View<Single, 2> to{image.data(), {straight ? height : 1, straight ? width : height * width}, {width, 1}};
    const View<const Single, 3> from{data.data(), {pings, 1, samples}, {samples, samples, 1}};
    Workspace work;
    const Totals totals = run(recipe, from, used.data(), 2.0, to, threads, kernels_for("auto"), work, tick);
    if (terms) *terms = static_cast<double>(totals.terms);
    return image;
}

double apart(const std::vector<Single>& a, const std::vector<Single>& b) {
    double wrong = 0, all = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        wrong += std::norm(a[i] - b[i]);
        all += std::norm(a[i]);
    }
    return std::sqrt(wrong / all);
}

// The lines of a recipe as points.
std::function<void(std::int64_t, std::int64_t, double*)> points_of(const Recipe& lines) {
    return [&lines](std::int64_t begin, std::int64_t end, double* out) {
        for (std::int64_t i = begin; i < end; ++i) {
            for (std::size_t axis = 0; axis < 3; ++axis) {
                const auto row = 3 * static_cast<std::size_t>(i / width) + axis;
                *out++ = lines.image.first[row] + double(i % width) * lines.image.step[row];
            }
        }
    };
}

// Rows that hear all traces are the image, and so are those of its two halves together; row i of its own traces is the
// same from lines and from points, whatever the threads.
void rows_hear_their_own() {
    const Recipe lines = recipe();
    const auto hearing = [&](const std::function<std::pair<std::int64_t, std::int64_t>(std::int64_t)>& of) {
        Recipe out = lines;
        for (std::int64_t row = 0; row < height; ++row) {
            const auto [first, last] = of(row);
            out.image.hears.insert(out.image.hears.end(), {first, last});
        }
        return out;
    };
    const auto whole = image_of(lines, 1);
    CHECK(apart(whole, image_of(hearing([](auto) { return std::make_pair(0, pings - 1); }), 2)) < 1e-6);
    auto both = image_of(hearing([](auto) { return std::make_pair(0, 12); }), 2);
    const auto other = image_of(hearing([](auto) { return std::make_pair(13, pings - 1); }), 2);
    for (std::size_t i = 0; i < both.size(); ++i) both[i] += other[i];
    CHECK(apart(whole, both) < 1e-6);
    const Recipe own = hearing([](auto row) { return std::make_pair(2 * row, 7 * row / 2 + 3); });
    double terms = 0;
    const auto found = image_of(own, 1, {}, &terms);
    CHECK(terms == double((3 + 4 + 7 + 8 + 10) * width));  // trace 3 is not used
    CHECK(apart(found, image_of(own, 3)) == 0);
    Recipe points = own;
    points.image.points = points_of(lines);
    points.image.first.clear();
    CHECK(apart(found, image_of(points, 2)) < 1e-4);
}

void recipes_agree() {
    const Recipe lines = recipe();
    double terms = 0;
    const auto first = image_of(lines, 1, {}, &terms);
    CHECK(terms == double((pings - 1) * height * width));
    CHECK(apart(first, image_of(lines, 3)) == 0);
    Recipe points = lines;
    points.image.first.clear();
    points.image.points = points_of(lines);
    CHECK(apart(first, image_of(points, 2)) < 1e-4);
    for (const bool wide : {false, true}) {
        Recipe lowered = lines;
        lowered.reader.cut = Reader::Cut{fast_length(samples + 100), {}};
        lowered.reader.wide = wide;
        lowered.reader.filter = design(0.25, 3, 2, 1, 1e-4, 8, 8);
        lowered.model.rate = 4;
        CHECK(apart(first, image_of(lowered, 2)) < 3e-3);  // the filter's ends ring more than W's
        CHECK(apart(image_of(lowered, 1), image_of(lowered, 3)) == 0);
    }
    Recipe views = points;
    views.views = ViewWeights{1};
    CHECK(apart(image_of(views, 1), image_of(views, 3)) == 0);
}

// Heights off lines, by polynomials in them, by halves of blocks where they are too near for these, and where nothing
// but every pixel's own delay is allowed.
void heights_agree() {
    std::vector<double> z;
    for (std::int64_t i = 0; i < height * width; ++i) z.push_back(3 + 0.04 * std::sin(0.37 * double(i)));
    Recipe hills = recipe();
    hills.image.heights = {z.data(), width, 1, 3};
    hills.rise = {20, 20, 1};
    Recipe points = hills;
    points.image.first.clear();
    points.image.heights = {};
    points.image.points = [&](std::int64_t begin, std::int64_t end, double* out) {
        for (std::int64_t i = begin; i < end; ++i) {
            const auto row = 3 * static_cast<std::size_t>(i / width);
            *out++ = hills.image.first[row] + double(i % width) * hills.image.step[row];
            *out++ = hills.image.first[row + 1];
            *out++ = z[static_cast<std::size_t>(i)] - 3;
        }
    };
    const auto exact = image_of(points, 1);
    for (const double near : {0.0, 12.0, 1e3}) {
        for (const int count : {16, 64, 70 - 64}) {
            Recipe one = hills;
            one.model.near = near;
            one.image.count = count;
            for (std::int64_t left = 0; left < width; left += count)
                one.image.spans.insert(one.image.spans.end(), {-0.04, 0.04});
            CHECK(apart(exact, image_of(one, 2)) < 1e-4);
            one.rise.highest = 0.01;
            CHECK(apart(exact, image_of(one, 1)) < 1e-5);
        }
    }
}

void runs_stop() {
    std::vector<double> shares;
    image_of(recipe(), 2, [&](double share) {
        shares.push_back(share);
        return true;
    });
    CHECK(shares.size() > 2 && std::is_sorted(shares.begin(), shares.end()) && shares.back() > 0.99 &&
          shares.back() < 1);
    bool caught = false;
    try {
        image_of(recipe(), 2, [](double) { return false; });
    } catch (const Error& error) {
        caught = error.code == Code::cancelled;
    }
    CHECK(caught);
}

// A degree, number of terms or of nodes that kernels are not compiled for cannot run as another.
template <typename Real>
void only_what_is_compiled_runs() {
    using Sizes = pysas::Sizes<Real>;
    const auto refused = [](int degree, int terms, int nodes) {
        pysas::Terms<Real> some{};
        some.degree = degree;
        some.trig = terms;
        some.nodes.count = nodes;
        try {
            pysas::compiled(some);
        } catch (const std::logic_error&) {
            return true;
        }
        return false;
    };
    for (int degree = 0; degree <= pysas::max_degree; ++degree)
        CHECK(refused(degree, Sizes::terms[0], Sizes::nodes) != pysas::has_degree<Sizes>(degree));
    CHECK(refused(Sizes::degrees[0], Sizes::terms[0] + 3, Sizes::nodes));
    CHECK(refused(Sizes::degrees[0], Sizes::terms[0], Sizes::nodes - 2));
    pysas::Filter filter;
    filter.degree = 6;
    bool caught = false;
    try {
        pysas::prepare<Real, std::complex<Real>>(pysas::kernels_for("auto"), {}, filter, nullptr, 0, 1, {});
    } catch (const std::logic_error&) {
        caught = true;
    }
    CHECK(caught);
}

void names_of_sets() {
    CHECK(kernels_for("auto").name == levels().back());
    bool caught = false;
    try {
        kernels_for("mmx");
    } catch (const Error& error) {
        caught = error.code == Code::argument;
    }
    CHECK(caught);
}

// Lines that lead away from a group, and how fast rays cross them.
void lines_lead_away() {
    Survey survey{};
    survey.traces.push_back({{0, -25, 5}, {0, -25, 5}, {}, {}, {}, 0, 1500, 0, 2999, 0, 0});
    survey.model = {1500, 100e3, 40e3, 1, 2999, {no_beam, 0, 0}, 0, 0};
    survey.band = 0.375;
    survey.single = true;
    survey.channels = 1;
    survey.weights.assign(1, 1.0);
    Pixels pixels;
    pixels.height = 130;
    pixels.width = 100;
    for (int line = 0; line < 130; ++line) {
        pixels.first.insert(pixels.first.end(), {-1, 0.02 * line - 1.3, 0});
        pixels.step.insert(pixels.step.end(), {0.02, 0, 0});
    }
    Pixels bent = pixels;
    bent.first[3 * 64] += 1e-5;
    const Scene scene(survey, pixels, {-1, -1.3, 0}, {0.98, 1.28, 0}),
        other(survey, bent, {-1, -1.3, 0}, {0.98, 1.28, 0});
    // as far apart as their pixels: columns may be as long as blocks, but where floats would round too much
    const auto lines = parallel_of(scene, 0, 130, 64, 1e-3);
    CHECK(lines && lines->column == 64 && lines->line == 64);
    CHECK(!parallel_of(scene, 0, 1, 64, 1e-3) && parallel_of(scene, 0, 130, 64, 1e-6)->column < least_stretch);
    CHECK(!parallel_of(other, 0, 130, 64, 1e-3) && parallel_of(other, 65, 130, 64, 1e-3));
    CHECK(turning({0, 25, 0}, {0, 1, 0}, 5) == 0 && std::isinf(turning({0, 25, 0}, {1, 0, 0}, 5)));
    // d(bearing)/d(slant range) of a column 2 m beside a centre 5 m up, by differences
    const auto at = [](double y) { return std::pair(std::atan2(2, y), std::sqrt(4 + y * y + 25)); };
    const auto low = at(24.999), high = at(25.001);
    const double slope = (low.first - high.first) / (high.second - low.second);
    CHECK(std::abs(turning({2, 25, 0}, {0, -1, 0}, 5) / slope - 1) < 1e-6);
}

}  // namespace

void test_recipes() {
    names_of_sets();
    lines_lead_away();
    only_what_is_compiled_runs<float>();
    only_what_is_compiled_runs<double>();
    transforms_are_sums();
    recipes_agree();
    rows_hear_their_own();
    heights_agree();
    runs_stop();
}
