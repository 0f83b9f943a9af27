#include "planning/tiles.hpp"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <utility>

namespace pysas {
namespace {

constexpr std::int64_t at_once = std::int64_t{1} << 16;  // points

// An upright box along a direction and across it.
struct Box {
    double low[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, high[3] = {-HUGE_VAL, -HUGE_VAL, -HUGE_VAL};

    void hold(const Point& p) {
        const double at[3] = {p.x, p.y, p.z};
        for (int k = 0; k < 3; ++k) {
            low[k] = std::min(low[k], at[k]);
            high[k] = std::max(high[k], at[k]);
        }
    }
    // number of a corner: bit k says whether it is the high one along axis k
    Point corner(int number, double cosine, double sine) const {
        double at[3];
        for (int k = 0; k < 3; ++k) at[k] = number >> k & 1 ? high[k] : low[k];
        return {at[0] * cosine - at[1] * sine, at[0] * sine + at[1] * cosine, at[2]};
    }
};

// Lines [line, last) in blocks of `count` pixels.
struct Row {
    const Pixels& pixels;
    std::int64_t line, last, count;

    std::int64_t blocks() const { return (pixels.width + count - 1) / count; }

    // Corners of boxes about the blocks, whatever the order of the lines; along straight lines' mean direction, which
    // fits lines of any.
    void corners(std::vector<Point>& out) const {
        std::vector<Box> boxes(static_cast<std::size_t>(blocks()));
        double cosine = 1, sine = 0;
        if (pixels.lined()) {
            double x = 0, y = 0;
            for (std::int64_t i = line; i < last; ++i) {
                x += pixels.step[static_cast<std::size_t>(3 * i)];
                y += pixels.step[static_cast<std::size_t>(3 * i + 1)];
            }
            if (const double size = std::hypot(x, y); size > 0) {
                cosine = x / size;
                sine = y / size;
            }
            hold_ends(boxes, cosine, sine);
            if (pixels.heights.z) hold_heights(boxes);
        } else {
            hold_points(boxes);
        }
        for (const Box& box : boxes) {
            for (int k = 0; k < 8; ++k) out.push_back(box.corner(k, cosine, sine));
        }
    }

    void hold_ends(std::vector<Box>& boxes, double cosine, double sine) const {
        for (std::int64_t i = line; i < last; ++i) {
            const Point first = point(&pixels.first[static_cast<std::size_t>(3 * i)]);
            const Point step = point(&pixels.step[static_cast<std::size_t>(3 * i)]);
            for (std::int64_t left = 0, k = 0; left < pixels.width; left += count, ++k) {
                for (const std::int64_t column : {left, std::min(left + count, pixels.width) - 1}) {
                    const Point p = first + static_cast<double>(column) * step;
                    boxes[static_cast<std::size_t>(k)].hold(
                        {p.x * cosine + p.y * sine, p.y * cosine - p.x * sine, p.z});
                }
            }
        }
    }

    // Of a map, whose lines have heights of their own.
    void hold_heights(std::vector<Box>& boxes) const {
        for (Box& box : boxes) {
            box.low[2] = HUGE_VAL;
            box.high[2] = -HUGE_VAL;
        }
        for (std::int64_t i = line; i < last; ++i) {
            const double* z = pixels.heights.z + i * pixels.heights.row;
            const std::int64_t apart = pixels.heights.apart;
            for (std::int64_t left = 0, k = 0; left < pixels.width; left += count, ++k) {
                double low = HUGE_VAL, high = -HUGE_VAL;
                for (std::int64_t m = left; m < std::min(left + count, pixels.width); ++m) {
                    low = std::min(low, z[m * apart]);
                    high = std::max(high, z[m * apart]);
                }
                Box& box = boxes[static_cast<std::size_t>(k)];
                box.low[2] = std::min(box.low[2], low - pixels.heights.origin);
                box.high[2] = std::max(box.high[2], high - pixels.heights.origin);
            }
        }
    }

