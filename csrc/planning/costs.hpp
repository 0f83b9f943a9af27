// What things cost: rough times of parts of sums, ns on one thread, by which planners compare their options.
#pragma once

#include <cstdint>

#include "core/filters.hpp"
#include "planning/scene.hpp"

namespace pysas {

struct Settings;

// Of an instruction set.
struct Costs {
    const char* isa;
    double term, coefficient, line, exact, gathered;  // see costs.cpp
    int lanes;
    struct Window {
        double registers, times;
    } windows[4];
    struct {
        double term, node, merge[2], read[2];
    } tree;
};

const Costs& costs_of(const char* isa);

constexpr double line_cost = 0.35;      // of a pixel read alone: one of a line that is read whole
constexpr double relief_cost = 2.0;     // times as long as from their plane: pixels read off it
constexpr double tree_seconds = 0.003;  // of a tree that threads do not share, its planning included
// Trees are judged as on so many threads, which do not share all of their work: the image is the same for any number.
constexpr double judged_threads = 2;
constexpr double arc_ns = 40;           // of a pixel's view where each has its own weight
constexpr double plan_seconds = 0.003;  // of planning any trees at all

// ns of a term, the mean of those with a block's delay polynomial and those nearer than `near`; of `part` of all terms,
// the nearest.
double term_ns(const Scene& scene, const Costs& costs, bool narrow, int block, double near, int degree,
               double oversampling, double part = 1);

// Of a coefficient, made by a filter.
double coefficient_ns(const Filter& filter);

// Of making all coefficients of `traces` traces; of the direct sum of `part` of the terms, the nearest: s on one
// thread.
double prepare_seconds(const Settings& settings, std::int64_t traces);
double sum_seconds(const Scene& scene, const Settings& settings, const Costs& costs, double part = 1);

}  // namespace pysas
