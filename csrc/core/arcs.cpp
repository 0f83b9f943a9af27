#include "core/arcs.hpp"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "core/light.hpp"

namespace pysas {
namespace {

constexpr double turn = 6.283185307179586;
constexpr double coincident = 1e-9;          // rad: views nearer than this are one
constexpr double opening = 4 * (1 + 1e-6);   // a gap this many times as wide as those beside it is nobody's
constexpr double doubt = 1.1;                // a gap this near to that may open from one place to the next
constexpr double nowhere = 1e-12;            // of a bisector: no direction
constexpr std::int64_t points_at_once = 64;  // of a task
constexpr std::int64_t moves = 16;           // a view on average, beyond which views are sorted anew

std::uint64_t mixed(std::uint64_t x) {  // SplitMix64's
    x += 0x9e3779b97f4a7c15;
    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9;
    x = (x ^ (x >> 27)) * 0x94d049bb133111eb;
    return x ^ (x >> 31);
}

// Room for one point's views, used again from point to point.
class Circle {
  public:
    Circle(const Viewers& viewers, const Light& light)
        : viewers_(viewers),
          light_(light),
          angle_(static_cast<std::size_t>(viewers.count)),
          seen_(static_cast<std::size_t>(viewers.count)),
          lit_(static_cast<std::size_t>(viewers.count)),
          value_(static_cast<std::size_t>(viewers.count)) {}

    // Arcs of all traces at a point, of mean 1 over those that light it.
    const std::vector<double>& at(const double* point) {
        look(point);
        sort();
        group();
        share();
        const auto n = static_cast<std::size_t>(viewers_.count);
        std::fill(value_.begin(), value_.end(), 0.0);
        for (std::size_t k = 0; k < order_.size(); ++k) {
            const std::size_t g = group_[k];
            value_[order_[k]] = arc_[g] / static_cast<double>(size_[g]);
        }
        double sum = 0;
        std::int64_t counted = 0;
        for (const bool all : {false, true}) {
            for (std::size_t i = 0; i < n; ++i) {
                if (!seen_[i] || (!all && !lit_[i])) continue;
                sum += value_[i];
                ++counted;
            }
            if (counted > 0) break;
        }
        if (counted > 0) {
            const double mean = std::max(sum / static_cast<double>(counted), 1e-300);
            for (double& v : value_) v /= mean;
        }
        return value_;
    }

    std::uint64_t pattern() const {
        if (order_.size() != angle_.size() || doubtful_) return 0;
        // around the circle from the first trace's group on; within a group traces have no order
        const std::size_t n = size_.size();
        std::vector<std::uint64_t> of(n);
        std::size_t first = 0;
        for (std::size_t k = 0; k < order_.size(); ++k) {
            of[group_[k]] += mixed(order_[k]);
            if (order_[k] == 0) first = group_[k];
        }
        std::uint64_t hash = n;
        for (std::size_t i = 0; i < n; ++i) {
            const std::size_t g = (first + i) % n;
            hash = mixed(hash ^ (of[g] + (open_[g] ? 1 : 0)));
        }
        return hash | 1;
    }

  private:
    void look(const double* point) {
        bool same = !order_.empty();
        for (std::size_t i = 0; i < angle_.size(); ++i) {
            const Trace& t = viewers_.traces[i];
            double there[3], back[3];
            for (int k = 0; k < 3; ++k) {
                there[k] = t.tx[k] - point[k];
                back[k] = t.rx[k] - point[k];
            }
            const double away = std::sqrt(there[0] * there[0] + there[1] * there[1] + there[2] * there[2]);
            const double returned = std::sqrt(back[0] * back[0] + back[1] * back[1] + back[2] * back[2]);
            const double x = there[0] * returned + back[0] * away, y = there[1] * returned + back[1] * away;
            const double least = nowhere * away * returned;
            const bool seen = x * x + y * y > least * least;
            same = same && seen == (seen_[i] != 0);
            seen_[i] = seen;
            const double a = std::atan2(y, x);
            angle_[i] = a < 0 ? a + turn : a;
            const double out[3] = {-there[0], -there[1], -there[2]};
            lit_[i] = lights(light_, t, out);
        }
        if (same) return;
        order_.clear();
        for (std::size_t i = 0; i < angle_.size(); ++i) {
            if (seen_[i]) order_.push_back(i);
        }
        sorted_ = false;
    }

    // By angle. Neighbouring points see nearly one order, but for where it begins.
    void sort() {
        if (sorted_)
            std::rotate(order_.begin(),
                        std::min_element(order_.begin(), order_.end(),
                                         [this](std::size_t a, std::size_t b) { return angle_[a] < angle_[b]; }),
                        order_.end());
        auto left = moves * static_cast<std::int64_t>(order_.size());
        for (std::size_t k = 1; sorted_ && k < order_.size(); ++k) {
            const std::size_t number = order_[k];
            const double a = angle_[number];
            std::size_t to = k;
            for (; to > 0 && angle_[order_[to - 1]] > a; --to) order_[to] = order_[to - 1];
            order_[to] = number;
            left -= static_cast<std::int64_t>(k - to);
            sorted_ = left >= 0;
        }
        if (!sorted_)
            std::sort(order_.begin(), order_.end(), [this](std::size_t a, std::size_t b) {
                return std::make_pair(angle_[a], a) < std::make_pair(angle_[b], b);
            });
        sorted_ = true;
    }

