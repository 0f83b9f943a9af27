#include "core/columns.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <vector>

#include "core/room.hpp"

namespace pysas {
namespace {

constexpr std::int64_t longest = 512;  // pixels of a task's lines, or those of a tile: their sums fit a cache
constexpr std::int64_t square = 8;     // pixels that are turned from lines to rows at a time

// Tiles as a matrix whose rows lie along the lines that are read.
struct Cut {
    bool columns;
    std::int64_t along, across;            // tiles
    std::int64_t tile_along, tile_across;  // pixels of a tile
    std::int64_t whole_along, whole_across;

    Cut(const Raster& raster, Reads how) : columns(how == by_columns) {
        const std::int64_t down = (raster.height + tile_rows - 1) / tile_rows,
                           beside = (raster.width + raster.count - 1) / raster.count;
        along = columns ? down : beside;
        across = columns ? beside : down;
        tile_along = columns ? tile_rows : raster.count;
        tile_across = columns ? raster.count : tile_rows;
        whole_along = columns ? raster.height : raster.width;
        whole_across = columns ? raster.width : raster.height;
    }
    std::size_t number(std::int64_t i, std::int64_t k) const {
        return static_cast<std::size_t>(columns ? i * across + k : k * along + i);
    }
};

// Tiles [begin, end) along the lines of row `across` of tiles.
struct Part {
    std::int64_t begin, end, across;
};

// Sums of a part's lines, one after the other, real parts before imaginary ones.
struct Sums {
    float* at;
    std::int64_t padded;

