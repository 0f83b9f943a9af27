// Interpolation between a tree's nodes: Kaiser-Bessel taps and the filter that undoes their smoothing, designed
// together.
#pragma once

#include "core/kernels.hpp"

namespace pysas {

// Taps for nodes `rate` times as dense as the band needs; error of a unit component over band and places, at worst and
// on average.
struct TapDesign {
    Taps taps{};
    double rate = 0, worst = 0, rms = 0;

    // nodes beside a place that it depends on
    int reach() const { return taps.half + taps.count / 2; }
};

// The best of the Kaiser-Bessel windows of `count` taps (6 or 8) with a filter of `half` nodes to each side. With A the
// filter's response and S(f, x) the taps' sum at place x, A S = 1 is solved by least squares over band and places, the
// band's edge weighing most (near-minimax). As in non-uniform FFTs (Fessler & Sutton, 2003) such taps need far fewer
// than an interpolator of plain samples.
TapDesign design_taps(int count, double rate, int half);

}  // namespace pysas
