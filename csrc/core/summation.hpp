// The sum over a batch of traces, in two steps on worker threads: their tables from samples, then every tile of the
// image.
#pragma once

#include <algorithm>
#include <cmath>
#include <complex>
#include <cstdint>
#include <vector>

#include "core/filters.hpp"
#include "core/kernels.hpp"
#include "core/recipe.hpp"
#include "core/threads.hpp"
#include "core/views.hpp"

namespace pysas {

// Which samples of which traces become tables.
template <typename Sample>
struct Batch {
    View<const Sample, 3> data;           // ping, channel, sample
    const std::int64_t* order;            // (count) flat ping-channel numbers
    const std::int64_t* start;            // (count) first sample kept; those before the record's first are zero
    const std::complex<double>* weights;  // (count), or null
    const Trace* traces;                  // (count), which say what was recorded, or null: all
    std::int64_t count;
    std::int64_t length;  // samples kept
    double scale;         // samples are divided by it, a power of two
};

// weight / scale for samples: one over a float's smallest amplitude is no float, and one over a double's no double.
class Factor {
  public:
    Factor(std::complex<double> weight, double scale) : re(weight.real() / scale), im(weight.imag() / scale) {
        const double size = std::max(std::abs(re), std::abs(im));
        if (size <= 0x1p1000 && (size >= 0x1p-1000 || weight == 0.0)) return;
        divisor = scale;
        re = weight.real();
        im = weight.imag();
    }
    std::complex<double> operator()(std::complex<double> s) const {
        const double x = s.real() / divisor, y = s.imag() / divisor;
        return {x * re - y * im, x * im + y * re};
    }

    double re, im, divisor = 1;  // samples are divided first
};

// Reals between planes: room for `intervals` and a window's overhang, and planes that do not share cache sets.
std::int64_t plane_stride(std::int64_t intervals, int degree, std::size_t real);

std::int64_t intervals_of(std::int64_t length, double rate);

// Fill the tables of a batch, (count, 2 (degree + 1), stride).
template <typename Real, typename Sample>
void prepare(const Kernels& kernels, const Batch<Sample>& batch, const Filter& filter, Real* table, std::int64_t stride,
             int threads, const Tick& tick);

// The image seen as lines of pixels: straight and evenly spaced, but for heights, or a list of points (one line).
struct Raster {
    const double* first;       // (height, 3) first pixels of the lines, or null
    const double* step;        // (height, 3)
    const double* points;      // (width, 3) where there are no lines
    const std::uint8_t* mask;  // (height, width) pixels wanted, or null
    std::int64_t height, width;
    int count;                            // pixels of a block
    const std::uint8_t* tiles = nullptr;  // those wanted, of lines; or all
    Heights heights{};                    // of the lines' pixels, instead of the lines' own
    const double* spans = nullptr;        // (tile, 2) between which these lie
};

// How the lines of a raster are cut into tiles of `tile_rows` lines and `count` pixels.
struct Tiling {
    struct Tile {
        std::int64_t top, bottom, left, right;
    };

    explicit Tiling(const Raster& raster) : raster(raster), across((raster.width + raster.count - 1) / raster.count) {}
    std::int64_t count() const { return (raster.height + tile_rows - 1) / tile_rows * across; }
    Tile at(std::int64_t number) const {
        const std::int64_t top = number / across * tile_rows, left = number % across * raster.count;
        return {top, std::min<std::int64_t>(top + tile_rows, raster.height), left,
                std::min<std::int64_t>(left + raster.count, raster.width)};
    }
    // First pixel and step of each line of a tile, (rows, 6).
    void lines(const Tile& tile, double* out) const {
        for (std::int64_t r = 0; r < tile.bottom - tile.top; ++r) {
            for (std::int64_t axis = 0; axis < 3; ++axis) {
                const double step = raster.step[3 * (tile.top + r) + axis];
                out[6 * r + axis] = raster.first[3 * (tile.top + r) + axis] + static_cast<double>(tile.left) * step;
                out[6 * r + 3 + axis] = step;
            }
        }
    }
    // Whether any pixel of a piece of a line is wanted.
    bool any(std::int64_t line, std::int64_t begin, std::int64_t end) const {
        const std::uint8_t* wanted = raster.mask ? raster.mask + line * raster.width : nullptr;
        return !wanted || std::any_of(wanted + begin, wanted + end, [](std::uint8_t m) { return m != 0; });
    }

    const Raster& raster;
    std::int64_t across;
};

// Throws std::logic_error where no kernel is compiled for the terms' polynomials.
template <typename Real>
void compiled(const Terms<Real>& terms);

// Add a batch's terms to `image` (line, pixel); returns how many there were.
template <typename Real, typename Pixel>
std::int64_t add(const Kernels& kernels, const Terms<Real>& terms, const Raster& raster, const View<Pixel, 2>& image,
                 int threads, const Tick& tick);

// Largest |real| or |imaginary| part of samples begin to end - 1, which were recorded, of each trace, (ping, channel);
// not finite where what the trace recorded is not, within or without them.
template <typename Sample>
void peaks(const View<const Sample, 3>& data, const Trace* traces, const std::int64_t* begin, const std::int64_t* end,
           double* out, int threads, const Tick& tick);

// Places in traces: (count) flat ping-channel and sample numbers, and samples to each side of them.
struct Places {
    const std::int64_t *trace, *place;
    std::int64_t count, reach;
    const Trace* traces;  // all
};

// Mean square of the 2 reach + 1 samples about each place, (count), in units of scale^2; zero where nothing was
// recorded.
template <typename Sample>
void mean_squares(const View<const Sample, 3>& data, const Places& places, double scale, double* out, int threads,
                  const Tick& tick);

}  // namespace pysas
