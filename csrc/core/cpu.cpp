// Reading CPUID and XCR0 with GCC, Clang and MSVC; see cpu.hpp for what the words mean.
// Bit numbers: Intel 64 and IA-32 Architectures Software Developer's Manual, vol. 2A, CPUID, and vol. 1, section 13.3.

#include "core/cpu.hpp"

#if defined(__x86_64__) || defined(__i386__) || defined(_M_X64) || defined(_M_IX86)
#define PYSAS_X86 1
#if defined(_MSC_VER) && !defined(__clang__)
#include <immintrin.h>
#include <intrin.h>
#else
#include <cpuid.h>
#endif
#endif

namespace pysas {
namespace {

template <typename Word>
constexpr Word bit(unsigned number) {
    return Word{1} << number;
}

template <typename Word>
constexpr bool has(Word word, Word bits) {
    return (word & bits) == bits;
}

constexpr std::uint32_t leaf1_fma = bit<std::uint32_t>(12);
constexpr std::uint32_t leaf1_osxsave = bit<std::uint32_t>(27);
constexpr std::uint32_t leaf1_avx = bit<std::uint32_t>(28);
constexpr std::uint32_t leaf7_avx2 = bit<std::uint32_t>(5);
constexpr std::uint32_t leaf7_avx512 =  // F, DQ, BW, VL
    bit<std::uint32_t>(16) | bit<std::uint32_t>(17) | bit<std::uint32_t>(30) | bit<std::uint32_t>(31);
constexpr std::uint64_t xcr0_ymm = bit<std::uint64_t>(1) | bit<std::uint64_t>(2);  // XMM, upper halves of YMM
constexpr std::uint64_t xcr0_zmm =                                                 // opmask, upper ZMM, ZMM16-31
    bit<std::uint64_t>(5) | bit<std::uint64_t>(6) | bit<std::uint64_t>(7);

#if defined(PYSAS_X86) && defined(_MSC_VER) && !defined(__clang__)

CpuWords read_words() noexcept {
    CpuWords words;
    int registers[4];
    __cpuid(registers, 0);
    const int last_leaf = registers[0];
    if (last_leaf < 1) return words;
    __cpuid(registers, 1);
    words.leaf1_ecx = static_cast<std::uint32_t>(registers[2]);
    if (last_leaf >= 7) {
        __cpuidex(registers, 7, 0);
        words.leaf7_ebx = static_cast<std::uint32_t>(registers[1]);
    }
    if (has(words.leaf1_ecx, leaf1_osxsave)) words.xcr0 = _xgetbv(0);
    return words;
}

#elif defined(PYSAS_X86)

CpuWords read_words() noexcept {
    CpuWords words;
    unsigned eax = 0, ebx = 0, ecx = 0, edx = 0;
    if (!__get_cpuid(1, &eax, &ebx, &ecx, &edx)) return words;
    words.leaf1_ecx = ecx;
    if (__get_cpuid_count(7, 0, &eax, &ebx, &ecx, &edx)) words.leaf7_ebx = ebx;
    if (has(words.leaf1_ecx, leaf1_osxsave)) {
        // the intrinsic _xgetbv would need this file compiled with -mxsave
        std::uint32_t low = 0, high = 0;
        __asm__ volatile("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
        words.xcr0 = (static_cast<std::uint64_t>(high) << 32) | low;
    }
    return words;
}

#endif

}  // namespace

Isa level_of(const CpuWords& words) noexcept {
    // without OSXSAVE nothing says which registers are saved, whatever stands in `xcr0`
    const bool ymm_saved = has(words.leaf1_ecx, leaf1_osxsave) && has(words.xcr0, xcr0_ymm);
    if (!ymm_saved || !has(words.leaf1_ecx, leaf1_avx | leaf1_fma) || !has(words.leaf7_ebx, leaf7_avx2)) {
        return Isa::baseline;
    }
    return has(words.xcr0, xcr0_zmm) && has(words.leaf7_ebx, leaf7_avx512) ? Isa::avx512 : Isa::avx2;
}

Isa detect() noexcept {
#if defined(PYSAS_X86)
    static const Isa found = level_of(read_words());
    return found;
#elif defined(__aarch64__) || defined(_M_ARM64)
    return Isa::neon;
#else
    return Isa::baseline;
#endif
}

const char* name_of(Isa isa) noexcept {
    switch (isa) {
        case Isa::avx2:
            return "avx2";
        case Isa::avx512:
            return "avx512";
        case Isa::neon:
            return "neon";
        case Isa::baseline:
            break;
    }
    return "baseline";
}

}  // namespace pysas
