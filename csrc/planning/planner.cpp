#include "planning/planner.hpp"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <limits>
#include <mutex>
#include <stdexcept>
#include <utility>
#include <vector>

#include "core/errors.hpp"
#include "core/polynomials.hpp"
#include "planning/bounds.hpp"
#include "planning/crossings.hpp"
#include "planning/words.hpp"

namespace pysas {
namespace {

constexpr double infinite = std::numeric_limits<double>::infinity();

constexpr double share_positions = 0.03;  // of a budget, for polynomials of positions in up to most_merges merges
// of a budget, for what records' ends ring with beyond the band of sub-images; it adds to these as squares do
constexpr double share_ends = 0.2;
// of a budget, for what a beam's taper leaves beyond the bands of sub-images across their rays, and along them
constexpr double share_fading = 0.15, share_ramp = 0.05;
constexpr double few_nodes = 4;  // of a sub-image: smaller images are summed directly
constexpr int most_planes = 6;   // that pixels off them are read from
// of a budget, for pixels read off the planes of their sub-images, where any are, and along lines that are not straight
constexpr double share_relief = 0.12, share_lines = 0.08;
// wavelengths: beyond it sub-images have more nodes than memory holds, and double loses 1e-5 anyway
constexpr double farthest = 1e9;
constexpr double most_speeds = 1.1;  // of sound, the largest to the least: nodes lie as the least asks
constexpr double tree_tol = 3e-5;    // below it float sub-images would round too much
constexpr double spare = 1.05;  // sampling beyond the band's own limit, which a short group's band overlaps a little
constexpr double finest = 8;    // nodes per sample, at most
constexpr double longer_groups = 1.0 / 8;  // of a layout's groups: shorter ones are not tried
constexpr std::size_t looked_at = 4;       // layouts
constexpr char longer[] = "a tree would take longer";

// width, rate and half length of the filters that a tree may use, cheapest first
struct Row {
    int width;
    double rate;
    int half;
};
constexpr Row rows[] = {{6, 1.2, 8},  {6, 1.3, 8},   {6, 1.33, 8}, {6, 1.4, 8},  {6, 1.45, 8}, {6, 1.5, 8},
                        {8, 1.4, 10}, {8, 1.45, 10}, {8, 1.5, 10}, {8, 1.6, 10}, {8, 1.75, 10}};
const std::vector<std::vector<int>> fans = {{},        {2},       {4},          {4, 2},      {4, 4},
                                            {4, 4, 2}, {4, 4, 4}, {4, 4, 4, 2}, {4, 4, 4, 4}};
// the same where a beam's taper weighs pings as they are merged
const std::vector<std::vector<int>> fans_of_pings = {{by_ping},    {by_ping, 2},    {by_ping, 4},
                                                     {2, by_ping}, {2, by_ping, 2}, {2, by_ping, 4},
                                                     {4, by_ping}, {4, by_ping, 2}, {4, by_ping, 4}};
constexpr double most_merges = 5;  // reading lines is another

// Designed once, when first asked for.
const TapDesign& taps_of(std::size_t row) {
    static std::once_flag flags[std::size(rows)];
    static TapDesign designs[std::size(rows)];
    std::call_once(flags[row], [row] { designs[row] = design_taps(rows[row].width, rows[row].rate, rows[row].half); });
    return designs[row];
}

// A layout, how pixels off planes are read, and what sums cost with them on one thread, before any tree is made; trees
// cost `cost`, or serve as much of all terms as that says.
struct Choice {
    Layout layout;
    OffPlanes relief;
    double cost, seconds;
    std::int64_t trees;
};

// Where trees could stand, the best choices first.
struct Candidate {
    std::vector<Tiled> image;
    int block;
    double near, share, height;
    OffPlanes relief;
    std::vector<Choice> choices;

    const Choice& best() const { return choices.front(); }
};

// Either what was looked for, or why there is none.
template <typename T>
struct Found {
    std::optional<T> value;
    std::string why, predicted;  // of what was given up, if it came so far
};

class Planner {
  public:
    Planner(std::shared_ptr<const Scene> scene, const Wish& wish)
        : scene_(std::move(scene)), s_(*scene_), wish_(wish), costs_(costs_of(wish.isa)) {}

