// A plan for callers without Python: the same bounds as pysas/planner.py, whose choices are cheaper but not more
// accurate.
#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "core/filters.hpp"
#include "core/kernels.hpp"
#include "core/summation.hpp"
#include "pysas.h"

namespace pysas {

class Plan {
  public:
    // Throws Error: argument, tolerance.
    Plan(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options);

    void execute(const void* data, const std::int64_t* data_stride, void* image,
                 const std::int64_t* image_stride) const;

  private:
    void check(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options) const;
    void place(const pysas_survey& survey, const pysas_grid& grid);
    void bound(const double low[3], const double high[3]);
    void choose(double tol);

    template <typename Real, typename Sample>
    void sum(const void* data, const std::int64_t* data_stride, void* image, const std::int64_t* image_stride) const;

    std::int64_t pings_, channels_, samples_, height_, width_;
    bool single_, narrow_;  // float samples and image; float arithmetic
    int threads_;
    const Kernels* kernels_;
    std::function<bool(double)> progress_;
    Model model_{};
    Kind kind_ = Kind::monostatic;
    double band_ = 0;     // half the bandwidth, cycles per sample
    double step_ = 0;     // pixel spacing along a line, m
    double nearest_ = 0;  // least distance of a pixel from a transmitter or receiver, m
    std::vector<Trace> traces_;
    std::vector<std::int64_t> order_, start_;
    std::vector<std::complex<double>> weights_;
    std::vector<double> first_, along_, points_;
    std::vector<std::uint8_t> mask_;
    Filter filter_;
    Nodes nodes_{};
    int count_ = block;
    std::vector<double> sine_, cosine_;
    std::int64_t length_ = 1, lowest_ = 0, highest_ = 0;
};

}  // namespace pysas
