// The core's scheduler, filters and C ABI without Python: run under the address, undefined-behaviour and thread
// sanitizers by `make sanitize`.

#include <algorithm>
#include <atomic>
#include <cmath>
#include <complex>
#include <cstdio>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "core/dispatch.hpp"
#include "core/errors.hpp"
#include "core/factorised.hpp"
#include "core/polynomials.hpp"
#include "core/threads.hpp"
#include "planning/callers.hpp"
#include "planning/crossings.hpp"
#include "planning/forest.hpp"
#include "planning/imaging.hpp"
#include "planning/layouts.hpp"
#include "planning/taps.hpp"
#include "pysas.h"
#include "tests/check.hpp"

namespace {

constexpr double pi = pysas::pi;

void every_task_runs_once() {
    for (const int threads : {1, 2, 5}) {
        std::vector<std::atomic<int>> times(1000);
        pysas::run(1000, threads, [&](std::int64_t i) { ++times[static_cast<std::size_t>(i)]; }, {});
        for (const auto& count : times) CHECK(count == 1);
        pysas::run(0, threads, [&](std::int64_t) { CHECK(false); }, {});
    }
}

void one_exception_comes_out() {
    for (const int threads : {1, 2, 5}) {
        std::atomic<int> after{0};
        bool caught = false;
        try {
            pysas::run(100000, threads,
                       [&](std::int64_t i) {
                           if (i % 7 == 3) throw std::runtime_error("injected");
                           ++after;
                       },
                       {});
        } catch (const std::runtime_error& error) {
            caught = std::strcmp(error.what(), "injected") == 0;
        }
        CHECK(caught && after < 50000);
    }
}

// A point at (0, 30, 0) seen from a line: Gaussian echoes whose spectrum is below 3e-9 beyond a quarter of the sample
// rate.
struct Scene {
    static constexpr int pings = 21, channels = 2, samples = 1200, side = 24;
    std::vector<double> tx, rx, velocity, weights;
    std::vector<std::complex<double>> data;
    std::vector<std::uint8_t> mask = std::vector<std::uint8_t>(side * side, 1);
    pysas_survey survey{};
    pysas_grid grid{};
    pysas_options options{};

    explicit Scene(bool moving) {
        const double fs = 40e3, fc = 100e3, c = 1500, t0 = 2 * 30.15 / c - 600 / fs;
        for (int ping = 0; ping < pings; ++ping) {
            const double x = 0.1 * (ping - pings / 2);
            tx.insert(tx.end(), {x, 0, 3});
            for (int channel = 0; channel < channels; ++channel) {
                const double at[3] = {x + 0.05 * channel, 0, 3};
                rx.insert(rx.end(), at, at + 3);
                velocity.insert(velocity.end(), {moving ? 2.0 : 0.0, 0, 0});
                weights.push_back(1 + 0.1 * channel);
                double tau = 0;
                for (int turn = 0; turn < 40; ++turn) {  // the receiver moves until the echo arrives
                    const double dx = at[0] + (moving ? 2.0 : 0.0) * tau;
                    tau = (std::hypot(x, std::hypot(30.0, 3.0)) + std::hypot(dx, std::hypot(30.0, 3.0))) / c;
                }
                for (int n = 0; n < samples; ++n) {
                    const double place = (fs * (t0 - tau) + n) / 4;
                    data.push_back(std::exp(-place * place / 2) * std::polar(1.0, -2 * pi * fc * tau));
                }
            }
        }
        survey = {sizeof survey, pings,   channels, samples, fs, fc, fs / 2, c,       t0,      nullptr, tx.data(),
                  rx.data(),     nullptr, nullptr,  nullptr, 0,  0,  0,      nullptr, nullptr, nullptr};
        if (moving) survey.velocity = velocity.data();
        if (moving) survey.weights = weights.data();
        grid.struct_size = sizeof grid;
        grid.height = grid.width = side;
        grid.first[0] = -0.12;
        grid.first[1] = 29.88;
        grid.along[0] = grid.down[1] = 0.01;
        options.struct_size = sizeof options;
        options.tol = 1e-3;
        options.dtype = PYSAS_COMPLEX128;
    }