    Plan direct() const {
        Plan out{wish_, scene_, choose(s_, wish_.budget, costs_), {}, 0, {}, 0, {}};
        out.block = out.settings.block;
        out.seconds = direct_seconds(out.settings);
        if (s_.survey.each)
            out.seconds += 1e-9 * arc_ns * static_cast<double>(s_.wanted) * static_cast<double>(s_.traces());
        return out;
    }

    // A tree for each of the longest groups, or why all is summed directly, as `plain` has it; an error where that is
    // forbidden. With "auto" planning the trees counts beside their sums.
    Found<Plan> trees(const Plan& plain, Poll& poll) const {
        const bool automatic = wish_.method == Method::automatic, fallback = stands_in();
        const double most = fallback && wish_.pay ? plain.seconds : infinite;
        const double planning = automatic ? judged_threads * plan_seconds : 0;
        if (most <= 3 * planning) {  // looking for a layout alone takes about as long
            const std::string no = impossible();
            return {{}, no.empty() ? longer : no, {}};
        }
        const auto found = candidate(plain.settings, most - planning);
        constexpr double alone = judged_threads * tree_seconds;
        if (found.value &&
            found.value->best().seconds + alone * static_cast<double>(found.value->best().trees) > most - planning)
            return {{}, longer, predicted(*found.value, plain.settings)};
        Found<Plan> made{{}, found.why, {}};
        if (found.value) made = best_trees(*found.value, !fallback, (most - planning) / alone, poll);
        if (made.value) {
            const auto count = static_cast<double>(made.value->trees->count);
            const bool pays = made.value->seconds + alone * count <= most;
            made.value->seconds += wish_.threads * tree_seconds * count;
            if (!pays) return {{}, longer, time(made.value->seconds)};
        }
        if (!fallback && !(made.value && made.value->share() >= 1)) {
            const std::string why = made.value ? number(100 * (1 - made.value->share()), 3) +
                                                     " % of the terms, pixels near "
                                                     "the track or across the ends of records or beams"
                                               : made.why;
            throw Error(Code::tolerance, "fallback=False, tol=" + number(wish_.tol, 6) +
                                             ": expected all terms to go through the tree, found: " + why);
        }
        return made;
    }

