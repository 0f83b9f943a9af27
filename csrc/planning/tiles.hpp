// An image cut into tiles, by the plane its lines lie on, with boxes about them.
#pragma once

#include <algorithm>
#include <cstdint>
#include <optional>
#include <vector>

#include "planning/scene.hpp"

namespace pysas {

// The lines of a stretch of an image, as far apart as each other and steps alike when looked at from above: from pixel
// to pixel along them, and from line to line; the pixels of a column and of a line that one polynomial of positions
// holds for, and those of a tile at most.
struct Parallel {
    Point step, down;
    int column, line;
    std::int64_t height, width;
    int block;

    std::int64_t across() const { return (width + block - 1) / block; }
    // Pixels of a column, or of a line, of tile number `tile` and those behind it.
    std::int64_t rows_from(std::int64_t tile) const { return height - tile / across() * tile_rows; }
    std::int64_t pixels_from(std::int64_t tile) const { return width - tile % across() * block; }
};

// Lines [begin, end) of an image in tiles of tile_rows lines and `block` pixels, row by row of tiles.
struct Tiled {
    std::int64_t begin, end;
    double plane;                // the middle of all heights, m
    bool flat;                   // all corners lie on the plane
    int each;                    // corners of a tile: 4, or 8 of an upright box, the lower ones first
    std::vector<Point> corners;  // (tile, each)
    std::vector<Point> middle;   // of a sphere about each tile ...
    std::vector<double> radius;  // ... and its radius
    Numbers pixels;              // wanted, of each tile
    std::optional<Parallel> lines;

    bool any() const;  // pixels wanted
};

// By the planes that lines lie on, or all of them where they lie on none. `block` 0: of points, in tiles of the longest
// block.
std::vector<Tiled> tiles_of(const Scene& scene, int block);

}  // namespace pysas
