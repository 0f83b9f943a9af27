// The tree of fast factorised back-projection: sub-images of the shortest groups from traces, of longer ones from
// theirs, and the image from the longest. Every step is one call, its rays or tiles on worker threads.
#pragma once

#include <cstdint>
#include <vector>

#include "core/kernels.hpp"
#include "core/summation.hpp"
#include "core/threads.hpp"
#include "core/views.hpp"

namespace pysas {

// Taps from their polynomials: even (taps / 2, taps / 2 + 1), odd (taps / 2, taps / 2), powers by taps (taps + 1, 8).
Taps make_taps(int count, const float* even, const float* odd, const float* tap, const float* filter, int half);

// Sub-images whose rows lie in `store`: place (count, 7) centre, plane, first angle, angle step, node step; shape
// (count, 5) i0, rays, stride, where in the store, number of the first range. Throws Error(argument) where they do not
// fit.
std::vector<SubImage> sub_images(const double* place, const std::int64_t* shape, std::int64_t count,
                                 const std::int32_t* range, std::int64_t n_range, float* store, std::int64_t room);

// Fill sub-images of groups of traces: image i from traces span[i] to span[i + 1] of `terms`. With `smooth` pixels are
// to be read from them; with `fades` traces weigh what a beam's taper leaves of them. `slack`: what phase factors may
// be wrong by.
void leaves(const Kernels& kernels, const Tree& tree, const Terms<float>& terms, const std::int64_t* span,
            const SubImage* images, std::int64_t n_image, double slack, bool fades, bool smooth, int threads,
            const Tick& tick);

// Sub-images from their children: image i from children span[i] to span[i + 1], added to what it holds with `add`.
// `last`: no more children come, filter it across its rays; with `smooth` (pixels are to be read) along them too.
// `lit`: a trace of each child, which weighs what a beam's taper leaves of it; or null.
void merge(const Kernels& kernels, const Tree& tree, const SubImage* children, const std::int64_t* span,
           const SubImage* images, std::int64_t n_image, const Trace* const* lit, const Light& light, bool add,
           bool last, bool smooth, int threads, const Tick& tick);

// Filter sub-images along their rays, which pixels are read off one by one.
void smooth_along(const Kernels& kernels, const Tree& tree, const SubImage* images, std::int64_t n_image, int threads,
                  const Tick& tick);

// Add a sub-image to the tiles of an image for which `wanted` (in the order of rows of tiles) is not 0. The raster has
// lines on the sub-image's plane, or points and a stack.
template <typename Pixel>
void read(const Kernels& kernels, const Tree& tree, const SubImage& from, const Raster& raster, const Stack* stack,
          const std::uint8_t* wanted, const View<Pixel, 2>& image, int threads, const Tick& tick);

}  // namespace pysas