    // The cheapest layout that keeps tol, or why there is none within `most` s.
    Found<Candidate> candidate(const Settings& plain, double most) const {
        const double tol = wish_.budget, share = share_leaves * tol;
        const std::string no = impossible();
        if (!no.empty()) return {{}, no, {}};
        Candidate out{};
        out.share = share;
        if (s_.pixels.lined()) {
            const Delay delay = choose_delay(s_, share, costs_, true, share_rounding, true);
            if (delay.block == 0) return {{}, "pixels too coarse for float32 blocks", {}};
            out.block = even_split(s_.pixels.width, delay.block);
            out.near = delay.near;
        }
        double top = -infinite, bottom = infinite;
        for (std::size_t i = 0; i < s_.heard.size(); ++i) {
            if (!s_.heard[i]) continue;
            for (const double* sensor : {s_.survey.traces[i].tx, s_.survey.traces[i].rx}) {
                top = std::max(top, sensor[2]);
                bottom = std::min(bottom, sensor[2]);
            }
        }
        out.height = std::max(top - s_.low.z, s_.high.z - bottom);
        out.image = tiles_of(s_, out.block);
        const bool flat = std::all_of(out.image.begin(), out.image.end(), [](const Tiled& t) { return t.flat; });
        out.relief = {1, flat ? 0 : share_relief * tol, flat ? 0 : share_lines * tol};
        const Parallel* lines = nullptr;
        for (Tiled& tiled : out.image) {
            if (out.block > 0 && (tiled.flat || s_.pixels.heights.z))
                tiled.lines = parallel_of(s_, tiled.begin, tiled.end, out.block, share_rounding * share);
            if (tiled.lines && !lines) lines = &*tiled.lines;
        }
        const bool fades = s_.light.terms > 0;
        const double fading = fades ? share_fading * tol : 0, ramp = fades ? share_ramp * tol : 0;
        const double bright = s_.brightness();  // which what weights are wrong by is relative to
        const Kinds kinds =
            kinds_within(tol * (1 - share_positions) - share - out.relief.error - out.relief.lines - fading - ramp);
        if (kinds.empty()) return {{}, "no interpolation keeps tol", {}};
        const double direct = sum_seconds(s_, plain, costs_);
        const auto options = cheapest(s_, kinds, costs_, lines, spare, fading * bright, direct);
        if (options.empty()) return {{}, "pixels too near the track", {}};
        const double all = std::min_element(options.begin(), options.end(), [](const Option& a, const Option& b) {
                               return a.all < b.all;
                           })->all;
        if (all > most) return {{}, longer, "at least " + time(all)};
        // what groups of a length serve is known only once it is looked at
        const std::size_t looked = std::min(options.size(), flat ? looked_at : options.size());
        const int stacks = flat ? 1 : most_planes;
        out.choices.resize(looked * static_cast<std::size_t>(stacks));
        run(static_cast<std::int64_t>(out.choices.size()), wish_.threads,
            [&](std::int64_t task) {
                const Option& option = options[static_cast<std::size_t>(task / stacks)];
                const Layout layout = clear(option.layout, out);
                const OffPlanes relief{static_cast<int>(task % stacks) + 1, out.relief.error, out.relief.lines};
                const Served served = pysas::served(s_, out.image, layout, out.near, relief);
                const double seconds = option.all * served.share * served.planes + direct * (1 - served.share);
                const std::int64_t count = served.planes * served.groups;
                const double alone = judged_threads * tree_seconds * static_cast<double>(count);
                const double cost = by_time() ? seconds + alone : -served.share;
                out.choices[static_cast<std::size_t>(task)] = {layout, relief, cost, seconds, count};
            },
            {});
        std::stable_sort(out.choices.begin(), out.choices.end(),
                         [](const Choice& a, const Choice& b) { return a.cost < b.cost; });

        return {std::move(out), {}, {}};
    }

    // Predicted time of a candidate.
    std::string predicted(const Candidate& candidate, const Settings& plain) const {
        const double alone = static_cast<double>(candidate.best().trees * wish_.threads) * tree_seconds;
        return time(candidate.best().seconds + prepare_seconds(plain, s_.audible) + alone);
    }
    std::string time(double seconds) const { return number(seconds / wish_.threads, 2) + " s predicted"; }

  private:
    // Whether direct sums may stand in for trees.
    bool stands_in() const { return wish_.fallback || wish_.method == Method::automatic; }

    // Trees that take the least time, or else as much as trees can do.
    bool by_time() const { return wish_.pay && stands_in(); }

    double direct_seconds(const Settings& settings) const {
        return sum_seconds(s_, settings, costs_) + prepare_seconds(settings, s_.audible);
    }

    // Why no tree can keep tol, or nothing.
    std::string impossible() const {
        const Model& model = s_.survey.model;
        if (wish_.budget < tree_tol * (1 - 1e-9)) return "tol below " + number(tree_tol, 6);
        if (s_.farthest > farthest * model.c / model.fc) return "range beyond " + number(farthest, 6) + " wavelengths";
        const auto [slow, fast] = std::minmax_element(s_.survey.traces.begin(), s_.survey.traces.end(),
                                                      [](const Trace& a, const Trace& b) { return a.c < b.c; });
        if (fast->c > most_speeds * slow->c) return "speeds of sound that differ by more than a tenth";
        if (s_.audible == 0) return "the grid lies outside the recorded window";
        // reads at unrelated places between nodes are what bounds of sub-images' errors rest on
        if (length(s_.high - s_.low) < few_nodes * model.c / (4 * s_.survey.band * model.fs))
            return "the image is no larger than a few nodes of a sub-image";
        if (s_.survey.each) return "view-angle weights are every pixel's own: views change their order over the image";
        if (s_.light.terms > 0 && s_.survey.bent) return "view-angle weights beside a beam's taper";
        if (const auto& bent = s_.survey.bent) {
            const double node = model.c / (4 * s_.survey.band * model.fs);  // from one to the next on a ray, m, at most
            if (bent->beyond < block * node) return "views change their order around the image";
            if (!bent->holds(node, block)) return "view-angle weights change fast along the rays of sub-images";
        }
        return {};
    }

