#include "planning/plan.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <iterator>
#include <limits>
#include <thread>

#include "core/border.hpp"
#include "core/dispatch.hpp"
#include "core/errors.hpp"
#include "core/polynomials.hpp"

namespace pysas {
namespace {

constexpr std::int64_t most = std::int64_t{1} << 40;  // of any one size, and of their products

[[noreturn]] void refuse(const std::string& text) { throw Error(Code::argument, text); }

void finite(const double* values, std::int64_t count, const char* name) {
    for (std::int64_t i = 0; values && i < count; ++i) {
        if (!(std::abs(values[i]) <= 1e15)) refuse(std::string(name) + ": not finite, or beyond 1e15");
    }
}

void size(std::int64_t a, std::int64_t b, std::int64_t c, const char* name) {
    if (a < 1 || b < 1 || c < 1 || a > most || b > most / a || c > most / (a * b)) refuse(std::string(name) + ": size");
}

double distance(const double* a, const double* b) {
    return std::sqrt((a[0] - b[0]) * (a[0] - b[0]) + (a[1] - b[1]) * (a[1] - b[1]) + (a[2] - b[2]) * (a[2] - b[2]));
}

// Whether a box lies in every beam: its corners do, and beams up to a right angle off boresight are convex.
bool all_lit(const std::vector<Trace>& traces, double cosine, const double low[3], const double high[3]) {
    return std::all_of(traces.begin(), traces.end(), [&](const Trace& trace) {
        for (int corner = 0; corner < 8; ++corner) {
            double along = 0, square = 0;
            for (int axis = 0; axis < 3; ++axis) {
                const double away = (corner >> axis & 1 ? high : low)[axis] - trace.tx[axis];
                along += away * trace.boresight[axis];
                square += away * away;
            }
            if (!(along >= (std::max(cosine, 0.0) + 1e-9) * std::sqrt(square))) return false;
        }
        return true;
    });
}

}  // namespace

double longest_run(double tol) {
    double run = 256;
    while (run > 32 && run * 0x1p-25 > 0.05 * tol * (1 + 1e-9)) run /= 2;
    return run;
}

Plan::Plan(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options)
    : pings_(survey.n_ping),
      channels_(survey.n_channel),
      samples_(survey.n_sample),
      height_(grid.height),
      width_(grid.width) {
    check(survey, grid, options);
    single_ = options.dtype == PYSAS_COMPLEX64;
    narrow_ = single_ || options.tol >= 1e-5 * (1 - 1e-9);
    tol_ = options.tol;
    const unsigned all = std::thread::hardware_concurrency();
    threads_ = options.threads > 0 ? options.threads : std::max(1, static_cast<int>(all));
    const char* wanted = options.isa ? options.isa : std::getenv("PYSAS_ISA");
    kernels_ = &kernels_for(wanted ? wanted : "auto");
    if (options.progress) {
        const auto call = options.progress;
        void* const user = options.user;
        progress_ = [call, user](double share) { return call(share, user) == 0; };
    }
    const double bandwidth = survey.bandwidth > 0 ? survey.bandwidth : survey.fs / 1.1;
    band_ = bandwidth / 2 / survey.fs;
    model_.c = survey.c;
    model_.fc = survey.fc;
    model_.fs = survey.fs;
    model_.last = static_cast<double>(samples_ - 1);
    const double widest = survey.beam_half_angle + edge_angle;
    model_.cos_beam = survey.boresight && widest < pi ? std::cos(widest) : -1.0;
    model_.run = narrow_ ? longest_run(tol_) : 0;
    place(survey, grid);
    // of the carrier's phase, or of the place in a record whose band is wider than its carrier is high
    if (1e-14 * farthest_ * std::max(survey.fc, bandwidth) / survey.c > tol_)
        throw Error(Code::tolerance, "tol: out of reach of double over this range");
    if (options.method == PYSAS_FFBP) factorise(options.tol);
    if (forest_) return;
    const Shares shares{0.1, 0.6};
    choose_delay(options.tol, shares, nearest_);
    if (traces_.empty()) return;
    if (!choose_filter(options.tol, shares,
                       {{1, 1}, {3, 2}, {2, 1}, {5, 2}, {3, 1}, {4, 1}, {5, 1}, {6, 1}, {8, 1}, {11, 1}, {16, 1}}))
        throw Error(Code::tolerance, "tol: pixels need samples too near a record's ends");
}

void Plan::check(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options) const {
    size(pings_, channels_, samples_, "survey");
    size(height_, width_, 3, "grid");
    if (!survey.tx || !survey.rx) refuse("survey: tx and rx are needed");
    const std::int64_t traces = pings_ * channels_;
    finite(survey.tx, 3 * pings_, "tx");
    finite(survey.rx, 3 * traces, "rx");
    finite(survey.velocity, 3 * traces, "velocity");
    finite(survey.weights, traces, "weights");
    finite(survey.ping_t0, pings_, "ping_t0");
    finite(survey.boresight, 3 * pings_, "boresight");
    finite(&survey.t0, 1, "t0");
    for (const double value : {survey.fs, survey.fc, survey.c}) {
        if (!(value > 1e-9 && value <= 1e15)) refuse("survey: fs, fc and c must be positive and finite");
    }
    if (!(survey.bandwidth >= 0 && survey.bandwidth <= survey.fs / 1.1 * (1 + 1e-9)))
        refuse("bandwidth: above fs / 1.1");
    if (survey.boresight && !(survey.beam_half_angle > 0 && survey.beam_half_angle <= pi * (1 + 1e-9)))
        refuse("beam_half_angle: not in (0, pi]");
    for (std::int64_t i = 0; survey.velocity && i < traces; ++i) {
        const double zero[3] = {0, 0, 0};
        if (!(distance(survey.velocity + 3 * i, zero) < 0.5 * survey.c))
            refuse("velocity: above half the speed of sound");
    }
    for (const double* vector : {grid.first, grid.along, grid.down}) finite(vector, 3, "grid");
    finite(grid.points, 3 * height_ * width_, "points");
    if (options.dtype != PYSAS_COMPLEX64 && options.dtype != PYSAS_COMPLEX128) refuse("dtype");
    if (options.method != PYSAS_BACKPROJECTION && options.method != PYSAS_FFBP) refuse("method");
    if (options.threads < 0 || options.threads > 4096) refuse("threads");
    const double least = options.dtype == PYSAS_COMPLEX64 ? 1e-5 : 1e-10;
    if (!(options.tol >= least * (1 - 1e-9) && options.tol <= 0.1)) throw Error(Code::tolerance, "tol: out of reach");
}

void Plan::place(const pysas_survey& survey, const pysas_grid& grid) {
    const std::int64_t pixels = height_ * width_;
    double low[3], high[3], origin[3];
    for (int axis = 0; axis < 3; ++axis) {
        if (grid.points) {
            low[axis] = high[axis] = grid.points[axis];
            for (std::int64_t i = 0; i < pixels; ++i) {
                low[axis] = std::min(low[axis], grid.points[3 * i + axis]);
                high[axis] = std::max(high[axis], grid.points[3 * i + axis]);
            }
        } else {
            const double along = grid.along[axis] * static_cast<double>(width_ - 1);
            const double down = grid.down[axis] * static_cast<double>(height_ - 1);
            low[axis] = grid.first[axis] + std::min(along, 0.0) + std::min(down, 0.0);
            high[axis] = grid.first[axis] + std::max(along, 0.0) + std::max(down, 0.0);
        }
        origin[axis] = (low[axis] + high[axis]) / 2;
        low[axis] -= origin[axis];
        high[axis] -= origin[axis];
    }
    if (grid.points) {
        points_.assign(grid.points, grid.points + 3 * pixels);
        for (std::size_t i = 0; i < points_.size(); ++i) points_[i] -= origin[i % 3];
    } else {
        for (std::int64_t i = 0; i < height_; ++i) {
            for (int axis = 0; axis < 3; ++axis) {
                first_.push_back(grid.first[axis] - origin[axis] + static_cast<double>(i) * grid.down[axis]);
                along_.push_back(grid.along[axis]);
            }
        }
        const double zero[3] = {0, 0, 0};
        step_ = distance(grid.along, zero);
    }
    if (grid.mask) mask_.assign(grid.mask, grid.mask + pixels);
    bool together = true, moving = false;
    for (std::int64_t i = 0; i < pings_ * channels_; ++i) {
        const std::int64_t ping = i / channels_;
        if (survey.weights && survey.weights[i] == 0) continue;
        Trace trace{};
        for (int axis = 0; axis < 3; ++axis) {
            trace.tx[axis] = survey.tx[3 * ping + axis] - origin[axis];
            trace.rx[axis] = survey.rx[3 * i + axis] - origin[axis];
            together = together && trace.tx[axis] == trace.rx[axis];
            if (survey.velocity) trace.velocity[axis] = survey.velocity[3 * i + axis];
            moving = moving || trace.velocity[axis] != 0;
            if (survey.boresight) trace.boresight[axis] = survey.boresight[3 * ping + axis];
        }
        if (survey.boresight) normalise(trace.boresight);
        trace.t0 = survey.ping_t0 ? survey.ping_t0[ping] : survey.t0;
        traces_.push_back(trace);
        order_.push_back(i);
        if (survey.weights) weights_.emplace_back(survey.weights[i]);
    }
    kind_ = moving ? Kind::moving : together ? Kind::monostatic : Kind::stop_and_hop;
    if (model_.cos_beam > -1 && all_lit(traces_, model_.cos_beam, low, high)) model_.cos_beam = -1;
    bound(low, high);
}

// Samples that any pixel of the box asks of each trace; traces that no pixel hears are dropped.
void Plan::bound(const double low[3], const double high[3]) {
    std::size_t kept = 0;
    nearest_ = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < traces_.size(); ++i) {
        Trace& trace = traces_[i];
        double shortest = 0, longest = 0;
        for (const double* sensor : {trace.tx, trace.rx}) {
            double inside[3], far[3];
            for (int axis = 0; axis < 3; ++axis) {
                inside[axis] = std::clamp(sensor[axis], low[axis], high[axis]);
                far[axis] = sensor[axis] - low[axis] > high[axis] - sensor[axis] ? low[axis] : high[axis];
            }
            const double least = distance(sensor, inside), most = distance(sensor, far);
            nearest_ = std::min(nearest_, least);
            farthest_ = std::max(farthest_, most);
            shortest += least;
            longest += most;
        }
        const double zero[3] = {0, 0, 0}, speed = distance(trace.velocity, zero);
        const double begin = std::floor((shortest / (model_.c + speed) - trace.t0) * model_.fs);
        const double end = std::ceil((longest / (model_.c - speed) - trace.t0) * model_.fs);
        if (!(end >= 0 && begin <= model_.last)) continue;
        asked_.push_back(static_cast<std::int64_t>(std::max(begin, 0.0)));
        until_.push_back(static_cast<std::int64_t>(std::min(end, model_.last)));
        traces_[kept] = trace;
        order_[kept] = order_[i];
        if (!weights_.empty()) weights_[kept] = weights_[i];
        ++kept;
    }
    traces_.resize(kept);
    order_.resize(kept);
    if (!weights_.empty()) weights_.resize(kept);
    keep();
}

