// What one sum needs, and nothing else: no tolerance, no grid, no echoes. One executor carries it out, for every
// caller.
#pragma once

#include <complex>
#include <cstdint>
#include <functional>
#include <optional>
#include <vector>

#include "core/filters.hpp"
#include "core/kernels.hpp"
#include "core/threads.hpp"
#include "core/trees.hpp"
#include "core/views.hpp"

namespace pysas {

// Samples begin to end - 1 of those that a trace recorded: others may hold anything.
struct Recorded {
    std::int64_t begin, end;

    explicit Recorded(const Trace& trace)
        : begin(static_cast<std::int64_t>(trace.first)), end(static_cast<std::int64_t>(trace.last) + 1) {}
    Recorded(std::int64_t begin, std::int64_t end) : begin(begin), end(end) {}
};

// How traces become tables: by `filter`, of samples, or of traces low-passed by W at twice the sample rate.
struct Reader {
    // What of a trace is transformed.
    struct Cut {
        std::int64_t n_fft;
        std::vector<double> window;  // (length) of the samples kept, or none
    };

    Filter filter;
    std::int64_t length = 0;  // samples kept of each trace
    std::optional<Cut> cut;
    bool wide = false;  // whole records are low-passed, in double, and `length` samples of that are kept

    // samples that the filter reads
    std::int64_t samples() const { return cut ? 2 * length - 1 : length; }
};

// Which of some pixels are wanted, or nothing: all.
struct Wanted {
    const std::uint8_t* at = nullptr;
    std::int64_t count = 0;

    bool empty() const { return count == 0; }
    const std::uint8_t* data() const { return at; }
    const std::uint8_t* begin() const { return at; }
    const std::uint8_t* end() const { return at + count; }
    std::uint8_t operator[](std::size_t i) const { return at[i]; }
};

// Straight lines (height, 3), or lines with heights of their own, or points by their numbers.
struct Image {
    std::int64_t height = 0, width = 0;
    std::vector<double> first, step;
    std::function<void(std::int64_t begin, std::int64_t end, double* out)> points;  // (end - begin, 3)
    Wanted mask;                      // (height, width), the caller keeps it
    std::vector<std::int64_t> hears;  // (height, 2) first and last trace that count for a row's; or all
    int count = 0;                    // pixels of a block

    Heights heights;
    std::vector<double> spans;  // (tile, 2) between which these lie

    bool lined() const { return !first.empty(); }
    bool straight() const { return lined() && !heights.z; }
};

// Weights of terms that change from pixel to pixel: those of a lattice (ny, nx, all traces), see kernels.hpp,
// Lattice...
struct LatticeWeights {
    const float* value;  // the caller keeps it
    std::int64_t nx, ny;
    double x0, y0, dx, dy, longest;
};
// ... or every pixel's own arcs of view angle.
struct ViewWeights {
    std::int64_t channels;
};

struct Recipe {
    Model model;
    Light light;
    Kind kind;
    bool narrow;                // float arithmetic
    std::int64_t channels;      // traces of a ping
    std::vector<Trace> traces;  // all of them, by flat number; `kept` is their first sample that tables have
    std::vector<std::complex<double>> weights;  // likewise
    Reader reader;
    std::vector<double> sine, cosine;
    Nodes nodes;
    Rise rise;
    Image image;
    std::int64_t batch;  // traces that have tables at a time
    std::optional<LatticeWeights> lattice;
    std::optional<ViewWeights> views;
    const Forest* forest = nullptr;  // the caller keeps it
};

class Workspace;

struct Totals {
    double prepare_seconds = 0, sum_seconds = 0;
    std::int64_t terms = 0;
};

// Add the traces `used` (by flat number) to `image`: (height, width), or (1, height width) where its pixels are points
// and there is no forest. Samples are divided by `scale`, a power of two. What `work` holds is used again. `tick` is
// told the share done, and stops by false.
template <typename Sample, typename Pixel>
Totals run(const Recipe& recipe, const View<const Sample, 3>& data, const std::uint8_t* used, double scale,
           const View<Pixel, 2>& image, int threads, const Kernels& kernels, Workspace& work, const Tick& tick);

}  // namespace pysas
