#include "core/factorised.hpp"

#include <algorithm>
#include <cmath>
#include <complex>
#include <vector>

#include "core/errors.hpp"
#include "core/lattice.hpp"
#include "core/room.hpp"

namespace pysas {
namespace {

constexpr std::int64_t columns = 256;  // of a sub-image smoothed across its rays at a time
constexpr std::int64_t rays_at_once = 8;

struct Piece {
    std::int64_t image, begin, end;
};

void smooth_across(const Kernels& kernels, const Tree& tree, const SubImage* images, std::int64_t n_image, int threads,
                   const Tick& tick) {
    std::vector<Piece> pieces;
    for (std::int64_t i = 0; i < n_image; ++i) {
        for (std::int64_t m = 0; m < images[i].stride; m += columns)
            pieces.push_back({i, m, std::min(m + columns, images[i].stride)});
    }
    Scratch scratch;
    run(
        static_cast<std::int64_t>(pieces.size()), threads,
        [&](std::int64_t task) {
            const Piece& piece = pieces[static_cast<std::size_t>(task)];
            const SubImage& image = images[piece.image];
            std::int64_t first = image.rays, last = 0;
            for (std::int64_t r = 0; r < image.rays; ++r) {
                const std::int32_t* range = image.range + 2 * r;
                if (range[0] < piece.end && range[1] > piece.begin && range[0] < range[1]) {
                    first = std::min(first, r);
                    last = r + 1;
                }
            }
            if (last - first <= 2 * tree.taps->half) return;
            auto work = scratch.take(static_cast<std::size_t>((last - first) * block));
            for (float* plane : {image.re, image.im})
                kernels.smooth_across(*tree.taps, plane, image.stride, first, last, piece.begin, piece.end,
                                      work.data());
            scratch.give(std::move(work));
        },
        tick);
}

}  // namespace

void smooth_along(const Kernels& kernels, const Tree& tree, const SubImage* images, std::int64_t n_image, int threads,
                  const Tick& tick) {
    const int half = tree.taps->half;
    for (std::int64_t i = 0; i < n_image; ++i) {
        const SubImage& image = images[i];
        run(
            image.rays, threads,
            [&](std::int64_t ray) {
                const std::int64_t begin = image.range[2 * ray], count = image.range[2 * ray + 1] - begin;
                if (count <= 2 * half) return;
                std::vector<float> in(static_cast<std::size_t>(count + block)), out(in.size());
                for (float* plane : {image.re, image.im}) {
                    float* row = plane + ray * image.stride + begin;
                    std::copy_n(row, count, in.data());
                    kernels.smooth(*tree.taps, in.data() + half, out.data(), count - 2 * half);
                    std::copy_n(out.data(), count - 2 * half, row + half);
                }
            },
            tick);
    }
}

Taps make_taps(int count, const float* even, const float* odd, const float* tap, const float* filter, int half) {
    if ((count != 6 && count != 8) || half < 0 || half > max_smoothing)
        throw Error(Code::argument, "taps: a count or a filter that no kernel has");
    Taps taps{};
    taps.count = count;
    taps.half = half;
    const int pairs = count / 2;
    for (int p = 0; p < pairs; ++p) {
        std::copy_n(even + p * (pairs + 1), pairs + 1, taps.even[p]);
        std::copy_n(odd + p * pairs, pairs, taps.odd[p]);
    }
    for (int q = 0; q <= count; ++q) std::copy_n(tap + q * max_taps, max_taps, taps.tap[q]);
    std::copy_n(filter, half + 1, taps.filter);
    return taps;
}

std::vector<SubImage> sub_images(const double* place, const std::int64_t* shape, std::int64_t count,
                                 const std::int32_t* range, std::int64_t n_range, float* store, std::int64_t room) {
    std::vector<SubImage> out;
    for (std::int64_t i = 0; i < count; ++i) {
        const double* p = place + 7 * i;
        const std::int64_t *n = shape + 5 * i, plane = n[1] * n[2];
        if (n[1] < max_taps || n[2] < block || n[3] < 0 || n[3] + 2 * plane > room || n[4] < 0 ||
            2 * (n[4] + n[1]) > n_range)
            throw Error(Code::argument, "sub-images do not fit into their arrays");
        for (std::int64_t r = 0; r < n[1]; ++r) {  // vectors run on behind a ray's last node
            const std::int32_t* ends = range + 2 * (n[4] + r);
            if (ends[0] < 0 || ends[1] + block > n[2])
                throw Error(Code::argument, "sub-images' rays do not fit into their rows");
        }
        float* re = store + n[3];
        out.push_back({{p[0], p[1], p[2]}, p[3], p[4], p[5], p[6], n[0], n[1], n[2], re, re + plane, range + 2 * n[4]});
    }
    return out;
}

void leaves(const Kernels& kernels, const Tree& tree, const Terms<float>& terms, const std::int64_t* span,
            const SubImage* images, std::int64_t n_image, double slack, bool fades, bool smooth, int threads,
            const Tick& tick) {
    compiled(terms);
    std::vector<Piece> pieces;
    for (std::int64_t i = 0; i < n_image; ++i) {
        std::int64_t begin = images[i].stride, end = 0;
        for (std::int64_t r = 0; r < images[i].rays; ++r) {
            const std::int32_t* range = images[i].range + 2 * r;
            if (range[0] >= range[1]) continue;
            begin = std::min<std::int64_t>(begin, range[0]);
            end = std::max<std::int64_t>(end, range[1]);
        }
        for (std::int64_t m = begin; m < end; m += block) pieces.push_back({i, m, std::min(m + block, end)});
    }
    // a task takes all rays of a stretch: they read the same samples
    run(
        static_cast<std::int64_t>(pieces.size()), threads,
        [&](std::int64_t task) {
            const Piece& piece = pieces[static_cast<std::size_t>(task)];
            const SubImage& image = images[piece.image];
            Terms<float> part = terms;
            part.traces += span[piece.image];
            part.table += span[piece.image] * terms.trace_stride;
            part.n_trace = span[piece.image + 1] - span[piece.image];
            Lattice lattice{};
            if (terms.lattice) {
                lattice = *terms.lattice;
                lattice.value += span[piece.image];
                part.lattice = &lattice;
            }
            TileWeights<float> weights;
            alignas(64) float re[tile_rows * block], im[tile_rows * block];
            std::int64_t rays[tile_rows];
            LeafJob job{&tree, &image, &part, rays, 0, 0, 0, static_cast<float>(slack), fades, re, im, nullptr};
            for (std::int64_t ray = 0; ray < image.rays;) {
                // rays that have nodes here, and what of the stretch they need
                std::int64_t begin = piece.end, end = piece.begin;
                for (job.rows = 0; job.rows < tile_rows && ray < image.rays; ++ray) {
                    const std::int64_t from = std::max<std::int64_t>(image.range[2 * ray], piece.begin);
                    const std::int64_t to = std::min<std::int64_t>(image.range[2 * ray + 1], piece.end);
                    if (from >= to) continue;
                    begin = std::min(begin, from);
                    end = std::max(end, to);
                    rays[job.rows++] = ray;
                }
                if (job.rows == 0) break;
                job.begin = begin;
                job.count = static_cast<int>(end - begin);
                job.weights = weights.of_rays(part, image, rays, job.rows, begin, job.count);
                kernels.leaf(job);
                for (int r = 0; r < job.rows; ++r) {
                    std::copy_n(re + r * block, job.count, image.re + rays[r] * image.stride + begin);
                    std::copy_n(im + r * block, job.count, image.im + rays[r] * image.stride + begin);
                }
            }
        },
        tick);
    if (smooth) smooth_along(kernels, tree, images, n_image, threads, tick);
    smooth_across(kernels, tree, images, n_image, threads, tick);
}

void merge(const Kernels& kernels, const Tree& tree, const SubImage* children, const std::int64_t* span,
           const SubImage* images, std::int64_t n_image, const Trace* const* lit, const Light& light, bool add,
           bool last, bool smooth, int threads, const Tick& tick) {
    std::vector<Piece> pieces;
    std::int64_t longest = 0;
    for (std::int64_t i = 0; i < n_image; ++i) {
        for (std::int64_t r = 0; r < images[i].rays; r += rays_at_once)
            pieces.push_back({i, r, std::min(r + rays_at_once, images[i].rays)});
        longest = std::max(longest, images[i].stride);
        for (std::int64_t c = span[i]; c < span[i + 1]; ++c) longest = std::max(longest, children[c].stride);
    }
    const std::int64_t room = (longest / block + 4) * block;
    Scratch scratch;
    run(
        static_cast<std::int64_t>(pieces.size()), threads,
        [&](std::int64_t task) {
            const Piece& piece = pieces[static_cast<std::size_t>(task)];
            auto work = scratch.take(static_cast<std::size_t>(4 * room) + aligned);
            MergeJob job{&tree,
                         images + piece.image,
                         children + span[piece.image],
                         span[piece.image + 1] - span[piece.image],
                         0,
                         room,
                         add,
                         smooth,
                         align(work.data()),
                         lit ? lit + span[piece.image] : nullptr,
                         &light};
            for (job.ray = piece.begin; job.ray < piece.end; ++job.ray) kernels.merge(job);
            scratch.give(std::move(work));
        },
        tick);
    if (last) smooth_across(kernels, tree, images, n_image, threads, tick);
}

template <typename Pixel>
void read(const Kernels& kernels, const Tree& tree, const SubImage& from, const Raster& raster, const Stack* stack,
          const std::uint8_t* wanted, const View<Pixel, 2>& image, int threads, const Tick& tick) {
    const Tiling tiling(raster);
    run(
        tiling.count(), threads,
        [&](std::int64_t task) {
            if (!wanted[task]) return;
            const Tiling::Tile tile = tiling.at(task);
            alignas(64) float re[tile_rows * block] = {}, im[tile_rows * block] = {};
            double lines[tile_rows * 6];
            std::uint8_t active[tile_rows];
            ReadJob job{&tree,
                        &from,
                        stack ? nullptr : lines,
                        stack ? raster.points + 3 * (tile.top * raster.width + tile.left) : nullptr,
                        raster.width,
                        stack,
                        active,
                        static_cast<int>(tile.bottom - tile.top),
                        static_cast<int>(tile.right - tile.left),
                        re,
                        im};
            if (!stack) tiling.lines(tile, lines);
            for (int r = 0; r < job.rows; ++r) active[r] = tiling.any(tile.top + r, tile.left, tile.right);
            kernels.read(job);
            using value = typename Pixel::value_type;
            for (int r = 0; r < job.rows; ++r) {
                Pixel* to = &image(tile.top + r, tile.left);
                for (int m = 0; m < job.count; ++m)
                    to[m * image.stride[1]] +=
                        Pixel(static_cast<value>(re[r * block + m]), static_cast<value>(im[r * block + m]));
            }
        },
        tick);
}

template void read(const Kernels&, const Tree&, const SubImage&, const Raster&, const Stack*, const std::uint8_t*,
                   const View<std::complex<float>, 2>&, int, const Tick&);
template void read(const Kernels&, const Tree&, const SubImage&, const Raster&, const Stack*, const std::uint8_t*,
                   const View<std::complex<double>, 2>&, int, const Tick&);

}  // namespace pysas
