// Arcs of view angle that traces stand for at a point: weights that make a sum uniform in view angle. The rule is that
// of pysas.circular.view_weights.
#pragma once

#include <cstdint>

#include "core/kernels.hpp"
#include "core/threads.hpp"

namespace pysas {

// `channels` traces a ping.
struct Viewers {
    const Trace* traces;
    std::int64_t count;
    int channels;
    Beam beam;
};

// Arcs at `n` points (n, 3) of the `kept` traces `order`: out (n, kept). All traces are seen, and the mean is 1 over
// those whose beam holds the point. `pattern`, or null: a number for each point that is the same where the views have
// one order around the circle, one grouping and one set of openings, so that arcs are smooth from place to place; 0
// where a view has no angle or a gap is about as wide as makes an opening.
template <typename Real>
void arcs(const Viewers& viewers, const double* points, std::int64_t n, const std::int64_t* order, std::int64_t kept,
          Real* out, std::uint64_t* pattern, int threads, const Tick& tick);

}  // namespace pysas
