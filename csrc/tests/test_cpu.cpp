// The core's own test, without Python: run under the address and undefined-behaviour sanitizers by `make sanitize`.
// Machines are made of the words of CPUID and XCR0; the compiler's own run-time detection is the second opinion on this
// one.

#include <cstdio>
#include <cstring>
#include <initializer_list>

#include "core/cpu.hpp"
#include "tests/check.hpp"

namespace {

constexpr std::uint32_t fma = 1u << 12, osxsave = 1u << 27, avx = 1u << 28;
constexpr std::uint32_t avx2 = 1u << 5;
constexpr std::uint32_t avx512f = 1u << 16, avx512dq = 1u << 17, avx512bw = 1u << 30, avx512vl = 1u << 31;
constexpr std::uint64_t ymm = 0x06, zmm = 0xe0;

pysas::CpuWords full() { return {fma | osxsave | avx, avx2 | avx512f | avx512dq | avx512bw | avx512vl, ymm | zmm | 1}; }

void each_missing_bit_lowers_the_level() {
    using pysas::Isa;
    CHECK(pysas::level_of(full()) == Isa::avx512);
    CHECK(pysas::level_of({}) == Isa::baseline);
    for (const std::uint32_t word : {fma, osxsave, avx}) {
        pysas::CpuWords words = full();
        words.leaf1_ecx &= ~word;
        CHECK(pysas::level_of(words) == Isa::baseline);
    }
    for (const std::uint32_t word : {avx512f, avx512dq, avx512bw, avx512vl}) {
        pysas::CpuWords words = full();
        words.leaf7_ebx &= ~word;
        CHECK(pysas::level_of(words) == Isa::avx2);
    }
    pysas::CpuWords words = full();
    words.leaf7_ebx &= ~avx2;
    CHECK(pysas::level_of(words) == Isa::baseline);
}

void registers_the_system_does_not_save_are_not_used() {
    using pysas::Isa;
    for (unsigned number = 0; number < 8; ++number) {
        pysas::CpuWords words = full();
        words.xcr0 &= ~(std::uint64_t{1} << number);
        const Isa expected = number == 1 || number == 2 ? Isa::baseline : number >= 5 ? Isa::avx2 : Isa::avx512;
        CHECK(pysas::level_of(words) == expected);
    }
}

void this_machine_is_what_the_compiler_says() {
    const pysas::Isa found = pysas::detect();
    CHECK(found == pysas::detect());
#if defined(__GNUC__) && (defined(__x86_64__) || defined(__i386__))
    __builtin_cpu_init();
    const bool has_avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    const bool has_avx512 = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                            __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
    CHECK((found != pysas::Isa::baseline) == has_avx2);
    CHECK((found == pysas::Isa::avx512) == (has_avx2 && has_avx512));
#elif defined(__ARM_NEON)
    CHECK(found == pysas::Isa::neon);
#endif
}

void names() {
    CHECK(std::strcmp(pysas::name_of(pysas::Isa::baseline), "baseline") == 0);
    CHECK(std::strcmp(pysas::name_of(pysas::Isa::avx2), "avx2") == 0);
    CHECK(std::strcmp(pysas::name_of(pysas::Isa::avx512), "avx512") == 0);
    CHECK(std::strcmp(pysas::name_of(pysas::Isa::neon), "neon") == 0);
}

}  // namespace

int main() {
    each_missing_bit_lowers_the_level();
    registers_the_system_does_not_save_are_not_used();
    this_machine_is_what_the_compiler_says();
    names();
    std::printf("test_cpu: %s (this machine: %s)\n", failures == 0 ? "passed" : "FAILED",
                pysas::name_of(pysas::detect()));
    return failures == 0 ? 0 : 1;
}
