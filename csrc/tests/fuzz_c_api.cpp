// libFuzzer on the C ABI: random geometry, shapes, strides and options; whatever comes in, a code comes out. `make
// fuzz`.

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <vector>

#include "core/errors.hpp"
#include "planning/callers.hpp"
#include "planning/imaging.hpp"
#include "pysas.h"

namespace {

struct Bytes {
    const std::uint8_t* data;
    std::size_t size;

    std::uint32_t state;

    // The input, then sensible bytes that depend on all of it: whole scenes from short inputs.
    std::uint8_t byte() {
        if (size == 0) {
            state = state * 1664525 + 1013904223;
            return static_cast<std::uint8_t>((state >> 24) % 240);
        }
        --size;
        state = (state ^ *data) * 16777619;
        return *data++;
    }
    // mostly sensible, at times anything a double can be
    double number(double low, double high) {
        const std::uint8_t kind = byte();
        if (kind < 250) return low + (high - low) * (byte() + kind / 250.0) / 256;
        const double odd[] = {
            0, -1, 1e300, -1e300, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()};
        return odd[kind - 250];
    }
    std::int64_t count(int most) {
        const std::uint8_t kind = byte();
        if (kind < 252) return 1 + kind % most;
        const std::int64_t odd[] = {0, -1, std::int64_t{1} << 62, std::numeric_limits<std::int64_t>::min()};
        return odd[kind - 252];
    }
};

std::int64_t clipped(std::int64_t n) { return std::clamp<std::int64_t>(n, 0, 200); }

// So small a scene takes no trees, as they take longer: here they need not pay.
void through_trees(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options,
                   const void* samples, const std::int64_t (&from)[3], void* image, const std::int64_t (&to)[2]) {
    using Sample = std::complex<float>;
    try {
        pysas::Wish wish = pysas::wish_of(options);
        wish.pay = false;
        const pysas::Imaging imaging(pysas::plan(pysas::scene_of(survey, grid, options), wish));
        const pysas::View<const Sample, 3> data{static_cast<const Sample*>(samples),
                                                {survey.n_ping, survey.n_channel, survey.n_sample},
                                                {from[0], from[1], from[2]}};
        imaging(data, pysas::View<Sample, 2>{static_cast<Sample*>(image), {grid.height, grid.width}, {to[0], to[1]}},
                true, {});
    } catch (const pysas::Error&) {
    }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    Bytes in{data, size, 1};
    pysas_survey survey{};
    pysas_grid grid{};
    pysas_options options{};
    survey.struct_size = in.byte() < 250 ? sizeof survey : in.byte();
    grid.struct_size = in.byte() < 250 ? sizeof grid : in.byte();
    const std::uint8_t known = in.byte();  // now and then the options of callers before there was a method
    options.struct_size = known < 240 ? sizeof options : known < 250 ? offsetof(pysas_options, method) : in.byte();
    survey.n_ping = in.count(6);
    survey.n_channel = in.count(3);
    survey.n_sample = in.count(200);
    grid.height = in.count(40);
    grid.width = in.count(70);
    const double scale = std::pow(10.0, in.number(-2, 3));
    survey.fs = in.number(1e3, 1e5);
    survey.fc = in.number(1e3, 1e6);
    survey.bandwidth = in.byte() % 2 ? 0 : survey.fs / in.number(1, 4);
    survey.c = in.number(300, 3000);
    survey.t0 = in.number(-0.001, 2 * scale / 1500);
    const auto fill = [&](std::int64_t n, double low, double high) {
        std::vector<double> out(static_cast<std::size_t>(n));
        for (double& value : out) value = in.number(low, high);
        return out;
    };
    const std::int64_t pings = clipped(survey.n_ping), traces = pings * clipped(survey.n_channel);
    const std::int64_t pixels = clipped(grid.height) * clipped(grid.width);
    auto tx = fill(3 * pings, -scale, scale), rx = fill(3 * traces, -scale, scale);
    const auto velocity = fill(3 * traces, -10, 10), weights = fill(traces, -2, 2),
               t0 = fill(pings, 0, 2 * scale / 1500);
    const auto boresight = fill(3 * pings, -1, 1), points = fill(in.byte() % 4 ? 0 : 3 * pixels, -scale, scale);
    survey.tx = tx.data();
    survey.rx = rx.data();
    const std::uint8_t parts = in.byte();
    survey.velocity = parts & 1 ? velocity.data() : nullptr;
    survey.weights = parts & 2 ? weights.data() : nullptr;
    survey.ping_t0 = parts & 4 ? t0.data() : nullptr;
    survey.boresight = parts & 8 ? boresight.data() : nullptr;
    survey.beam_half_angle = in.number(0, 4);
    const auto axis = fill(3 * pings, -1, 1);
    const std::uint8_t beam = in.byte();
    survey.beam_shape = beam % 8 == 7 ? beam : beam % 2;
    survey.beam_taper = beam & 16 ? in.number(-0.1, 1.1) : 0;
    survey.beam_axis = beam & 32 ? axis.data() : nullptr;
    const auto speeds = fill(pings, beam & 64 ? 1400 : 300, beam & 64 ? 1540 : 3000);
    survey.ping_c = parts & 16 ? speeds.data() : nullptr;
    std::vector<std::int64_t> valid;
    for (std::int64_t i = 0; i < traces; ++i) {
        const std::int64_t last = clipped(survey.n_sample) - 1, first = in.byte() % 32;
        valid.push_back(in.byte() < 250 ? std::min(first, last) : first);
        valid.push_back(in.byte() < 250 ? last - in.byte() % 32 : last + 1);
    }
    survey.valid = parts & 32 ? valid.data() : nullptr;
    for (double* vector : {grid.first, grid.along, grid.down}) {
        const double reach = vector == grid.first ? scale : scale / 50;
        for (int axis = 0; axis < 3; ++axis) vector[axis] = in.number(-reach, reach);
    }
    grid.points = points.empty() ? nullptr : points.data();
    std::vector<std::uint8_t> mask(static_cast<std::size_t>(pixels));
    for (auto& wanted : mask) wanted = in.byte() % 3;
    grid.mask = parts & 16 ? mask.data() : nullptr;
    // small ones are slow beside a record's ends
    options.tol = std::pow(10.0, in.byte() % 16 ? in.number(-2.5, -1) : in.number(-7, -2.5));
    options.dtype = in.byte() % 16 ? in.byte() % 2 : in.byte();
    options.threads = 1 + in.byte() % 2;
    const std::uint8_t method = in.byte();
    options.method = method < 250 ? method % 3 : method - 252;
    if (parts & 32) {  // a short track beside a small level image in the middle of the record: what trees can serve
        for (auto* places : {&tx, &rx}) {
            for (double& value : *places) value *= 0.02;
        }
        grid.along[2] = grid.down[2] = 0;
        grid.points = nullptr;
        survey.ping_t0 = survey.boresight = nullptr;
        for (double* vector : {grid.along, grid.down}) {
            for (int axis = 0; axis < 3; ++axis) vector[axis] *= 0.1;
        }
        const std::int64_t n = survey.n_sample =
            survey.n_sample > 200 || survey.n_sample < 0 ? survey.n_sample : 5 * survey.n_sample;
        survey.fs = static_cast<double>(n) * survey.c / (2 * scale);
        const double away = std::hypot(grid.first[0], grid.first[1], grid.first[2]);
        survey.t0 = 2 * away / survey.c - static_cast<double>(n) / (2 * survey.fs);
        survey.bandwidth = 0;
        survey.fc = survey.c / std::hypot(grid.along[0], grid.along[1]) * in.number(0.05, 1);
    }
    const char* sets[] = {nullptr, "baseline", "avx2", "avx512", "neon", "mmx"};
    options.isa = sets[in.byte() % 6];

    pysas_plan* plan = nullptr;
    if (pysas_plan_create(&survey, &grid, &options, &plan) != PYSAS_OK) return 0;
    // samples and image with gaps, read and written with strides
    const std::int64_t gap = 1 + in.byte() % 2, n = survey.n_sample;
    const std::int64_t from[3] = {survey.n_channel * n * gap, n * gap, gap}, to[2] = {grid.width * gap, gap};
    const std::size_t item = options.dtype == PYSAS_COMPLEX64 ? 8 : 16;
    std::vector<std::uint8_t> samples(static_cast<std::size_t>(traces * n * gap) * item),
        image(static_cast<std::size_t>(pixels * gap) * item);
    for (std::size_t i = 0; i + 4 <= samples.size(); i += 4) {
        const float value = static_cast<float>(in.byte()) - 100;
        const double wide = value;
        if (item == 8)
            std::memcpy(&samples[i], &value, 4);
        else if (i % 8 == 0)
            std::memcpy(&samples[i], &wide, 8);
    }
    pysas_plan_execute(plan, samples.data(), from, image.data(), to);
    char text[400];
    pysas_plan_describe(plan, text, sizeof text);
    pysas_plan_destroy(plan);
    if (options.method == PYSAS_FFBP && item == 8)
        through_trees(survey, grid, options, samples.data(), from, image.data(), to);
    return 0;
}