// Keep of every trace what is asked of it.
void Plan::keep() {
    lowest_ = samples_ - 1;
    highest_ = 0;
    length_ = 1;
    start_.clear();
    for (std::size_t i = 0; i < traces_.size(); ++i) {
        lowest_ = std::min(lowest_, asked_[i]);
        highest_ = std::max(highest_, until_[i]);
        length_ = std::max(length_, until_[i] - asked_[i] + 4);
        traces_[i].kept = static_cast<double>(asked_[i] - 1);
        start_.push_back(asked_[i] - 1);
    }
}

// Blocks, delay polynomials, sine and cosine; false where float offsets would not keep their share even in the shortest
// block.
bool Plan::choose_delay(double tol, const Shares& shares, double nearest) {
    const double share = 0.1 * tol, eps = narrow_ ? 0x1p-24 : 0x1p-53;
    for (const int k : {0, 1}) {
        const int terms = narrow_ ? Sizes<float>::terms[k] : Sizes<double>::terms[k];
        if (fit_trigonometry(terms, sine_, cosine_) <= share / 2) break;
    }
    nodes_.count = narrow_ ? Sizes<float>::nodes : Sizes<double>::nodes;
    const int n = nodes_.count;
    for (int j = 0; j < n; ++j) nodes_.at[j] = j == n / 2 ? 0.0 : -std::cos(pi * (2 * j + 1) / (2 * n));
    const std::vector<long double> places(nodes_.at, nodes_.at + n);
    for (int j = 0; j < n; ++j) {  // column j: the polynomial that is 1 at node j and 0 at the others
        std::vector<long double> column(places.size());
        column[static_cast<std::size_t>(j)] = 1;
        monomials(places, column);
        for (int q = 0; q < n; ++q) nodes_.fit[q][j] = static_cast<double>(column[static_cast<std::size_t>(q)]);
    }
    model_.near = std::numeric_limits<double>::infinity();
    const double wave = model_.fc / model_.c;
    bool found = false;
    for (const int size : {64, 48, 32, 16, 8}) {  // the bounds of pysas/planning/choices.py, choose_delay
        count_ = size;
        const double half = step_ * (size - 1) / 2, turns = 2 * half * wave;
        if (pi * turns * eps + 4 * eps > shares.rounding * tol) continue;
        found = true;
        const double wrong = 2 * pi * wave * 2 * 1.3 * (2.0 / (2 * n - 1)) * std::pow(half, n) / std::pow(2.0, n - 1);
        model_.near = std::max(2 * half, std::pow(wrong / share, 1.0 / (n - 1)));
        if (model_.near <= nearest) break;
    }
    if (!first_.empty() && std::isinf(model_.near)) model_.near = 1e300;
    if (!points_.empty()) count_ = block;
    return found;
}

