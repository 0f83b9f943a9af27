#include "planning/fates.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/light.hpp"
#include "core/polynomials.hpp"
#include "planning/draw.hpp"

namespace pysas {
namespace {

constexpr double wide = 0.3;      // a tile's radius seen from a group at most, rad
constexpr double ahead = 0.25;    // sine of the angle to a group's axis within which pixels are ahead of it
constexpr double flattest = 0.7;  // of a unit axis along the ground, at least
constexpr std::int64_t few = 32;  // traces that mostly tell

double ground_between(const Point& a, const Point& b) {
    const double x = a.x - b.x, y = a.y - b.y;
    return std::sqrt(x * x + y * y);
}

// The least distance of a tile's corners from a group's axis if it lies beside the group and not ahead, so that the
// plane has all its ranges; else 0.
double beside(const Onto& onto, const Group& group, const Point* corners, int count) {
    double least = HUGE_VAL;
    for (int k = 0; k < count; ++k) {
        const auto found = onto(corners[k]);
        if (!found || !(found->beside > ahead * ground_between(corners[k], group.centre))) return 0;
        least = std::min(least, found->beside);
    }
    return least;
}

// What is known of a group's records before any trace is looked at, and its traces.
class Records {
  public:
    Records(const Scene& scene, const Numbers& traces) : model_(scene.survey.model) {
        Point low[2], high[2];
        for (const std::int64_t i : traces) {
            const Trace& trace = scene.survey.traces[static_cast<std::size_t>(i)];
            const One one{{point(trace.tx), point(trace.rx)}, length(point(trace.velocity)), trace};
            for (int k = 0; k < 2; ++k) {
                const Point& p = one.sensor[k];
                const bool fresh = all_.empty();
                low[k] = fresh ? p : Point{std::min(low[k].x, p.x), std::min(low[k].y, p.y), std::min(low[k].z, p.z)};
                high[k] =
                    fresh ? p : Point{std::max(high[k].x, p.x), std::max(high[k].y, p.y), std::max(high[k].z, p.z)};
            }
            soonest_ = std::min(soonest_, trace.t0);
            latest_ = std::max(latest_, trace.t0);
            fastest_ = std::max(fastest_, one.speed);
            slow_ = std::min(slow_, trace.c);
            fast_ = std::max(fast_, trace.c);
            for (int k = 0; k < 2; ++k) {
                first_[k] = k ? std::max(first_[k], trace.first) : std::min(first_[k], trace.first);
                last_[k] = k ? std::max(last_[k], trace.last) : std::min(last_[k], trace.last);
            }
            all_.push_back(one);
        }
        for (int k = 0; k < 2; ++k) {
            middle_[k] = 0.5 * (low[k] + high[k]);
            about_ += length(high[k] - low[k]) / 2;
        }
        for (const std::int64_t i : some_of(static_cast<std::int64_t>(all_.size()), few))
            some_.push_back(all_[static_cast<std::size_t>(i)]);
    }

    struct State {
        bool inside, heard;
    };
    // Whether a ball about pixels lies, with paths `more` m longer and shorter around it, inside the records of all
    // traces, if that is asked; and itself inside any. By boxes about all sensors; where these do not tell some traces
    // mostly do, and all traces tell the rest.
    State operator()(const Point& middle, double radius, double more, bool asked) const {
        const double path = length(middle - middle_[0]) + length(middle - middle_[1]);
        const double spread = 2 * radius + more;
        const double earliest = ((path - spread - about_) / (fast_ + fastest_) - latest_) * model_.fs;
        const double latest = ((path + spread + about_) / (slow_ - fastest_) - soonest_) * model_.fs;
        if (earliest >= first_[1] && latest <= last_[0]) return {true, true};
        if (!(latest >= first_[0] - edge_samples && earliest <= last_[1] + edge_samples)) return {false, false};
        State state{asked, false};
        for (const auto* traces : {&some_, &all_}) {
            for (const One& one : *traces) {
                if (state.heard && !state.inside) return state;
                const double way = length(middle - one.sensor[0]) + length(middle - one.sensor[1]);
                const Trace& g = one.trace;
                const double low = ((way - spread) / (g.c + one.speed) - g.t0) * model_.fs;
                const double high = ((way + spread) / (g.c - one.speed) - g.t0) * model_.fs;
                state.inside = state.inside && low >= g.first && high <= g.last;
                state.heard = state.heard || (high >= g.first - edge_samples && low <= g.last + edge_samples);
            }
        }
        return {state.inside && state.heard, state.heard};
    }