    float* line(std::int64_t k) const { return at + 2 * k * padded; }
};

// Pixel `place` of line `line` of those that are read, as the raster has it.
double pixel(const Raster& raster, bool columns, std::int64_t place, std::int64_t line, int axis) {
    const std::int64_t row = columns ? place : line, column = columns ? line : place;
    return raster.first[3 * row + axis] + static_cast<double>(column) * raster.step[3 * row + axis];
}

// From pixel to pixel along lines that are as far apart as each other, by line `line` of the whole image: a part may
// have one pixel.
double step_of(const Raster& raster, const Cut& cut, std::int64_t line, int axis) {
    const std::int64_t whole = cut.whole_along - 1;
    return (pixel(raster, cut.columns, whole, line, axis) - pixel(raster, cut.columns, 0, line, axis)) /
           static_cast<double>(whole);
}

// Sums lines [left, right) at pixels [begin, end) from one sub-image; they come to lie at `to` on.
void sum_lines(const Kernels& kernels, ColumnJob job, const Raster& raster, const Cut& cut, std::int64_t begin,
               std::int64_t end, std::int64_t left, std::int64_t right, const Sums& sums, std::int64_t to) {
    const std::int64_t count = end - begin;
    job.count = count;
    double away = 0;
    for (int axis = 0; axis < 2; ++axis) {
        job.step[axis] = step_of(raster, cut, left, axis);
        away += (pixel(raster, cut.columns, begin, left, axis) - job.image->centre[axis]) * job.step[axis];
    }
    const bool outward = away > 0;
    for (int axis = 0; axis < 2 && !outward; ++axis) job.step[axis] = -job.step[axis];
    for (std::int64_t k = left; k < right; ++k) {
        for (int axis = 0; axis < 2; ++axis)
            job.first[axis] = pixel(raster, cut.columns, outward ? begin : end - 1, k, axis);
        kernels.column(job);
        float *re = sums.line(k - left) + to, *im = re + sums.padded;
        for (std::int64_t m = 0; m < count; ++m) {
            const std::int64_t from = outward ? m : count - 1 - m;
            re[m] += job.re[from];
            im[m] += job.im[from];
        }
    }
}

// Heights of a part's pixels, line by line, `padded` apart.
struct Ground {
    const double* at;
    std::int64_t padded;
};

// The same for pixels of a map, the first of which is number `first` of those whose heights these are: in pieces that
// have a slope each.
void sum_relief(const Kernels& kernels, ColumnJob job, const Raster& raster, const Cut& cut, std::int64_t begin,
                std::int64_t end, std::int64_t left, std::int64_t right, const Sums& sums, std::int64_t first,
                const Ground& ground) {
    for (int axis = 0; axis < 2; ++axis) job.step[axis] = step_of(raster, cut, left, axis);
    const std::int64_t longest = read_at_once(cut.tile_along) * cut.tile_along;
    for (std::int64_t k = left; k < right; ++k) {
        for (std::int64_t from = begin; from < end; from += job.count) {
            job.count = std::min(longest - from % longest, end - from);
            for (int axis = 0; axis < 2; ++axis) job.first[axis] = pixel(raster, cut.columns, from, k, axis);
            job.heights = ground.at + (k - left) * ground.padded + from - first;
            kernels.column(job);
            float *re = sums.line(k - left) + from - first, *im = re + sums.padded;
            for (std::int64_t m = 0; m < job.count; ++m) {
                re[m] += job.re[m];
                im[m] += job.im[m];
            }
        }
    }
}

// Heights of pixels [begin, end) of lines [left, right).
void heights_of(const Raster& raster, bool columns, std::int64_t begin, std::int64_t end, std::int64_t left,
                std::int64_t right, std::int64_t padded, double* to) {
    for (std::int64_t i = begin; i < end; i += square) {
        for (std::int64_t k = left; k < right; ++k) {
            for (std::int64_t m = i; m < std::min(i + square, end); ++m)
                to[(k - left) * padded + m - begin] = columns ? raster.heights(m, k) : raster.heights(k, m);
        }
    }
}

// Adds sums of pixels [begin, end) of lines [left, right), which lie at `at` on, to the image.
template <typename Pixel>
void add(const Sums& sums, std::int64_t at, const Raster& raster, bool columns, std::int64_t begin, std::int64_t end,
         std::int64_t left, std::int64_t right, const View<Pixel, 2>& image) {
    using value = typename Pixel::value_type;
    const auto one = [&](std::int64_t m, std::int64_t k) {
        const std::int64_t row = columns ? m : k, column = columns ? k : m;
        if (raster.mask && !raster.mask[row * raster.width + column]) return;
        const float* from = sums.line(k - left) + at + m - begin;
        image(row, column) += Pixel(static_cast<value>(from[0]), static_cast<value>(from[sums.padded]));
    };
    for (std::int64_t i = begin; i < end; i += square) {
        for (std::int64_t j = left; j < right; j += square) {
            const std::int64_t last = std::min(i + square, end), stop = std::min(j + square, right);
            if (columns) {
                for (std::int64_t m = i; m < last; ++m) {
                    for (std::int64_t k = j; k < stop; ++k) one(m, k);
                }
            } else {
                for (std::int64_t k = j; k < stop; ++k) {
                    for (std::int64_t m = i; m < last; ++m) one(m, k);
                }
            }
        }
    }
}

}  // namespace

template <typename Pixel>
void read_along(const Kernels& kernels, const Tree& tree, const std::vector<Source>& sources, const Raster& raster,
                Reads how, int stretch, double turn, const View<Pixel, 2>& image, int threads, const Tick& tick) {
    const Cut cut(raster, how);
    const std::int64_t most = std::max<std::int64_t>(longest / cut.tile_along, 1);
    std::vector<Part> parts;
    for (std::int64_t k = 0; k < cut.across; ++k) {
        for (std::int64_t i = 0; i < cut.along; i += most) {
            const std::int64_t end = std::min(i + most, cut.along);
            const bool any = std::any_of(sources.begin(), sources.end(), [&](const Source& source) {
                for (std::int64_t m = i; m < end; ++m) {
                    if (source.reads[cut.number(m, k)] == how) return true;
                }
                return false;
            });
            if (any) parts.push_back({i, end, k});
        }
    }
    if (parts.empty()) return;
    double apart = 0;  // of pixels, m, along each axis at most
    for (int axis = 0; axis < 2; ++axis)
        apart += std::abs(pixel(raster, cut.columns, cut.whole_along - 1, 0, axis) -
                          pixel(raster, cut.columns, 0, 0, axis)) /
                 static_cast<double>(cut.whole_along - 1);
    const std::int64_t pixels = most * cut.tile_along, padded = pixels + block;
    const auto nodes = static_cast<std::int64_t>(static_cast<double>(pixels) * apart / sources.front().image.step);
    const std::int64_t room = (nodes / block + 6) * block;
    Scratch scratch;
    run(
        static_cast<std::int64_t>(parts.size()), threads,
        [&](std::int64_t task) {
            const Part& part = parts[static_cast<std::size_t>(task)];
            const std::int64_t left = part.across * cut.tile_across,
                               right = std::min(left + cut.tile_across, cut.whole_across);
            const std::int64_t first = part.begin * cut.tile_along,
                               last = std::min(part.end * cut.tile_along, cut.whole_along);
            const bool relief = raster.heights.z != nullptr;
            const std::int64_t summed = 2 * (right - left) * padded;
            auto work = scratch.take(static_cast<std::size_t>(4 * room + 2 * padded + summed) + aligned);
            float* const begin = align(work.data());
            const Sums sums{begin + 4 * room + 2 * padded, padded};
            std::fill_n(sums.at, summed, 0.0F);
            ColumnJob job{&tree, nullptr, {}, {}, 0, stretch, room, begin, begin + 4 * room, begin + 4 * room + padded};
            std::vector<double> heights;
            if (relief) {
                heights.resize(static_cast<std::size_t>((right - left) * padded));
                heights_of(raster, cut.columns, first, last, left, right, padded, heights.data());
                job.turn = turn;
            }
            const Ground ground{heights.data(), padded};
            std::int64_t low = last, high = first;
            for (const Source& source : sources) {
                job.image = &source.image;
                job.stack = &source.stack;
                for (std::int64_t i = part.begin; i < part.end;) {
                    if (source.reads[cut.number(i, part.across)] != how) {
                        ++i;
                        continue;
                    }
                    std::int64_t stop = i + 1;
                    while (stop < part.end && source.reads[cut.number(stop, part.across)] == how) ++stop;
                    const std::int64_t from = i * cut.tile_along, to = std::min(stop * cut.tile_along, last);
                    if (relief)
                        sum_relief(kernels, job, raster, cut, from, to, left, right, sums, first, ground);
                    else
                        sum_lines(kernels, job, raster, cut, from, to, left, right, sums, from - first);
                    low = std::min(low, from);
                    high = std::max(high, to);
                    i = stop;
                }
            }
            add(sums, low - first, raster, cut.columns, low, high, left, right, image);
            scratch.give(std::move(work));
        },
        tick);
}

using Single = std::complex<float>;
using Double = std::complex<double>;

template void read_along(const Kernels&, const Tree&, const std::vector<Source>&, const Raster&, Reads, int, double,
                         const View<Single, 2>&, int, const Tick&);
template void read_along(const Kernels&, const Tree&, const std::vector<Source>&, const Raster&, Reads, int, double,
                         const View<Double, 2>&, int, const Tick&);

}  // namespace pysas
