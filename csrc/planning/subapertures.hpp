// Polar grids of groups of traces: the geometry of fast factorised back-projection, free of choices. See docs/ffbp.md.
#pragma once

#include <cstdint>
#include <vector>

#include "core/kernels.hpp"
#include "core/points.hpp"
#include "core/trees.hpp"
#include "planning/groups.hpp"
#include "planning/layouts.hpp"

namespace pysas {

constexpr double near_lengths = 1.15;  // a group's centre stays this many lengths away from what is read from it
constexpr double widest_beam = 0.1;    // between rays at most, rad

struct Span {
    double low, high;
};

// Highest frequencies of a group's sub-image: radians a radian across its rays, and how fast that changes (second
// derivative), cycles a metre of slant range along them.
struct Bands {
    double across, bend, along;
};

// Over the ground distances and bearings given, of all of a group's traces.
Bands bands_of(const Group& group, const Geometry& geometry, double plane, Span angles, Span grounds);

// What is read from a sub-image in one place: bearings from a direction, and distances.
struct Reading {
    Span bearing, distance;
};

// Tiles by their corners, `each` of every one, seen from a centre: bearings from `direction`, ground distances.
std::vector<Reading> seen_from(const Point& centre, const std::vector<Point>& corners, int each, double& direction);

// `count` places from low to high, ends included.
std::vector<double> spread(double low, double high, int count);

double slant_of(double ground, double height);
double ground_from(double slant, double height);  // 0 where the ground is farther

// A tree below one of the longest groups.
struct Subtree {
    Numbers traces;             // in the order of the leaves
    std::vector<Level> levels;  // leaves first; none if the tree would hold more than the floats `left`
    double along = 0;           // highest frequency along any ray, cycles a metre of slant range
};

// The tree below a group for what is read from it at bearings from `direction` and ground distances, nodes `step`
// apart; no levels if it would hold more than the floats `left`.
Subtree make_subtree(const Group& group, const Geometry& geometry, const std::vector<Point>& centres,
                     const Layout& layout, double plane, double direction, std::vector<Reading> readings, double step,
                     std::int64_t& left);

}  // namespace pysas
