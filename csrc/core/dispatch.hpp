// The kernels that run: the best the machine offers of those this build has, or the ones asked for by name.
#pragma once

#include <string>
#include <vector>

#include "core/kernels.hpp"

namespace pysas {

// Names of the instruction sets this build has and this machine runs, worst first.
std::vector<std::string> levels();

// "auto": the best of `levels`. Throws Error(argument) where the machine or the build does not have `name`.
const Kernels& kernels_for(const std::string& name);

}  // namespace pysas