    // Numbers of parts with the cheapest taps each whose error, and that of records' ends, is at most `error`.
    Kinds kinds_within(double error) const {
        Kinds out;
        auto tried = fans;
        if (s_.light.terms > 0) tried.insert(tried.end(), fans_of_pings.begin(), fans_of_pings.end());
        for (const auto& parts : tried) {
            for (std::size_t row = 0; row < std::size(rows); ++row) {
                const double wrong = std::hypot(tree_error(taps_of(row), parts.size() + 1), share_ends * wish_.budget);
                if (wrong > error) continue;
                out.emplace_back(parts, taps_of(row));
                break;
            }
        }
        return out;
    }

    Layout clear(const Layout& layout, const Candidate& best) const {
        const double tol = wish_.budget;
        Layout with = layout;
        with.positions = share_positions * tol / most_merges;
        return cleared(s_, with, best.height, share_phase * best.share, share_positions * tol / most_merges,
                       share_ends * tol, share_ramp * tol * s_.brightness());
    }

    // About `most` trees of the best choice; or of those that serve most, which is known once they are made.
    Found<Plan> best_trees(const Candidate& candidate, bool whole, double most, Poll& poll) const {
        if (by_time()) return make_trees(candidate, candidate.best(), whole, most, poll);
        Found<Plan> best;
        for (const Choice& choice : candidate.choices) {
            auto made = make_trees(candidate, choice, whole, most, poll);
            const bool better = made.value && (!best.value || made.value->share() > best.value->share());
            if (better || (!best.value && best.why.empty())) best = std::move(made);
            if (best.value && best.value->share() >= 1) break;
        }
        return best;
    }

    // In shorter groups where its own reach too few pixels (`whole`: not all).
    Found<Plan> make_trees(const Candidate& candidate, const Choice& best, bool whole, double most, Poll& poll) const {
        Layout layout = best.layout;
        OffPlanes relief = best.relief;
        const auto made = [&](double least) {
            return make_forest(s_, candidate.image, clear(layout, candidate), candidate.near, relief, least, whole,
                               poll, wish_.threads);
        };
        // from more planes nearer pixels can be read
        const auto from_any = [&] {
            auto found = made(0);
            for (; !found && relief.error > 0 && relief.count < most_planes; found = made(0)) ++relief.count;
            if (!found) relief.count = best.relief.count;
            return found;
        };
        auto planned = from_any();
        // shorter groups see more as from a line, and nearer pixels from afar
        const double parts = std::max(longer_groups, static_cast<double>(best.trees) / std::max(most, 1e-9));
        while (!planned && layout.length > best.layout.length * parts) {
            layout.length *= 0.7;
            planned = from_any();
        }
        while (planned) {
            auto wider = std::make_shared<Scene>(s_);
            wider->first = planned->first;
            wider->last = planned->last;
            const Forest& forest = planned->forest;
            if (auto settings = choose_for_leaves(*wider, candidate.share, costs_, forest.phases, forest.per_samples))
                return {finish(std::move(wider), std::move(*planned), std::move(*settings), candidate), {}, {}};
            // near a record's end tables hold all frequencies that samples can: their intervals must be shorter for
            // that
            const double rate = static_cast<double>(forest.phases) / forest.per_samples;
            planned = rate < finest ? made(2 * rate) : std::nullopt;
        }
        return {{}, "no pixel far enough from all groups of pings, or too steep a relief", {}};
    }

