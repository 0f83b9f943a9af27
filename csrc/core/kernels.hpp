// What the kernels of every instruction set take: plain structs, and the table of functions that a set fills.
//
// A tile is up to `tile_rows` lines of up to `block` pixels. Traces arrive as tables of polynomial coefficients: for
// every interval of an over-sampled time axis and every power q of the position t in [-1/2, 1/2] from its middle, the
// real and the imaginary coefficient, in planes: plane 2 q + part at table + trace * trace_stride + plane *
// plane_stride.
#pragma once

#include <cstdint>

namespace pysas {

constexpr int tile_rows = 32;
constexpr int block = 64;
constexpr int plane_slack = 64;  // reals behind a plane's intervals that a window load may touch
constexpr int max_degree = 9;
constexpr int max_trig = 12;
constexpr int max_nodes = 7;

enum class Kind : int { monostatic, stop_and_hop, moving };

// One trace's geometry, as pysas.engine.GEOMETRY numbers its columns.
struct Trace {
    double tx[3], rx[3], velocity[3], boresight[3];
    double t0;    // time of sample 0 of the record, s
    double crop;  // number of the first sample kept
    double first;
};

struct Model {
    double c, fc, fs;
    double rate;      // intervals per sample
    double last;      // last sample number that counts
    double cos_beam;  // of the half-angle; -1: no beam
    double near;      // distance below which every pixel's delay is exact, m
};

// How a block's delays become a polynomial: exact delays at `count` nodes in [-1, 1], and the matrix from their
// differences to the middle node's into the coefficients of x^1, x^2, ...
struct Nodes {
    int count;
    double at[max_nodes];
    double fit[max_nodes][max_nodes];
};

template <typename Real>
struct Terms {
    const Real* table;
    std::int64_t trace_stride, plane_stride;
    int degree;
    int trig;  // terms of the sine's polynomial in turns^2; the cosine's has one more
    double sine[max_trig], cosine[max_trig];
    const Trace* traces;
    std::int64_t n_trace;
    Model model;
    Kind kind;
    Nodes nodes;
};

template <typename Real>
struct TileJob {
    const Terms<Real>* terms;
    const double* lines;         // (rows, 6) first pixel and step of each line, or null
    const double* points;        // (rows * count, 3) where there are no lines
    const std::uint8_t* active;  // (rows)
    int rows, count;
    Real *re, *im;           // (rows, block), set to the sums
    std::int64_t evaluated;  // terms evaluated
};

// Interval k = phases m + phase lies (k + 1/2) step / phases samples after the first; its coefficients are sums over
// `taps` samples from step m + first[phase] on, weighted by weight[(phase taps + tap) (degree + 1) + q].
template <typename Real>
struct FilterJob {
    const Real* re[2];  // samples; with step 2 the even and the odd ones apart. Sample 0 is at `origin`
    const Real* im[2];
    std::int64_t origin;
    const Real* weight;
    const std::int64_t* first;
    int phases, step, taps, degree;
    std::int64_t intervals;
    Real* out;
    std::int64_t plane_stride;
};

struct Kernels {
    const char* name;
    void (*sum_single)(TileJob<float>&);
    void (*sum_double)(TileJob<double>&);
    void (*filter_single)(const FilterJob<float>&);
    void (*filter_double)(const FilterJob<double>&);
};

namespace baseline {
extern const Kernels kernels;
}
namespace avx2 {
extern const Kernels kernels;
}
namespace avx512 {
extern const Kernels kernels;
}

}  // namespace pysas
