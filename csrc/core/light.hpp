// What beams light, and the polynomials by which kernels know.
#pragma once

#include "core/kernels.hpp"

namespace pysas {

// A beam as kernels take it, its quick powers left out.
Light light_of(const Beam& beam);

// Fit the powers of a fan that has a taper; returns the largest error of a weight, that of sines in float with it.
// Nothing else has any: 0.
double fit_powers(const Beam& beam, Light& light);

// Whether a term counts whose pixel lies `away` from the transmitter.
bool lights(const Light& light, const Trace& trace, const double (&away)[3]);

// How a ball about a place `away` from the transmitter is lit: nowhere, or nowhere because it lies behind a fan; all of
// it with the same weight; with one that fades, or by a part of the beam that does; or across a hard edge, which a
// fan's side is too.
enum class Lit { nowhere, behind, alike, fading, cut };
Lit lit(const Light& light, const Trace& trace, const double (&away)[3], double radius);

// What it weighs then.
double brightness(const Beam& beam, const Trace& trace, const double (&away)[3]);

}  // namespace pysas
