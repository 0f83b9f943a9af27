// Sums through trees, depth first: leaves of a batch of traces, their parents as soon as these are complete, and the
// image from the topmost sub-image. See docs/ffbp.md.

#include "core/trees.hpp"

#include <algorithm>
#include <stdexcept>

#include "core/columns.hpp"
#include "core/execution.hpp"
#include "core/factorised.hpp"
#include "core/polynomials.hpp"
#include "core/reader.hpp"
#include "core/room.hpp"

namespace pysas {
namespace {

using Store = Loan<float>;
using Mask = std::vector<std::uint8_t>;

constexpr int carrier_terms = 6;  // of the sine of sub-images' carriers

// Some of a level's images, in a store that begins with image `base`.
std::vector<SubImage> images_of(const Level& level, std::int64_t begin, std::int64_t end, std::int64_t base,
                                Store& store) {
    Numbers shape(level.shape.begin() + 5 * begin, level.shape.begin() + 5 * end);
    for (std::size_t i = 3; i < shape.size(); i += 5) shape[i] -= level.offset(base);
    return sub_images(level.place.data() + 7 * begin, shape.data(), end - begin, level.range.data(),
                      static_cast<std::int64_t>(level.range.size()), align(store.get()),
                      static_cast<std::int64_t>(store.size() - aligned));
}

bool any(const Mask& tiles) { return std::count(tiles.begin(), tiles.end(), 0) != std::ptrdiff_t(tiles.size()); }

template <typename Sample, typename Pixel>
class Walk {
  public:
    Walk(Execution& run, const View<const Sample, 3>& data, const View<Pixel, 2>& image)
        : run_(run), forest_(*run.recipe.forest), image_(run.recipe.image), data_(data), to_(image) {
        std::int64_t longest = 0;
        for (const Section& section : forest_.sections) {
            for (const GroupTree& tree : section.trees) {
                whole_ += static_cast<std::int64_t>(tree.traces.size());
                for (const TreeBatch& b : batches_of(tree, run.recipe.batch))
                    longest = std::max(longest, b.end - b.begin);
            }
        }
        tables_.emplace(run, data.shape[2], longest);
        rooms_ = rooms_of(forest_, run.recipe.batch);
        stores_.resize(rooms_.size());
        std::vector<double> sine, cosine;
        fit_trigonometry(carrier_terms, sine, cosine);
        tree_.taps = &forest_.taps;
        tree_.wave = 2 * run.recipe.model.fc / run.recipe.model.c;
        std::copy(sine.begin(), sine.end(), tree_.sine);
        std::copy(cosine.begin(), cosine.end(), tree_.cosine);
        tree_.nodes = run.recipe.nodes;
    }

    void sum() {
        for (const Section& section : forest_.sections) {
            for (const GroupTree& tree : section.trees) sum(section, tree);
            Stopwatch watch;
            read_waiting(section);
            run_.totals.sum_seconds += watch.lap();
        }
    }

  private:
    // Lines [top, bottom) of a section.
    struct Band {
        std::int64_t top, bottom;
    };

    void sum(const Section& section, const GroupTree& tree) {
        const bool beside = any(tree.direct);
        const Mask direct = beside && !image_.lined() ? pixels_of(tree.direct, section) : Mask();
        for (const TreeBatch& b : batches_of(tree, run_.recipe.batch)) {
            Stopwatch watch;
            tables_->fill(run_, data_, tree.traces.data() + b.begin, b.end - b.begin);
            run_.totals.prepare_seconds += watch.lap();
            const double part = tree.levels.empty() || !beside ? 1 : 0.5;
            if (!tree.levels.empty()) make_leaves(tree, b, share_of(b, 0, part));
            if (beside) add_direct(section, tree, direct, b, part);
            run_.totals.sum_seconds += watch.lap();
            run_.progress.reach(static_cast<double>(done_ + b.end) / static_cast<double>(whole_));
        }
        done_ += static_cast<std::int64_t>(tree.traces.size());
        if (tree.levels.empty()) return;
        Stopwatch watch;
        if (along(tree)) {
            waiting_.push_back({&tree, std::move(stores_[tree.levels.size() - 1])});
            if (waiting(tree) <= static_cast<std::int64_t>(waiting_.size())) read_waiting(section);
        } else {
            read_top(section, tree, images_of(tree.levels.back(), 0, 1, 0, stores_[tree.levels.size() - 1])[0]);
        }
        if (section.number == 0) run_.totals.terms += used_of(tree) * read_of(section, tree);
        run_.totals.sum_seconds += watch.lap();
        run_.progress.reach(static_cast<double>(done_) / static_cast<double>(whole_));
    }

