#include "planning/groups.hpp"

#include <algorithm>
#include <cmath>

namespace pysas {
namespace {

Point over(const Point& sum, std::size_t count) {
    const auto n = static_cast<double>(count);
    return {sum.x / n, sum.y / n, sum.z / n};
}

struct Axes {
    Point axis[3];  // by variance, least first
};

// Axes of a cloud of points about the origin: eigenvectors of its covariance by Jacobi's rotations.
Axes axes_of(const std::vector<Point>& points) {
    double a[3][3] = {}, v[3][3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    Point mean;
    for (const Point& p : points) mean = mean + (1 / static_cast<double>(points.size())) * p;
    for (const Point& p : points) {
        const double d[3] = {p.x - mean.x, p.y - mean.y, p.z - mean.z};
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) a[i][j] += d[i] * d[j];
        }
    }
    for (int sweep = 0; sweep < 12; ++sweep) {
        for (const auto& pair : {std::pair<int, int>{0, 1}, {0, 2}, {1, 2}}) {
            const int p = pair.first, q = pair.second;
            if (!(std::abs(a[p][q]) > 1e-300)) continue;
            const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
            const double t = (theta < 0 ? -1 : 1) / (std::abs(theta) + std::sqrt(theta * theta + 1));
            const double c = 1 / std::sqrt(t * t + 1), s = t * c;
            for (int k = 0; k < 3; ++k) {
                const double left = a[k][p], right = a[k][q];
                a[k][p] = c * left - s * right;
                a[k][q] = s * left + c * right;
            }
            for (int k = 0; k < 3; ++k) {
                const double left = a[p][k], right = a[q][k];
                a[p][k] = c * left - s * right;
                a[q][k] = s * left + c * right;
            }
            for (auto& row : v) {
                const double left = row[p], right = row[q];
                row[p] = c * left - s * right;
                row[q] = s * left + c * right;
            }
        }
    }
    int order[3] = {0, 1, 2};
    std::stable_sort(order, order + 3, [&](int i, int j) { return a[i][i] < a[j][j]; });
    Axes out;
    for (int i = 0; i < 3; ++i) out.axis[i] = {v[0][order[i]], v[1][order[i]], v[2][order[i]]};
    return out;
}

}  // namespace

std::vector<Point> phase_centres(const Geometry& geometry) {
    std::vector<Point> out;
    for (std::int64_t i = 0; i < geometry.count; ++i) {
        const Trace& trace = geometry.traces[i];
        out.push_back(0.5 * (point(trace.tx) + point(trace.rx) + geometry.delay * point(trace.velocity)));
    }
    return out;
}

Group make_group(Numbers traces, const std::vector<Point>& centres) {
    Group out;
    std::vector<Point> offset;
    for (const std::int64_t i : traces) offset.push_back(centres[static_cast<std::size_t>(i)]);
    Point middle;
    for (const Point& p : offset) middle = middle + p;
    middle = over(middle, offset.size());
    for (Point& p : offset) p = p - middle;
    out.axis = axes_of(offset).axis[2];
    for (const Point& p : offset) {
        out.along.push_back(dot(p, out.axis));
        out.off = std::max(out.off, pysas::length(p - out.along.back() * out.axis));
    }
    const auto ends = std::minmax_element(out.along.begin(), out.along.end());
    if (!(*ends.second > *ends.first)) out.axis = {1, 0, 0};
    out.centre = middle + (*ends.first + *ends.second) / 2 * out.axis;
    out.extent = *ends.second - *ends.first;
    out.traces = std::move(traces);
    return out;
}

double Group::distance(const Point& point) const {
    const Point away = point - centre;
    const double ahead = dot(away, axis), beside = pysas::length(away - ahead * axis);
    return std::hypot(std::max(std::abs(ahead) - extent / 2, 0.0), std::max(beside - off, 0.0));
}

std::vector<Numbers> cut_track(const Geometry& geometry, const std::vector<Point>& centres, double length) {
    // traces come ping by ping
    std::vector<Point> middle;
    Numbers first;
    for (std::int64_t i = 0; i < geometry.count;) {
        std::int64_t end = i;
        Point sum;
        for (; end < geometry.count && geometry.pings[end] == geometry.pings[i]; ++end)
            sum = sum + centres[static_cast<std::size_t>(end)];
        middle.push_back(over(sum, static_cast<std::size_t>(end - i)));
        first.push_back(i);
        i = end;
    }
    first.push_back(geometry.count);
    std::vector<double> path{0};
    for (std::size_t i = 1; i < middle.size(); ++i)
        path.push_back(path.back() + pysas::length(middle[i] - middle[i - 1]));
    const double whole = std::max(path.back(), 1e-300), pieces = std::max(1.0, std::ceil(path.back() / length));
    std::vector<Numbers> out;
    double current = -1;
    for (std::size_t i = 0; i < middle.size(); ++i) {
        const double number = std::min(std::floor(path[i] / whole * pieces), pieces - 1);
        if (number != current) out.emplace_back();
        current = number;
        for (std::int64_t k = first[i]; k < first[i + 1]; ++k) out.back().push_back(k);
    }
    return out;
}

std::vector<Numbers> split_by_ping(const Group& group, const Geometry& geometry) {
    const auto alike = [&](std::int64_t i, std::int64_t k) {
        const Trace &a = geometry.traces[i], &b = geometry.traces[k];
        return i / geometry.channels == k / geometry.channels && std::equal(a.tx, a.tx + 3, b.tx) &&
               std::equal(a.boresight, a.boresight + 3, b.boresight) && std::equal(a.axis, a.axis + 3, b.axis);
    };
    std::vector<Numbers> parts;
    for (const std::int64_t i : group.traces) {
        if (parts.empty() || !alike(parts.back().back(), i)) parts.emplace_back();
        parts.back().push_back(i);
    }
    return parts;
}

std::vector<Numbers> split(const Group& group, int fan) {
    const double low = *std::min_element(group.along.begin(), group.along.end());
    std::vector<Numbers> parts(static_cast<std::size_t>(fan));
    for (std::size_t i = 0; i < group.traces.size(); ++i) {
        const double share = (group.along[i] - low) / std::max(group.extent, 1e-300);
        parts[static_cast<std::size_t>(std::min(static_cast<int>(share * fan), fan - 1))].push_back(group.traces[i]);
    }
    parts.erase(std::remove_if(parts.begin(), parts.end(), [](const Numbers& part) { return part.empty(); }),
                parts.end());
    return parts;
}

}  // namespace pysas
