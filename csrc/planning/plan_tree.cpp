// Fast factorised back-projection for a plan: whether and how a tree is used, and its execution, depth first.

#include <algorithm>
#include <cmath>

#include "core/errors.hpp"
#include "core/factorised.hpp"
#include "core/polynomials.hpp"
#include "planning/layouts.hpp"
#include "planning/plan.hpp"

namespace pysas {
namespace {

using Store = std::vector<float>;

std::vector<SubImage> images_of(const Level& level, std::int64_t begin, std::int64_t end, std::int64_t base,
                                Store& store) {
    // numbers of a store that begins with image `base`
    std::vector<std::int64_t> shape(level.shape.begin() + 5 * begin, level.shape.begin() + 5 * end);
    for (std::size_t i = 3; i < shape.size(); i += 5) shape[i] -= level.offset(base);
    return sub_images(level.place.data() + 7 * begin, shape.data(), end - begin, level.range.data(),
                      static_cast<std::int64_t>(level.range.size()), store.data(),
                      static_cast<std::int64_t>(store.size()));
}

// Sub-images of a tree: a batch of leaves, and one of each level above them.
struct Merger {
    const Kernels& kernels;
    const Tree& tree;
    const std::vector<Level>& levels;
    std::vector<Store>& stores;
    int threads;
    const Tick& tick;

    Store& room(std::size_t level, std::int64_t begin, std::int64_t end) {
        Store& store = stores[level];
        const auto size = static_cast<std::size_t>(levels[level].room(begin, end));
        if (store.size() < size) store.resize(size);
        return store;
    }

