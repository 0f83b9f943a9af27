// The C ABI: arguments checked for null and size here, for meaning in planning/callers.cpp; every exception becomes a
// code.
#include <algorithm>
#include <cmath>
#include <complex>
#include <cstddef>
#include <cstring>
#include <iterator>
#include <new>
#include <string>
#include <utility>

#include "core/border.hpp"
#include "core/errors.hpp"
#include "planning/callers.hpp"
#include "planning/imaging.hpp"
#include "pysas.h"

struct pysas_plan {
    pysas::Imaging imaging;
    pysas::Tick tick;
    std::string words;
};

namespace {

// Sizes that callers may have: the first options had no method, the first surveys cones without taper alone.
constexpr std::size_t options_sizes[] = {offsetof(pysas_options, method), sizeof(pysas_options)};
constexpr std::size_t survey_sizes[] = {offsetof(pysas_survey, beam_shape), offsetof(pysas_survey, ping_c),
                                        sizeof(pysas_survey)};

// What an older caller's struct does not have is zero; false: no size that this library knows.
template <typename Struct, std::size_t N>
bool take(const Struct* from, const std::size_t (&sizes)[N], Struct& to) {
    if (std::find(std::begin(sizes), std::end(sizes), from->struct_size) == std::end(sizes)) return false;
    std::memcpy(&to, from, from->struct_size);
    return true;
}

template <typename F>
int guarded(F body) noexcept {
    try {
        body();
        return PYSAS_OK;
    } catch (const pysas::Error& error) {
        return static_cast<int>(error.code);
    } catch (const std::bad_alloc&) {
        return PYSAS_ERROR_MEMORY;
    } catch (const std::length_error&) {
        return PYSAS_ERROR_MEMORY;
    } catch (...) {  // std::logic_error among them
        return PYSAS_ERROR_INTERNAL;
    }
}

template <typename Sample>
void execute(const pysas_plan& plan, const void* data, const std::int64_t* data_stride, void* image,
             const std::int64_t* image_stride) {
    const pysas::Scene& scene = *plan.imaging.plan().scene;
    const std::int64_t channels = scene.survey.channels, pings = scene.traces() / channels, samples = scene.samples();
    const std::int64_t packed[3] = {channels * samples, samples, 1}, rows[2] = {scene.pixels.width, 1};
    pysas::View<const Sample, 3> from{static_cast<const Sample*>(data), {pings, channels, samples}, {}};
    pysas::View<Sample, 2> to{static_cast<Sample*>(image), {scene.pixels.height, scene.pixels.width}, {}};
    std::copy_n(data_stride ? data_stride : packed, 3, from.stride);
    std::copy_n(image_stride ? image_stride : rows, 2, to.stride);
    pysas::check_image(to.shape, to.stride, image, from.shape, from.stride, data, sizeof(Sample));
    const pysas::Done done = plan.imaging(from, to, true, plan.tick);
    const pysas::Plan& by = done.by->plan;
    const bool lost = done.lost > 0 && std::hypot(done.lost, by.predicted_error()) > by.wish.tol;
    if (lost || done.loudest >= 0)
        throw pysas::Error(pysas::Code::range, "the image lies beyond the range of its type");
    if (done.beside > 0)
        throw pysas::Error(pysas::Code::tolerance, "tol: samples beside those that pixels read are too bright");
}

}  // namespace

extern "C" {

int pysas_plan_create(const pysas_survey* survey, const pysas_grid* grid, const pysas_options* options,
                      pysas_plan** plan) {
    if (!plan) return PYSAS_ERROR_ARGUMENT;
    *plan = nullptr;
    if (!survey || !grid || !options) return PYSAS_ERROR_ARGUMENT;
    pysas_options all{};
    pysas_survey whole{};
    if (!take(survey, survey_sizes, whole) || grid->struct_size != sizeof *grid || !take(options, options_sizes, all))
        return PYSAS_ERROR_STRUCT;
    return guarded([&] {
        pysas::Plan made = pysas::plan(pysas::scene_of(whole, *grid, all), pysas::wish_of(all));
        const std::string shape = std::to_string(grid->height) + " x " + std::to_string(grid->width);
        std::string words = made.describe(shape, 0);
        pysas::Tick tick;
        if (all.progress)
            tick = [call = all.progress, user = all.user](double share) { return call(share, user) == 0; };
        *plan = new pysas_plan{pysas::Imaging(std::move(made)), std::move(tick), std::move(words)};
    });
}

int pysas_plan_execute(const pysas_plan* plan, const void* data, const int64_t data_stride[3], void* image,
                       const int64_t image_stride[2]) {
    if (!plan || !data || !image) return PYSAS_ERROR_ARGUMENT;
    return guarded([&] {
        if (plan->imaging.plan().scene->survey.single)
            execute<std::complex<float>>(*plan, data, data_stride, image, image_stride);
        else
            execute<std::complex<double>>(*plan, data, data_stride, image, image_stride);
    });
}

double pysas_plan_factorised_share(const pysas_plan* plan) { return plan ? plan->imaging.plan().share() : 0; }

double pysas_plan_seconds(const pysas_plan* plan) {
    return plan ? plan->imaging.plan().seconds / plan->imaging.plan().wish.threads : 0;
}

double pysas_plan_error(const pysas_plan* plan) { return plan ? plan->imaging.plan().predicted_error() : 0; }

size_t pysas_plan_describe(const pysas_plan* plan, char* text, size_t size) {
    if (!plan) return 0;
    if (text && size > 0) {
        const std::size_t count = std::min(size - 1, plan->words.size());
        std::memcpy(text, plan->words.data(), count);
        text[count] = 0;
    }
    return plan->words.size();
}

void pysas_plan_destroy(pysas_plan* plan) { delete plan; }

const char* pysas_strerror(int code) {
    switch (code) {
        case PYSAS_OK:
            return "no error";
        case PYSAS_ERROR_ARGUMENT:
            return "an argument is null, not finite or out of range";
        case PYSAS_ERROR_TOLERANCE:
            return "the tolerance cannot be kept: 1e-5 with complex64, 1e-10 with complex128 at best";
        case PYSAS_ERROR_MEMORY:
            return "not enough memory";
        case PYSAS_ERROR_CANCELLED:
            return "stopped by the progress callback";
        case PYSAS_ERROR_INTERNAL:
            return "internal error: a fault of pysas, not of its input: please report it";
        case PYSAS_ERROR_STRUCT:
            return "struct_size is not one this library knows: set it to sizeof the struct";
        case PYSAS_ERROR_DATA:
            return "the data hold samples that are not finite";
        case PYSAS_ERROR_RANGE:
            return "the image, or a weight times a sample, lies beyond the range of its type: scale the data";
        default:
            return "unknown error code";
    }
}
}
