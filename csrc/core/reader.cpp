#include "core/reader.hpp"

#include <algorithm>
#include <type_traits>

namespace pysas {

template <typename Real>
LowPassed<Real>::LowPassed(const Reader& reader, std::int64_t n_sample)
    : reader_(reader), length_(reader.wide ? n_sample : reader.length), transform_(reader.cut->n_fft) {
    if (!reader.wide) window_.assign(reader.cut->window.begin(), reader.cut->window.end());
    const std::int64_t n = transform_.size();
    for (std::int64_t i = 0; i < n; ++i) {
        const std::int64_t k = i < (n + 1) / 2 ? i : i - n;
        const double pass = low_pass(static_cast<double>(k) / static_cast<double>(n)) / static_cast<double>(n);
        const std::complex<double> half = pass * root_of_unity(k, 2 * n);
        even_.push_back(static_cast<Real>(pass));
        odd_re_.push_back(static_cast<Real>(half.real()));
        odd_im_.push_back(static_cast<Real>(half.imag()));
    }
}

// The samples kept of some of a batch's traces, weighted and cut, side by side: behind as many zeros as the filter
// reaches before the first of them.
template <typename Real>
template <typename Sample>
void LowPassed<Real>::take(const Batch<Sample>& batch, std::int64_t first, std::int64_t count, Planes to) const {
    constexpr std::int64_t lanes = transform_lanes<Real>;
    std::fill_n(to.re, transform_.size() * lanes, Real(0));
    std::fill_n(to.im, transform_.size() * lanes, Real(0));
    const std::int64_t channels = batch.data.shape[1], apart = batch.data.stride[2], lead = reader_.filter.taps;
    for (std::int64_t lane = 0; lane < count; ++lane) {
        const std::int64_t i = first + lane;
        if (batch.weights[i] == 0.0) continue;  // or it may hold anything
        const std::int64_t start = reader_.wide ? 0 : batch.start[i];
        const Recorded recorded(batch.traces[i]);
        const std::int64_t from = std::max(start, recorded.begin), last = std::min(start + length_, recorded.end);
        const Sample* trace = &batch.data(batch.order[i] / channels, batch.order[i] % channels, 0);
        const Factor by(batch.weights[i], batch.scale);
        for (std::int64_t n = from; n < last; ++n) {
            const std::complex<double> s = by(std::complex<double>(trace[n * apart]));
            const std::int64_t place = (lead + n - start) * lanes + lane;
            to.re[place] = static_cast<Real>(s.real());
            to.im[place] = static_cast<Real>(s.imag());
            if (window_.empty()) continue;
            to.re[place] *= window_[static_cast<std::size_t>(n - start)];
            to.im[place] *= window_[static_cast<std::size_t>(n - start)];
        }
    }
}

// The low-passed traces of `data` at twice the sample rate: samples and places half-way are twice as many sequences
// side by side, which is the order of time. `work` is used up as `data` is, and both together are the room of `to`.
template <typename Real>
typename LowPassed<Real>::Planes LowPassed<Real>::refine(const Kernels& kernels, Planes data, Planes work,
                                                         Planes to) const {
    constexpr std::int64_t lanes = transform_lanes<Real>;
    const Planes spectrum = transform_(kernels, data, work, lanes);
    for (std::int64_t k = 0; k < transform_.size(); ++k) {
        const auto at = static_cast<std::size_t>(k);
        const Real pass = even_[at], c = odd_re_[at], d = odd_im_[at];
        const Real *re = spectrum.re + k * lanes, *im = spectrum.im + k * lanes;
        Real *to_re = to.re + 2 * k * lanes, *to_im = to.im + 2 * k * lanes;
        for (std::int64_t i = 0; i < lanes; ++i) {
            to_re[i] = re[i] * pass;
            to_im[i] = im[i] * pass;
            to_re[lanes + i] = re[i] * c - im[i] * d;
            to_im[lanes + i] = re[i] * d + im[i] * c;
        }
    }
    Real* const room = std::min(data.re, work.re);
    // inverse: imaginary parts for real ones
    const Planes fine = transform_(kernels, {to.im, to.re}, {room + 2 * transform_.size() * lanes, room}, 2 * lanes);
    return {fine.im, fine.re};
}

template <typename Real>
template <typename Table, typename Sample>
void LowPassed<Real>::fill(const Kernels& kernels, const Batch<Sample>& batch, Table* table, std::int64_t stride,
                           int threads, const Tick& tick) const {
    constexpr std::int64_t lanes = transform_lanes<Real>;
    const std::int64_t n = transform_.size(), planes = 2 * (reader_.filter.degree + 1), half = n * lanes;
    const std::int64_t own_stride =
        plane_stride(intervals_of(reader_.samples(), reader_.filter.rate()), reader_.filter.degree, sizeof(Real));
    run((batch.count + lanes - 1) / lanes, threads,
        [&](std::int64_t task) {
            const std::int64_t first = task * lanes, count = std::min(lanes, batch.count - first);
            // two rooms, each for all sequences at twice the rate
            std::vector<Complex> rooms(static_cast<std::size_t>(4 * half));
            Real *const room = reinterpret_cast<Real*>(rooms.data()), *const other = room + 4 * half;
            const Planes data{room, room + half}, work{room + 2 * half, room + 3 * half};
            take(batch, first, count, data);
            const Planes fine = refine(kernels, data, work, {other, other + 2 * half});
            Complex* const traces = rooms.data() + (fine.re < other ? 2 * half : 0);  // where these are not
            std::vector<std::int64_t> order, start;
            for (std::int64_t lane = 0; lane < count; ++lane) {
                Complex* to = traces + lane * 2 * n;
                for (std::int64_t m = 0; m < 2 * n; ++m) to[m] = {fine.re[m * lanes + lane], fine.im[m * lanes + lane]};
                order.push_back(lane);
                start.push_back(2 * (reader_.filter.taps + (reader_.wide ? batch.start[first + lane] : 0)));
            }
            const Batch<Complex> lowered{{traces, {count, 1, 2 * n}, {2 * n, 2 * n, 1}},
                                         order.data(),
                                         start.data(),
                                         nullptr,
                                         nullptr,
                                         count,
                                         reader_.samples(),
                                         1.0};
            if constexpr (std::is_same_v<Table, Real>) {
                prepare(kernels, lowered, reader_.filter, table + first * planes * stride, stride, 1, {});
            } else {  // rounded where it is read, not where it is bright
                std::unique_ptr<Real[]> own(new Real[static_cast<std::size_t>(count * planes * own_stride)]);
                prepare(kernels, lowered, reader_.filter, own.get(), own_stride, 1, {});
                const std::int64_t kept = std::min(own_stride, stride);
                for (std::int64_t row = 0; row < count * planes; ++row) {
                    Table* to = table + (first * planes + row) * stride;
                    for (std::int64_t k = 0; k < kept; ++k) to[k] = static_cast<Table>(own[row * own_stride + k]);
                    std::fill(to + kept, to + stride, Table(0));
                }
            }
        },
        tick);
}

template <typename Real>
Tables<Real>::Tables(Execution& run, std::int64_t n_sample, std::int64_t most) : recipe_(run.recipe) {
    const Recipe& recipe = run.recipe;
    const Reader& reader = recipe.reader;
    if (reader.cut && (reader.wide || sizeof(Real) == 8)) double_.emplace(reader, n_sample);
    if (reader.cut && !double_) single_.emplace(reader, n_sample);
    terms_.degree = reader.filter.degree;
    terms_.plane_stride =
        plane_stride(intervals_of(reader.samples(), reader.filter.rate()), terms_.degree, sizeof(Real));
    terms_.trace_stride = 2 * (terms_.degree + 1) * terms_.plane_stride;
    table_ = Loan<Real>(run.work.of<Real>(), static_cast<std::size_t>(most * terms_.trace_stride));
    terms_.table = table_.get();
    terms_.trig = static_cast<int>(recipe.sine.size());
    std::copy(recipe.sine.begin(), recipe.sine.end(), terms_.sine);
    std::copy(recipe.cosine.begin(), recipe.cosine.end(), terms_.cosine);
    terms_.model = recipe.model;
    terms_.light = recipe.light;
    terms_.kind = recipe.kind;
    terms_.nodes = recipe.nodes;
    terms_.rise = recipe.rise;
    if (!recipe.lattice) return;
    const LatticeWeights& l = *recipe.lattice;
    lattice_ = {nullptr, 0, l.nx, l.ny, l.x0, l.y0, l.dx, l.dy, l.longest};
    terms_.lattice = &lattice_;
}

// Weights on the lattice lie side by side for the traces at hand.
template <typename Real>
void Tables<Real>::weigh(const std::int64_t* order, std::int64_t count) {
    const auto places = static_cast<std::size_t>(lattice_.nx * lattice_.ny);
    value_.resize(places * static_cast<std::size_t>(count));
    float* to = value_.data();
    for (std::size_t place = 0; place < places; ++place) {
        const float* row = recipe_.lattice->value + place * recipe_.traces.size();
        for (std::int64_t i = 0; i < count; ++i) *to++ = row[order[i]];
    }
    lattice_.value = value_.data();
    lattice_.apart = count;
}

template <typename Real>
template <typename Sample>
void Tables<Real>::fill(Execution& run, const View<const Sample, 3>& data, const std::int64_t* order,
                        std::int64_t count) {
    traces_.clear();
    weights_.clear();
    start_.clear();
    for (std::int64_t i = 0; i < count; ++i) {
        const auto flat = static_cast<std::size_t>(order[i]);
        traces_.push_back(recipe_.traces[flat]);
        weights_.push_back(run.used[flat] ? recipe_.weights[flat] : 0.0);
        start_.push_back(static_cast<std::int64_t>(traces_.back().kept));
    }
    if (recipe_.lattice) weigh(order, count);
    const Batch<Sample> batch{
        data, order, start_.data(), weights_.data(), traces_.data(), count, recipe_.reader.samples(), run.scale};
    const std::int64_t stride = terms_.plane_stride;
    const Tick poll = run.progress.poll();
    if constexpr (sizeof(Real) == 4) {
        if (single_) single_->fill(run.kernels, batch, table_.get(), stride, run.threads, poll);
    }
    if (double_) double_->fill(run.kernels, batch, table_.get(), stride, run.threads, poll);
    if (!single_ && !double_)
        prepare(run.kernels, batch, recipe_.reader.filter, table_.get(), stride, run.threads, poll);
    for (std::int64_t i = 0; i < count; ++i) {
        Real* const row = table_.get() + i * terms_.trace_stride;
        if (!run.used[order[i]]) std::fill_n(row, terms_.trace_stride, Real(0));  // it may hold anything
    }
    terms_.traces = traces_.data();
    terms_.n_trace = count;
}

using Single = std::complex<float>;
using Double = std::complex<double>;

template class Tables<float>;
template class Tables<double>;
template void Tables<float>::fill(Execution&, const View<const Single, 3>&, const std::int64_t*, std::int64_t);
template void Tables<float>::fill(Execution&, const View<const Double, 3>&, const std::int64_t*, std::int64_t);
template void Tables<double>::fill(Execution&, const View<const Double, 3>&, const std::int64_t*, std::int64_t);

}  // namespace pysas