// The cheapest filter for tables of one of the rates; false where none keeps its share.
bool Plan::choose_filter(double tol, const Shares& shares, const std::vector<std::pair<int, int>>& rates) {
    // this far from a record's ends any short filter reads it as the low-pass W does: above GUARD of
    // pysas/planning/bounds.py
    const auto away = static_cast<std::int64_t>(3.5 * std::pow(0.1 * tol, -0.4)) + 8;
    const bool ends = lowest_ < away || highest_ > samples_ - 1 - away;
    const double most = shares.interpolation * tol;
    int least = 8, longest = 400;
    const std::vector<int> single(std::begin(Sizes<float>::degrees), std::end(Sizes<float>::degrees));
    const std::vector<int> twice(std::begin(Sizes<double>::degrees), std::end(Sizes<double>::degrees));
    if (ends) {
        // how long W's response must be hardly depends on the polynomials: ask once, with ones that are no limit
        least = longest = design(band_, narrow_ ? single.back() : twice.back(), 2, 1, most / 2, 64, 2048, true).taps;
    }
    double cheapest = std::numeric_limits<double>::infinity();
    for (const int degree : narrow_ ? single : twice) {
        for (const auto& rate : rates) {
            const double theta = pi * (ends ? 0.5 : band_) * rate.second / rate.first;
            // a polynomial's own error, before any filter is made
            if (std::pow(theta, degree + 1) / std::tgamma(degree + 2.0) / std::pow(2.0, degree) > 1.5 * most) continue;
            const double cost = (degree + 7) * (1 + 0.05 * rate.first / rate.second);
            if (cost >= cheapest) break;
            Filter filter = design(band_, degree, rate.first, rate.second, most, least, longest, ends);
            if (filter.error > most) continue;
            cheapest = cost;
            filter_ = std::move(filter);
            break;
        }
    }
    model_.rate = filter_.rate();
    return filter_.taps != 0;
}

