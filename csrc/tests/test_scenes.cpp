// Scenes from a file, whose answers the float64 oracle of the Python package gave, through the C ABI: tolerances are
// kept on every instruction set, by direct sums and by trees, and the image does not depend on the number of threads.
// `make qemu` runs this; tests/oracle_scenes.py writes the file and says what is in it.

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <string>
#include <vector>

#include "core/dispatch.hpp"
#include "planning/callers.hpp"
#include "planning/imaging.hpp"
#include "pysas.h"
#include "tests/check.hpp"

namespace {

using Numbers = std::vector<double>;

// Doubles in this machine's order, after how many they are.
Numbers read_numbers(std::FILE* file) {
    double count = 0;
    if (std::fread(&count, sizeof count, 1, file) != 1) return {};
    Numbers out(static_cast<std::size_t>(count));
    if (std::fread(out.data(), sizeof(double), out.size(), file) != out.size()) {
        std::fprintf(stderr, "a file of scenes that ends in the midst of one\n");
        std::exit(1);
    }
    return out;
}

struct Scene {
    std::string name;
    Numbers scalars, t0, tx, rx, velocity, boresight, axis, points, data, pixels, exact, level;
    Numbers direct[2], trees;  // tolerances: of sums in complex64 and complex128, of trees
    pysas_survey survey{};
    pysas_grid grid{};
    bool must_pay = false;

    explicit Scene(std::FILE* file) {
        for (const double letter : read_numbers(file)) name += static_cast<char>(letter);
        for (Numbers* numbers : {&scalars, &t0, &tx, &rx, &velocity, &boresight, &axis, &points, &data, &pixels, &exact,
                                 &level, &direct[0], &direct[1], &trees})
            *numbers = read_numbers(file);
        if (name.empty()) return;
        const auto whole = [this](std::size_t i) { return static_cast<std::int64_t>(scalars[i]); };
        const auto given = [](const Numbers& numbers) { return numbers.empty() ? nullptr : numbers.data(); };
        survey.struct_size = sizeof survey;
        survey.n_ping = whole(0), survey.n_channel = whole(1), survey.n_sample = whole(2);
        survey.fs = scalars[3], survey.fc = scalars[4], survey.bandwidth = scalars[5], survey.c = scalars[6];
        survey.ping_t0 = t0.data(), survey.tx = tx.data(), survey.rx = rx.data();
        survey.velocity = given(velocity), survey.boresight = given(boresight), survey.beam_axis = given(axis);
        survey.beam_half_angle = scalars[7], survey.beam_taper = scalars[8];
        survey.beam_shape = static_cast<std::int32_t>(scalars[9]);
        grid.struct_size = sizeof grid;
        grid.height = whole(10), grid.width = whole(11);
        std::copy_n(&scalars[12], 3, grid.first);
        std::copy_n(&scalars[15], 3, grid.along);
        std::copy_n(&scalars[18], 3, grid.down);
        grid.points = given(points);
        must_pay = scalars[21] != 0;
    }

    template <typename Real>
    std::vector<std::complex<Real>> samples() const {
        std::vector<std::complex<Real>> out;
        for (std::size_t i = 0; i < data.size(); i += 2)
            out.emplace_back(static_cast<Real>(data[i]), static_cast<Real>(data[i + 1]));
        return out;
    }

