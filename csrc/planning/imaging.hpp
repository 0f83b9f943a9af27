// A plan carried out on data: these are checked, held against what the plan takes them to be, summed, and the image is
// brought into the range of its type.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <utility>

#include "core/dispatch.hpp"
#include "core/recipe.hpp"
#include "core/room.hpp"
#include "planning/levels.hpp"
#include "planning/planner.hpp"

namespace pysas {

// A plan and what the executor needs for it.
struct Ready {
    explicit Ready(Plan&& made) : plan(std::move(made)), recipe(plan.recipe()) {}
    Ready(const Ready&) = delete;  // the recipe looks at the plan
    Plan plan;
    Recipe recipe;
};

// What became of some data.
struct Done {
    std::shared_ptr<const Ready> by;  // the plan that was carried out
    Totals totals;
    Numbers left_out;           // traces with samples that are not finite
    std::int64_t used = 0;      // traces summed
    double beside = 0;          // error that bright samples make beyond the bounds of the plan
    double lost = 0;            // share of the image that its type does not hold, if that is more than a tenth of tol
    std::int64_t loudest = -1;  // trace beside which the others are lost in sums of floats
};

class Imaging {
  public:
    explicit Imaging(Plan plan);

    const Plan& plan() const { return first_->plan; }

    // Share what sums keep with one that was before: both may work at a time, and need twice as much then.
    void follow(const Imaging& before);

    // Image (ping, channel, sample) into (height, width), which is overwritten. Traces with samples that are not finite
    // are left out, or an error (`whole`). Throws Error(data), Error(range), Error(tolerance) where bright samples
    // beside those that pixels read forbid trees and these were asked for without a fallback, Error(cancelled).
    template <typename Sample>
    Done operator()(const View<const Sample, 3>& data, const View<Sample, 2>& image, bool whole,
                    const Tick& tick) const;

  private:
    std::shared_ptr<const Ready> variant(const Verdict& verdict) const;
    template <typename Sample>
    Totals sum(const Ready& ready, const View<const Sample, 3>& data, const std::uint8_t* used, double scale,
               const View<Sample, 2>& image, const Tick& tick) const;
    template <typename Sample>
    Verdict hold(const View<const Sample, 3>& data, const std::uint8_t* used, double scale, const Tick& poll) const;

    std::shared_ptr<const Ready> first_;
    const Kernels& kernels_;
    std::shared_ptr<Workspace> work() const {
        const std::lock_guard<std::mutex> lock(guard_);
        return work_;
    }
    std::shared_ptr<Workspace> work_ = std::make_shared<Workspace>();
    mutable std::mutex guard_;
    mutable std::unique_ptr<const SomeTerms> terms_;
    mutable std::map<std::pair<bool, double>, std::shared_ptr<const Ready>> others_;  // by trees left and ends
};

}  // namespace pysas