void Plan::execute(const void* data, const std::int64_t* data_stride, void* image,
                   const std::int64_t* image_stride) const {
    if (single_)
        sum<float, std::complex<float>>(data, data_stride, image, image_stride);
    else if (narrow_)
        sum<float, std::complex<double>>(data, data_stride, image, image_stride);
    else
        sum<double, std::complex<double>>(data, data_stride, image, image_stride);
}

template <typename Real, typename Sample>
void Plan::sum(const void* data, const std::int64_t* data_stride, void* image, const std::int64_t* image_stride) const {
    const std::int64_t packed[3] = {channels_ * samples_, samples_, 1}, rows[2] = {width_, 1};
    View<const Sample, 3> from{static_cast<const Sample*>(data), {pings_, channels_, samples_}, {}};
    View<Sample, 2> to{static_cast<Sample*>(image), {height_, width_}, {}};
    std::copy_n(data_stride ? data_stride : packed, 3, from.stride);
    std::copy_n(image_stride ? image_stride : rows, 2, to.stride);
    check_image(to.shape, to.stride, image, from.shape, from.stride, data, sizeof(Sample));
    for (std::int64_t i = 0; i < height_; ++i) {
        for (std::int64_t j = 0; j < width_; ++j) to(i, j) = 0;
    }
    if (progress_ && !progress_(0)) throw Error(Code::cancelled, "stopped by the caller");
    const auto scale = this->scale(from);
    if (!scale) return;

    View<Sample, 2> lines = to;
    std::vector<Sample> list;
    if (!points_.empty()) {  // a list of points is one line
        lines.shape[0] = 1;
        lines.shape[1] = height_ * width_;
        if (to.stride[0] == width_ * to.stride[1]) {
            lines.stride[0] = lines.shape[1];
            lines.stride[1] = to.stride[1];
        } else {
            list.assign(static_cast<std::size_t>(lines.shape[1]), Sample(0));
            lines = {list.data(), {1, lines.shape[1]}, {lines.shape[1], 1}};
        }
    }
    const auto fill = [&](const auto& into) {
        if constexpr (sizeof(Real) == 4) {
            if (forest_) return sum_forest(from, into, *scale);
        }
        sum_directly<Real>(from, into, *scale);
    };
    if (sizeof(Sample) == sizeof(std::complex<float>) && wide()) {
        std::vector<std::complex<double>> wider(static_cast<std::size_t>(lines.shape[0] * lines.shape[1]));
        const View<std::complex<double>, 2> sums{wider.data(), {lines.shape[0], lines.shape[1]}, {lines.shape[1], 1}};
        fill(sums);
        for (std::int64_t i = 0; i < lines.shape[0]; ++i) {
            for (std::int64_t j = 0; j < lines.shape[1]; ++j) lines(i, j) = static_cast<Sample>(sums(i, j));
        }
    } else {
        fill(lines);
    }
    using value = typename Sample::value_type;
    using limits = std::numeric_limits<value>;
    const int exponent = exponent_of(*scale) - 1;
    const auto scaled = [&](value part) {  // the scale itself may be no float
        return exponent > limits::min_exponent && exponent < limits::max_exponent ? part * static_cast<value>(*scale)
                                                                                  : std::ldexp(part, exponent);
    };
    double power = 0, largest = 0;
    for (std::int64_t i = 0; i < height_; ++i) {
        for (std::int64_t j = 0; j < width_; ++j) {
            const std::int64_t flat = i * width_ + j;
            Sample& pixel = to(i, j);
            if (!list.empty()) pixel = list[static_cast<std::size_t>(flat)];
            const bool wanted = mask_.empty() || mask_[static_cast<std::size_t>(flat)];
            if (wanted) {
                power += std::norm(std::complex<double>(pixel));
                largest = std::max<double>({largest, std::abs(pixel.real()), std::abs(pixel.imag())});
            }
            pixel = wanted ? Sample(scaled(pixel.real()), scaled(pixel.imag())) : Sample(0);
        }
    }
    if (largest > 0) {
        // rounding to multiples of the smallest number, evenly spread, of both parts
        const double lost = std::ldexp(std::sqrt(static_cast<double>(height_ * width_) / 6 / power),
                                       std::clamp(limits::min_exponent - limits::digits - exponent, -2000, 2000));
        if (exponent_of(largest) + exponent > limits::max_exponent || !(lost <= tol_ / 10))
            throw Error(Code::range, "the image lies beyond the range of its type");
    }
    if (progress_ && !progress_(1)) throw Error(Code::cancelled, "stopped by the caller");
}