    Plan finish(std::shared_ptr<const Scene> scene, PlannedForest planned, Settings settings,
                const Candidate& best) const {
        const double tol = wish_.budget;
        const double merges = static_cast<double>(planned.layout.fans.size()) + (planned.layout.crossing > 0 ? 1 : 0);
        const double ends = planned.layout.ends > 0 ? share_ends * tol : 0;
        settings.errors.emplace_back("sub-images",
                                     std::hypot(tree_error(planned.layout.taps, planned.layout.fans.size() + 1), ends));
        if (merges > 0) settings.errors.emplace_back("positions", share_positions * tol * merges / most_merges);
        if (best.relief.error > 0) settings.errors.emplace_back("relief", best.relief.error + best.relief.lines);
        if (s_.light.terms > 0) settings.errors.emplace_back("taper", (share_fading + share_ramp) * tol);
        planned.forest.slack = share_phase * best.share;
        settings.near = std::max(settings.near, best.near);  // tiles are as wide as its blocks
        Plan out{wish_, std::move(scene), std::move(settings), std::move(planned), best.block, {}, 0, {}};
        out.seconds = forest_seconds(*out.scene, *out.trees, out.settings, costs_);
        return out;
    }

    std::shared_ptr<const Scene> scene_;
    const Scene& s_;
    const Wish& wish_;
    const Costs& costs_;
};

// Errors that tables have no part in stay what they are.
Settings with_errors_of(Settings settings, const Settings& old) {
    for (const auto& [name, error] : old.errors) {
        if (name == "sub-images" || name == "positions" || name == "relief" || name == "taper")
            settings.errors.emplace_back(name, error);
    }
    return settings;
}

}  // namespace

double least_tol(const Scene& scene) {
    const Model& model = scene.survey.model;
    // of the carrier's phase, or of the place in a record whose band is wider than its carrier is high
    const double highest = std::max(model.fc, 2 * scene.survey.band * model.fs);
    return std::max(scene.survey.single ? 1e-5 : 1e-10, 1e-14 * scene.farthest * highest / model.c);
}

Plan plan(std::shared_ptr<const Scene> scene, const Wish& wish, const Tick& tick) {
    const double least = least_tol(*scene);
    if (!(wish.tol >= least * (1 - 1e-9) && wish.tol <= 0.1 && wish.budget > 0))
        throw Error(Code::tolerance, "tol=" + number(wish.tol, 6) + ": expected 0.1 to " + number(least, 3));
    const Planner planner(std::move(scene), wish);
    Plan plain = planner.direct();
    if (wish.method == Method::backprojection) return plain;
    Poll poll(tick);
    try {
        Found<Plan> trees = planner.trees(plain, poll);
        if (trees.value) {
            trees.value->other = "backprojection: " + planner.time(plain.seconds);
            return std::move(*trees.value);
        }
        if (wish.method == Method::ffbp) plain.why_direct = trees.why;
        plain.other = "ffbp: " + (trees.predicted.empty() ? trees.why : trees.predicted);
    } catch (const std::length_error&) {
        throw;
    } catch (const std::logic_error& error) {  // no fault of the scene: there is always the direct sum
        if (wish.method == Method::ffbp && !wish.fallback) throw;
        plain.why_direct = std::string("no trees: ") + error.what();
        plain.other = "ffbp: " + plain.why_direct;
    }
    return plain;
}

Plan directly(const Plan& plan, const std::string& why) {
    Plan out = Planner(plan.scene, plan.wish).direct();
    out.why_direct = why;
    return out;
}

Plan widely(const Plan& plan, double ends) {
    const Costs& costs = costs_of(plan.wish.isa);
    if (plan.trees) {
        const Forest& forest = plan.trees->forest;
        const double share = share_leaves * plan.wish.budget;
        auto settings = choose_for_leaves(*plan.scene, share, costs, forest.phases, forest.per_samples, ends);
        if (!settings) return widely(directly(plan, plan.why_direct), ends);
        Plan out = plan;
        settings->near = std::max(settings->near, plan.settings.near);
        out.settings = with_errors_of(std::move(*settings), plan.settings);
        return out;
    }
    Plan out = plan;
    out.settings = choose(*plan.scene, plan.wish.budget, costs, ends);
    out.block = out.settings.block;
    return out;
}

std::string alternative(const Plan& plan) {
    if (!plan.other.empty()) return plan.other;
    const Planner planner(plan.scene, plan.wish);
    try {
        const auto found = planner.candidate(plan.settings, infinite);
        return "ffbp: " + (found.value ? planner.predicted(*found.value, plan.settings) : found.why);
    } catch (const std::logic_error& error) {
        return std::string("ffbp: no trees: ") + error.what();
    }
}

}  // namespace pysas