    // A batch's tick: from `low` on `more` of its share of the work.
    Tick share_of(const TreeBatch& b, double low, double more) {
        const auto whole = static_cast<double>(whole_), count = static_cast<double>(b.end - b.begin);
        return run_.progress.part((static_cast<double>(done_ + b.begin) + low * count) / whole, more * count / whole);
    }

    std::int64_t used_of(const GroupTree& tree) const {
        return std::count_if(tree.traces.begin(), tree.traces.end(), [&](std::int64_t i) { return run_.used[i] != 0; });
    }
    static std::int64_t read_of(const Section& section, const GroupTree& tree) {
        std::int64_t pixels = 0;
        for (std::size_t i = 0; i < tree.read.size(); ++i) pixels += tree.read[i] ? section.pixels[i] : 0;
        return pixels;
    }

    // Leaves of a batch, and what they complete above them.
    void make_leaves(const GroupTree& tree, const TreeBatch& b, const Tick& tick) {
        const Level& level = tree.levels.front();
        const auto images = images_of(level, b.first, b.last, b.first, store(0));
        Numbers span(level.span.begin() + b.first, level.span.begin() + b.last + 1);
        for (auto& number : span) number -= b.begin;
        const bool alone = tree.levels.size() == 1, by_pixel = !along(tree);
        leaves(run_.kernels, tree_, tables_->terms(), span.data(), images.data(), b.last - b.first, forest_.slack,
               run_.recipe.light.terms > 0 && tree.lit < 0, alone && by_pixel, run_.threads, tick);
        if (!alone) merge_up(tree, 0, b.first, b.last, by_pixel);
    }

    // Merge complete sub-images [begin, end) of a level into their parents, and parents that this completes into
    // theirs. Of each level above the leaves there is room for one alone. `smooth`: the topmost along its rays too.
    void merge_up(const GroupTree& tree, std::size_t below, std::int64_t begin, std::int64_t end, bool smooth) {
        const std::vector<Level>& levels = tree.levels;
        const Level& above = levels[below + 1];
        for (const std::int64_t base = begin; begin < end;) {
            const auto at = std::upper_bound(above.span.begin(), above.span.end(), begin) - 1;
            const std::int64_t parent = at - above.span.begin(), stop = std::min(end, at[1]);
            const auto children = images_of(levels[below], begin, stop, base, stores_[below]);
            const auto image = images_of(above, parent, parent + 1, parent, store(below + 1));
            const bool last = stop == at[1], top = below + 2 == levels.size();
            const std::int64_t span[] = {0, stop - begin};
            std::vector<const Trace*> lit;
            for (std::int64_t c = begin; static_cast<int>(below) == tree.lit && c < stop; ++c)
                lit.push_back(&run_.recipe.traces[static_cast<std::size_t>(first_of(tree, below, c))]);
            merge(run_.kernels, tree_, children.data(), span, image.data(), 1, lit.empty() ? nullptr : lit.data(),
                  run_.recipe.light, begin > at[0], last, last && top && smooth, run_.threads, run_.progress.poll());
            if (last && !top) merge_up(tree, below + 1, parent, parent + 1, smooth);
            begin = stop;
        }
    }

    // Flat number of the first trace of a level's image.
    static std::int64_t first_of(const GroupTree& tree, std::size_t level, std::int64_t image) {
        for (std::size_t i = level + 1; i-- > 0;) image = tree.levels[i].span[static_cast<std::size_t>(image)];
        return tree.traces[static_cast<std::size_t>(image)];
    }

