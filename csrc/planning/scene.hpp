// What a planner sees of a survey and a grid: geometry about the image's centre, the window of every trace, the shape
// of the work. No choices.
#pragma once

#include <complex>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <vector>

#include "core/kernels.hpp"
#include "core/points.hpp"
#include "core/recipe.hpp"

namespace pysas {

using Numbers = std::vector<std::int64_t>;

// Tells coordinates (numbers, 3) of some pixels about an image's centre, counted through all its lines.
using Points = std::function<void(const Numbers& numbers, double* out)>;

// Of a list (n, 3), or of a height map (height, width) over axes x and y, that `keep` holds, less `origin`.
Points points_in_list(const double* list, const Point& origin, std::shared_ptr<const void> keep);
Points points_on_map(const double* x, const double* y, const double* height, std::int64_t width, const Point& origin,
                     std::shared_ptr<const void> keep);

// An image's pixels about its centre, (height, width): `width` is the grid's last axis.
struct Pixels {
    std::int64_t height = 0, width = 0;
    std::vector<double> first, step;  // (height, 3) of evenly spaced lines; empty where there are none
    Heights heights;                  // of their pixels, of a map: `points` holds them
    double uneven = 0;                // how far pixels lie off their lines at most, m
    Points points;                    // exact, where lines may be off
    std::vector<std::uint8_t> mask;   // (height, width) 0: not wanted; empty: all are
    Numbers hears;                    // (height, 2) first and last trace that a row hears; empty: all

    bool lined() const { return !first.empty(); }
    bool straight() const { return lined() && !heights.z; }
    // Whether rows hear traces that there are, if so many are.
    bool hear(std::int64_t traces) const;
    std::int64_t size() const { return height * width; }
};

// Give pixels, rows of points (height, width, 3), the lines about an origin that they happen to lie on, if they are
// evenly spaced there: to 1e-9 of a line's length and the rounding of large coordinates; or that they lie on when
// looked at from above, with heights of their own.
void find_lines(const double* points, const Point& origin, Pixels& pixels);
// The same of a height map over axes x and y.
void find_lines(const double* x, const double* y, const double* height, const Point& origin, Pixels& pixels);

// Along which lines weights uniform in view angle may be read off their lattice, m; and how far it reaches around the
// image.
struct Bent {
    double longest, vector, beyond;
    // whether kernels may read weights along lines of `count` pixels `step` apart
    bool holds(double step, int count) const;
};

// What a caller knows of a survey.
struct Survey {
    Model model{};  // c, fc, fs, last, beam; the rest is a recipe's
    double band;    // half the bandwidth, cycles per sample
    bool single;    // float samples and image
    std::int64_t channels;
    std::vector<Trace> traces;                  // about the image's centre, ping by ping
    std::vector<std::complex<double>> weights;  // of traces
    std::optional<Bent> bent;
    std::optional<LatticeWeights> lattice;  // where there is a `bent`
    std::shared_ptr<const void> keep;       // what holds these
    bool each = false;                      // weights uniform in view angle are every pixel's own
};

const char* words_of(Kind kind);

class Scene {
  public:
    // `low`, `high`: corners of a box about the pixels.
    Scene(Survey survey, Pixels pixels, const Point& low, const Point& high);

    Survey survey;
    Pixels pixels;
    Point low, high;
    Kind kind;
    std::int64_t wanted;              // pixels
    double each;                      // pixels that hear a trace, on average, whatever their windows and beams
    double nearest, farthest;         // of a pixel of the box from a transmitter or receiver, m
    Numbers first, last;              // samples that any pixel can ask of each trace, within its record
    std::vector<std::uint8_t> heard;  // traces that weigh anything, of which any pixel can ask for a sample
    std::int64_t audible;             // number of them
    Light light;                      // of the beam, and what its powers are wrong by in float
    double faded;
    double step, slope;  // longest step of a line; share of it that changes the one-way range, at most (plus 10 %)

    std::int64_t traces() const { return static_cast<std::int64_t>(survey.traces.size()); }
    std::int64_t samples() const { return static_cast<std::int64_t>(survey.model.last) + 1; }
    // About the share of the terms whose pixel is nearer than `distance` to where its pulse leaves or its echo arrives.
    double within(double distance) const;
    // About the share of the terms whose range changes by less than `slope` of a step along their line.
    double flatter(double slope) const;
    // About the share of (trace, pixel) pairs within record and beam: the terms.
    double lit() const;
    // Root of their weights' mean square for the beam: what errors of these are relative to.
    double brightness() const;
    // About what passes until an echo arrives where receivers move, s, else 0.
    double reception() const { return kind == Kind::moving ? (nearest + farthest) / survey.model.c : 0.0; }

  private:
    void look() const;

    // of some of the terms, sorted
    mutable std::vector<double> distances_, slopes_;
    mutable double lit_ = -1, brightness_ = 1;
};

}  // namespace pysas
