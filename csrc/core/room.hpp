// Memory for many numbers.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <mutex>
#include <new>
#include <utility>
#include <vector>

#if defined(__linux__)
#include <sys/mman.h>
#endif

namespace pysas {

// Floats by which vectors' loads lie on lines of the cache, and the first such place at `from` or behind.
constexpr std::size_t aligned = 16;
inline float* align(float* from) {
    const auto place = reinterpret_cast<std::uintptr_t>(from);
    return from + (aligned - place / sizeof(float) % aligned) % aligned;
}

// Room for `count` numbers, all 0 or not set, in large pages where the system has them: the first touch of small ones
// takes as long as some sums do.
template <typename T>
class Room {
  public:
    Room() = default;
    explicit Room(std::size_t count, bool zero = false)
        : data_(static_cast<T*>(zero ? std::calloc(count, sizeof(T)) : std::malloc(count * sizeof(T)))), count_(count) {
        if (!data_ && count > 0) throw std::bad_alloc();
#if defined(__linux__)
        constexpr std::uintptr_t page = 4096;
        const auto begin = (reinterpret_cast<std::uintptr_t>(data_) + page - 1) / page * page;
        const auto end = reinterpret_cast<std::uintptr_t>(data_ + count) / page * page;
        if (count * sizeof(T) >= least) madvise(reinterpret_cast<void*>(begin), end - begin, MADV_HUGEPAGE);
#endif
    }
    ~Room() { std::free(data_); }
    Room(const Room&) = delete;
    Room(Room&& other) noexcept : data_(other.data_), count_(other.count_) {
        other.data_ = nullptr;
        other.count_ = 0;
    }
    Room& operator=(Room other) noexcept {
        std::swap(data_, other.data_);
        std::swap(count_, other.count_);
        return *this;
    }

    T* get() const { return data_; }
    std::size_t size() const { return count_; }

  private:
    static constexpr std::size_t least = std::size_t{1} << 22;  // bytes

    T* data_ = nullptr;
    std::size_t count_ = 0;
};

// Rooms that were given back, for who comes next: pages that were touched once need not be cleared again. All of a
// room's numbers have been set, to what nobody may rely on.
template <typename T>
class Pool {
  public:
    Room<T> take(std::size_t count) {
        const std::lock_guard<std::mutex> lock(guard_);
        const auto least =
            std::find_if(free_.begin(), free_.end(), [&](const auto& room) { return room.size() >= count; });
        if (least != free_.end()) {
            Room<T> out = std::move(*least);
            free_.erase(least);
            return out;
        }
        if (!free_.empty()) free_.pop_back();  // or rooms that are too small would pile up
        return Room<T>(count + count / 8, true);
    }
    void give(Room<T>&& room) {
        if (room.size() == 0) return;
        const std::lock_guard<std::mutex> lock(guard_);
        const auto behind =
            std::find_if(free_.begin(), free_.end(), [&](const auto& other) { return other.size() >= room.size(); });
        free_.insert(behind, std::move(room));
    }

  private:
    std::mutex guard_;
    std::vector<Room<T>> free_;  // by size
};

// A pool's room of at least `count` numbers, until this goes.
template <typename T>
class Loan {
  public:
    Loan() = default;
    Loan(Pool<T>& pool, std::size_t count) : pool_(&pool), room_(pool.take(count)) {}
    ~Loan() {
        if (pool_) pool_->give(std::move(room_));
    }
    Loan(Loan&& other) noexcept : pool_(std::exchange(other.pool_, nullptr)), room_(std::move(other.room_)) {}
    Loan& operator=(Loan other) noexcept {
        std::swap(pool_, other.pool_);
        std::swap(room_, other.room_);
        return *this;
    }

    T* get() const { return room_.get(); }
    std::size_t size() const { return room_.size(); }

  private:
    Pool<T>* pool_ = nullptr;
    Room<T> room_;
};

// What sums keep from one image to the next.
class Workspace {
  public:
    template <typename T>
    Pool<T>& of() {
        if constexpr (sizeof(T) == sizeof(float))
            return single_;
        else
            return double_;
    }

  private:
    Pool<float> single_;
    Pool<double> double_;
};

}  // namespace pysas