    // Prepared traces, at pixels of a section that are not read from trees.
    void add_direct(const Section& section, const GroupTree& tree, const Mask& pixels, const TreeBatch& b,
                    double part) {
        const Tick tick = share_of(b, 1 - part, part);
        const Terms<float>& terms = tables_->terms();
        const std::int64_t width = image_.width;
        if (image_.lined()) {
            Raster raster = lines_of(section, mask_of(section));
            raster.tiles = tree.direct.data();
            run_.totals.terms +=
                add(run_.kernels, terms, raster, lines(section.begin, section.end), run_.threads, tick);
            return;
        }
        for (const Band& band : bands_of(section, pixels)) {
            // alone those that are summed here: a block of points may hold others, which are read from the tree
            const std::uint8_t* wanted = pixels.data() + band.top * width;
            std::vector<double> points = points_of(section, band);
            Numbers some;
            for (std::int64_t i = 0; i < (band.bottom - band.top) * width; ++i) {
                if (!wanted[i]) continue;
                std::copy_n(points.data() + 3 * i, 3, points.data() + 3 * some.size());
                some.push_back(i);
            }
            const auto count = static_cast<std::int64_t>(some.size());
            std::vector<Pixel> sums(some.size());
            const int across = static_cast<int>(std::min<std::int64_t>(image_.count, count));
            const Raster raster{nullptr, nullptr, points.data(), nullptr, 1, count, across};
            const View<Pixel, 2> row{sums.data(), {1, count}, {count, 1}};
            run_.totals.terms += add(run_.kernels, terms, raster, row, run_.threads, tick);
            const View<Pixel, 2> to = lines(section.begin + band.top, section.begin + band.bottom);
            for (std::size_t k = 0; k < some.size(); ++k) to(some[k] / width, some[k] % width) += sums[k];
        }
    }

    // Sub-images that wait, at lines of pixels that are read from them, then at what is read pixel by pixel.
    void read_waiting(const Section& section) {
        if (waiting_.empty()) return;
        const Raster raster = lines_of(section, mask_of(section));
        const View<Pixel, 2> to = lines(section.begin, section.end);
        const Tick poll = run_.progress.poll();
        std::vector<Source> sources;
        for (Waiting& one : waiting_)
            sources.push_back({images_of(one.tree->levels.back(), 0, 1, 0, one.store)[0], one.tree->read.data(),
                               stack_of(section, *one.tree)});
        const auto along = [&](Reads how, int stretch) {
            read_along(run_.kernels, tree_, sources, raster, how, stretch, section.turn, to, run_.threads, poll);
        };
        along(by_columns, section.stretch);
        along(by_lines, image_.count);
        for (std::size_t i = 0; i < waiting_.size(); ++i) {
            const GroupTree& tree = *waiting_[i].tree;
            if (std::find(tree.read.begin(), tree.read.end(), by_pixels) != tree.read.end()) {
                smooth_along(run_.kernels, tree_, &sources[i].image, 1, run_.threads, poll);
                read_top(section, tree, sources[i].image);
            }
        }
        waiting_.clear();
    }

    // The topmost sub-image, at pixels that are read from it one by one.
    void read_top(const Section& section, const GroupTree& tree, const SubImage& from) {
        const std::uint8_t* mask = mask_of(section);
        const Tick poll = run_.progress.poll();
        Mask single(tree.read.size());
        for (std::size_t i = 0; i < single.size(); ++i) single[i] = tree.read[i] == by_pixels;
        if (section.flat && image_.straight()) {
            read(run_.kernels, tree_, from, lines_of(section, mask), nullptr, single.data(),
                 lines(section.begin, section.end), run_.threads, poll);
            return;
        }
        const Stack stack = stack_of(section, tree);
        const std::int64_t across = (image_.width + image_.count - 1) / image_.count;
        for (const Band& band : bands_of(section, pixels_of(single, section))) {
            const auto points = points_of(section, band);
            const Raster raster{nullptr,
                                nullptr,
                                points.data(),
                                mask ? mask + band.top * image_.width : nullptr,
                                band.bottom - band.top,
                                image_.width,
                                image_.count};
            read(run_.kernels, tree_, from, raster, &stack, single.data() + band.top / tile_rows * across,
                 lines(section.begin + band.top, section.begin + band.bottom), run_.threads, poll);
        }
    }

