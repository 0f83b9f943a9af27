// Weights of terms that change from pixel to pixel, read off a lattice of places at the few places of a tile that its
// kernel goes by.
#pragma once

#include <cstdint>
#include <vector>

#include "core/kernels.hpp"

namespace pysas {

// Weights of a tile's terms for the kernel, with room that is used again from tile to tile.
template <typename Real>
class TileWeights {
  public:
    // A tile of straight lines (rows, 6), of `count` pixels each.
    const Weights<Real>* of_lines(const Terms<Real>& terms, const double* lines, int rows, int count);
    // Points (rows * count, 3), the first of them number `first` of the list.
    const Weights<Real>* of_points(const Terms<Real>& terms, const double* points, int rows, int count,
                                   std::int64_t first);
    // `count` nodes, from `begin` on, of some rays of a sub-image.
    const Weights<Real>* of_rays(const Terms<Real>& terms, const SubImage& image, const std::int64_t* rays, int rows,
                                 std::int64_t begin, int count);

  private:
    void lie(int row, double share);
    const Weights<Real>* read(const Terms<Real>& terms, const double* x, const double* y, int lines, int columns);

    std::vector<Real> value_;
    Weights<Real> weights_{};
};

}  // namespace pysas
