// A plan for callers without Python: the same bounds as pysas/planning/choices.py, whose choices are cheaper but not
// more accurate. The tree of fast factorised back-projection is in plan_tree.cpp.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/filters.hpp"
#include "core/kernels.hpp"
#include "core/summation.hpp"
#include "planning/forest.hpp"
#include "pysas.h"

namespace pysas {

// Traces that are summed in float before these sums are added up in double, see pysas/planning/bounds.py.
double longest_run(double tol);

class Plan {
  public:
    // Throws Error: argument, tolerance.
    Plan(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options);

    void execute(const void* data, const std::int64_t* data_stride, void* image,
                 const std::int64_t* image_stride) const;

    // Of the terms, those that go through trees.
    double factorised_share() const { return forest_ ? forest_->share : 0; }

  private:
    // Of a tolerance: for float offsets in a block, and for the samples' interpolation.
    struct Shares {
        double rounding, interpolation;
    };
    // of the leaves' share; with delay polynomials (0.1), sine and cosine (0.05) and the drift (0.05): 0.95
    static constexpr Shares tree_shares{0.4, 0.35};

    void check(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options) const;
    void place(const pysas_survey& survey, const pysas_grid& grid);
    void bound(const double low[3], const double high[3]);
    void keep();
    void factorise(double tol);
    bool use(const Forest& forest, double tol);
    bool choose_delay(double tol, const Shares& shares, double nearest);
    bool choose_filter(double tol, const Shares& shares, const std::vector<std::pair<int, int>>& rates);

    template <typename Real, typename Sample>
    void sum(const void* data, const std::int64_t* data_stride, void* image, const std::int64_t* image_stride) const;
    template <typename Sample>
    std::optional<double> scale(const View<const Sample, 3>& from) const;
    bool wide() const;
    template <typename Real, typename Sample, typename Pixel>
    void sum_directly(const View<const Sample, 3>& from, const View<Pixel, 2>& to, double scale) const;
    template <typename Sample, typename Pixel>
    void sum_forest(const View<const Sample, 3>& from, const View<Pixel, 2>& to, double scale) const;
    template <typename Real>
    Terms<Real> terms() const;
    Raster lines() const;
    std::int64_t batch(std::size_t real) const;
    std::int64_t stride(std::size_t real) const;

    std::int64_t pings_, channels_, samples_, height_, width_;
    bool single_, narrow_;  // float samples and image; float arithmetic
    int threads_;
    double tol_;
    const Kernels* kernels_;
    std::function<bool(double)> progress_;
    Model model_{};
    Kind kind_ = Kind::monostatic;
    double band_ = 0;     // half the bandwidth, cycles per sample
    double step_ = 0;     // pixel spacing along a line, m
    double nearest_ = 0;  // least distance of a pixel from a transmitter or receiver, m
    double farthest_ = 0;
    std::vector<Trace> traces_;
    std::vector<std::int64_t> order_, start_, asked_, until_;  // samples asked of each trace: first and last
    std::vector<std::complex<double>> weights_;
    std::vector<double> first_, along_, points_;
    std::vector<std::uint8_t> mask_;
    Filter filter_;
    Nodes nodes_{};
    int count_ = block;
    std::vector<double> sine_, cosine_;
    std::int64_t length_ = 1, lowest_ = 0, highest_ = 0;
    std::optional<Forest> forest_;
};

}  // namespace pysas
