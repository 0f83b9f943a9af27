// The core's scheduler, filters and C ABI without Python: run under the address, undefined-behaviour and thread
// sanitizers by `make sanitize`.

#include <atomic>
#include <cmath>
#include <complex>
#include <cstdio>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "core/dispatch.hpp"
#include "core/errors.hpp"
#include "core/polynomials.hpp"
#include "core/threads.hpp"
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
        survey = {sizeof survey, pings,     channels,  samples, fs,      fc,      fs / 2, c, t0,
                  nullptr,       tx.data(), rx.data(), nullptr, nullptr, nullptr, 0};
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

void names_of_sets() {
    CHECK(pysas::kernels_for("auto").name == pysas::levels().back());
    bool caught = false;
    try {
        pysas::kernels_for("mmx");
    } catch (const pysas::Error& error) {
        caught = error.code == pysas::Code::argument;
    }
    CHECK(caught);
}

}  // namespace

int main() {
    every_task_runs_once();
    one_exception_comes_out();
    a_point_is_imaged_at_its_place();
    threads_and_kinds_of_pixels_agree();
    names_of_sets();
    std::printf("test_core: %s\n", failures == 0 ? "passed" : "FAILED");
    return failures == 0 ? 0 : 1;
}
