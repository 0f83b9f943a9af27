// Tasks by number on worker threads that live for one call: nothing is left for a fork to inherit.
#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <mutex>
#include <utility>
#include <vector>

namespace pysas {

// Called from the calling thread, at most every 0.05 s, with the share of tasks done; false asks to stop.
using Tick = std::function<bool(double)>;

// Call body(0) ... body(count - 1), in order of a shared counter, on `threads` threads, the calling one among them. The
// first exception of a task ends the others after their current task and is thrown here; a tick that returns false
// throws Error(cancelled).
void run(std::int64_t count, int threads, const std::function<void(std::int64_t)>& body, const Tick& tick);

// Asks a tick now and then in work that one thread does.
class Poll {
  public:
    explicit Poll(const Tick& tick) : tick_(tick) {}
    // Throws Error(cancelled) where the tick stops.
    void operator()();
    // The same for what `run` does.
    Tick tick() const {
        return tick_ ? Tick([this](double) { return tick_(0); }) : Tick();
    }

  private:
    const Tick& tick_;
    std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
};

// Working memory that tasks of one call borrow, so that each worker allocates once and not for every task.
class Scratch {
  public:
    using Buffer = std::vector<float>;

    Buffer take(std::size_t size) {
        Buffer out;
        {
            const std::lock_guard<std::mutex> lock(guard_);
            if (!free_.empty()) {
                out = std::move(free_.back());
                free_.pop_back();
            }
        }
        if (out.size() < size) out.resize(size);
        return out;
    }
    void give(Buffer&& buffer) {
        const std::lock_guard<std::mutex> lock(guard_);
        free_.push_back(std::move(buffer));
    }

  private:
    std::mutex guard_;
    std::vector<Buffer> free_;
};

}  // namespace pysas
