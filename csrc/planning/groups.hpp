// Groups of traces: where they stand, and how they are cut into smaller ones.
#pragma once

#include <cstdint>
#include <vector>

#include "core/kernels.hpp"
#include "core/points.hpp"
#include "core/trees.hpp"

namespace pysas {

// What trees are made from: traces about the scene's centre, the ping each is of, and the record. `delay`: about what
// passes until an echo arrives, where receivers move, else 0.
struct Geometry {
    const Trace* traces;
    const std::int64_t* pings;
    std::int64_t channels;  // of a ping, by which traces are counted
    std::int64_t count;
    Model model;
    double band;  // half the bandwidth, cycles per sample
    double delay;

    double half_band() const { return band * model.fs; }  // Hz
};

// Middles of transmitter and receiver when an echo arrives.
std::vector<Point> phase_centres(const Geometry& geometry);

// Traces of one group; the centre of their phase centres; their longest axis, extent along it, distance off it at most,
// and places on it, m.
struct Group {
    Numbers traces;
    Point centre, axis;
    double extent = 0, off = 0;
    std::vector<double> along;

    // at least, of a point from any of the phase centres
    double distance(const Point& point) const;
};

Group make_group(Numbers traces, const std::vector<Point>& centres);

// Runs of consecutive pings of about equal path, at most `length` metres.
std::vector<Numbers> cut_track(const Geometry& geometry, const std::vector<Point>& centres, double length);

// A group's traces by ping, as far as they follow each other: of one transmitter's place and beam.
std::vector<Numbers> split_by_ping(const Group& group, const Geometry& geometry);

// A group's traces in `fan` stretches of equal length, empty ones left out.
std::vector<Numbers> split(const Group& group, int fan);

}  // namespace pysas
