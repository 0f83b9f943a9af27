// One run of a recipe: what its parts share. The caller's side is core/recipe.hpp.
#pragma once

#include <chrono>
#include <cstdint>

#include "core/recipe.hpp"
#include "core/room.hpp"

namespace pysas {

// Tells the caller's tick of parts of the work, as shares of all of it that never fall, and never reach 1.
class Progress {
  public:
    explicit Progress(const Tick& tick) : tick_(tick) {}

    // For a part whose shares are `done` to `done + more` of all.
    Tick part(double done, double more) {
        if (!tick_) return {};
        return [this, done, more](double share) { return tell(done + share * more); };
    }
    // For a part that has no share of its own, but may take long.
    Tick poll() { return part(0, 0); }
    // Steps too short to tick by themselves still add up. Throws Error(cancelled).
    void reach(double share);

  private:
    bool tell(double share);

    const Tick& tick_;
    double reached_ = 0;
};

class Stopwatch {
  public:
    // Seconds since the last time, or since it was made.
    double lap() {
        const auto now = std::chrono::steady_clock::now();
        const std::chrono::duration<double> passed = now - last_;
        last_ = now;
        return passed.count();
    }

  private:
    std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

struct Execution {
    const Recipe& recipe;
    const std::uint8_t* used;  // traces
    double scale;
    int threads;
    const Kernels& kernels;
    Workspace& work;
    Progress progress;
    Totals totals{};
};

// The recipe's sum through its forest, to `image` (height, width).
template <typename Sample, typename Pixel>
void sum_forest(Execution& run, const View<const Sample, 3>& data, const View<Pixel, 2>& image);

}  // namespace pysas
