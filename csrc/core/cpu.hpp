// Which instruction set the machine offers, of those the kernels are compiled for.
//
// A level counts only where the processor has the instructions (CPUID) and the operating system saves the registers
// they use (OSXSAVE, then XCR0 by XGETBV): a processor with AVX-512 under a system or a virtual machine that does not
// save its registers raises SIGILL at the first such instruction. `level_of` is the rule, free of hardware, so that
// tests can feed it machines that are not at hand; `detect` reads this machine. Every AArch64 machine is `neon`; other
// architectures are `baseline`.
#pragma once

#include <cstdint>

namespace pysas {

enum class Isa {  // a machine that has one has those of its architecture before it
    baseline,     // what compilers make of plain loops
    avx2,         // AVX2 and FMA
    avx512,       // AVX-512 F, DQ, BW and VL, besides all of avx2
    neon,         // AArch64's own vectors
};

// The words of CPUID and XCR0 that decide. Words that do not exist on a machine are zero.
struct CpuWords {
    std::uint32_t leaf1_ecx = 0;
    std::uint32_t leaf7_ebx = 0;
    std::uint64_t xcr0 = 0;
};

Isa level_of(const CpuWords& words) noexcept;

Isa detect() noexcept;

const char* name_of(Isa isa) noexcept;

}  // namespace pysas
