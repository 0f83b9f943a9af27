#include "core/border.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/errors.hpp"

namespace pysas {

void normalise(double (&vector)[3]) {
    double most = 0, power = 0;
    for (const double part : vector) most = std::max(most, std::abs(part));
    if (most == 0) throw Error(Code::argument, "boresight or axis: zero");
    for (double& part : vector) {
        part /= most;
        power += part * part;
    }
    for (double& part : vector) part /= std::sqrt(power);
}

void check_image(const std::int64_t (&shape)[2], const std::int64_t (&step)[2], const void* image,
                 const std::int64_t (&extent)[3], const std::int64_t (&apart)[3], const void* data, std::int64_t item) {
    const std::int64_t a = std::abs(step[0]), b = std::abs(step[1]);
    const bool rows = shape[0] > 1, columns = shape[1] > 1;
    if ((rows && a == 0) || (columns && b == 0) ||
        (rows && columns && (a < b ? b <= a * (shape[0] - 1) : a <= b * (shape[1] - 1))))
        throw Error(Code::argument, "image_stride: pixels overlap");
    const auto span = [item](const void* at, const std::int64_t* sizes, const std::int64_t* strides, int axes) {
        auto low = reinterpret_cast<std::intptr_t>(at), high = low + static_cast<std::intptr_t>(item);
        for (int axis = 0; axis < axes; ++axis) {
            const auto reach = static_cast<std::intptr_t>((sizes[axis] - 1) * strides[axis] * item);
            (reach < 0 ? low : high) += reach;
        }
        return std::make_pair(low, high);
    };
    const auto to = span(image, shape, step, 2), from = span(data, extent, apart, 3);
    if (to.first < from.second && from.first < to.second) throw Error(Code::argument, "image: overlaps the data");
}

int exponent_of(double value) {
    int exponent = 0;
    std::frexp(value, &exponent);
    return exponent;
}

}  // namespace pysas
