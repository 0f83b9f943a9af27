// Views of arrays that somebody else owns: a pointer, a shape, and strides in elements.
#pragma once

#include <cstdint>

namespace pysas {

template <typename T, int N>
struct View {
    T* data = nullptr;
    std::int64_t shape[N] = {};
    std::int64_t stride[N] = {};

    // From strides in bytes, which must be whole elements.
    template <typename Size>
    static View of_bytes(T* data, const Size* shape, const Size* bytes) {
        View out;
        out.data = data;
        for (int axis = 0; axis < N; ++axis) {
            out.shape[axis] = shape[axis];
            out.stride[axis] = bytes[axis] / static_cast<Size>(sizeof(T));
        }
        return out;
    }

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
