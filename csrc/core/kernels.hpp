// What the kernels of every instruction set take: plain structs, and the table of functions that a set fills.
//
// A tile is up to `tile_rows` lines of up to `block` pixels. Traces arrive as tables of polynomial coefficients: for
// every interval of an over-sampled time axis and every power q of the position t in [-1/2, 1/2] from its middle, the
// real and the imaginary coefficient, in planes: plane 2 q + part at table + trace * trace_stride + plane *
// plane_stride.
#pragma once

#include <cstdint>

// Of what compilers leave out of hot loops, though its vectors then go through memory.
#if defined(_MSC_VER) && !defined(__clang__)
#define PYSAS_INLINE __forceinline
#else
#define PYSAS_INLINE inline __attribute__((always_inline))
#endif

namespace pysas {

constexpr int tile_rows = 32;
constexpr int block = 64;
constexpr int plane_slack = 64;  // reals behind a plane's intervals that a window load may touch
constexpr int max_degree = 9;
constexpr int max_trig = 12;
constexpr int max_nodes = 7;
constexpr int max_step = 24;  // of a filter, in samples

// What kernels are compiled for, by the type of their arithmetic: degrees of the interpolation, terms of the sine's
// polynomial, nodes of the delay's. Few enough to compile, dense enough to lose little.
template <typename Real>
struct Sizes {
    static constexpr int degrees[] = {1, 2, 3, 4, 5, 7};
    static constexpr int terms[] = {5, 6};
    static constexpr int nodes = 5;
};

template <>
struct Sizes<double> {
    static constexpr int degrees[] = {3, 5, 7, 9};
    static constexpr int terms[] = {8, 10};
    static constexpr int nodes = 7;
};

// Filters make tables in double for sums in float too.
struct FilterSizes {
    static constexpr int degrees[] = {1, 2, 3, 4, 5, 7, 9};
};

template <int D>
struct Degree {
    static constexpr int value = D;
};

template <class List>
constexpr bool has_degree(int degree) {
    for (const int listed : List::degrees) {
        if (listed == degree) return true;
    }
    return false;
}

// call(Degree<degree>()), for one of the list's: callers see to that (core/summation.cpp, compiled).
template <class List, int I = 0, class Call>
inline void with_degree(int degree, const Call& call) {
    constexpr int count = sizeof(List::degrees) / sizeof(int);
    if (degree == List::degrees[I]) return call(Degree<List::degrees[I]>());
    if constexpr (I + 1 < count) with_degree<List, I + 1>(degree, call);
}

// A term counts up to this many samples beyond its record's ends, where the trace is read at the end, and up to this
// angle beyond the edge of a beam without taper or the end of a fan's side: far more than places in float64 are rounded
// by, so that pixels put on an edge count whatever the rounding, and far less than anything physical. Said in pysas.h
// and pysas.reference.exact too.
constexpr double edge_samples = 1e-4, edge_angle = 1e-7;
// Nearer than this to a record's ends, in samples, every pixel's own delay decides: places in float reach beyond
// tables.
constexpr double edge_margin = 0.01;

enum class Kind : int { monostatic, stop_and_hop, moving };

// Where and when a trace was recorded; pysas.engine.traces has the same record.
struct Trace {
    double tx[3], rx[3];  // m, at the start of transmission
    double velocity[3];   // of the receiver, m/s
    double boresight[3];  // of length 1, or zeros
    double axis[3];       // along a fan's element, of length 1, or zeros
    double t0;            // time of sample 0 of the record, s
    double c;             // speed of sound, m/s
    double first, last;   // samples that were recorded: others count for nothing
    double kept;          // number of the first sample kept
    double interval;      // for Numba's kernels alone: the trace's first interval in a table of all
};

// What transmitters light: a place by its angle off boresight (cone), or off the plane across the axis, on boresight's
// side (fan). pysas.engine.traces has the same record.
constexpr double no_beam = 0, cone = 1, fan = 2;

struct Beam {
    double shape;
    double half_angle;  // the largest that counts
    double full_angle;  // the largest whose weight is 1: less than half_angle where the beam has a taper
};

constexpr int max_ramp = 24, ramp_powers = 7;

// The same as kernels take it. Over the taper a term weighs e^2 Q(e), where e falls from 1 at full_angle to 0 at
// half_angle: 1 - tan(b/4) / tan(b_all/4) of the angle b beyond full_angle, with Q as a sum of Chebyshev polynomials on
// [0, 1]; or, of fans in float, `per` (sine of half_angle - sine of the angle), with Q in powers of that.
struct Light {
    double shape, sine_half, cosine_half, sine_full, cosine_full;
    int terms;  // of the Chebyshev sum; 0: a hard edge
    double per_quarter, chebyshev[max_ramp];
    bool quick;  // whether kernels in float may take the powers
    double per, power[ramp_powers];
};

// What traces have in common; pysas.engine.traces has the same record.
struct Model {
    double c, fc, fs;
    double rate;  // intervals per sample
    double last;  // last sample number that counts
    Beam beam;
    double near;  // distance below which delays are no polynomials along a whole block, m
    double run;   // traces that a sum in float may have before it is added to one in double; 0: any number
};

// How a block's delays become a polynomial: exact delays at `count` nodes in [-1, 1], and the matrix from their
// differences to the middle node's into the coefficients of x^1, x^2, ...
struct Nodes {
    int count;
    double at[max_nodes];
    double fit[max_nodes][max_nodes];
};

// Weights of terms at places of a lattice over x and y, (ny, nx) places `apart` floats from one to the next, one float
// for each trace; between them cubics. Along `longest` metres a quartic through five places holds as well.
struct Lattice {
    const float* value;
    std::int64_t apart, nx, ny;
    double x0, y0, dx, dy, longest;
};

// Heights of a map's pixels over evenly spaced places on lines: of pixel m of row r at z[r row + m apart], less
// `origin`; or none.
struct Heights {
    const double* z = nullptr;
    std::int64_t row = 0, apart = 0;
    double origin = 0;