    void hold_points(std::vector<Box>& boxes) const {
        std::vector<double> places;
        for (std::int64_t begin = line * pixels.width; begin < last * pixels.width; begin += at_once) {
            const std::int64_t end = std::min(begin + at_once, last * pixels.width);
            Numbers numbers(static_cast<std::size_t>(end - begin));
            std::iota(numbers.begin(), numbers.end(), begin);
            places.resize(3 * numbers.size());
            pixels.points(numbers, places.data());
            std::int64_t column = begin % pixels.width;
            for (std::size_t i = 0; i < places.size(); i += 3) {
                boxes[static_cast<std::size_t>(column / count)].hold(point(&places[i]));
                if (++column == pixels.width) column = 0;
            }
        }
    }

    void wanted(Numbers& out) const {
        for (std::int64_t left = 0; left < pixels.width; left += count) {
            const std::int64_t right = std::min(left + count, pixels.width);
            std::int64_t found = (last - line) * (right - left);
            if (!pixels.mask.empty()) {
                for (std::int64_t i = line; i < last; ++i) {
                    const auto from = pixels.mask.begin() + i * pixels.width;
                    found -= std::count(from + left, from + right, std::uint8_t{0});
                }
            }
            out.push_back(found);
        }
    }
};

// Leaves out what lies above the lower corners where that is nothing, and puts spheres about the tiles.
void finish(Tiled& tiled) {
    const auto ends = std::minmax_element(tiled.corners.begin(), tiled.corners.end(),
                                          [](const Point& a, const Point& b) { return a.z < b.z; });
    const double low = ends.first->z, high = ends.second->z;
    tiled.plane = (low + high) / 2;
    tiled.flat = low == high;
    tiled.each = tiled.flat ? 4 : 8;
    const auto each = static_cast<std::size_t>(tiled.each);
    const std::size_t tiles = tiled.corners.size() / 8;
    for (std::size_t i = 0; i < tiles; ++i)
        std::copy_n(tiled.corners.begin() + static_cast<std::ptrdiff_t>(8 * i), each,
                    tiled.corners.begin() + static_cast<std::ptrdiff_t>(each * i));
    tiled.corners.resize(each * tiles);
    for (std::size_t i = 0; i < tiles; ++i) {
        const Point* corner = &tiled.corners[each * i];
        Point sum;
        for (std::size_t k = 0; k < each; ++k) sum = sum + corner[k];
        const Point middle = 1.0 / tiled.each * sum;
        double radius = 0;
        for (std::size_t k = 0; k < each; ++k) radius = std::max(radius, length(corner[k] - middle));
        tiled.middle.push_back(middle);
        tiled.radius.push_back(radius);
    }
}

// First lines of the stretches that lie on one plane, and the end of the last; of all where these are too many to cut.
Numbers cuts_of(const Pixels& pixels) {
    const Numbers whole{0, pixels.height};
    if (!pixels.straight()) return whole;
    Numbers cuts{0};
    for (std::size_t i = 0; i < static_cast<std::size_t>(pixels.height); ++i) {
        if (pixels.step[3 * i + 2] != 0) return whole;
        if (i > 0 && pixels.first[3 * i + 2] != pixels.first[3 * i - 1]) cuts.push_back(static_cast<std::int64_t>(i));
    }
    const auto changes = static_cast<std::int64_t>(cuts.size()) - 1;
    cuts.push_back(pixels.height);
    return changes < std::max<std::int64_t>(1, pixels.height / tile_rows) ? cuts : whole;
}

}  // namespace

bool Tiled::any() const {
    return std::any_of(pixels.begin(), pixels.end(), [](std::int64_t count) { return count > 0; });
}

std::vector<Tiled> tiles_of(const Scene& scene, int count) {
    const Pixels& pixels = scene.pixels;
    if (count == 0) count = static_cast<int>(std::min<std::int64_t>(block, pixels.width));
    const Numbers cuts = cuts_of(pixels);
    std::vector<Tiled> out;
    for (std::size_t i = 0; i + 1 < cuts.size(); ++i) {
        Tiled tiled{};
        tiled.begin = cuts[i];
        tiled.end = cuts[i + 1];
        for (std::int64_t line = tiled.begin; line < tiled.end; line += tile_rows) {
            const Row row{pixels, line, std::min<std::int64_t>(line + tile_rows, tiled.end), count};
            row.corners(tiled.corners);
            row.wanted(tiled.pixels);
        }
        finish(tiled);
        out.push_back(std::move(tiled));
    }
    return out;
}

}  // namespace pysas
