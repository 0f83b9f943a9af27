// What callers of the C ABI may hand over, and what becomes of it.
#pragma once

#include <cstdint>

namespace pysas {

// Give a vector length 1, though the square of a component may be no number. Error for a zero one.
void normalise(double (&vector)[3]);

// Error unless all pixels have memory of their own, none of it between the first and the last of the data.
void check_image(const std::int64_t (&shape)[2], const std::int64_t (&step)[2], const void* image,
                 const std::int64_t (&extent)[3], const std::int64_t (&apart)[3], const void* data, std::int64_t item);

// Exponent of the power of two above a number that is not 0.
int exponent_of(double value);

}  // namespace pysas
