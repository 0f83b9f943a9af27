#include "core/threads.hpp"

#include <atomic>
#include <chrono>
#include <exception>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>

#include "core/errors.hpp"

namespace pysas {

namespace {

constexpr std::chrono::milliseconds apart{50};  // from tick to tick

}  // namespace

void Poll::operator()() {
    const auto now = std::chrono::steady_clock::now();
    if (!tick_ || now - last_ < apart) return;
    if (!tick_(0)) throw Error(Code::cancelled, "stopped by the caller");
    last_ = std::chrono::steady_clock::now();
}

void run(std::int64_t count, int threads, const std::function<void(std::int64_t)>& body, const Tick& tick) {
    std::atomic<std::int64_t> next{0}, done{0};
    std::atomic<bool> stop{false};
    std::mutex guard;
    std::exception_ptr failure;
    const auto fail = [&] {
        const std::lock_guard<std::mutex> lock(guard);
        if (!failure) failure = std::current_exception();
        stop = true;
    };
    const auto step = [&] {  // one task; false when there is none left
        const std::int64_t number = next.fetch_add(1);
        if (stop || number >= count) return false;
        body(number);
        ++done;
        return true;
    };
    std::vector<std::thread> workers;
    const std::int64_t helpers = (threads < count ? threads : count) - 1;
    try {
        workers.reserve(static_cast<std::size_t>(helpers > 0 ? helpers : 0));
        for (std::int64_t i = 0; i < helpers; ++i) {
            workers.emplace_back([&] {
                try {
                    while (step()) {
                    }
                } catch (...) {
                    fail();
                }
            });
        }
    } catch (const std::system_error&) {
        // no more threads to be had: those that started, and this one, do the work
    } catch (...) {
        fail();
    }
    try {
        using clock = std::chrono::steady_clock;
        auto last = clock::now();
        while (step()) {
            if (!tick || clock::now() - last < apart) continue;
            if (!tick(static_cast<double>(done) / static_cast<double>(count)))
                throw Error(Code::cancelled, "stopped by the caller");
            last = clock::now();
        }
    } catch (...) {
        fail();
    }
    for (auto& worker : workers) worker.join();
    if (failure) std::rethrow_exception(failure);
}

}  // namespace pysas