  private:
    struct One {
        Point sensor[2];
        double speed;
        const Trace& trace;
    };
    Model model_;
    std::vector<One> all_, some_;
    Point middle_[2];
    double about_ = 0, soonest_ = HUGE_VAL, latest_ = -HUGE_VAL, fastest_ = 0, slow_ = HUGE_VAL, fast_ = 0;
    double first_[2] = {HUGE_VAL, -HUGE_VAL}, last_[2] = {HUGE_VAL, -HUGE_VAL};  // least and largest of all
};

// How a group's transmitters light pixels.
class Beams {
  public:
    Beams(const Scene& scene, const Numbers& traces) : light_(scene.light) {
        if (light_.shape == no_beam) return;
        Numbers some = traces;  // one of each ping
        const auto ping = [&](std::int64_t i) { return i / scene.survey.channels; };
        std::sort(some.begin(), some.end());
        some.erase(std::unique(some.begin(), some.end(), [&](auto a, auto b) { return ping(a) == ping(b); }),
                   some.end());
        for (const std::int64_t i : some) traces_.push_back(&scene.survey.traces[static_cast<std::size_t>(i)]);
    }

    struct State {
        bool lit, whole;  // by any; and where weights have no step
    };
    State operator()(const Point& middle, double radius) const {
        State state{traces_.empty(), true};
        bool dark = false, behind = false, alike = false;
        for (const Trace* trace : traces_) {
            const Point away = middle - point(trace->tx);
            const Lit found = lit(light_, *trace, {away.x, away.y, away.z}, radius);
            state.lit = state.lit || (found != Lit::nowhere && found != Lit::behind);
            state.whole = state.whole && found != Lit::cut;
            dark = dark || found == Lit::nowhere;
            behind = behind || found == Lit::behind;
            alike = alike || found == Lit::alike;
        }
        // nodes hold weights that fade, or none at all, and go on behind a fan
        if (state.lit && (behind || (light_.terms == 0 && dark && alike))) state.whole = false;
        return state;
    }

  private:
    Light light_;
    std::vector<const Trace*> traces_;
};

// Radians a metre.
double highest_of(const Scene& scene) {
    const Model& model = scene.survey.model;
    return 2 * pi * (model.fc + scene.survey.band * model.fs) / model.c;
}

Point across(const Group& group, const Point& p) { return p - dot(p, group.axis) * group.axis; }

// Sine of the angle between a group's axis and those of its fans, at most.
double between_axes(const Scene& scene, const Group& group) {
    double most = 0;
    for (const std::int64_t i : group.traces) {
        const Point axis = point(scene.survey.traces[static_cast<std::size_t>(i)].axis);
        most = std::max(most, length(across(group, axis)));
    }
    return most;
}

// What a fan's weights turn with the angle about the group's axis. Those of cones are not alike at one range and one
// place along it: 1.
double askew(const Scene& scene, const Group& group) {
    if (scene.light.terms == 0) return 0;
    return scene.light.shape == fan ? between_axes(scene, group) : 1;
}

// Until when echoes arrive, s.
double latest_of(const Scene& scene) { return 2 * scene.farthest / scene.survey.model.c; }

// What transmitter and receiver of a group's own trace together lie beside its axis until echoes arrive, m.
double beside_axis(const Scene& scene, const Group& group, const Trace& own) {
    return length(across(group, point(own.tx) - group.centre)) + length(across(group, point(own.rx) - group.centre)) +
           latest_of(scene) * length(across(group, point(own.velocity)));
}

// What a group's transmitters and receivers together lie beside its axis: for pixels `closest` m beside it at most
// straight + bent / closest + twisted / closest^2.
struct OffAxis {
    double straight = 0, bent = 0, twisted = 0, shift = 0;  // of what is read, m a rad

    OffAxis(const Scene& scene, const Group& group, bool alone) {
        if (alone) {
            beside_own(scene, group);
            return;
        }
        for (const std::int64_t i : group.traces) {
            const Trace& trace = scene.survey.traces[static_cast<std::size_t>(i)];
            const Point tx = point(trace.tx), rx = point(trace.rx);
            const Point out = across(group, tx - group.centre), back = across(group, rx - group.centre);
            straight = std::max(straight, length(out + back));
            bent =
                std::max(bent, dot(out, out) + dot(back, back) + std::min(length(out), length(back)) * length(tx - rx));
        }
    }