    Stack stack_of(const Section& section, const GroupTree& tree) const {
        Stack stack{};
        std::copy_n(tree.axis, 3, stack.axis);
        std::copy(section.heights.begin(), section.heights.end(), stack.height);
        stack.count = static_cast<int>(section.heights.size());
        stack.number = section.number;
        stack.own = tree.own < 0 ? nullptr : &run_.recipe.traces[static_cast<std::size_t>(tree.own)];
        return stack;
    }

    // Room for what a tree has of a level at a time.
    Store& store(std::size_t level) {
        Store& found = stores_[level];
        if (found.size() == 0) found = Store(run_.work.of<float>(), static_cast<std::size_t>(rooms_[level]) + aligned);
        return found;
    }

    const std::uint8_t* mask_of(const Section& section) const {
        return image_.mask.empty() ? nullptr : image_.mask.data() + section.begin * image_.width;
    }

    // The pixels wanted of some tiles of a section, (line, pixel).
    Mask pixels_of(const Mask& tiles, const Section& section) const {
        const std::int64_t width = image_.width, across = (width + image_.count - 1) / image_.count;
        Mask out(static_cast<std::size_t>((section.end - section.begin) * width));
        for (std::int64_t line = section.begin; line < section.end; ++line) {
            const std::uint8_t* of = tiles.data() + (line - section.begin) / tile_rows * across;
            const std::uint8_t* wanted = image_.mask.empty() ? nullptr : image_.mask.data() + line * width;
            std::uint8_t* row = out.data() + (line - section.begin) * width;
            for (std::int64_t tile = 0; tile < across; ++tile) {
                if (!of[tile]) continue;
                const std::int64_t left = tile * image_.count, right = std::min(left + image_.count, width);
                if (wanted)
                    std::copy(wanted + left, wanted + right, row + left);
                else
                    std::fill(row + left, row + right, std::uint8_t{1});
            }
        }
        return out;
    }

    Raster lines_of(const Section& section, const std::uint8_t* mask) const {
        if (image_.heights.z && section.begin != 0) throw std::logic_error("a relief is one section");
        return {image_.first.data() + 3 * section.begin,
                image_.step.data() + 3 * section.begin,
                nullptr,
                mask,
                section.end - section.begin,
                image_.width,
                image_.count,
                nullptr,
                image_.heights.from(section.begin, 0),
                image_.spans.data()};
    }

    View<Pixel, 2> lines(std::int64_t begin, std::int64_t end) const {
        View<Pixel, 2> out = to_;
        out.data += begin * to_.stride[0];
        out.shape[0] = end - begin;
        return out;
    }

    // Rows of tiles that have any of the pixels.
    std::vector<Band> bands_of(const Section& section, const Mask& pixels) const {
        std::vector<Band> out;
        const std::int64_t height = section.end - section.begin, width = image_.width;
        for (std::int64_t top = 0; top < height; top += tile_rows) {
            const std::int64_t bottom = std::min<std::int64_t>(top + tile_rows, height);
            const auto first = pixels.begin() + top * width, last = pixels.begin() + bottom * width;
            if (std::find_if(first, last, [](std::uint8_t m) { return m != 0; }) != last) out.push_back({top, bottom});
        }
        return out;
    }

    // Coordinates (line, pixel, 3) of a band's pixels.
    std::vector<double> points_of(const Section& section, const Band& band) const {
        const std::int64_t first = section.begin + band.top, last = section.begin + band.bottom, width = image_.width;
        std::vector<double> out(static_cast<std::size_t>(3 * (last - first) * width));
        if (!image_.straight()) {
            image_.points(first * width, last * width, out.data());
            return out;
        }
        double* to = out.data();
        for (std::int64_t line = first; line < last; ++line) {
            const double *from = image_.first.data() + 3 * line, *step = image_.step.data() + 3 * line;
            for (std::int64_t k = 0; k < width; ++k) {
                for (int axis = 0; axis < 3; ++axis) *to++ = from[axis] + static_cast<double>(k) * step[axis];
            }
        }
        return out;
    }

