// Sums without trees: of lines, of lists of points, and of points with weights of their own.

#include "core/execution.hpp"

#include <algorithm>
#include <stdexcept>

#include "core/arcs.hpp"
#include "core/errors.hpp"
#include "core/reader.hpp"
#include "core/summation.hpp"

namespace pysas {

namespace {

constexpr double most = 1 - 0x1p-20;

}  // namespace

bool Progress::tell(double share) {
    // all is done once the caller has its image: that is for him to tell
    reached_ = std::min(std::max(reached_, share), most);
    return tick_(reached_);
}

void Progress::reach(double share) {
    if (tick_ && !tell(share)) throw Error(Code::cancelled, "stopped by the caller");
}

namespace {

constexpr std::int64_t slab = 1 << 16;                     // points at a time
constexpr std::int64_t own_bytes = std::int64_t{1} << 28;  // of pixels' own weights at a time

// A part of all work: `more` of it after what is `done`.
struct Share {
    double done, more;
    Share part(std::int64_t begin, std::int64_t count, std::int64_t all) const {
        const auto whole = static_cast<double>(all);
        return {done + more * static_cast<double>(begin) / whole, more * static_cast<double>(count) / whole};
    }
};

template <typename Real, typename Sample, typename Pixel>
class Direct {
  public:
    Direct(Execution& run, const View<const Sample, 3>& data, const View<Pixel, 2>& image)
        : run_(run),
          data_(data),
          image_(image),
          order_(used_of(run)),
          rows_(rows_of(run.recipe.image)),
          tables_(run, data.shape[2], std::min(run.recipe.batch, static_cast<std::int64_t>(order_.size()))) {}

    void sum() {
        if (run_.recipe.views)
            add_each();
        else if (!run_.recipe.image.hears.empty())
            in_batches({0, 1}, [&](std::int64_t begin, Share share) { add_rows(begin, share); });
        else if (run_.recipe.image.lined())
            in_batches({0, 1}, [&](std::int64_t, Share share) { add_lines(share); });
        else
            in_batches({0, 1}, [&](std::int64_t, Share share) { add_points(share); });
    }

  private:
    static Numbers used_of(const Execution& run) {
        Numbers order;
        for (std::size_t i = 0; i < run.recipe.traces.size(); ++i) {
            if (run.used[i]) order.push_back(static_cast<std::int64_t>(i));
        }
        return order;
    }

    // `add` the traces in batches, in their order: the number of a batch's first, and its share of the work.
    template <typename Add>
    void in_batches(Share all, const Add& add) {
        const auto whole = static_cast<std::int64_t>(order_.size());
        for (std::int64_t begin = 0; begin < whole; begin += run_.recipe.batch) {
            const std::int64_t count = std::min(run_.recipe.batch, whole - begin);
            const Share share = all.part(begin, count, whole);
            Stopwatch watch;
            tables_.fill(run_, data_, order_.data() + begin, count);
            run_.totals.prepare_seconds += watch.lap();
            add(begin, share);
            run_.totals.sum_seconds += watch.lap();
            run_.progress.reach(share.done + share.more);
        }
    }

    void add_to(const Terms<Real>& terms, const Raster& raster, const View<Pixel, 2>& image, Share share) {
        const Tick tick = run_.progress.part(share.done, share.more);
        run_.totals.terms += add(run_.kernels, terms, raster, image, run_.threads, tick);
    }

    void add_lines(Share share) {
        const Image& lines = run_.recipe.image;
        const std::uint8_t* mask = lines.mask.empty() ? nullptr : lines.mask.data();
        const Raster raster{lines.first.data(), lines.step.data(), nullptr, mask,          lines.height,
                            lines.width,        lines.count,       nullptr, lines.heights, lines.spans.data()};
        add_to(tables_.terms(), raster, image_, share);
    }

    void add_points(Share share) {
        const Image& points = run_.recipe.image;
        const std::int64_t all = points.height * points.width;
        for (std::int64_t begin = 0; begin < all; begin += slab) {
            const std::int64_t count = std::min(slab, all - begin);
            const double* at = look_up(begin, begin + count);
            const std::uint8_t* mask = points.mask.empty() ? nullptr : points.mask.data() + begin;
            const Raster raster{nullptr, nullptr, at, mask, 1, count, points.count};
            View<Pixel, 2> part = image_;
            part.data += begin * part.stride[1];
            part.shape[1] = count;
            const Share own = share.part(begin, count, all);
            add_to(tables_.terms(), raster, part, own);
            run_.progress.reach(own.done + own.more);
        }
    }

