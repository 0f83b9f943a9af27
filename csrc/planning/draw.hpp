// Samples of things, the same on every platform and at every call.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "planning/scene.hpp"

namespace pysas {

// Steele, Lea and Flood's SplitMix64.
class Draw {
  public:
    explicit Draw(std::uint64_t seed) : state_(seed) {}
    double next() {  // in [0, 1)
        std::uint64_t z = state_ += 0x9e3779b97f4a7c15U;
        z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9U;
        z = (z ^ (z >> 27)) * 0x94d049bb133111ebU;
        return static_cast<double>((z ^ (z >> 31)) >> 11) * 0x1p-53;
    }
    std::size_t below(std::size_t count) { return static_cast<std::size_t>(next() * static_cast<double>(count)); }

  private:
    std::uint64_t state_;
};

// Of `count` things at most `most`, evenly spaced, the first and the last among them.
Numbers some_of(std::int64_t count, std::int64_t most);

// Numbers of at most `count` of a scene's wanted pixels, one somewhere in each of equal parts, ascending.
Numbers drawn_pixels(const Scene& scene, std::int64_t count, std::uint64_t seed);

// About the image's centre.
std::vector<Point> places_of(const Pixels& pixels, const Numbers& numbers);

}  // namespace pysas