    Execution& run_;
    const Forest& forest_;
    const Image& image_;
    const View<const Sample, 3>& data_;
    const View<Pixel, 2>& to_;
    std::int64_t whole_ = 0, done_ = 0;  // traces of trees
    std::optional<Tables<float>> tables_;
    Tree tree_{};
    Numbers rooms_;  // floats of each level's store
    std::vector<Store> stores_;

    // Topmost sub-images that are read together: an image is added to as often.
    struct Waiting {
        const GroupTree* tree;
        Store store;
    };
    std::vector<Waiting> waiting_;
};

}  // namespace

bool along(const GroupTree& tree) {
    return std::any_of(tree.read.begin(), tree.read.end(), [](std::uint8_t how) { return how > by_pixels; });
}

std::int64_t waiting(const GroupTree& tree) {
    constexpr std::int64_t most = 8, floats = std::int64_t{1} << 24;
    return std::clamp<std::int64_t>(floats / std::max<std::int64_t>(tree.levels.back().room(0, 1), 1), 1, most);
}

std::vector<TreeBatch> batches_of(const GroupTree& tree, std::int64_t most) {
    std::vector<TreeBatch> out;
    if (tree.levels.empty()) {
        const auto count = static_cast<std::int64_t>(tree.traces.size());
        for (std::int64_t i = 0; i < count; i += most) out.push_back({i, std::min(i + most, count), 0, 0});
        return out;
    }
    const Numbers& span = tree.levels[0].span;
    // the last number at which `ends` are at most `limit`
    const auto fitting = [](const Numbers& ends, std::int64_t limit) -> std::int64_t {
        return std::upper_bound(ends.begin(), ends.end(), limit) - ends.begin() - 1;
    };
    for (std::int64_t leaf = 0; leaf < tree.levels[0].count();) {
        const std::int64_t begin = span[static_cast<std::size_t>(leaf)];
        std::int64_t last = std::max(leaf + 1, fitting(span, begin + most));
        if (tree.levels.size() > 1) {
            const Numbers& parents = tree.levels[1].span;
            const std::int64_t whole = parents[static_cast<std::size_t>(fitting(parents, last))];
            if (whole > leaf) last = whole;
        }
        out.push_back({begin, span[static_cast<std::size_t>(last)], leaf, last});
        leaf = last;
    }
    return out;
}

Numbers rooms_of(const Forest& forest, std::int64_t batch) {
    Numbers most;
    for (const Section& section : forest.sections) {
        for (const GroupTree& tree : section.trees) {
            most.resize(std::max(most.size(), tree.levels.size()));
            for (std::size_t i = 0; i < tree.levels.size(); ++i) {
                const Level& level = tree.levels[i];
                if (i == 0) {
                    for (const TreeBatch& b : batches_of(tree, batch))
                        most[i] = std::max(most[i], level.room(b.first, b.last));
                    continue;
                }
                for (std::int64_t k = 0; k < level.count(); ++k) most[i] = std::max(most[i], level.room(k, k + 1));
            }
        }
    }
    return most;
}

std::int64_t stores_of(const Forest& forest, std::int64_t batch) {
    const Numbers most = rooms_of(forest, batch);
    std::int64_t sum = 0, kept = 0;
    for (const std::int64_t floats : most) sum += floats;
    for (const Section& section : forest.sections) {
        for (const GroupTree& tree : section.trees) {
            if (along(tree)) kept = std::max(kept, (waiting(tree) - 1) * most[tree.levels.size() - 1]);
        }
    }
    return sum + kept;
}

template <typename Sample, typename Pixel>
void sum_forest(Execution& run, const View<const Sample, 3>& data, const View<Pixel, 2>& image) {
    Walk<Sample, Pixel>(run, data, image).sum();
}

using Single = std::complex<float>;
using Double = std::complex<double>;

template void sum_forest(Execution&, const View<const Single, 3>&, const View<Single, 2>&);
template void sum_forest(Execution&, const View<const Single, 3>&, const View<Double, 2>&);
template void sum_forest(Execution&, const View<const Double, 3>&, const View<Double, 2>&);

}  // namespace pysas
