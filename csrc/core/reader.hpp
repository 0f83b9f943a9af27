// From traces to what kernels read: tables by a recipe's reader, and what goes with them.
#pragma once

#include <complex>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/execution.hpp"
#include "core/room.hpp"
#include "core/summation.hpp"
#include "core/transforms.hpp"

namespace pysas {

// Tables of traces low-passed by W, at twice the sample rate: only transforms read a record's end as the low-pass of
// all of it does, at every tolerance. Transforms are made in Real.
template <typename Real>
class LowPassed {
  public:
    // `n_sample`: of a record.
    LowPassed(const Reader& reader, std::int64_t n_sample);

    template <typename Table, typename Sample>
    void fill(const Kernels& kernels, const Batch<Sample>& batch, Table* table, std::int64_t stride, int threads,
              const Tick& tick) const;

  private:
    using Complex = std::complex<Real>;
    using Planes = typename Transform<Real>::Planes;

    template <typename Sample>
    void take(const Batch<Sample>& batch, std::int64_t first, std::int64_t count, Planes to) const;
    Planes refine(const Kernels& kernels, Planes data, Planes work, Planes to) const;

    const Reader& reader_;
    std::int64_t length_;
    Transform<Real> transform_;
    std::vector<Real> window_, even_, odd_re_, odd_im_;  // of frequencies: W, and W with half a sample's turn
};

// Some traces of a recipe at a time, as kernels take them.
template <typename Real>
class Tables {
  public:
    // Room for `most` traces, whose records have `n_sample` samples.
    Tables(Execution& run, std::int64_t n_sample, std::int64_t most);
    Tables(const Tables&) = delete;

    // Take traces `order`; tables of those that are not used are zero.
    template <typename Sample>
    void fill(Execution& run, const View<const Sample, 3>& data, const std::int64_t* order, std::int64_t count);

    const Terms<Real>& terms() const { return terms_; }

  private:
    void weigh(const std::int64_t* order, std::int64_t count);

    const Recipe& recipe_;
    Loan<Real> table_;
    std::optional<LowPassed<float>> single_;
    std::optional<LowPassed<double>> double_;
    std::vector<Trace> traces_;
    std::vector<std::complex<double>> weights_;
    std::vector<std::int64_t> start_;
    std::vector<float> value_;  // of the lattice
    Lattice lattice_{};
    Terms<Real> terms_{};
};

}  // namespace pysas
