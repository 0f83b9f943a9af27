#include "core/dispatch.hpp"

#include "core/cpu.hpp"
#include "core/errors.hpp"

#ifndef PYSAS_SETS  // PYSAS_SET(name) of each set of isa/sets.txt that was built
#define PYSAS_SETS
#endif

namespace pysas {

#define PYSAS_SET(name)           \
    namespace name {              \
    extern const Kernels kernels; \
    }
PYSAS_SETS
#undef PYSAS_SET

namespace {

std::vector<const Kernels*> available() {
    std::vector<const Kernels*> found{&baseline::kernels};
#define PYSAS_SET(name) \
    if (detect() >= Isa::name) found.push_back(&name::kernels);
    PYSAS_SETS
#undef PYSAS_SET
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