    double operator()(std::int64_t r, std::int64_t m) const { return z[r * row + m * apart] - origin; }
    Heights from(std::int64_t r, std::int64_t m) const { return {z ? z + r * row + m * apart : z, row, apart, origin}; }
};

// What a block of pixels whose heights lie up to h off a line may be summed by polynomials in height: as far away as
// cubic h^1.5 m, and where light fades fading h m; not at all where they reach beyond `highest` m from their middle.
struct Rise {
    double cubic, fading, highest;
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
    Light light;
    Kind kind;
    Nodes nodes;
    const Lattice* lattice;  // or null: every term weighs 1, or what `weights` say
    const Real* weights;     // of a list of points, (point, n_trace), padded to whole rows of blocks; or null
    Rise rise;
};

constexpr int weight_nodes = 5;
constexpr int least_width = 16;  // pixels that weights are looked up over, if a block has fewer: those of a vector

// Weights of a tile's terms: of `n_trace` traces at each of (lines, columns) places. Lines: all, or weight_nodes evenly
// spaced from the first to the last, of whose values a row's are sums with its factors. Columns: all pixels, or
// weight_nodes evenly spaced along a block, or along least_width pixels if that is more.
template <typename Real>
struct Weights {
    const Real* value;
    std::int64_t n_trace;
    int lines;
    alignas(64) Real factor[weight_nodes][tile_rows];
};

template <typename Real>
struct TileJob {
    const Terms<Real>* terms;
    const double* lines;         // (rows, 6) first pixel and step of each line, or null
    Heights heights;             // of pixels on lines, instead of the lines' own
    double low, high;            // between which these lie
    const double* points;        // (rows * count, 3) where there are no lines
    const std::uint8_t* active;  // (rows)
    int rows, count;
    Real *re, *im;           // (rows, block), set to the sums
    std::int64_t evaluated;  // terms evaluated
    const Weights<Real>* weights;
    double near;       // distance below which delays along lines so long are exact, m
    int first, whole;  // of the pixels of lines that `weights` are of: the tile's first, and how many
};

// Interval k = phases m + phase lies (k + 1/2) step / phases samples after the first; its coefficients are sums over
// `taps` samples from step m + first[phase] on, weighted by weight[(phase taps + tap) (degree + 1) + q].
template <typename Real>
struct FilterJob {
    const Real* re[max_step];  // every step-th sample, from the first, the second, ... on. Sample 0 is at `origin`
    const Real* im[max_step];
    std::int64_t origin;
    const Real* weight;
    const std::int64_t* first;
    int phases, step, taps, degree;
    std::int64_t intervals;
    Real* out;
    std::int64_t plane_stride;
};

// A sub-image: what a group of pings makes of the plane z = `plane`, its carrier about `centre` taken away, at slant
// ranges (i0 + m) step from `centre` along rays angle0 + r dangle from its foot. Filtered across its rays, and along
// them where pixels are read from it: a parent's ray crosses its children's, so that merging filters after it has
// changed rays. A ray's nodes range[2 r] to range[2 r + 1] are summed, the rest of its row is not. Real parts at re + r
// stride
// + m.
struct SubImage {
    double centre[3], plane, angle0, dangle, step;
    std::int64_t i0, rays, stride;
    float *re, *im;
    const std::int32_t* range;
};

constexpr int max_taps = 8;        // of the interpolation of sub-images
constexpr int max_bend = 8;        // highest power of a tap's polynomial
constexpr int max_smoothing = 16;  // half length of the filter that undoes the taps' own smoothing

// Interpolation between nodes: tap t of a place x in [-1/2, 1/2] from the middle of its interval is a polynomial of
// degree taps; of taps p and taps - 1 - p one is the mirror image of the other, so that they share even and odd
// parts. Nodes are filtered beforehand, along both axes, by the symmetric filter[0 ... half] that undoes the taps'
// smoothing.
struct Taps {
    int count, half;
    float even[max_taps / 2][max_bend / 2 + 1], odd[max_taps / 2][max_bend / 2];
    float tap[max_bend + 1][max_taps];  // the same, powers of x by taps
    float filter[max_smoothing + 1];
};

// What all steps of the tree share.
struct Tree {
    const Taps* taps;
    double wave;  // turns of the carrier a metre of range
    double sine[max_trig], cosine[max_trig];
    Nodes nodes;
};

// Sums of a leaf's traces at `count` nodes from `begin` on of some of its rays, their carrier taken away. The tables'
// intervals are as long as nodes are apart; phase factors may be wrong by `slack`.
struct LeafJob {
    const Tree* tree;
    const SubImage* image;
    const Terms<float>* terms;
    const std::int64_t* rays;
    int rows;
    std::int64_t begin;
    int count;
    float slack;
    bool fades;      // whether traces weigh here what a beam's taper leaves of them
    float *re, *im;  // (tile_rows, block), set to the sums
    const Weights<float>* weights;
};

// One ray of a parent from its children, added to what it holds with `add`; `smooth`: filtered along it then. `work`: 4
// rows of `room`. `lit`: a trace of each child, which weighs what the beam's taper leaves of it at the parent's nodes;
// or null.
struct MergeJob {
    const Tree* tree;
    const SubImage *parent, *children;
    std::int64_t n_child, ray, room;
    bool add, smooth;
    float* work;
    const Trace* const* lit;
    const Light* light;
};

// How pixels off a sub-image's plane are read from it: at their range and place along the group's `axis`, which a group
// on that axis sees alike; weighed as value `number` of the polynomial through values at `count` heights.
// What a group of one ping sees is turned by `own`, its middle trace: by what its delay on the plane is off.
constexpr int max_planes = 8;
struct Stack {
    double axis[3], height[max_planes];
    int count, number;
    const Trace* own;  // or null
};

// Pixels read from a sub-image and added to (rows, block) sums: lines on its plane, or points near it, `apart` points
// from row to row, through a stack.
struct ReadJob {
    const Tree* tree;
    const SubImage* image;
    const double* lines;  // (rows, 6), or null
    const double* points;
    std::int64_t apart;
    const Stack* stack;
    const std::uint8_t* active;
    int rows, count;
    float *re, *im;
};

// Pixels first + m step, m < count, of a line on a sub-image's plane that leads away from its centre within 16 degrees,
// their carrier given back. Positions are polynomials along `stretch` pixels. `work`: 4 rows of `room`, which holds
// what lies between the line's ends and 4 blocks more; vectors of `re` and `im` run on. Of a map's pixels, up to a
// block of them, `heights` are read through a stack; those off the line's slope may turn what it sees by `turn` rays.
struct ColumnJob {
    const Tree* tree;
    const SubImage* image;
    double first[2], step[2];
    std::int64_t count;
    int stretch;
    std::int64_t room;
    float *work, *re, *im;
    const double* heights = nullptr;
    const Stack* stack = nullptr;
    double turn = 0;
};

// A stage of a Fourier transform of sequences side by side, see core/transforms.cpp. Value m of a sequence lies at
// multiples of `run`, which is one of transform_lanes; of values part + k parts, k below the radix, come values radix
// part + k, turned by twiddle[(radix - 1) part + k - 1] (real, imaginary) where k is not 0.
template <typename Real>
constexpr int transform_lanes = 32 / sizeof(Real);

template <typename Real>
struct StageJob {
    const Real *from_re, *from_im;
    Real *to_re, *to_im;
    const Real* twiddle;
    int radix;
    std::int64_t parts, run;
};

struct Kernels {
    const char* name;
    void (*sum_single)(TileJob<float>&);
    void (*sum_double)(TileJob<double>&);
    void (*filter_single)(const FilterJob<float>&);
    void (*filter_double)(const FilterJob<double>&);
    void (*leaf)(LeafJob&);
    // out[m] for m < count from in[m - half] ... in[m + half]
    void (*smooth)(const Taps&, const float* in, float* out, std::int64_t count);
    // columns [begin, end) of rows [first, last), in place, with `work` for (last - first) rows of a vector
    void (*smooth_across)(const Taps&, float* plane, std::int64_t stride, std::int64_t first, std::int64_t last,
                          std::int64_t begin, std::int64_t end, float* work);
    void (*merge)(const MergeJob&);
    void (*read)(ReadJob&);
    void (*column)(const ColumnJob&);
    void (*stage_single)(const StageJob<float>&);
    void (*stage_double)(const StageJob<double>&);
};

namespace baseline {
extern const Kernels kernels;
}

}  // namespace pysas
