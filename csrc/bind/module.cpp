// The Python face of the C++ core: pysas.engine._core. Bindings only make views, call the core and turn errors into
// exceptions; pysas/engine/_core.pyi is the list of what stands here, and a test compares the two.

#include <pybind11/pybind11.h>

#include "core/cpu.hpp"

namespace {

#define PYSAS_TEXT_OF(x) #x
#define PYSAS_TEXT(x) PYSAS_TEXT_OF(x)

const char* compiler() {
#if defined(__clang__)
    return "clang " __clang_version__;
#elif defined(__GNUC__)
    return "gcc " __VERSION__;
#elif defined(_MSC_VER)
    return "msvc " PYSAS_TEXT(_MSC_VER);
#else
    return "unknown";
#endif
}

}  // namespace

PYBIND11_MODULE(_core, m) {
    m.doc() = "Compiled part of the engine.";
    m.def("compiler", &compiler, "Name and version of the compiler that built this extension.");
    m.def(
        "isa", [] { return pysas::name_of(pysas::detect()); },
        "Best instruction set this machine offers to the kernels: baseline, avx2 or avx512.");
}
