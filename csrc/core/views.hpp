// Views of arrays that somebody else owns: a pointer, a shape, and strides in elements.
#pragma once

#include <cstdint>

namespace pysas {

template <typename T, int N>
struct View {
    T* data = nullptr;
    std::int64_t shape[N] = {};
    std::int64_t stride[N] = {};

    template <typename... Index>
    T& operator()(Index... index) const {
        static_assert(sizeof...(Index) == N, "one index for each axis");
        std::int64_t place = 0;
        int axis = 0;
        ((place += static_cast<std::int64_t>(index) * stride[axis++]), ...);
        return data[place];
    }
};

}  // namespace pysas
