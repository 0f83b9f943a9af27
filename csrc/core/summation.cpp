#include "core/summation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>
#include <type_traits>

#include "core/lattice.hpp"

namespace pysas {
namespace {

template <typename Real>
void run_filter(const Kernels& kernels, const FilterJob<Real>& job) {
    if constexpr (sizeof(Real) == 4)
        kernels.filter_single(job);
    else
        kernels.filter_double(job);
}

template <typename Real>
void run_sum(const Kernels& kernels, TileJob<Real>& job) {
    if constexpr (sizeof(Real) == 4)
        kernels.sum_single(job);
    else
        kernels.sum_double(job);
}

}  // namespace

std::int64_t intervals_of(std::int64_t length, double rate) {
    return static_cast<std::int64_t>(std::ceil(static_cast<double>(length - 1) * rate - 1e-9)) + 1;
}

std::int64_t plane_stride(std::int64_t intervals, int degree, std::size_t real) {
    const auto page = static_cast<std::int64_t>(4096 / real), line = static_cast<std::int64_t>(64 / real);
    const std::int64_t apart = page / (2 * (degree + 1)) / line * line;
    const std::int64_t needed = intervals + plane_slack;
    const std::int64_t pages = (needed - apart + page - 1) / page;
    return std::max<std::int64_t>(pages, 0) * page + apart;
}

template <typename Real, typename Sample>
void prepare(const Kernels& kernels, const Batch<Sample>& batch, const Filter& filter, Real* table, std::int64_t stride,
             int threads, const Tick& tick) {
    if (!has_degree<FilterSizes>(filter.degree))
        throw std::logic_error("no kernel for filters of degree " + std::to_string(filter.degree));
    const std::int64_t n_sample = batch.data.shape[2], channels = batch.data.shape[1];
    const std::vector<Real> weight(filter.weight.begin(), filter.weight.end());
    const std::int64_t intervals = intervals_of(batch.length, filter.rate());
    const int planes = 2 * (filter.degree + 1);
    // taps reach before the first and behind the last sample kept; vectors run on to a multiple of their length
    const std::int64_t before = filter.taps;
    const std::int64_t part = (before + batch.length + filter.taps) / filter.step + 2 + plane_slack;
    constexpr std::int64_t at_once = 4;
    run((batch.count + at_once - 1) / at_once, threads,
        [&](std::int64_t task) {
            std::vector<Real> samples(static_cast<std::size_t>(2 * filter.step * part));
            FilterJob<Real> job{};
            for (int i = 0; i < filter.step; ++i) {
                job.re[i] = samples.data() + 2 * i * part;
                job.im[i] = job.re[i] + part;
            }
            job.origin = before;
            job.weight = weight.data();
            job.first = filter.first.data();
            job.phases = filter.phases;
            job.step = filter.step;
            job.taps = filter.taps;
            job.degree = filter.degree;
            job.intervals = intervals;
            job.plane_stride = stride;
            for (std::int64_t i = task * at_once; i < std::min(batch.count, (task + 1) * at_once); ++i) {
                std::fill(samples.begin(), samples.end(), Real(0));
                const std::int64_t start = batch.start[i];
                // all that the record has of what the taps reach
                const Recorded recorded = batch.traces ? Recorded(batch.traces[i]) : Recorded(0, n_sample);
                const std::int64_t from = std::max(start - before, recorded.begin);
                const std::int64_t to = std::min(start + batch.length + filter.taps, recorded.end);
                const Sample* trace = &batch.data(batch.order[i] / channels, batch.order[i] % channels, 0);
                const std::int64_t apart = batch.data.stride[2];
                const std::complex<double> weight = batch.weights ? batch.weights[i] : std::complex<double>(1.0);
                const Factor by(weight, batch.scale);
                for (int i = 0; i < filter.step; ++i) {
                    // the first sample of each part
                    const std::int64_t ahead = (i - (from - start + before)) % filter.step;
                    const std::int64_t begin = from + (ahead < 0 ? ahead + filter.step : ahead);
                    Real* re = samples.data() + 2 * i * part + (begin - start + before) / filter.step;
                    if (by.divisor != 1) {
                        for (std::int64_t n = begin; n < to; n += filter.step, ++re) {
                            const std::complex<double> s = by(std::complex<double>(trace[n * apart]));
                            re[0] = static_cast<Real>(s.real());
                            re[part] = static_cast<Real>(s.imag());
                        }
                        continue;
                    }
                    for (std::int64_t n = begin; n < to; n += filter.step, ++re) {
                        const Sample s = trace[n * apart];
                        re[0] = static_cast<Real>(s.real() * by.re - s.imag() * by.im);
                        re[part] = static_cast<Real>(s.real() * by.im + s.imag() * by.re);
                    }
                }
                job.out = table + i * planes * stride;
                for (int plane = 0; plane < planes; ++plane) {
                    std::fill(job.out + plane * stride + intervals, job.out + (plane + 1) * stride, Real(0));
                }
                run_filter(kernels, job);
            }
        },
        tick);
}

template <typename Real>
void compiled(const Terms<Real>& terms) {
    using List = Sizes<Real>;
    const bool listed = terms.trig == List::terms[0] || terms.trig == List::terms[1];
    if (!has_degree<List>(terms.degree) || !listed || terms.nodes.count != List::nodes)
        throw std::logic_error("no kernel for degree " + std::to_string(terms.degree) + ", " +
                               std::to_string(terms.trig) + " terms of the sine, " + std::to_string(terms.nodes.count) +
                               " nodes");
}

template void compiled(const Terms<float>&);
template void compiled(const Terms<double>&);

template <typename Real, typename Pixel>
std::int64_t add(const Kernels& kernels, const Terms<Real>& terms, const Raster& raster, const View<Pixel, 2>& image,
                 int threads, const Tick& tick) {
    compiled(terms);
    const bool straight = raster.first != nullptr;
    const std::int64_t rows = straight ? tile_rows : 1, columns = straight ? raster.count : tile_rows * raster.count;
    const std::int64_t down = (raster.height + rows - 1) / rows, across = (raster.width + columns - 1) / columns;
    std::vector<std::int64_t> counted(static_cast<std::size_t>(down * across));
    run(
        down * across, threads,
        [&](std::int64_t task) {
            if (raster.tiles && !raster.tiles[task]) return;
            const std::int64_t top = task / across * rows, left = task % across * columns;
            const std::int64_t bottom = std::min(top + rows, raster.height),
                               right = std::min(left + columns, raster.width);
            const std::int64_t pixels = (bottom - top) * (right - left);
            alignas(64) Real re[tile_rows * block], im[tile_rows * block];
            double lines[tile_rows * 6];
            std::vector<double> tail;
            std::uint8_t active[tile_rows];
            TileJob<Real> job{&terms,       nullptr, {}, 0, 0,       nullptr,          active, 0,
                              raster.count, re,      im, 0, nullptr, terms.model.near, 0,      0};
            TileWeights<Real> weights;
            if (straight) {
                job.rows = static_cast<int>(bottom - top);
                job.count = static_cast<int>(right - left);  // a block never runs on behind the image: tables end there
                Tiling(raster).lines({top, bottom, left, right}, lines);
                job.lines = lines;
                job.heights = raster.heights.from(top, left);
                if (raster.spans) job.low = raster.spans[2 * task], job.high = raster.spans[2 * task + 1];
            } else {
                job.rows = static_cast<int>((pixels + raster.count - 1) / raster.count);
                job.points = raster.points + 3 * left;
                if (job.rows * raster.count != pixels) {  // the last tile: repeat its last point
                    tail.assign(job.points, job.points + 3 * pixels);
                    while (static_cast<std::int64_t>(tail.size()) < 3 * job.rows * raster.count) {
                        for (int axis = 0; axis < 3; ++axis)
                            tail.push_back(tail[static_cast<std::size_t>(3 * (pixels - 1) + axis)]);
                    }
                    job.points = tail.data();
                }
            }
            bool any = false;
            const auto row_of = [&](std::int64_t r, std::int64_t& line, std::int64_t& begin, std::int64_t& end) {
                line = straight ? top + r : 0;
                begin = straight ? left : left + r * raster.count;
                end = std::min(begin + raster.count, right);
            };
            for (int r = 0; r < job.rows; ++r) {
                std::int64_t line, begin, end;
                row_of(r, line, begin, end);
                active[r] = Tiling(raster).any(line, begin, end);
                any = any || active[r];
            }
            if (!any) return;
            job.whole = job.count;
            job.weights = straight ? weights.of_lines(terms, lines, job.rows, job.count)
                                   : weights.of_points(terms, job.points, job.rows, job.count, left);
            run_sum(kernels, job);
            if (job.evaluated == 0) return;  // beams leave most tiles dark for most batches
            counted[static_cast<std::size_t>(task)] = job.evaluated * pixels / (job.rows * job.count);
            using value = typename Pixel::value_type;
            for (int r = 0; r < job.rows; ++r) {
                std::int64_t line, begin, end;
                row_of(r, line, begin, end);
                Pixel* to = &image(line, begin);
                const Real *a = re + r * block, *b = im + r * block;
                const auto one = [&](std::int64_t m) {
                    return Pixel(static_cast<value>(a[m]), static_cast<value>(b[m]));
                };
                if (image.stride[1] == 1) {  // which compilers take several at a time of
                    for (std::int64_t m = 0; m < end - begin; ++m) to[m] += one(m);
                } else {
                    for (std::int64_t m = 0; m < end - begin; ++m) to[m * image.stride[1]] += one(m);
                }
            }
        },
        tick);
    std::int64_t sum = 0;
    for (const std::int64_t n : counted) sum += n;
    return sum;
}

// The largest magnitude of `count` reals, not finite where any of them is not. Without its sign a number's bits are in
// the order of its size, infinite and what is no number above all others; and a compiler may take whole numbers side by
// side.
template <typename Real>
Real largest(const Real* x, std::int64_t count) {
    using Bits = std::conditional_t<sizeof(Real) == 4, std::int32_t, std::int64_t>;
    static_assert(sizeof(Bits) == sizeof(Real) && std::numeric_limits<Real>::is_iec559);
    Bits most = 0;
    for (std::int64_t n = 0; n < count; ++n) {
        Bits bits;
        std::memcpy(&bits, x + n, sizeof bits);
        most = std::max(most, bits & std::numeric_limits<Bits>::max());
    }
    Real found;
    std::memcpy(&found, &most, sizeof found);
    return found;
}

template <typename Sample>
void peaks(const View<const Sample, 3>& data, const Trace* traces, const std::int64_t* begin, const std::int64_t* end,
           double* out, int threads, const Tick& tick) {
    using value = typename Sample::value_type;
    constexpr std::int64_t at_once = 256;  // samples copied where they do not lie side by side
    run(
        data.shape[0], threads,
        [&](std::int64_t ping) {
            Sample copy[at_once];
            for (std::int64_t channel = 0; channel < data.shape[1]; ++channel) {
                const Sample* trace = &data(ping, channel, 0);
                const std::int64_t flat = ping * data.shape[1] + channel, step = data.stride[2];
                const auto most = [&](std::int64_t from, std::int64_t to) {
                    if (step == 1)
                        return largest(reinterpret_cast<const value*>(trace + from),
                                       2 * std::max<std::int64_t>(to - from, 0));
                    value found = 0;
                    for (std::int64_t n = from; n < to && std::isfinite(found); n += at_once) {
                        const std::int64_t count = std::min(at_once, to - n);
                        for (std::int64_t k = 0; k < count; ++k) copy[k] = trace[(n + k) * step];
                        const value here = largest(reinterpret_cast<const value*>(copy), 2 * count);
                        found = here <= found ? found : here;
                    }
                    return found;
                };
                const value found = most(begin[flat], end[flat]);
                const Recorded recorded(traces[flat]);
                const bool finite = std::isfinite(found) && std::isfinite(most(recorded.begin, begin[flat])) &&
                                    std::isfinite(most(std::max(begin[flat], end[flat]), recorded.end));
                out[flat] = finite ? static_cast<double>(found) : HUGE_VAL;
            }
        },
        tick);
}

template <typename Sample>
void mean_squares(const View<const Sample, 3>& data, const Places& places, double scale, double* out, int threads,
                  const Tick& tick) {
    const std::int64_t channels = data.shape[1], all = data.shape[2];
    const double inverse = std::min(1 / scale, std::numeric_limits<double>::max());  // one over a subnormal is infinite
    const std::int64_t at_once = std::max<std::int64_t>(1, 16384 / std::min(2 * places.reach + 1, all));
    run((places.count + at_once - 1) / at_once, threads,
        [&](std::int64_t task) {
            for (std::int64_t i = task * at_once; i < std::min(places.count, (task + 1) * at_once); ++i) {
                const std::int64_t ping = places.trace[i] / channels, channel = places.trace[i] % channels;
                const Sample* trace = &data(ping, channel, 0);
                const Recorded recorded(places.traces[places.trace[i]]);
                const std::int64_t from = std::max(places.place[i] - places.reach, recorded.begin);
                const std::int64_t to = std::min(places.place[i] + places.reach, recorded.end - 1);
                double sum[4] = {0, 0, 0, 0};  // one after another each addition would wait for the one before
                for (std::int64_t n = from; n <= to; ++n) {
                    const Sample s = trace[n * data.stride[2]];
                    const double a = s.real() * inverse, b = s.imag() * inverse;
                    sum[n & 3] += a * a + b * b;
                }
                out[i] = (sum[0] + sum[1] + sum[2] + sum[3]) / static_cast<double>(2 * places.reach + 1);
            }
        },
        tick);
}

using Single = std::complex<float>;
using Double = std::complex<double>;

template void prepare(const Kernels&, const Batch<Single>&, const Filter&, float*, std::int64_t, int, const Tick&);
template void prepare(const Kernels&, const Batch<Double>&, const Filter&, float*, std::int64_t, int, const Tick&);
template void prepare(const Kernels&, const Batch<Double>&, const Filter&, double*, std::int64_t, int, const Tick&);
template std::int64_t add(const Kernels&, const Terms<float>&, const Raster&, const View<Single, 2>&, int, const Tick&);
template std::int64_t add(const Kernels&, const Terms<float>&, const Raster&, const View<Double, 2>&, int, const Tick&);
template std::int64_t add(const Kernels&, const Terms<double>&, const Raster&, const View<Double, 2>&, int,
                          const Tick&);
template void peaks(const View<const Single, 3>&, const Trace*, const std::int64_t*, const std::int64_t*, double*, int,
                    const Tick&);
template void peaks(const View<const Double, 3>&, const Trace*, const std::int64_t*, const std::int64_t*, double*, int,
                    const Tick&);
template void mean_squares(const View<const Single, 3>&, const Places&, double, double*, int, const Tick&);
template void mean_squares(const View<const Double, 3>&, const Places&, double, double*, int, const Tick&);

}  // namespace pysas
