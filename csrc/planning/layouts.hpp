// How a tree of sub-apertures is cut: the cheapest layout whose error bounds keep a tolerance. The bounds are those of
// pysas/imaging/planner.py, the costs those of pysas/planning/layouts.py and pysas/planning/costs.py.
#pragma once

#include <cstdint>
#include <optional>

#include "core/summation.hpp"
#include "planning/subapertures.hpp"

namespace pysas {

constexpr double tree_tol = 3e-5;      // below it float32 sub-images would round too much
constexpr double share_leaves = 0.35;  // of tol, for the sums of a tree's leaves
constexpr double share_drift = 0.05;   // of the leaves' share: phase factors along a ray

// `raster`: straight lines on a horizontal plane; `isa`: the kernels' name. Nothing if no interpolation keeps `tol`, or
// no pixel is far enough from any group. What it must be clear of is left open.
std::optional<Layout> choose_layout(const Geometry& geometry, const Raster& raster, double tol, const char* isa);

// A layout with the slant ranges from which the polynomials along its leaves' rays hold, and those of its merges.
Layout cleared(const Geometry& geometry, const Raster& raster, Layout layout, double tol);

}  // namespace pysas
