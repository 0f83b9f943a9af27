// Points and vectors of three coordinates.
#pragma once

#include <cmath>

namespace pysas {

struct Point {
    double x = 0, y = 0, z = 0;
};

inline Point point(const double* p) { return {p[0], p[1], p[2]}; }
inline Point operator+(const Point& a, const Point& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Point operator-(const Point& a, const Point& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Point operator*(double s, const Point& a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(const Point& a, const Point& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline double length(const Point& a) { return std::sqrt(dot(a, a)); }

}  // namespace pysas