    std::vector<std::complex<double>> through_trees(double& share) const {
        pysas::Wish wish = pysas::wish_of(options);
        wish.pay = false;
        const pysas::Imaging imaging(pysas::plan(pysas::scene_of(survey, grid, options), wish));
        share = imaging.plan().share();
        std::vector<std::complex<double>> out(side * side);
        const std::int64_t record = samples;
        imaging(
            pysas::View<const std::complex<double>, 3>{
                data.data(), {pings, channels, record}, {channels * record, record, 1}},
            pysas::View<std::complex<double>, 2>{out.data(), {side, side}, {side, 1}}, true, {});
        return out;
    }

    std::vector<std::complex<double>> image() const {
        std::vector<std::complex<double>> out(side * side);
        pysas_plan* plan = nullptr;
        const int code = pysas_plan_create(&survey, &grid, &options, &plan);
        CHECK(code == PYSAS_OK);
        if (code != PYSAS_OK) return out;
        CHECK(pysas_plan_execute(plan, data.data(), nullptr, out.data(), nullptr) == PYSAS_OK);
        pysas_plan_destroy(plan);
        return out;
    }
};

void a_point_is_imaged_at_its_place() {
    for (const bool moving : {false, true}) {
        Scene scene(moving);
        const double sum = Scene::pings * (moving ? 2.1 : 2.0);
        for (const std::string& isa : pysas::levels()) {
            scene.options.isa = isa.c_str();
            for (const double tol : {1e-2, 1e-4, 1e-5}) {
                scene.options.tol = tol;
                // every term is 1 at the point: the image there is their number
                const auto peak = scene.image()[12 * Scene::side + 12];
                CHECK(std::abs(peak - sum) < tol * sum);
            }
        }
    }
}

void threads_and_kinds_of_pixels_agree() {
    Scene scene(true);
    scene.options.tol = 1e-4;
    scene.mask[5] = 0;
    scene.grid.mask = scene.mask.data();
    const auto expected = scene.image();
    CHECK(expected[5] == 0.0);
    for (const int threads : {1, 2, 5}) {
        scene.options.threads = threads;
        CHECK(scene.image() == expected);
    }
    std::vector<double> points;
    for (int i = 0; i < Scene::side; ++i) {
        for (int j = 0; j < Scene::side; ++j) points.insert(points.end(), {-0.12 + 0.01 * j, 29.88 + 0.01 * i, 0});
    }
    scene.grid.points = points.data();
    const auto listed = scene.image();
    double worst = 0;
    for (std::size_t i = 0; i < expected.size(); ++i) worst = std::max(worst, std::abs(listed[i] - expected[i]));
    CHECK(worst < 1e-4 * 45);
}

// A trace that holds 1 everywhere makes sub-images of 1, whatever their rays: three such traces through leaves, a merge
// and a read give three times the carrier, exactly where linear interpolation of a constant is exact.
void a_constant_goes_through_the_tree() {
    using namespace pysas;
    constexpr double wave = 10, c = 1500, step = 0.0375;  // an interval of 20 kHz
    const float filter[2] = {1, 0};
    float halves[12] = {}, slopes[9] = {}, tap[7 * max_taps] = {};
    halves[8] = 0.5F;  // taps 2 and 3, the middle ones: 1/2 -+ x
    slopes[6] = -1.0F;
    tap[2] = tap[3] = 0.5F;
    tap[max_taps + 2] = -1.0F;
    tap[max_taps + 3] = 1.0F;
    const Taps taps = make_taps(6, halves, slopes, tap, filter, 1);
    Tree tree{};
    tree.taps = &taps;
    tree.wave = wave;
    tree.nodes.count = 5;
    std::vector<long double> places;
    for (int j = 0; j < 5; ++j) {
        tree.nodes.at[j] = j == 2 ? 0.0 : -std::cos(pi * (2 * j + 1) / 10);
        places.push_back(tree.nodes.at[j]);
    }
    for (std::size_t j = 0; j < 5; ++j) {
        std::vector<long double> column(5);
        column[j] = 1;
        monomials(places, column);
        for (std::size_t q = 0; q < 5; ++q) tree.nodes.fit[q][j] = static_cast<double>(column[q]);
    }
    double power = 2 * pi;  // Taylor series in turns^2
    for (int q = 0; q < 6; power *= -4 * pi * pi / ((2 * q + 2) * (2 * q + 3)), ++q) tree.sine[q] = power;
    power = 1;
    for (int q = 0; q < 7; power *= -4 * pi * pi / ((2 * q + 1) * (2 * q + 2)), ++q) tree.cosine[q] = power;
    constexpr std::int64_t stride = 1024, traces = 3;
    std::vector<float> table(traces * 4 * stride, 0.0F);
    for (std::int64_t i = 0; i < traces; ++i) std::fill_n(table.begin() + i * 4 * stride, stride, 1.0F);
    std::vector<Trace> sensors(traces);
    for (Trace& trace : sensors) {
        trace.tx[2] = trace.rx[2] = 3;
        trace.c = c;
        trace.last = 900;
    }
    Terms<float> terms{};
    terms.table = table.data();
    terms.trace_stride = 4 * stride;
    terms.plane_stride = stride;
    terms.degree = 1;
    terms.trig = 6;
    std::copy_n(tree.sine, 6, terms.sine);
    std::copy_n(tree.cosine, 7, terms.cosine);
    terms.traces = sensors.data();
    terms.n_trace = traces;
    terms.model = {c, wave * c / 2, 20e3, 1.0, 900, {pysas::no_beam, 0.0, 0.0}, 0.0, 0.0};
    terms.nodes = tree.nodes;
    for (const std::string& set : levels()) {
        const Kernels& kernels = kernels_for(set);
        // two leaves of one and two traces, and their parent, whose rays lie between the leaves'
        const double place[] = {0, 0, 3, 0, 1.0, 0.02, step, 0, 0, 3, 0, 1.0, 0.02, step, 0, 0, 3, 0, 1.1, 0.011, step};
        const std::int64_t shape[] = {100, 60, 432, 0, 0, 100, 60, 432, 2 * 60 * 432, 0, 120, 90, 352, 0, 60};
        std::vector<std::int32_t> range(2 * 150);
        for (std::size_t r = 0; r < 150; ++r) range[2 * r + 1] = r < 60 ? 340 : 250;
        std::vector<float> below(4 * 60 * 432), above(2 * 90 * 352);
        const std::int64_t n_range = static_cast<std::int64_t>(range.size());
        const auto leaf =
            sub_images(place, shape, 2, range.data(), n_range, below.data(), static_cast<std::int64_t>(below.size()));
        const auto top = sub_images(place + 14, shape + 10, 1, range.data(), n_range, above.data(),
                                    static_cast<std::int64_t>(above.size()));
        const std::int64_t span[] = {0, 1, 3}, first[] = {0, 1};
        leaves(kernels, tree, terms, span, leaf.data(), 2, 1e-5, false, false, 2, {});
        merge(kernels, tree, leaf.data(), first, top.data(), 1, nullptr, terms.light, false, false, false, 2, {});
        merge(kernels, tree, leaf.data() + 1, first, top.data(), 1, nullptr, terms.light, true, true, true, 2, {});
        std::vector<double> begin, along;
        for (int r = 0; r < 40; ++r) {
            for (const double v : {-1.0, 9.0 + 0.02 * r, 0.0}) begin.push_back(v);
            for (const double v : {0.02, 0.0, 0.0}) along.push_back(v);
        }
        std::vector<std::complex<float>> image(40 * 100);
        const Raster raster{begin.data(), along.data(), nullptr, nullptr, 40, 100, 50};
        const std::vector<std::uint8_t> wanted(4, 1);
        const View<std::complex<float>, 2> to{image.data(), {40, 100}, {100, 1}};
        read(kernels, tree, top[0], raster, nullptr, wanted.data(), to, 2, {});
        double worst = 0;
        for (int r = 0; r < 40; ++r) {
            for (int m = 0; m < 100; ++m) {
                const double x = -1 + 0.02 * m, y = 9 + 0.02 * r, range_to = std::sqrt(x * x + y * y + 9);
                const auto expected = std::polar(3.0, 2 * pi * wave * range_to);
                worst = std::max(worst, std::abs(std::complex<double>(to(r, m)) - expected));
            }
        }
        CHECK(worst < 0.01);  // the Taylor series' 5e-4, three times on the way
    }
    bool caught = false;
    try {
        const std::int64_t shape[] = {0, 60, 432, 0, 0};
        const double place[7] = {};
        std::vector<std::int32_t> range(120);
        std::vector<float> store(2 * 60 * 432 - 1);
        sub_images(place, shape, 1, range.data(), 120, store.data(), static_cast<std::int64_t>(store.size()));
    } catch (const Error& error) {
        caught = error.code == Code::argument;
    }
    CHECK(caught);
}

// The same point through a tree, which need not take less time than so small a direct sum.
void a_point_goes_through_a_tree() {
    for (const bool moving : {false, true}) {
        Scene scene(moving);
        scene.options.method = PYSAS_FFBP;
        const double sum = Scene::pings * (moving ? 2.1 : 2.0);
        for (const std::string& isa : pysas::levels()) {
            scene.options.isa = isa.c_str();
            for (const double tol : {1e-1, 1e-2, 1e-3, 1e-4, 1e-5}) {
                scene.options.tol = tol;
                scene.options.threads = 1;
                double share = 0;
                const auto image = scene.through_trees(share);
                CHECK(share == (tol < 3e-5 ? 0 : 1));  // below it float trees would round too much
                CHECK(std::abs(image[12 * Scene::side + 12] - sum) < tol * sum);
                scene.options.threads = 3;
                CHECK(scene.through_trees(share) == image);
                scene.options.method = PYSAS_BACKPROJECTION;
                const auto direct = scene.image();
                scene.options.method = PYSAS_FFBP;
                double apart = 0;
                for (std::size_t i = 0; i < image.size(); ++i) apart = std::max(apart, std::abs(image[i] - direct[i]));
                CHECK((apart > 0) == (share > 0) && apart < tol * sum);
            }
        }
    }
}

void taps_are_as_good_as_they_say() {
    const double designs[][3] = {{6, 1.2, 8}, {6, 1.5, 8}, {8, 1.4, 10}, {8, 1.6, 10}};
    for (const auto& d : designs) {
        const pysas::TapDesign design = pysas::design_taps(static_cast<int>(d[0]), d[1], static_cast<int>(d[2]));
        const pysas::Taps& taps = design.taps;
        double worst = 0, mirrored = 0;
        for (int i = 0; i <= 300; ++i) {
            const double f = 0.5 / d[1] * i / 300;
            double response = taps.filter[0];
            for (int k = 1; k <= taps.half; ++k) response += 2 * std::cos(2 * pi * f * k) * taps.filter[k];
            for (int j = 0; j <= 20; ++j) {
                const double x = j / 20.0 - 0.5;
                std::complex<double> sum = 0;
                for (int t = 0; t < taps.count; ++t) {
                    double weight = 0;
                    for (int q = taps.count; q >= 0; --q) weight = weight * x + static_cast<double>(taps.tap[q][t]);
                    sum += weight * std::polar(1.0, 2 * pi * f * (t - (taps.count - 1) / 2.0 - x));
                    const int p = std::min(t, taps.count - 1 - t);
                    double even = 0, odd = 0;
                    for (int q = taps.count / 2; q >= 0; --q)
                        even = even * x * x + static_cast<double>(taps.even[p][q]);
                    for (int q = taps.count / 2 - 1; q >= 0; --q)
                        odd = odd * x * x + static_cast<double>(taps.odd[p][q]);
                    mirrored = std::max(mirrored, std::abs(even + (t == p ? odd : -odd) * x - weight));
                }
                worst = std::max(worst, std::abs(response * sum - 1.0));
            }
        }
        CHECK(worst > 0.8 * design.worst && worst < 1.1 * design.worst);
        CHECK(design.rms > 0.1 * design.worst && design.rms < design.worst);
        CHECK(mirrored < 1e-6);
    }
}

// What is wrong with a level: whether places at a bearing and a slant range have nodes on all sides that taps read.
bool covered(const pysas::Level& level, std::size_t image, const pysas::Taps& taps, double bearing, double range) {
    const double* place = level.place.data() + 7 * image;
    const std::int64_t* shape = level.shape.data() + 5 * image;
    const double width = static_cast<double>(shape[1]) * place[5];
    double turn = bearing - place[4];
    turn -= 2 * pi * std::floor((turn - (width - 2 * pi) / 2) / (2 * pi));
    const auto ray = static_cast<std::int64_t>(std::floor(turn / place[5]));
    const auto node = static_cast<std::int64_t>(std::floor(range / place[6])) - shape[0];
    for (std::int64_t r = ray - taps.count / 2 + 1; r <= ray + taps.count / 2; ++r) {
        if (r < taps.half || r >= shape[1] - taps.half) return false;
        const std::int32_t* ends = level.range.data() + 2 * (shape[4] + r);
        // of the nodes summed the filter spoils some at either end
        if (node - taps.count / 2 + 1 < ends[0] + taps.half || node + taps.count / 2 >= ends[1] - taps.half)
            return false;
    }
    return true;
}

void a_forest_holds_every_trace_and_serves_every_read() {
    using pysas::batches_of, pysas::tiles_of, pysas::Tiling, pysas::TreeBatch;
    using pysas::cheapest, pysas::cleared, pysas::costs_of, pysas::design_taps, pysas::Forest, pysas::GroupTree;
    using pysas::Kinds, pysas::Layout, pysas::Level, pysas::make_forest, pysas::Pixels, pysas::Raster, pysas::Survey;
    Survey survey{};
    for (int ping = 0; ping < 60; ++ping) {  // a bent track with a gap, two receivers behind the transmitter
        const double x = 0.1 * ping + (ping > 40 ? 1.5 : 0) - 3.7, y = 0.3 * std::sin(0.2 * ping);
        for (int channel = 0; channel < 2; ++channel)
            survey.traces.push_back(
                {{x, y - 25, 5 + 0.1 * y}, {x - 0.1 - 0.2 * channel, y - 25, 5}, {}, {}, {}, 0, 1500, 0, 2999, 0, 0});
    }
    survey.model = {1500, 100e3, 40e3, 1, 2999, {pysas::no_beam, 0, 0}, 0, 0};
    survey.band = 0.375;
    survey.single = true;
    survey.channels = 2;
    survey.weights.assign(survey.traces.size(), 1.0);
    const std::size_t traces = survey.traces.size();
    constexpr int height = 130, width = 100;
    Pixels pixels;
    pixels.height = height;
    pixels.width = width;
    for (int line = 0; line < height; ++line) {
        pixels.first.insert(pixels.first.end(), {-1, 0.02 * line - 1.3, 0});
        pixels.step.insert(pixels.step.end(), {0.02, 0, 0});
    }
    pixels.mask.assign(height * width, 1);
    std::fill_n(pixels.mask.begin(), 32 * width, std::uint8_t{0});
    const pysas::Scene scene(survey, pixels, {-1, -1.3, 0}, {0.98, 1.28, 0});
    CHECK(scene.audible == static_cast<std::int64_t>(traces) && scene.wanted == (height - 32) * width);
    const auto image = tiles_of(scene, 64);
    CHECK(image.size() == 1 && image[0].flat && image[0].pixels.size() == 10);
    CHECK(image[0].pixels[0] == 0 && image[0].pixels[9] == 2 * 36);
    const Kinds kinds{{{2}, design_taps(6, 1.5, 8)}};
    const auto found = cheapest(scene, kinds, costs_of("baseline"), nullptr, 1.05, 0, 1);
    CHECK(!found.empty() && found[0].layout.length > 0 && found[0].all > 0 && found[0].cost <= found.back().cost);
    if (found.empty()) return;
    const Layout layout = cleared(scene, found[0].layout, 5.1, 1e-5, 1e-5, 1e-3, 0);
    CHECK(layout.clear > 5 && layout.clear < 20);
    CHECK(cleared(scene, layout, 5.1, 1e-7, 1e-7, 1e-3, 0).clear > layout.clear);
    auto lined = image;
    lined[0].lines = pysas::parallel_of(scene, 0, height, 64, 1e-3);
    CHECK(lined[0].lines.has_value());
    const Raster raster{
        scene.pixels.first.data(), scene.pixels.step.data(), nullptr, scene.pixels.mask.data(), height, width, 64};
    const pysas::Tick none;
    pysas::Poll poll(none);
    const pysas::Served judged = pysas::served(scene, image, layout, 1, {1, 0, 0});
    CHECK(std::abs(judged.share - 1) < 0.1 && judged.planes == 1 && judged.groups > 1);
    std::ptrdiff_t columns = 0;
    for (const std::vector<int>& fans :
         {layout.fans, {}, {2}, {4, 2}, {4, 4, 2}, {pysas::by_ping}, {2, pysas::by_ping}}) {
        Layout cut = layout;
        cut.fans = fans;
        cut.length = 3;
        cut.crossing = fans.size() < 2 ? 0.045 : 0;
        cut.positions = 1e-4;
        const auto planned = make_forest(scene, lined, cut, 1, {1, 0, 0}, 0, false, poll, 2);
        CHECK(planned && planned->share == 1 && planned->count > 1 && planned->forest.sections.size() == 1);
        if (!planned) continue;
        const Forest& forest = planned->forest;
        // at least as dense as the echoes' own band asks, as dense as tables' intervals
        CHECK(forest.step < 1500 / (4 * 15e3 * cut.taps.rate));
        CHECK(std::abs(forest.step * 2 * 40e3 * forest.phases / forest.per_samples / 1500 - 1) < 1e-12);
        std::vector<std::int64_t> seen;
        for (const GroupTree& tree : forest.sections[0].trees) {
            seen.insert(seen.end(), tree.traces.begin(), tree.traces.end());
            CHECK(tree.levels.size() == fans.size() + 1);
            CHECK(tree.levels.front().span.back() == static_cast<std::int64_t>(tree.traces.size()));
            for (std::size_t i = 1; i < tree.levels.size(); ++i)
                CHECK(tree.levels[i].span.back() == tree.levels[i - 1].count());
            std::int64_t traces_in = 0;
            for (const TreeBatch& batch : batches_of(tree, 7)) {
                CHECK(batch.begin == traces_in && batch.end > batch.begin && batch.last > batch.first);
                traces_in = batch.end;
            }
            CHECK(traces_in == tree.levels.front().span.back());
            const bool by_pings = !fans.empty() && fans.back() == pysas::by_ping;
            CHECK(tree.lit == (by_pings ? 0 : -1));
            // halves of a group may have a ping's channels each
            CHECK(!by_pings || fans.size() > 1 || 2 * tree.levels[0].count() == tree.levels[0].span.back());
            columns += std::count(tree.read.begin(), tree.read.end(), pysas::by_columns);
            CHECK(cut.crossing > 0 || along(tree) == false);
            const Level& top = tree.levels.back();
            CHECK(top.count() == 1);
            bool all = true;
            const Tiling tiling(raster);
            for (std::int64_t number = 0; number < tiling.count(); ++number) {
                const bool wanted = image[0].pixels[static_cast<std::size_t>(number)] > 0;
                CHECK((tree.read[static_cast<std::size_t>(number)] != pysas::unread) == wanted);
                const Tiling::Tile tile = tiling.at(number);
                for (std::int64_t line = tile.top; wanted && line < tile.bottom; ++line) {
                    for (std::int64_t k = tile.left; k < tile.right; ++k) {
                        const double x = raster.first[3 * line] + 0.02 * static_cast<double>(k) - top.place[0],
                                     y = raster.first[3 * line + 1] - top.place[1];
                        all = all && covered(top, 0, cut.taps.taps, std::atan2(y, x),
                                             std::sqrt(x * x + y * y + top.place[2] * top.place[2]));
                    }
                }
            }
            CHECK(all);
            // and every node that a parent sums, from each child
            for (std::size_t i = 1; i < tree.levels.size(); ++i) {
                const Level &above = tree.levels[i], &below = tree.levels[i - 1];
                for (std::size_t number = 0; number + 1 < above.span.size(); ++number) {
                    const double* place = above.place.data() + 7 * number;
                    const std::int64_t* shape = above.shape.data() + 5 * number;
                    for (std::int64_t r = 0; r < shape[1]; ++r) {
                        const std::int32_t* ends = above.range.data() + 2 * (shape[4] + r);
                        const double ray = place[4] + static_cast<double>(r) * place[5];
                        for (std::int64_t m = ends[0]; m < ends[1]; m += 5) {
                            const double range = static_cast<double>(shape[0] + m) * place[6];
                            const double ground = std::sqrt(range * range - place[2] * place[2]);
                            for (std::int64_t c = above.span[number]; c < above.span[number + 1]; ++c) {
                                const double* child = below.place.data() + 7 * c;
                                const double x = place[0] + ground * std::cos(ray) - child[0],
                                             y = place[1] + ground * std::sin(ray) - child[1];
                                all = all && covered(below, static_cast<std::size_t>(c), cut.taps.taps,
                                                     std::atan2(y, x), std::sqrt(x * x + y * y + child[2] * child[2]));
                            }
                        }
                    }
                }
            }
            CHECK(all);
        }
        std::sort(seen.begin(), seen.end());
        CHECK(seen.size() == traces && seen.front() == 0 && std::unique(seen.begin(), seen.end()) == seen.end());
    }
    CHECK(columns > 0);
}

}  // namespace

void test_recipes();  // test_core_recipes.cpp

int main() {
    every_task_runs_once();
    one_exception_comes_out();
    a_point_is_imaged_at_its_place();
    threads_and_kinds_of_pixels_agree();
    a_constant_goes_through_the_tree();
    a_point_goes_through_a_tree();
    taps_are_as_good_as_they_say();
    a_forest_holds_every_trace_and_serves_every_read();
    test_recipes();
    std::printf("test_core: %s\n", failures == 0 ? "passed" : "FAILED");
    return failures == 0 ? 0 : 1;
}