    // Merge complete sub-images [begin, end) of a level into their parents, and parents that this completes into
    // theirs.
    void merge_up(std::size_t below, std::int64_t begin, std::int64_t end) {
        const Level& above = levels[below + 1];
        for (const std::int64_t base = begin; begin < end;) {
            const auto at = std::upper_bound(above.span.begin(), above.span.end(), begin) - 1;
            const std::int64_t parent = at - above.span.begin(), stop = std::min(end, at[1]);
            const auto children = images_of(levels[below], begin, stop, base, stores[below]);
            const auto image = images_of(above, parent, parent + 1, parent, room(below + 1, parent, parent + 1));
            const bool last = stop == at[1], top = below + 2 == levels.size();
            const std::int64_t span[] = {0, stop - begin};
            merge(kernels, tree, children.data(), span, image.data(), 1, begin > at[0], last, last && top, threads,
                  tick);
            if (last && !top) merge_up(below + 1, parent, parent + 1);
            begin = stop;
        }
    }
};

// Floats of the stores that a forest needs at a time.
std::int64_t stores_of(const Forest& forest, std::int64_t batch) {
    std::vector<std::int64_t> most;
    for (const GroupTree& tree : forest.trees) {
        most.resize(std::max(most.size(), tree.levels.size()));
        for (std::size_t i = 0; i < tree.levels.size(); ++i) {
            const Level& level = tree.levels[i];
            if (i == 0) {
                for (const TreeBatch& b : batches_of(tree, batch))
                    most[i] = std::max(most[i], level.room(b.first, b.last));
            } else {
                for (std::int64_t k = 0; k < level.count(); ++k) most[i] = std::max(most[i], level.room(k, k + 1));
            }
        }
    }
    std::int64_t sum = 0;
    for (const std::int64_t floats : most) sum += floats;
    return sum;
}

}  // namespace

// Makes trees where they keep `tol`; otherwise the plan is left as it was, for the direct sum.
void Plan::factorise(double tol) {
    if (!narrow_ || !points_.empty() || traces_.empty() || tol < tree_tol * (1 - 1e-9)) return;
    // tiles count by the spheres about them, which reach nearer than their pixels
    if (!choose_delay(share_leaves * tol, tree_shares, 0.9 * nearest_)) return;
    const Raster raster = lines();
    const auto section = section_of(raster);
    if (!section) return;
    std::vector<std::int64_t> pings(order_);
    for (auto& trace : pings) trace /= channels_;
    const double delay = kind_ == Kind::moving ? (nearest_ + farthest_) / model_.c : 0.0;
    const auto count = static_cast<std::int64_t>(traces_.size());
    const Geometry geometry{traces_.data(), pings.data(), count, model_, band_, delay};
    auto layout = choose_layout(geometry, raster, tol, kernels_->name);
    if (!layout) return;
    // a tree of more nodes than the sum has terms is no gain
    const double terms = static_cast<double>(count) * static_cast<double>(height_) * static_cast<double>(width_);
    const auto most = static_cast<std::int64_t>(2 * std::min(0x1p22 + terms, 0x1p40));
    // near a record's ends tables hold all frequencies up to fs/2: the second rate is for where the first is too low
    // for that
    for (const double rate : {1.0, 1.5}) {
        std::optional<Forest> forest;
        for (Layout cut = *layout; !forest && cut.length > layout->length / 8; cut.length *= 0.7) {
            cut = cleared(geometry, raster, cut, tol);  // shorter groups see nearer pixels from afar
            forest = make_forest(geometry, {*section}, cut, model_.near, rate, most);
        }
        if (!forest) return;
        if (use(*forest, tol)) {
            model_.run = longest_run(share_leaves * tol);
            forest_ = std::move(forest);
            return;
        }
    }
}

// Choose the filter of a forest's tables; false, and the plan as it was, where none keeps `tol` or sub-images are
// larger than some images.
bool Plan::use(const Forest& forest, double tol) {
    const auto asked = asked_, until = until_;
    for (std::size_t i = 0; i < traces_.size(); ++i) {
        asked_[i] = std::min(asked[i], forest.first[i]);
        until_[i] = std::max(until[i], forest.last[i]);
    }
    keep();
    const double pixels = static_cast<double>(height_) * static_cast<double>(width_);
    if (choose_filter(share_leaves * tol, tree_shares, {{forest.phases, forest.per_samples}}) &&
        static_cast<double>(stores_of(forest, batch(sizeof(float)))) < 0x1p24 + 8 * pixels)
        return true;
    asked_ = asked;
    until_ = until;
    filter_ = {};
    keep();
    return false;
}

template <typename Sample, typename Pixel>
void Plan::sum_forest(const View<const Sample, 3>& from, const View<Pixel, 2>& to, double scale) const {
    const Forest& forest = *forest_;
    Tree tree{&forest.taps.taps, 2 * model_.fc / model_.c, {}, {}, nodes_};
    std::vector<double> sine, cosine;
    fit_trigonometry(6, sine, cosine);
    std::copy(sine.begin(), sine.end(), tree.sine);
    std::copy(cosine.begin(), cosine.end(), tree.cosine);
    const double slack = share_drift * share_leaves * tol_;
    const std::int64_t most = batch(sizeof(float));
    std::int64_t longest = 0, whole = 0, done = 0;
    double reached = 0;  // a step's parts count their own share from 0
    for (const GroupTree& group : forest.trees) {
        whole += static_cast<std::int64_t>(group.traces.size());
        for (const TreeBatch& b : batches_of(group, most)) longest = std::max(longest, b.end - b.begin);
    }
    Terms<float> terms = this->terms<float>();
    std::vector<float> table(static_cast<std::size_t>(longest * terms.trace_stride));
    std::vector<Store> stores;
    const Raster raster = lines();
    const Tiling tiling(raster);
    for (const GroupTree& group : forest.trees) {
        std::vector<Trace> traces;
        std::vector<std::int64_t> order, start;
        std::vector<std::complex<double>> weights;
        for (const std::int64_t number : group.traces) {
            const auto i = static_cast<std::size_t>(number);
            traces.push_back(traces_[i]);
            order.push_back(order_[i]);
            start.push_back(start_[i]);
            if (!weights_.empty()) weights.push_back(weights_[i]);
        }
        std::vector<std::uint8_t> pixels;  // those summed directly
        Raster direct = raster;
        if (std::count(group.direct.begin(), group.direct.end(), 0) != tiling.count()) {
            pixels.assign(static_cast<std::size_t>(height_ * width_), 0);
            for (std::int64_t number = 0; number < tiling.count(); ++number) {
                if (!group.direct[static_cast<std::size_t>(number)]) continue;
                const Tiling::Tile tile = tiling.at(number);
                for (std::int64_t line = tile.top; line < tile.bottom; ++line) {
                    for (std::int64_t k = line * width_ + tile.left; k < line * width_ + tile.right; ++k)
                        pixels[static_cast<std::size_t>(k)] = !raster.mask || raster.mask[k];
                }
            }
            direct.mask = pixels.data();
        }
        stores.resize(std::max(stores.size(), group.levels.size()));
        for (const TreeBatch& b : batches_of(group, most)) {
            const std::int64_t count = b.end - b.begin;
            const auto between = [&](double low, double high) -> Tick {
                return [&, low, high, count](double share) {
                    const double now =
                        static_cast<double>(done) + (low + share * (high - low)) * static_cast<double>(count);
                    reached = std::max(reached, now / static_cast<double>(whole));
                    return !progress_ || progress_(reached);
                };
            };
            const Batch<Sample> batch{from,
                                      order.data() + b.begin,
                                      start.data() + b.begin,
                                      weights.empty() ? nullptr : weights.data() + b.begin,
                                      count,
                                      length_,
                                      scale};
            prepare(*kernels_, batch, filter_, table.data(), terms.plane_stride, threads_, {});
            terms.table = table.data();
            terms.traces = traces.data() + b.begin;
            terms.n_trace = count;
            if (!group.levels.empty()) {
                const Tick half = between(0.5, 0.5);
                Merger merger{*kernels_, tree, group.levels, stores, threads_, half};
                const Level& level = group.levels.front();
                const auto leaf = images_of(level, b.first, b.last, b.first, merger.room(0, b.first, b.last));
                std::vector<std::int64_t> span(level.span.begin() + b.first, level.span.begin() + b.last + 1);
                for (auto& number : span) number -= b.begin;
                leaves(*kernels_, tree, terms, span.data(), leaf.data(), b.last - b.first, slack,
                       group.levels.size() == 1, threads_, between(0, 0.5));
                if (group.levels.size() > 1) merger.merge_up(0, b.first, b.last);
            }
            if (!pixels.empty()) add(*kernels_, terms, direct, to, threads_, between(0.5, 1));
            // steps too short to tick by themselves still add up
            if (!between(1, 1)(1)) throw Error(Code::cancelled, "stopped by the caller");
            done += count;
        }
        if (group.levels.empty()) continue;
        const Level& top = group.levels.back();
        const auto image = images_of(top, 0, 1, 0, stores[group.levels.size() - 1]);
        read(*kernels_, tree, image[0], raster, nullptr, group.read.data(), to, threads_,
             [&](double) { return !progress_ || progress_(static_cast<double>(done) / static_cast<double>(whole)); });
    }
}

template void Plan::sum_forest(const View<const std::complex<float>, 3>&, const View<std::complex<float>, 2>&,
                               double) const;
template void Plan::sum_forest(const View<const std::complex<float>, 3>&, const View<std::complex<double>, 2>&,
                               double) const;
template void Plan::sum_forest(const View<const std::complex<double>, 3>&, const View<std::complex<double>, 2>&,
                               double) const;

}  // namespace pysas
