// From `tol` to a plan: the only place that knows how an error is bought with time. Looks at the scene, leaves out what
// it does not need, and takes the method of the least predicted time whose error bounds sum to at most `tol`.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "core/recipe.hpp"
#include "core/threads.hpp"
#include "planning/costs.hpp"
#include "planning/forest.hpp"
#include "planning/scene.hpp"
#include "planning/settings.hpp"

namespace pysas {

enum class Method { automatic, backprojection, ffbp };

// What is asked of a plan. `budget`: of tol, what sums may be wrong by; weights that change from pixel to pixel have
// the rest. `fallback`: whether terms that no tree serves may be summed directly, where trees are asked for; `leave`:
// whether trees may be left for data that are too bright for them; `pay`: whether trees must take less time than direct
// sums to be used.
struct Wish {
    double tol, budget;
    Method method;
    bool fallback, leave, pay;
    int threads;
    const char* isa;
};

struct Plan {
    Wish wish;
    std::shared_ptr<const Scene> scene;  // with the samples that trees ask for, where there are any
    Settings settings;
    std::optional<PlannedForest> trees;
    int block;               // pixels of a block of the image's lines; 0: the image is points
    std::string why_direct;  // or empty
    double seconds = 0;      // predicted, on one thread
    std::string other;       // the method that is not used: its predicted time, or why it cannot be; or not looked at

    double share() const { return trees ? trees->share : 0; }
    // Of a trace: number of the first sample that tables are made of; it may lie before the record.
    std::int64_t start(std::size_t trace) const;
    // Whether the image is a sum of so many batches, or trees, that floats would round it too often.
    bool wide() const;
    std::int64_t memory() const;  // bytes allocated beyond the input, about, but for what callers' weights take
    double predicted_error() const { return settings.predicted() + wish.tol - wish.budget; }
    Recipe recipe() const;  // of which this plan keeps mask and trees
    // What was chosen, a line for each part of it; `shape` of the image and `more` bytes that a caller allocates.
    std::string describe(const std::string& shape, std::int64_t more) const;
};

// The lowest tol that floats, or doubles, keep over a scene.
double least_tol(const Scene& scene);

// Throws Error(tolerance) where `tol` cannot be kept, or where without `fallback` not all terms go through trees.
// `tick` is asked while trees are made, with share 0.
Plan plan(std::shared_ptr<const Scene> scene, const Wish& wish, const Tick& tick = {});

// The same without trees, and with tables from whole records, whose ends are `ends` times as bright as what pixels read
// (without trees where their rate is too low for all that whole records hold).
Plan directly(const Plan& plan, const std::string& why);
Plan widely(const Plan& plan, double ends);

// The method that a plan does not use: its predicted time, or why it cannot be. Looks for trees where none were asked
// for.
std::string alternative(const Plan& plan);

}  // namespace pysas
