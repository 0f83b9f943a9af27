#include "core/light.hpp"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/polynomials.hpp"

namespace pysas {
namespace {

constexpr double least = 1e-17;  // of a sum's terms

// cos^2 of the share of the taper that an angle lies beyond full_angle.
double weight(const Beam& beam, double beyond) {
    const double wave = std::cos(pi / 2 * std::clamp(beyond / (beam.half_angle - beam.full_angle), 0.0, 1.0));
    return wave * wave;
}

// The place's parts across and along the middle of the beam: of its distance times the sine and cosine of its angle.
struct Parts {
    double across, along, before;
};

Parts parts(double shape, const Trace& trace, const double (&d)[3]) {
    const double* to = shape == fan ? trace.axis : trace.boresight;
    const double known = d[0] * to[0] + d[1] * to[1] + d[2] * to[2];
    const double cross[3] = {d[1] * to[2] - d[2] * to[1], d[2] * to[0] - d[0] * to[2], d[0] * to[1] - d[1] * to[0]};
    const double rest = std::sqrt(cross[0] * cross[0] + cross[1] * cross[1] + cross[2] * cross[2]);
    const double* look = trace.boresight;
    const double before = d[0] * look[0] + d[1] * look[1] + d[2] * look[2];
    return shape == fan ? Parts{std::abs(known), rest, before} : Parts{rest, known, before};
}

}  // namespace

Light light_of(const Beam& beam) {
    Light out{};
    out.shape = beam.shape;
    out.sine_half = std::sin(beam.half_angle);
    out.cosine_half = std::cos(beam.half_angle);
    out.sine_full = std::sin(beam.full_angle);
    out.cosine_full = std::cos(beam.full_angle);
    const double ramp = beam.half_angle - beam.full_angle;
    if (beam.shape == no_beam || ramp <= 0) return out;
    const double most = std::tan(ramp / 4);
    out.per_quarter = 1 / most;
    // through the Chebyshev nodes of [0, 1], none of which is 0
    std::vector<double> values;
    for (int j = 0; j < max_ramp; ++j) {
        const double e = 0.5 + 0.5 * std::cos(pi * (j + 0.5) / max_ramp);
        values.push_back(weight(beam, 4 * std::atan(most * (1 - e))) / (e * e));
    }
    double largest = 0;
    for (int k = 0; k < max_ramp; ++k) {
        double sum = 0;
        for (int j = 0; j < max_ramp; ++j)
            sum += values[static_cast<std::size_t>(j)] * std::cos(pi * k * (j + 0.5) / max_ramp);
        out.chebyshev[k] = sum * (k == 0 ? 1.0 : 2.0) / max_ramp;
        largest = std::max(largest, std::abs(out.chebyshev[k]));
    }
    out.terms = max_ramp;
    while (out.terms > 1 && std::abs(out.chebyshev[out.terms - 1]) < least * largest) --out.terms;
    return out;
}

double fit_powers(const Beam& beam, Light& light) {
    light.quick = false;
    light.per = 1;
    if (light.shape != fan || light.terms == 0) return 0;
    const double width = light.sine_half - light.sine_full;
    light.per = 1 / width;
    const auto exact = [&](double e) {
        return weight(beam, std::asin(std::min(light.sine_half - e * width, 1.0)) - beam.full_angle);
    };
    std::vector<double> at, values;
    for (int j = 0; j < ramp_powers; ++j) {
        at.push_back(0.5 + 0.5 * std::cos(pi * (j + 0.5) / ramp_powers));
        values.push_back(exact(at.back()) / (at.back() * at.back()));
    }
    monomials(at, values);
    std::copy(values.begin(), values.end(), light.power);
    double worst = 0;
    for (int i = 0; i <= 400; ++i) {
        const double e = i / 400.0;
        double sum = 0;
        for (int q = ramp_powers - 1; q >= 0; --q) sum = sum * e + light.power[q];
        worst = std::max(worst, std::abs(sum * e * e - exact(e)));
    }
    // a weight falls by at most pi/2 along the taper; its place is a sum of five rounded numbers, none above per
    // sine_half or so, and the weight one of seven
    return worst + 0x1p-24 * (pi / 2 * 6 * light.per * light.sine_half + 8);
}

bool lights(const Light& light, const Trace& trace, const double (&away)[3]) {
    if (light.shape == no_beam) return true;
    const Parts p = parts(light.shape, trace, away);
    if (light.shape == fan) {
        const double distance = std::sqrt(away[0] * away[0] + away[1] * away[1] + away[2] * away[2]);
        if (p.before < -edge_angle * distance) return false;
    }
    // by sines, as kernels do: cosines lose the smallest angles
    return p.across * light.cosine_half <= p.along * light.sine_half;
}

// By distances to the surfaces of cones, see kernels/light.inl.
Lit lit(const Light& light, const Trace& trace, const double (&away)[3], double radius) {
    if (light.shape == no_beam) return Lit::alike;
    const Parts p = parts(light.shape, trace, away);
    const double edge = p.along * light.sine_half - p.across * light.cosine_half;
    const bool flat = light.shape == fan;
    if (edge < -radius) return Lit::nowhere;
    if (flat && p.before < -radius) return Lit::behind;
    if (flat && p.before <= radius) return Lit::cut;
    if (p.along * light.sine_full - p.across * light.cosine_full > radius) return Lit::alike;
    return light.terms > 0 ? Lit::fading : Lit::cut;
}

double brightness(const Beam& beam, const Trace& trace, const double (&away)[3]) {
    if (beam.shape == no_beam || beam.half_angle <= beam.full_angle) return 1;
    const Parts p = parts(beam.shape, trace, away);
    return weight(beam, std::atan2(p.across, p.along) - beam.full_angle);
}

}  // namespace pysas