// The power of two next to the largest weight x sample that is read; none where all are 0.
template <typename Sample>
std::optional<double> Plan::scale(const View<const Sample, 3>& from) const {
    const auto count = static_cast<std::size_t>(pings_ * channels_);
    std::vector<double> peak(count);
    std::vector<std::int64_t> begin(count, 0), end(count, 0);
    for (std::size_t i = 0; i < traces_.size(); ++i) {
        const auto flat = static_cast<std::size_t>(order_[i]);
        begin[flat] = std::clamp<std::int64_t>(start_[i] - filter_.taps, 0, samples_);
        end[flat] = std::clamp<std::int64_t>(start_[i] + length_ + filter_.taps, begin[flat], samples_);
    }
    peaks(from, begin.data(), end.data(), peak.data(), threads_, {});
    if (!(*std::max_element(peak.begin(), peak.end()) <= std::numeric_limits<double>::max()))
        throw Error(Code::data, "data: samples that are not finite");
    std::optional<int> most;  // in exponents: the products may be no numbers
    for (std::size_t i = 0; i < traces_.size(); ++i) {
        const double largest = peak[static_cast<std::size_t>(order_[i])];
        if (largest == 0) continue;
        const int exponent = exponent_of(largest) + (weights_.empty() ? 1 : exponent_of(std::abs(weights_[i])));
        most = std::max(most.value_or(exponent), exponent);
    }
    if (!most) return {};
    if (*most > 1025) throw Error(Code::range, "weights x samples: beyond the range of double");
    return std::ldexp(1.0, std::clamp(*most, -1074, 1023));
}

