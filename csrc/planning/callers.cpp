#include "planning/callers.hpp"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "core/border.hpp"
#include "core/dispatch.hpp"
#include "core/errors.hpp"
#include "core/polynomials.hpp"

namespace pysas {
namespace {

constexpr std::int64_t most = std::int64_t{1} << 40;  // of any one size, and of their products
// a taper over less, rad, is an edge of which roundings would decide; of the angle between a fan's axis and boresight
constexpr double least_ramp = 1e-5, least_sine = 1e-6;

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

// Whether a box lies where every beam that counts lights all alike: its corners do. Cones up to a right angle are
// convex. So is what a fan holds on one side: across its axis a place is at least as far away as along one direction,
// here the box's centre's, and |aside| <= tan(angle) of that is a wedge.
bool all_lit(const Survey& survey, const Point& low, const Point& high) {
    const Beam& beam = survey.model.beam;
    if (beam.shape != fan && beam.full_angle >= pi) return true;
    const double sine = std::sin(beam.full_angle) * (1 - 1e-9), cosine = std::cos(beam.full_angle) + 1e-9;
    for (std::size_t i = 0; i < survey.traces.size(); ++i) {
        if (survey.weights[i] == 0.0) continue;
        const Trace& trace = survey.traces[i];
        const Point at = point(trace.tx), look = point(trace.boresight), axis = point(trace.axis);
        const Point middle = 0.5 * (low + high) - at, across = middle - dot(middle, axis) * axis;
        const Point out = (1 / std::max(length(across), 1e-300)) * across;
        for (int corner = 0; corner < 8; ++corner) {
            const Point away =
                Point{(corner & 1 ? high : low).x, (corner & 2 ? high : low).y, (corner & 4 ? high : low).z} - at;
            const double before = dot(away, look);
            const bool held = beam.shape == fan ? before > 0 && std::abs(dot(away, axis)) * std::max(cosine, 0.0) <=
                                                                    dot(away, out) * sine
                                                : before >= std::max(cosine, 1e-9) * length(away);
            if (!held) return false;
        }
    }
    return true;
}

void check_beam(const pysas_survey& survey) {
    if (!survey.boresight) return;
    const bool flat = survey.beam_shape == PYSAS_BEAM_FAN;
    if (!flat && survey.beam_shape != PYSAS_BEAM_CONE) refuse("beam_shape");
    if (flat) finite(survey.beam_axis, 3 * survey.n_ping, "beam_axis");
    const double widest = flat ? pi / 2 : pi;
    if (!(survey.beam_half_angle > 0 && survey.beam_half_angle <= widest * (1 + 1e-9)))
        refuse("beam_half_angle: not in (0, pi], of a fan (0, pi/2]");
    if (!(survey.beam_taper >= 0 && survey.beam_taper <= 1)) refuse("beam_taper: not in [0, 1]");
    if (survey.beam_taper > 0 && survey.beam_taper * survey.beam_half_angle < least_ramp)
        refuse("beam_taper: over less than 1e-5 rad");
}

// Directions of length 1 of a ping's beam.
void aim(Trace& trace, const pysas_survey& given, std::int64_t ping) {
    std::copy_n(given.boresight + 3 * ping, 3, trace.boresight);
    normalise(trace.boresight);
    if (given.beam_shape != PYSAS_BEAM_FAN) return;
    const double* look = trace.boresight;
    if (given.beam_axis) {
        std::copy_n(given.beam_axis + 3 * ping, 3, trace.axis);
    } else {  // across the vertical
        trace.axis[0] = look[1];
        trace.axis[1] = -look[0];
        trace.axis[2] = 0;
    }
    if (given.beam_axis || std::hypot(look[0], look[1]) > least_sine) normalise(trace.axis);
    const Point a = point(trace.axis), b = point(trace.boresight), rest = b - dot(a, b) * a;
    if (!(length(a) > 0.5 && length(rest) > least_sine))
        refuse(given.beam_axis ? "beam_axis: along boresight" : "boresight: vertical, and no beam_axis");
}

void check(const pysas_survey& survey, const pysas_grid& grid, const pysas_options& options) {
    size(survey.n_ping, survey.n_channel, survey.n_sample, "survey");
    size(grid.height, grid.width, 3, "grid");
    if (!survey.tx || !survey.rx) refuse("survey: tx and rx are needed");
    const std::int64_t traces = survey.n_ping * survey.n_channel;
    finite(survey.tx, 3 * survey.n_ping, "tx");
    finite(survey.rx, 3 * traces, "rx");
    finite(survey.velocity, 3 * traces, "velocity");
    finite(survey.weights, traces, "weights");
    finite(survey.ping_t0, survey.n_ping, "ping_t0");
    finite(survey.boresight, 3 * survey.n_ping, "boresight");
    finite(&survey.t0, 1, "t0");
    for (const double value : {survey.fs, survey.fc, survey.c}) {
        if (!(value > 1e-9 && value <= 1e15)) refuse("survey: fs, fc and c must be positive and finite");
    }
    if (!(survey.bandwidth >= 0 && survey.bandwidth <= survey.fs / 1.1 * (1 + 1e-9)))
        refuse("bandwidth: above fs / 1.1");
    check_beam(survey);
    for (std::int64_t i = 0; survey.ping_c && i < survey.n_ping; ++i) {
        if (!(survey.ping_c[i] > 1e-9 && survey.ping_c[i] <= 1e15)) refuse("ping_c: must be positive and finite");
    }
    for (std::int64_t i = 0; survey.valid && i < traces; ++i) {
        const std::int64_t first = survey.valid[2 * i], last = survey.valid[2 * i + 1];
        if (!(first >= 0 && first <= survey.n_sample && last >= first - 1 && last < survey.n_sample))
            refuse("valid: beyond the record, or the last more than one before the first");
    }
    for (std::int64_t i = 0; survey.velocity && i < traces; ++i) {
        const double zero[3] = {0, 0, 0}, c = survey.ping_c ? survey.ping_c[i / survey.n_channel] : survey.c;
        if (!(distance(survey.velocity + 3 * i, zero) < 0.5 * c)) refuse("velocity: above half the speed of sound");
    }
    for (const double* vector : {grid.first, grid.along, grid.down}) finite(vector, 3, "grid");
    finite(grid.points, 3 * grid.height * grid.width, "points");
    if (options.dtype != PYSAS_COMPLEX64 && options.dtype != PYSAS_COMPLEX128) refuse("dtype");
    if (options.method != PYSAS_BACKPROJECTION && options.method != PYSAS_FFBP && options.method != PYSAS_AUTO)
        refuse("method");
    if (options.threads < 0 || options.threads > 4096) refuse("threads");
    const double least = options.dtype == PYSAS_COMPLEX64 ? 1e-5 : 1e-10;
    if (!(options.tol >= least * (1 - 1e-9) && options.tol <= 0.1)) throw Error(Code::tolerance, "tol: out of reach");
}

// Corners of a box about a grid.
struct Box {
    double low[3], high[3];
};

Box box_of(const pysas_grid& grid) {
    Box box{};
    for (int axis = 0; axis < 3; ++axis) {
        if (grid.points) {
            box.low[axis] = box.high[axis] = grid.points[axis];
            for (std::int64_t i = 0; i < grid.height * grid.width; ++i) {
                box.low[axis] = std::min(box.low[axis], grid.points[3 * i + axis]);
                box.high[axis] = std::max(box.high[axis], grid.points[3 * i + axis]);
            }
        } else {
            const double along = grid.along[axis] * static_cast<double>(grid.width - 1);
            const double down = grid.down[axis] * static_cast<double>(grid.height - 1);
            box.low[axis] = grid.first[axis] + std::min(along, 0.0) + std::min(down, 0.0);
            box.high[axis] = grid.first[axis] + std::max(along, 0.0) + std::max(down, 0.0);
        }
    }
    return box;
}

Pixels pixels_of(const pysas_grid& grid, const double origin[3]) {
    Pixels out;
    out.height = grid.height;
    out.width = grid.width;
    if (grid.mask) out.mask.assign(grid.mask, grid.mask + grid.height * grid.width);
    if (grid.points) {
        // rows of points may happen to lie on lines; a single row is a list
        const auto list =
            std::make_shared<const std::vector<double>>(grid.points, grid.points + 3 * grid.height * grid.width);
        if (grid.height > 1) find_lines(list->data(), point(origin), out);
        out.points = points_in_list(list->data(), point(origin), list);
        return out;
    }
    for (std::int64_t i = 0; i < grid.height; ++i) {
        for (int axis = 0; axis < 3; ++axis) {
            out.first.push_back(grid.first[axis] - origin[axis] + static_cast<double>(i) * grid.down[axis]);
            out.step.push_back(grid.along[axis]);
        }
    }
    out.points = [first = out.first, step = out.step, width = out.width](const Numbers& numbers, double* to) {
        for (const std::int64_t i : numbers) {
            for (std::int64_t axis = 0; axis < 3; ++axis) {
                const auto at = static_cast<std::size_t>(3 * (i / width) + axis);
                *to++ = first[at] + static_cast<double>(i % width) * step[at];
            }
        }
    };
    return out;
}

Survey survey_of(const pysas_survey& given, const double origin[3], bool single) {
    Survey out;
    const double bandwidth = given.bandwidth > 0 ? given.bandwidth : given.fs / 1.1;
    out.band = bandwidth / 2 / given.fs;
    out.single = single;
    out.channels = given.n_channel;
    // wave numbers of the slowest ping are the largest
    out.model.c = given.ping_c ? *std::min_element(given.ping_c, given.ping_c + given.n_ping) : given.c;
    out.model.fc = given.fc;
    out.model.fs = given.fs;
    out.model.last = static_cast<double>(given.n_sample - 1);
    if (given.boresight) {
        const double edge = given.beam_taper > 0 ? 0 : edge_angle, half = given.beam_half_angle;
        out.model.beam = {given.beam_shape == PYSAS_BEAM_FAN ? fan : cone, half + edge,
                          (1 - given.beam_taper) * half + edge};
    } else {
        out.model.beam = {no_beam, pi, pi};
    }
    for (std::int64_t i = 0; i < given.n_ping * given.n_channel; ++i) {
        const std::int64_t ping = i / given.n_channel;
        Trace trace{};
        for (int axis = 0; axis < 3; ++axis) {
            trace.tx[axis] = given.tx[3 * ping + axis] - origin[axis];
            trace.rx[axis] = given.rx[3 * i + axis] - origin[axis];
            if (given.velocity) trace.velocity[axis] = given.velocity[3 * i + axis];
        }
        if (given.boresight && !(given.weights && given.weights[i] == 0)) aim(trace, given, ping);
        trace.t0 = given.ping_t0 ? given.ping_t0[ping] : given.t0;
        trace.c = given.ping_c ? given.ping_c[ping] : given.c;
        trace.first = given.valid ? static_cast<double>(given.valid[2 * i]) : 0;
        trace.last = given.valid ? static_cast<double>(given.valid[2 * i + 1]) : out.model.last;
        out.traces.push_back(trace);
        out.weights.emplace_back(given.weights ? given.weights[i] : 1.0);
    }
    return out;
}

}  // namespace

std::shared_ptr<const Scene> scene_of(const pysas_survey& survey, const pysas_grid& grid,
                                      const pysas_options& options) {
    check(survey, grid, options);
    Box box = box_of(grid);
    double origin[3];
    for (int axis = 0; axis < 3; ++axis) {
        origin[axis] = (box.low[axis] + box.high[axis]) / 2;
        box.low[axis] -= origin[axis];
        box.high[axis] -= origin[axis];
    }
    Survey own = survey_of(survey, origin, options.dtype == PYSAS_COMPLEX64);
    if (own.model.beam.shape != no_beam && all_lit(own, point(box.low), point(box.high)))
        own.model.beam = {no_beam, pi, pi};
    return std::make_shared<const Scene>(std::move(own), pixels_of(grid, origin), point(box.low), point(box.high));
}

Wish wish_of(const pysas_options& options) {
    const char* wanted = options.isa ? options.isa : std::getenv("PYSAS_ISA");
    const Kernels& kernels = kernels_for(wanted ? wanted : "auto");
    const unsigned all = std::thread::hardware_concurrency();
    const int threads = options.threads > 0 ? options.threads : std::max(1, static_cast<int>(all));
    const Method method = options.method == PYSAS_FFBP   ? Method::ffbp
                          : options.method == PYSAS_AUTO ? Method::automatic
                                                         : Method::backprojection;
    return {options.tol, options.tol, method, true, true, true, threads, kernels.name};
}

}  // namespace pysas