    // Neighbouring rows that hear the same traces: a tile's at most.
    struct Rows {
        std::int64_t begin, end, first, last;
    };
    static std::vector<Rows> rows_of(const Image& image) {
        std::vector<Rows> out;
        for (std::int64_t row = 0; row < static_cast<std::int64_t>(image.hears.size()) / 2; ++row) {
            const std::int64_t *heard = image.hears.data() + 2 * row, first = heard[0], last = heard[1];
            Rows* const before = out.empty() ? nullptr : &out.back();
            if (before && before->first == first && before->last == last && row - before->begin < tile_rows)
                ++before->end;
            else
                out.push_back({row, row + 1, first, last});
        }
        return out;
    }

    // Rows with their own traces among those of a batch, which are those from `begin` on: some by one thread.
    void add_rows(std::int64_t begin, Share share) {
        const Image& image = run_.recipe.image;
        const Terms<Real>& batch = tables_.terms();
        const std::int64_t* const order = order_.data() + begin;
        std::vector<Rows> rows;  // with numbers in the batch
        for (const Rows& some : rows_) {
            const std::int64_t from = std::lower_bound(order, order + batch.n_trace, some.first) - order;
            const std::int64_t to = std::upper_bound(order, order + batch.n_trace, some.last) - order;
            if (from < to) rows.push_back({some.begin, some.end, from, to});
        }
        std::vector<std::int64_t> counted(rows.size());
        pysas::run(
            static_cast<std::int64_t>(rows.size()), run_.threads,
            [&](std::int64_t task) {
                const Rows& some = rows[static_cast<std::size_t>(task)];
                Terms<Real> own = batch;
                own.traces += some.first;
                own.table += some.first * own.trace_stride;
                own.n_trace = some.last - some.first;
                std::vector<double> places;
                Raster raster{nullptr, nullptr, nullptr, nullptr, some.end - some.begin, image.width, image.count};
                View<Pixel, 2> part = image_;
                if (image.lined()) {
                    raster.first = image.first.data() + 3 * some.begin;
                    raster.step = image.step.data() + 3 * some.begin;
                    part.data += some.begin * part.stride[0];
                } else {
                    const std::int64_t first = some.begin * image.width;
                    raster.width *= raster.height;
                    raster.height = 1;
                    raster.count = static_cast<int>(std::min<std::int64_t>(block, raster.width));
                    places.resize(static_cast<std::size_t>(3 * raster.width));
                    image.points(first, first + raster.width, places.data());
                    raster.points = places.data();
                    part.data += first * part.stride[1];
                }
                part.shape[0] = raster.height;
                part.shape[1] = raster.width;
                counted[static_cast<std::size_t>(task)] = add(run_.kernels, own, raster, part, 1, {});
            },
            run_.progress.part(share.done, share.more));
        for (const std::int64_t n : counted) run_.totals.terms += n;
    }

    const double* look_up(std::int64_t begin, std::int64_t end) {
        places_.resize(static_cast<std::size_t>(3 * (end - begin)));
        run_.recipe.image.points(begin, end, places_.data());
        return places_.data();
    }

    // Pixels with weights of their own, as many at a time as these have room for.
    void add_each() {
        const Image& points = run_.recipe.image;
        const std::int64_t all = points.height * points.width;
        const auto traces = static_cast<std::int64_t>(order_.size()), item = static_cast<std::int64_t>(sizeof(Real));
        const std::int64_t most =
            std::min(slab, std::max<std::int64_t>(1, own_bytes / (item * traces * block)) * block);
        const std::int64_t wanted =
            points.mask.empty() ? all : all - std::count(points.mask.begin(), points.mask.end(), std::uint8_t{0});
        Numbers pixels;
        for (std::int64_t next = 0, done = 0; done < wanted; done += static_cast<std::int64_t>(pixels.size())) {
            pixels.clear();
            for (; next < all && static_cast<std::int64_t>(pixels.size()) < most; ++next) {
                if (points.mask.empty() || points.mask[static_cast<std::size_t>(next)]) pixels.push_back(next);
            }
            add_weighed(pixels, Share{0, 1}.part(done, static_cast<std::int64_t>(pixels.size()), wanted));
        }
    }