    // Coincident views share an arc: the gaps that follow groups around the circle.
    void group() {
        const std::size_t n = order_.size();
        gap_.clear();
        size_.clear();
        group_.resize(n);
        for (std::size_t k = 0; k < n; ++k) {
            const double next = k + 1 < n ? angle_[order_[k + 1]] : angle_[order_[0]] + turn;
            const double gap = next - angle_[order_[k]];
            group_[k] = gap_.size();
            if (gap > coincident) gap_.push_back(gap);
        }
        if (n > 0 && gap_.empty()) gap_.push_back(turn);
        size_.assign(gap_.size(), 0);
        for (std::size_t k = 0; k < n; ++k) {
            if (group_[k] == gap_.size()) group_[k] = 0;  // behind the last gap: one with the first
            ++size_[group_[k]];
        }
    }

    // The arc of each group from the gaps.
    void share() {
        const std::size_t n = gap_.size();
        doubtful_ = false;
        open_.assign(n, 0);
        arc_.assign(n, 1.0);
        if (n < 3) return;
        const std::size_t steps = std::min(2 * static_cast<std::size_t>(viewers_.channels) + 2, (n - 1) / 2);
        // the widest of `steps` gaps from each on, by windows of twice the length again and again
        widest_.resize(n + steps);
        for (std::size_t i = 0; i < n + steps; ++i) widest_[i] = gap_[i % n];
        std::size_t length = 1;
        while (length < steps) {
            const std::size_t more = std::min(length, steps - length);
            for (std::size_t i = 0; i + more < widest_.size(); ++i)
                widest_[i] = std::max(widest_[i], widest_[i + more]);
            length += more;
        }
        std::vector<double>& half = half_;
        half.resize(n);
        for (std::size_t i = 0; i < n; ++i) {
            const double before = widest_[i >= steps ? i - steps : i + n - steps];
            const double after = widest_[i + 1 < n ? i + 1 : 0];
            const double limit = opening * std::min(before, after);
            open_[i] = gap_[i] > limit;
            doubtful_ = doubtful_ || (gap_[i] > limit / doubt && gap_[i] < limit * doubt);
            half[i] = open_[i] ? 0.0 : gap_[i] / 2;
        }
        alone_.clear();
        for (std::size_t i = 0; i < n; ++i) {
            const std::size_t previous = i > 0 ? i - 1 : n - 1;
            arc_[i] = (half[i] + half[previous]) * (open_[i] || open_[previous] ? 2 : 1);
            if (arc_[i] > 0) alone_.push_back(arc_[i]);
        }
        if (alone_.size() == n) return;
        // a lone view has the median of the others
        double middle = 1;
        if (!alone_.empty()) {
            std::sort(alone_.begin(), alone_.end());
            middle = (alone_[alone_.size() / 2] + alone_[(alone_.size() - 1) / 2]) / 2;
        }
        for (double& a : arc_) a = a > 0 ? a : middle;
    }

    const Viewers& viewers_;
    const Light& light_;
    std::vector<double> angle_;
    std::vector<std::uint8_t> seen_, lit_, open_;
    std::vector<std::size_t> order_, group_, size_;
    std::vector<double> value_, gap_, widest_, half_, arc_, alone_;
    bool sorted_ = false, doubtful_ = false;
};

}  // namespace

template <typename Real>
void arcs(const Viewers& viewers, const double* points, std::int64_t n, const std::int64_t* order, std::int64_t kept,
          Real* out, std::uint64_t* pattern, int threads, const Tick& tick) {
    const Light light = light_of(viewers.beam);
    run((n + points_at_once - 1) / points_at_once, threads,
        [&](std::int64_t task) {
            Circle circle(viewers, light);
            for (std::int64_t i = task * points_at_once; i < std::min(n, (task + 1) * points_at_once); ++i) {
                const std::vector<double>& value = circle.at(points + 3 * i);
                for (std::int64_t k = 0; k < kept; ++k)
                    out[i * kept + k] = static_cast<Real>(value[static_cast<std::size_t>(order[k])]);
                if (pattern) pattern[i] = circle.pattern();
            }
        },
        tick);
}

template void arcs(const Viewers&, const double*, std::int64_t, const std::int64_t*, std::int64_t, float*,
                   std::uint64_t*, int, const Tick&);
template void arcs(const Viewers&, const double*, std::int64_t, const std::int64_t*, std::int64_t, double*,
                   std::uint64_t*, int, const Tick&);

}  // namespace pysas