    double error(const std::vector<std::complex<double>>& image) const {
        double wrong = 0, coherent = 0, incoherent = 0;
        for (std::size_t i = 0; i < pixels.size(); ++i) {
            const std::complex<double> right(exact[2 * i], exact[2 * i + 1]);
            wrong += std::norm(image[static_cast<std::size_t>(pixels[i])] - right);
            coherent += std::norm(right);
            incoherent += level[i] * level[i];
        }
        return std::sqrt(wrong / std::max(coherent, incoherent));
    }
};

struct Result {
    std::vector<std::complex<double>> image;
    double share = 0;
};

template <typename Real>
Result through_abi(const Scene& scene, const pysas_options& options) {
    const auto data = scene.samples<Real>();
    std::vector<std::complex<Real>> image(static_cast<std::size_t>(scene.grid.height * scene.grid.width));
    pysas_plan* plan = nullptr;
    int code = pysas_plan_create(&scene.survey, &scene.grid, &options, &plan);
    if (code == PYSAS_OK) code = pysas_plan_execute(plan, data.data(), nullptr, image.data(), nullptr);
    if (code != PYSAS_OK) std::fprintf(stderr, "%s: %s\n", scene.name.c_str(), pysas_strerror(code));
    CHECK(code == PYSAS_OK);
    Result out{{image.begin(), image.end()}, pysas_plan_factorised_share(plan)};
    pysas_plan_destroy(plan);
    return out;
}

// By trees that take longer than the direct sum would: so small a scene has no others.
template <typename Real>
Result through_any_trees(const Scene& scene, const pysas_options& options) {
    using Sample = std::complex<Real>;
    const auto data = scene.samples<Real>();
    const std::int64_t height = scene.grid.height, width = scene.grid.width;
    const std::int64_t channels = scene.survey.n_channel, record = scene.survey.n_sample;
    std::vector<Sample> image(static_cast<std::size_t>(height * width));
    pysas::Wish wish = pysas::wish_of(options);
    wish.pay = false;
    const pysas::Imaging imaging(pysas::plan(pysas::scene_of(scene.survey, scene.grid, options), wish));
    imaging(
        pysas::View<const Sample, 3>{
            data.data(), {scene.survey.n_ping, channels, record}, {channels * record, record, 1}},
        pysas::View<Sample, 2>{image.data(), {height, width}, {width, 1}}, true, {});
    return {{image.begin(), image.end()}, imaging.plan().share()};
}

Result image_of(const Scene& scene, const pysas_options& options) {
    const bool any = options.method == PYSAS_FFBP && !scene.must_pay;
    if (options.dtype == PYSAS_COMPLEX64)
        return any ? through_any_trees<float>(scene, options) : through_abi<float>(scene, options);
    return any ? through_any_trees<double>(scene, options) : through_abi<double>(scene, options);
}

void keeps_its_tolerances(const Scene& scene, const std::string& isa) {
    pysas_options options{};
    options.struct_size = sizeof options;
    options.isa = isa.c_str();
    options.threads = 2;
    const auto run = [&](int method, int dtype, const Numbers& tols) {
        double worst = 0, least = 1;
        options.method = method;
        options.dtype = dtype;
        for (const double tol : tols) {
            options.tol = tol;
            const Result found = image_of(scene, options);
            const double error = scene.error(found.image) / tol;
            CHECK(error <= 1);  // not a number neither
            worst = std::max(worst, error);
            least = std::min(least, found.share);
        }
        if (tols.empty()) return;
        CHECK(method == PYSAS_BACKPROJECTION ? least == 0 : least > 0.5);
        std::printf("%-24s %-9s %-6s complex%-3d %zu tolerances, error at most %.2f of them, %.0f %% through trees\n",
                    scene.name.c_str(), isa.c_str(), method == PYSAS_FFBP ? "trees" : "direct",
                    dtype == PYSAS_COMPLEX64 ? 64 : 128, tols.size(), worst, 100 * least);
    };
    run(PYSAS_BACKPROJECTION, PYSAS_COMPLEX64, scene.direct[0]);
    run(PYSAS_BACKPROJECTION, PYSAS_COMPLEX128, scene.direct[1]);
    run(PYSAS_FFBP, PYSAS_COMPLEX64, scene.trees);
    for (const int method : {PYSAS_BACKPROJECTION, PYSAS_FFBP}) {
        const Numbers& tols = method == PYSAS_FFBP ? scene.trees : scene.direct[0];
        if (tols.empty() || scene.must_pay) continue;
        options.method = method;
        options.dtype = PYSAS_COMPLEX64;
        options.tol = tols[0];
        options.threads = 1;
        const auto one = image_of(scene, options).image;
        for (const int threads : {2, 3, 7}) {
            options.threads = threads;
            CHECK(image_of(scene, options).image == one);
        }
    }
    std::fflush(stdout);
}

}  // namespace

int main(int count, char** arguments) {
    std::FILE* file = count == 2 ? std::fopen(arguments[1], "rb") : nullptr;
    if (!file) {
        std::fprintf(stderr, "usage: test_scenes FILE\n");
        return 1;
    }
    int scenes = 0;
    for (Scene scene(file); !scene.name.empty(); scene = Scene(file), ++scenes) {
        for (const std::string& isa : pysas::levels()) keeps_its_tolerances(scene, isa);
    }
    std::fclose(file);
    CHECK(scenes > 0);
    std::printf("test_scenes: %s (%d scenes)\n", failures == 0 ? "passed" : "FAILED", scenes);
    return failures == 0 ? 0 : 1;
}