    // Beside the middle trace's: receivers off the line through its own along the axis, until echoes arrive, s (a +
    // s/2r) apart for a receiver s away, a the sine of the angle to the line's normal. Of that way heights turn by q/r
    // what a line sees that lies q beside the axis, or that is read q/r away for a transmitter there; and as it is read
    // where the delay on the plane, which grows by q^2/4r^2 less than the range, has caught up, q^3/4r^2 are left.
    void beside_own(const Scene& scene, const Group& group) {
        const auto& traces = scene.survey.traces;
        const Trace& own = traces[static_cast<std::size_t>(own_of(scene, group))];
        const double c = scene.survey.model.c, latest = latest_of(scene);
        const Point speed = across(group, point(own.velocity));
        const double sine =
            scene.light.shape == fan ? std::min(1.0, scene.light.sine_half + between_axes(scene, group)) : 1.0;
        double away = 0;
        for (const std::int64_t i : group.traces) {
            const Trace& trace = traces[static_cast<std::size_t>(i)];
            const Point off = point(trace.rx) - point(own.rx);
            straight = std::max(straight, length(across(group, off)) + length(speed) * length(off) * sine / c +
                                              latest * length(point(trace.velocity) - point(own.velocity)));
            away = std::max(away, length(off));
        }
        shift = beside_axis(scene, group, own);
        const double q = shift;
        bent = straight * (straight + 2 * q + away) + q * away * sine + length(speed) * away * away / c;
        twisted = q * away * away / 2 + q * q * q / 4;
    }
};

}  // namespace

std::int64_t own_of(const Scene& scene, const Group& group) {
    const auto& traces = scene.survey.traces;
    const std::int64_t channels = scene.survey.channels, first = group.traces.front();
    std::size_t middle = 0;
    for (std::size_t k = 0; k < group.traces.size(); ++k) {
        const std::int64_t i = group.traces[k];
        const double *a = traces[static_cast<std::size_t>(first)].tx, *b = traces[static_cast<std::size_t>(i)].tx;
        if (i / channels != first / channels || !std::equal(a, a + 3, b)) return -1;
        if (std::abs(group.along[k]) < std::abs(group.along[middle])) middle = k;
    }
    return group.traces[middle];
}

double own_turn(const Scene& scene, const Group& group) {
    const Trace& own = scene.survey.traces[static_cast<std::size_t>(own_of(scene, group))];
    return highest_of(scene) * beside_axis(scene, group, own);
}

Onto::Onto(const Group& group, double plane)
    : centre_(group.centre), axis_(group.axis), plane_(plane), across_(std::hypot(group.axis.x, group.axis.y)) {}

std::optional<Onto::Found> Onto::operator()(const Point& p) const {
    if (across_ < flattest) return {};
    const Point away = p - centre_;
    const double x = axis_.x / across_, y = axis_.y / across_, height = centre_.z - plane_;
    const double along = (dot(away, axis_) + height * axis_.z) / across_;
    const double square = dot(away, away) - height * height - along * along;
    if (!(square > 0)) return {};
    const double side = away.y * x - away.x * y, off = std::copysign(std::sqrt(square), side);
    return Found{{centre_.x + along * x - off * y, centre_.y + along * y + off * x, plane_},
                 std::min(std::abs(off), std::abs(side))};
}

// What the weights of a taper over `width` are wrong by where the angle off the beam is by up to `angle` what `count`
// planes tell: their slope times that, or, where planes tell the slope, their second derivative's jump.
double weights_wrong(double width, double angle, int count) {
    const double slope = pi / 2 * angle / width;
    return angle == 0 ? 0 : count == 1 ? slope : slope * slope / 2;
}

// At one range and one place along its axis a group's phases turn with the angle about that axis by what its
// transmitters and receivers together lie beside it: exp(j a s), |s| <= 1, of which the polynomial through n Chebyshev
// nodes lacks a^n/(n! 2^(n-1)). Where they lie on opposite sides their paths differ in second order still: by q^2
// cos^2/(2 r) for each sensor q beside the axis, and as q/r of a transmitter and a receiver that are not equally far.
Stacked stack_of(const Scene& scene, const Tiled& tiled, const std::vector<Group>& groups, double error, int count) {
    const Survey& survey = scene.survey;
    const double highest = highest_of(scene);
    const auto each = static_cast<std::size_t>(tiled.each);
    double low = HUGE_VAL, high = -HUGE_VAL;
    for (std::size_t i = 0; i < tiled.corners.size(); ++i) {
        if (tiled.pixels[i / each] == 0) continue;
        low = std::min(low, tiled.corners[i].z);
        high = std::max(high, tiled.corners[i].z);
    }
    double straight = 0, bent = 0, twisted = 0, skew = 0, shift = 0;
    const bool alone =
        std::all_of(groups.begin(), groups.end(), [&](const Group& group) { return own_of(scene, group) >= 0; });
    for (const Group& group : groups) {
        const OffAxis off(scene, group, alone);
        straight = std::max(straight, off.straight);
        bent = std::max(bent, off.bent);
        twisted = std::max(twisted, off.twisted);
        shift = std::max(shift, off.shift);
        skew = std::max(skew, askew(scene, group));
    }
    const double half = (high - low) / 2, width = survey.model.beam.half_angle - survey.model.beam.full_angle;
    const auto wrong = [&](double closest) {
        const double most = highest * (straight + (bent + twisted / closest) / closest) * half / closest;
        double lacking = 2;
        for (int k = 1; k <= count; ++k) lacking *= most / k / 2;
        return lacking + weights_wrong(width, skew * half / closest, count);
    };
    double near = 0, far = scene.farthest;
    if (!(wrong(far) <= error)) return {};
    while (far > near * (1 + 1e-3) + 1e-3) {
        const double middle = (near + far) / 2;
        (wrong(middle) <= error ? far : near) = middle;
    }
    Stacked out{{}, far, alone, shift * half / std::max(far, 1e-9)};
    for (int k = count - 1; k >= 0; --k)
        out.heights.push_back((low + high) / 2 + half * std::cos(pi * (2 * k + 1) / (2 * count)));
    return out;
}

// None is read across a hard edge of a beam, where the sum has a step.
Fates fates_of(const Scene& scene, const Group& group, const Tiled& tiled, const Numbers& tiles, const Stacked& planes,
               const Layout& layout, double step, double near) {
    const Model& model = scene.survey.model;
    const auto each = static_cast<std::size_t>(tiled.each);
    double lowest = HUGE_VAL, highest = 0;
    for (const std::int64_t tile : tiles) {
        for (std::size_t k = 0; k < each; ++k) {
            const double height = std::abs(group.centre.z - tiled.corners[each * static_cast<std::size_t>(tile) + k].z);
            lowest = std::min(lowest, height);
            highest = std::max(highest, height);
        }
    }
    // nodes that a read depends on lie this much further out or in, and to the sides
    const double taps = layout.taps.reach();
    const double reach = static_cast<double>(layout.fans.size() + 1) * (taps + 4) * step;
    const double apart = near_lengths * group.extent;  // of the group's centre from what is read
    const double least = std::max(std::hypot(apart, highest), layout.clear);
    const double more = std::max(2 * reach, layout.ends * model.c / model.fs + 2 * taps * step) + 2 * planes.shift;
    const Records records(scene, group.traces);
    const Beams beams(scene, group.traces);
    std::vector<Onto> stack;
    if (!tiled.flat) {
        for (const double plane : planes.heights) stack.emplace_back(group, plane);
    }
    const auto on_planes = [&](const Point* corners) {
        return std::all_of(stack.begin(), stack.end(), [&](const Onto& onto) {
            if (!(beside(onto, group, corners, tiled.each) > planes.closest)) return false;
            return std::all_of(corners, corners + each, [&](const Point& corner) {
                return ground_between(onto(corner)->place, group.centre) >= apart;
            });
        });
    };
    Fates out{std::vector<std::uint8_t>(tiled.pixels.size()), std::vector<std::uint8_t>(tiled.pixels.size())};
    for (const std::int64_t number : tiles) {
        const auto tile = static_cast<std::size_t>(number);
        const Point& middle = tiled.middle[tile];
        const double radius = tiled.radius[tile], ground = ground_between(middle, group.centre);
        const double away = std::hypot(std::max(ground - radius, 0.0), lowest);
        const auto [lit, whole] = beams(middle, radius);
        if (!lit) continue;
        bool read = (!tiled.flat || away >= near) && away - reach >= least && radius <= wide * ground && whole;
        read =
            read && group.distance(middle) - radius - reach >= layout.apart && on_planes(&tiled.corners[each * tile]);
        const auto [inside, heard] = records(middle, radius, more, read);
        out.read[tile] = read && inside;
        out.direct[tile] = heard && !out.read[tile];
    }
    return out;
}

}  // namespace pysas
