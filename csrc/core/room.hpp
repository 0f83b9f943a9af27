// Memory for many numbers.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <new>
#include <utility>

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

}  // namespace pysas
