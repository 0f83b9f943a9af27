// The C ABI: arguments checked for null and size here, for meaning in plan.cpp; every exception becomes a code.
#include <cstddef>
#include <cstring>
#include <new>

#include "core/errors.hpp"
#include "planning/plan.hpp"
#include "pysas.h"

struct pysas_plan {
    pysas::Plan plan;
};

namespace {

// Sizes of pysas_options that callers may have: the first had no method.
constexpr std::size_t options_sizes[] = {offsetof(pysas_options, method), sizeof(pysas_options)};

bool known(std::size_t size) {
    for (const std::size_t one : options_sizes) {
        if (size == one) return true;
    }
    return false;
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

}  // namespace

extern "C" {

int pysas_plan_create(const pysas_survey* survey, const pysas_grid* grid, const pysas_options* options,
                      pysas_plan** plan) {
    if (!plan) return PYSAS_ERROR_ARGUMENT;
    *plan = nullptr;
    if (!survey || !grid || !options) return PYSAS_ERROR_ARGUMENT;
    if (survey->struct_size != sizeof *survey || grid->struct_size != sizeof *grid || !known(options->struct_size)) {
        return PYSAS_ERROR_STRUCT;
    }
    pysas_options all{};  // what an older caller's struct does not have is zero
    std::memcpy(&all, options, options->struct_size);
    return guarded([&] { *plan = new pysas_plan{pysas::Plan(*survey, *grid, all)}; });
}

int pysas_plan_execute(const pysas_plan* plan, const void* data, const int64_t data_stride[3], void* image,
                       const int64_t image_stride[2]) {
    if (!plan || !data || !image) return PYSAS_ERROR_ARGUMENT;
    return guarded([&] { plan->plan.execute(data, data_stride, image, image_stride); });
}

double pysas_plan_factorised_share(const pysas_plan* plan) { return plan ? plan->plan.factorised_share() : 0; }

void pysas_plan_destroy(pysas_plan* plan) { delete plan; }

const char* pysas_strerror(int code) {
    switch (code) {
        case PYSAS_OK:
            return "no error";
        case PYSAS_ERROR_ARGUMENT:
            return "an argument is null, not finite or out of range";
        case PYSAS_ERROR_TOLERANCE:
            return "the tolerance cannot be kept: 1e-5 with complex64, 1e-10 with complex128 at best, less near a "
                   "record's ends";
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