    void add_weighed(const Numbers& pixels, Share share) {
        Stopwatch watch;
        const Recipe& recipe = run_.recipe;
        const auto count = static_cast<std::int64_t>(pixels.size()), traces = static_cast<std::int64_t>(order_.size());
        const auto across = static_cast<int>(std::min<std::int64_t>(block, count));
        const std::vector<double> places = places_of(pixels);
        // rows of whole blocks
        std::vector<Real> own(static_cast<std::size_t>((count + across - 1) / across * across * traces));
        const Viewers viewers{recipe.traces.data(), static_cast<std::int64_t>(recipe.traces.size()),
                              static_cast<int>(recipe.views->channels), recipe.model.beam};
        arcs(viewers, places.data(), count, order_.data(), traces, own.data(), nullptr, run_.threads,
             run_.progress.poll());
        run_.totals.sum_seconds += watch.lap();
        std::vector<Pixel> sums(pixels.size());
        const Raster raster{nullptr, nullptr, places.data(), nullptr, 1, count, across};
        in_batches(share, [&](std::int64_t begin, Share part) {
            Terms<Real> terms = tables_.terms();
            std::vector<Real> some(own.size() / order_.size() * static_cast<std::size_t>(terms.n_trace));
            for (std::size_t row = 0; row < own.size() / order_.size(); ++row)
                std::copy_n(own.data() + static_cast<std::int64_t>(row) * traces + begin, terms.n_trace,
                            some.data() + static_cast<std::int64_t>(row) * terms.n_trace);
            terms.weights = some.data();
            add_to(terms, raster, View<Pixel, 2>{sums.data(), {1, count}, {count, 1}}, part);
        });
        for (std::size_t i = 0; i < pixels.size(); ++i) image_(0, pixels[i]) += sums[i];
    }

    // Coordinates of pixels by their rising numbers.
    std::vector<double> places_of(const Numbers& pixels) {
        std::vector<double> out;
        for (std::size_t i = 0; i < pixels.size();) {
            const std::int64_t begin = pixels[i];
            const auto last = std::lower_bound(pixels.begin(), pixels.end(), begin + slab);
            const double* at = look_up(begin, last[-1] + 1);
            for (; pixels.begin() + static_cast<std::ptrdiff_t>(i) < last; ++i) {
                const double* own = at + 3 * (pixels[i] - begin);
                out.insert(out.end(), own, own + 3);
            }
        }
        return out;
    }

    Execution& run_;
    const View<const Sample, 3>& data_;
    const View<Pixel, 2>& image_;
    const Numbers order_;
    const std::vector<Rows> rows_;
    Tables<Real> tables_;
    std::vector<double> places_;
};

}  // namespace

template <typename Sample, typename Pixel>
Totals run(const Recipe& recipe, const View<const Sample, 3>& data, const std::uint8_t* used, double scale,
           const View<Pixel, 2>& image, int threads, const Kernels& kernels, Workspace& work, const Tick& tick) {
    Execution run{recipe, used, scale, threads, kernels, work, Progress(tick)};
    const auto count = static_cast<std::ptrdiff_t>(recipe.traces.size());
    if (std::all_of(used, used + count, [](std::uint8_t u) { return u == 0; })) return run.totals;
    if (recipe.narrow && recipe.forest) {
        sum_forest(run, data, image);
    } else if (recipe.narrow) {
        Direct<float, Sample, Pixel>(run, data, image).sum();
    } else if constexpr (sizeof(Sample) == 16) {
        if (recipe.forest) throw std::logic_error("trees are summed in float");
        Direct<double, Sample, Pixel>(run, data, image).sum();
    } else {
        throw std::logic_error("samples in float are not summed in double");
    }
    return run.totals;
}

using Single = std::complex<float>;
using Double = std::complex<double>;

template Totals run(const Recipe&, const View<const Single, 3>&, const std::uint8_t*, double, const View<Single, 2>&,
                    int, const Kernels&, Workspace&, const Tick&);
template Totals run(const Recipe&, const View<const Single, 3>&, const std::uint8_t*, double, const View<Double, 2>&,
                    int, const Kernels&, Workspace&, const Tick&);
template Totals run(const Recipe&, const View<const Double, 3>&, const std::uint8_t*, double, const View<Double, 2>&,
                    int, const Kernels&, Workspace&, const Tick&);

}  // namespace pysas
