// Pixels read from sub-images along lines that lead away from them: rays cross these slowly, so that a line is read as
// a parent's ray reads its children, at a third of the cost of single pixels.
#pragma once

#include <cstdint>
#include <vector>

#include "core/kernels.hpp"
#include "core/summation.hpp"
#include "core/threads.hpp"
#include "core/trees.hpp"
#include "core/views.hpp"

namespace pysas {

// Tiles of so many pixels along lines that are read at a time where pixels have heights, from multiples of that on: one
// or two, so that what is read is one of them or both.
inline std::int64_t read_at_once(std::int64_t tile_along) { return 2 * tile_along <= block ? 2 : 1; }

// A sub-image, not filtered along its rays, and how tiles are read from it; of maps, through which stack.
struct Source {
    SubImage image;
    const std::uint8_t* reads;
    Stack stack;
};

// Add sub-images to the tiles of an image, of lines as far apart as each other and steps alike, that they are read for
// as `how`: by_columns or by_lines. Polynomials of positions hold for `stretch` pixels; heights of a map may turn what
// a group sees by `turn` rays.
template <typename Pixel>
void read_along(const Kernels& kernels, const Tree& tree, const std::vector<Source>& sources, const Raster& raster,
                Reads how, int stretch, double turn, const View<Pixel, 2>& image, int threads, const Tick& tick);

}  // namespace pysas