std::int64_t Plan::stride(std::size_t real) const {
    return plane_stride(intervals_of(length_, filter_.rate()), filter_.degree, real);
}

// Traces whose tables are kept at a time: 24 MB of them.
std::int64_t Plan::batch(std::size_t real) const {
    const std::int64_t row = 2 * (filter_.degree + 1) * stride(real) * static_cast<std::int64_t>(real);
    return std::max<std::int64_t>(8, (std::int64_t{24} << 20) / row);
}

// What all batches share: everything but tables and traces.
template <typename Real>
Terms<Real> Plan::terms() const {
    Terms<Real> out{};
    out.plane_stride = stride(sizeof(Real));
    out.trace_stride = 2 * (filter_.degree + 1) * out.plane_stride;
    out.degree = filter_.degree;
    out.trig = static_cast<int>(sine_.size());
    std::copy(sine_.begin(), sine_.end(), out.sine);
    std::copy(cosine_.begin(), cosine_.end(), out.cosine);
    out.model = model_;
    out.kind = kind_;
    out.nodes = nodes_;
    return out;
}

template Terms<float> Plan::terms() const;

Raster Plan::lines() const {
    const bool straight = points_.empty();
    return {straight ? first_.data() : nullptr,
            straight ? along_.data() : nullptr,
            straight ? nullptr : points_.data(),
            mask_.empty() ? nullptr : mask_.data(),
            straight ? height_ : 1,
            straight ? width_ : height_ * width_,
            count_};
}

// Whether the image is a sum of so many batches, or trees, that floats would round it too often: Plan.wide in
// pysas/imaging/plans.py.
bool Plan::wide() const {
    const std::int64_t most = batch(sizeof(float)), all = static_cast<std::int64_t>(traces_.size());
    const auto trees = forest_ ? static_cast<std::int64_t>(forest_->trees.size()) : 0;
    return static_cast<double>((all + most - 1) / most + trees) > model_.run / 8;
}

template <typename Real, typename Sample, typename Pixel>
void Plan::sum_directly(const View<const Sample, 3>& from, const View<Pixel, 2>& to, double scale) const {
    const auto all = static_cast<std::int64_t>(traces_.size()), most = std::min(all, batch(sizeof(Real)));
    Terms<Real> terms = this->terms<Real>();
    std::vector<Real> table(static_cast<std::size_t>(most * terms.trace_stride));
    terms.table = table.data();
    for (std::int64_t begin = 0; begin < all; begin += most) {
        const std::int64_t count = std::min(most, all - begin);
        const Tick tick = [&](double share) {
            const double done = static_cast<double>(begin) + share * static_cast<double>(count);
            return !progress_ || progress_(done / static_cast<double>(all));
        };
        const Batch<Sample> traces{from,
                                   order_.data() + begin,
                                   start_.data() + begin,
                                   weights_.empty() ? nullptr : weights_.data() + begin,
                                   count,
                                   length_,
                                   scale};
        prepare(*kernels_, traces, filter_, table.data(), terms.plane_stride, threads_, {});
        terms.traces = traces_.data() + begin;
        terms.n_trace = count;
        add(*kernels_, terms, lines(), to, threads_, tick);
    }
}

}  // namespace pysas
