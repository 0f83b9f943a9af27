#include "core/dispatch.hpp"

#include "core/cpu.hpp"
#include "core/errors.hpp"

namespace pysas {
namespace {

std::vector<const Kernels*> available() {
    std::vector<const Kernels*> found{&baseline::kernels};
#if defined(PYSAS_HAVE_AVX2)
    if (detect() == Isa::avx2 || detect() == Isa::avx512) found.push_back(&avx2::kernels);
#endif
#if defined(PYSAS_HAVE_AVX512)
    if (detect() == Isa::avx512) found.push_back(&avx512::kernels);
#endif
    return found;
}

}  // namespace

std::vector<std::string> levels() {
    std::vector<std::string> names;
    for (const Kernels* kernels : available()) names.emplace_back(kernels->name);
    return names;
}

const Kernels& kernels_for(const std::string& name) {
    const auto found = available();
    if (name == "auto") return *found.back();
    std::string text;
    for (const Kernels* kernels : found) {
        if (name == kernels->name) return *kernels;
        text += std::string(text.empty() ? "" : ", ") + kernels->name;
    }
    throw Error(Code::argument, "isa='" + name + "': expected 'auto' or one of this machine's: " + text);
}

}  // namespace pysas
