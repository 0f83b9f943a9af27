#include "core/leaving.hpp"

#include <atomic>
#include <chrono>
#include <thread>

namespace pysas::leaving {
namespace {

enum Stage { staying, stopped, kept };
std::atomic<Stage> stage{staying};
std::atomic<std::int64_t> number{0};
std::thread::id last;  // set before the stage

bool mine() { return std::this_thread::get_id() == last; }

}  // namespace

void stop_others() {
    last = std::this_thread::get_id();
    stage = stopped;
}

void keep_others() { stage = kept; }

bool stopping() { return stage != staying && !mine(); }

void off() { ++number; }

void back() {
    if (stage != kept || mine()) return;
    --number;
    for (;;) std::this_thread::sleep_for(std::chrono::hours(24));
}

void home() { --number; }

std::int64_t away() { return number; }

}  // namespace pysas::leaving
