// Two-way travel times in float64, and whether pixels lie within a trace's window.
// Included inside a namespace of one instruction set, after its vector types.

// Delay of the points (x, y, z). Moving: the positive root of (c^2 - v^2) tau^2 - 2 (c D - d.v) tau + D^2 - d^2 = 0,
// with D the distance from the transmitter and d the vector from the receiver's place at transmission.
inline Double::vec square_of(Double::vec a, Double::vec b, Double::vec d) {
    using V = Double;
    return V::fma(a, a, V::fma(b, b, V::mul(d, d)));
}

// Squares of the ways out.
inline Double::vec way_out(const Trace& trace, Double::vec x, Double::vec y, Double::vec z) {
    using V = Double;
    return square_of(V::sub(x, V::set(trace.tx[0])), V::sub(y, V::set(trace.tx[1])), V::sub(z, V::set(trace.tx[2])));
}

// With the way out and its square, which traces of a ping share.
template <Kind K>
Double::vec delay_from(const Trace& trace, double c, Double::vec there, Double::vec there2, Double::vec x,
                       Double::vec y, Double::vec z) {
    using V = Double;
    using vec = V::vec;
    if constexpr (K == Kind::monostatic) return V::mul(V::set(2.0 / c), there);
    const vec dx = V::sub(x, V::set(trace.rx[0])), dy = V::sub(y, V::set(trace.rx[1])),
              dz = V::sub(z, V::set(trace.rx[2]));
    const vec back2 = square_of(dx, dy, dz);
    if constexpr (K == Kind::stop_and_hop) return V::mul(V::set(1.0 / c), V::add(there, V::root(back2)));
    const double* v = trace.velocity;
    const double a = c * c - (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    const vec along = V::fma(dx, V::set(v[0]), V::fma(dy, V::set(v[1]), V::mul(dz, V::set(v[2]))));
    const vec b = V::sub(V::mul(V::set(c), there), along);
    const vec root = V::root(V::fma(b, b, V::mul(V::set(a), V::sub(back2, there2))));
    return V::mul(V::set(1.0 / a), V::add(b, root));
}

template <Kind K>
Double::vec delay(const Trace& trace, double c, Double::vec x, Double::vec y, Double::vec z) {
    const Double::vec there2 = way_out(trace, x, y, z);
    return delay_from<K>(trace, c, Double::root(there2), there2, x, y, z);
}

enum class Reach { outside, inside, fading, across };

inline double norm(double x, double y, double z) { return ::sqrt(x * x + y * y + z * z); }

// Centre and radius of a sphere that holds `count` points.
inline double sphere(const double* points, int count, double centre[3]) {
    for (int axis = 0; axis < 3; ++axis) {
        double low = points[axis], high = low;
        for (int i = 1; i < count; ++i) {
            const double p = points[3 * i + axis];
            low = p < low ? p : low;
            high = p > high ? p : high;
        }
        centre[axis] = (low + high) / 2;
    }
    double most = 0;  // of squares
    for (int i = 0; i < count; ++i) {
        const double x = points[3 * i] - centre[0], y = points[3 * i + 1] - centre[1],
                     z = points[3 * i + 2] - centre[2];
        const double d = x * x + y * y + z * z;
        most = d > most ? d : most;
    }
    return ::sqrt(most) * (1 + 1e-12);
}

// Whether distances out and home that sum to `least` to `most` lie outside, inside or across the record's window. Of
// rounding, one part in 1e9 must never decide what the exact path should.
inline Reach window(const Trace& g, const Model& model, double speed, double least, double most) {
    const double low = (least / (g.c + speed) * (1 - 1e-9) - g.t0) * model.fs;
    const double high = (most / (g.c - speed) * (1 + 1e-9) - g.t0) * model.fs;
    if (high < g.first - edge_samples || low > g.last + edge_samples) return Reach::outside;
    return low >= g.first + edge_margin && high <= g.last - edge_margin ? Reach::inside : Reach::across;
}

// Lines of a tile from end to end.
struct Segments {
    alignas(64) double begin[3][tile_rows], along[3][tile_rows], scale[tile_rows];  // 1 / along^2
    alignas(64) double half[tile_rows];                                             // of their lengths
};

// Least distance of each line from a sensor, and largest, which is that of an end. Spheres about lines that look along
// the track are far longer than the ranges on them differ.
inline void distances(const double sensor[3], const Segments& lines, int rows, double* least, double* most) {
    using V = Double;
    using vec = V::vec;
    const vec zero = V::set(0.0), one = V::set(1.0);
    for (int r = 0; r < rows; r += V::n) {
        vec d[3], s[3];
        for (int axis = 0; axis < 3; ++axis) {
            d[axis] = V::sub(V::load(lines.begin[axis] + r), V::set(sensor[axis]));
            s[axis] = V::load(lines.along[axis] + r);
        }
        const vec dot = V::fma(d[0], s[0], V::fma(d[1], s[1], V::mul(d[2], s[2])));
        const vec t = V::max(zero, V::min(one, V::sub(zero, V::mul(dot, V::load(lines.scale + r)))));
        vec nearest = zero, first = zero, last = zero;
        for (int axis = 0; axis < 3; ++axis) {
            const vec at = V::fma(t, s[axis], d[axis]), end = V::add(d[axis], s[axis]);
            nearest = V::fma(at, at, nearest);
            first = V::fma(d[axis], d[axis], first);
            last = V::fma(end, end, last);
        }
        V::store(least + r, V::root(nearest));
        V::store(most + r, V::root(V::max(first, last)));
    }
}
