// Errors of the core: one exception type with a code, so that every border translates it in one place.
#pragma once

#include <stdexcept>
#include <string>

namespace pysas {

// Numbered as the PYSAS_ERROR_ codes of pysas.h.
enum class Code { argument = 1, tolerance = 2, memory = 3, cancelled = 4, internal = 5, data = 7, range = 8 };

class Error : public std::runtime_error {
  public:
    Error(Code code, const std::string& text) : std::runtime_error(text), code(code) {}
    const Code code;
};

}  // namespace pysas
