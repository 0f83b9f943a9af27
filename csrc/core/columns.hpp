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

// A sub-image, not filtered along its rays, and how tiles are read from it.
struct Source {
    SubImage image;
    const std::uint8_t* reads;
};

// Add sub-images to the tiles of an image, of lines as far apart as each other and steps alike, that they are read for
// as `how`: by_columns or by_lines. Polynomials of positions hold for `stretch` pixels.
template <typename Pixel>
void read_along(const Kernels& kernels, const Tree& tree, const std::vector<Source>& sources, const Raster& raster,
                Reads how, int stretch, const View<Pixel, 2>& image, int threads, const Tick& tick);

}  // namespace pysas
