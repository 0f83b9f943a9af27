#include "core/lattice.hpp"

#include <algorithm>
#include <array>
#include <cmath>

namespace pysas {
namespace {

// Factors of four equally spaced values in the cubic through them, at a place counted from the first.
std::array<double, 4> cubic(double t) {
    const double a = t, b = t - 1, c = t - 2, d = t - 3;
    return {-b * c * d / 6, a * c * d / 2, -a * b * d / 2, a * b * c / 6};
}

// Of a place on an axis of n lattice places: the first of the four that its cubic goes through, and their factors. A
// place beyond the lattice has the values of its edge.
std::int64_t between(double place, double first, double step, std::int64_t n, std::array<double, 4>& factor) {
    const double u = std::min(std::max((place - first) / step, 0.0), static_cast<double>(n - 1));
    const auto begin = std::min(std::max<std::int64_t>(static_cast<std::int64_t>(u) - 1, 0), n - 4);
    factor = cubic(u - static_cast<double>(begin));
    return begin;
}

// Factors of weight_nodes evenly spaced values in the polynomial through them, at a share of the way.
std::array<double, weight_nodes> quartic(double share) {
    std::array<double, weight_nodes> out;
    for (std::size_t k = 0; k < weight_nodes; ++k) {
        double factor = 1;
        for (std::size_t i = 0; i < weight_nodes; ++i) {
            if (i == k) continue;
            const double apart = static_cast<double>(k) - static_cast<double>(i);
            factor *= (share * (weight_nodes - 1) - static_cast<double>(i)) / apart;
        }
        out[k] = factor;
    }
    return out;
}

}  // namespace

template <typename Real>
const Weights<Real>* TileWeights<Real>::read(const Terms<Real>& terms, const double* x, const double* y, int lines,
                                             int columns) {
    const Lattice& lattice = *terms.lattice;
    const std::int64_t n = terms.n_trace;
    weights_.n_trace = n;
    weights_.lines = lines;
    value_.resize(static_cast<std::size_t>(lines * columns * n));
    weights_.value = value_.data();
    for (int p = 0; p < lines * columns; ++p) {
        Real* out = value_.data() + p * n;
        std::array<double, 4> along, across;
        const std::int64_t left = between(x[p], lattice.x0, lattice.dx, lattice.nx, along);
        const std::int64_t top = between(y[p], lattice.y0, lattice.dy, lattice.ny, across);
        std::fill_n(out, n, Real(0));
        for (std::int64_t j = 0; j < 4; ++j) {
            const float* row = lattice.value + ((top + j) * lattice.nx + left) * lattice.apart;
            const float *a = row, *b = a + lattice.apart, *c = b + lattice.apart, *d = c + lattice.apart;
            Real f[4];
            for (std::size_t i = 0; i < 4; ++i)
                f[i] = static_cast<Real>(across[static_cast<std::size_t>(j)] * along[i]);
            for (std::int64_t i = 0; i < n; ++i) out[i] += f[0] * a[i] + f[1] * b[i] + f[2] * c[i] + f[3] * d[i];
        }
    }
    return &weights_;
}

template <typename Real>
void TileWeights<Real>::lie(int row, double share) {
    const auto factor = quartic(share);
    for (std::size_t k = 0; k < weight_nodes; ++k) weights_.factor[k][row] = static_cast<Real>(factor[k]);
}

template <typename Real>
const Weights<Real>* TileWeights<Real>::of_lines(const Terms<Real>& terms, const double* lines, int rows, int count) {
    if (!terms.lattice) return nullptr;
    const double* last = lines + 6 * (rows - 1);
    // evenly spaced and parallel: a few of the lines tell of all
    double uneven = 0, wide = 0;
    for (int r = 0; r < rows; ++r) {
        const double share = rows > 1 ? static_cast<double>(r) / (rows - 1) : 0;
        for (int axis = 0; axis < 2; ++axis) {
            const double first = lines[axis] + share * (last[axis] - lines[axis]);
            const double step = (lines[6 * r + 3 + axis] - lines[3 + axis]) * (count - 1);
            uneven = std::max({uneven, std::abs(lines[6 * r + axis] - first), std::abs(step)});
            wide = std::max(wide, std::abs(last[axis] - lines[axis]) + std::abs(lines[3 + axis]) * (count - 1));
        }
        lie(r, share);
    }
    const bool few =
        uneven <= 1e-6 * wide && std::hypot(last[0] - lines[0], last[1] - lines[1]) <= terms.lattice->longest;
    const int chosen = few ? weight_nodes : rows, width = std::max(count, least_width);
    double x[weight_nodes * tile_rows], y[weight_nodes * tile_rows];
    for (int k = 0; k < chosen; ++k) {
        const double share = static_cast<double>(k) / (weight_nodes - 1);
        for (int j = 0; j < weight_nodes; ++j) {
            double at[2];
            for (int axis = 0; axis < 2; ++axis) {
                const double first = few ? lines[axis] + share * (last[axis] - lines[axis]) : lines[6 * k + axis];
                at[axis] = first + j * (width - 1) * lines[(few ? 0 : 6 * k) + 3 + axis] / (weight_nodes - 1);
            }
            x[weight_nodes * k + j] = at[0];
            y[weight_nodes * k + j] = at[1];
        }
    }
    return read(terms, x, y, chosen, weight_nodes);
}

template <typename Real>
const Weights<Real>* TileWeights<Real>::of_points(const Terms<Real>& terms, const double* points, int rows, int count,
                                                  std::int64_t first) {
    if (terms.weights) {
        weights_.n_trace = terms.n_trace;
        weights_.lines = rows;
        weights_.value = terms.weights + first * terms.n_trace;
        return &weights_;
    }
    if (!terms.lattice) return nullptr;
    std::vector<double> x, y;
    for (int i = 0; i < rows * count; ++i) {
        x.push_back(points[3 * i]);
        y.push_back(points[3 * i + 1]);
    }
    return read(terms, x.data(), y.data(), rows, count);
}

template <typename Real>
const Weights<Real>* TileWeights<Real>::of_rays(const Terms<Real>& terms, const SubImage& image,
                                                const std::int64_t* rays, int rows, std::int64_t begin, int count) {
    if (!terms.lattice) return nullptr;
    const int width = std::max(count, least_width);
    const double height = image.centre[2] - image.plane;
    const auto low = static_cast<double>(rays[0]), high = static_cast<double>(rays[rows - 1]);
    double ground[weight_nodes];
    for (int j = 0; j < weight_nodes; ++j) {
        const double slant =
            (static_cast<double>(image.i0 + begin) + j * (width - 1.0) / (weight_nodes - 1)) * image.step;
        ground[j] = std::sqrt(std::max(slant * slant - height * height, 0.0));
    }
    const bool few = (high - low) * image.dangle * ground[weight_nodes - 1] <= terms.lattice->longest;
    for (int r = 0; r < rows; ++r) {
        // where every ray is looked up, a row is its own line, of as many lines as weight_nodes too
        const double whole = few ? high - low : rows - 1;
        const double part = few ? static_cast<double>(rays[r]) - low : r;
        lie(r, whole > 0 ? part / whole : 0);
    }
    const int chosen = few ? weight_nodes : rows;
    double x[weight_nodes * tile_rows], y[weight_nodes * tile_rows];
    for (int k = 0; k < chosen; ++k) {
        const double ray = few ? low + k * (high - low) / (weight_nodes - 1) : static_cast<double>(rays[k]);
        const double angle = image.angle0 + ray * image.dangle, ex = std::cos(angle), ey = std::sin(angle);
        for (int j = 0; j < weight_nodes; ++j) {
            x[weight_nodes * k + j] = image.centre[0] + ground[j] * ex;
            y[weight_nodes * k + j] = image.centre[1] + ground[j] * ey;
        }
    }
    return read(terms, x, y, chosen, weight_nodes);
}

template class TileWeights<float>;
template class TileWeights<double>;

}  // namespace pysas
