// Numbers in words.
#pragma once

#include <cstdio>
#include <string>

namespace pysas {

// With so many digits, as "%g" has it.
inline std::string number(double value, int digits) {
    char text[40];
    std::snprintf(text, sizeof text, "%.*g", digits, value);
    return text;
}

// With so many digits behind the point.
inline std::string fixed(double value, int digits) {
    char text[400];
    std::snprintf(text, sizeof text, "%.*f", digits, value);
    return text;
}

}  // namespace pysas
