// Two-way travel times in float64, and whether a sphere of pixels lies within a trace's window.
// Included inside a namespace of one instruction set, after its vector types.

// Delay of the points (x, y, z). Moving: the positive root of (c^2 - v^2) tau^2 - 2 (c D - d.v) tau + D^2 - d^2 = 0,
// with D the distance from the transmitter and d the vector from the receiver's place at transmission.
template <Kind K>
Double::vec delay(const Trace& trace, double c, Double::vec x, Double::vec y, Double::vec z) {
    using V = Double;
    using vec = V::vec;
    const auto square = [](vec a, vec b, vec d) { return V::fma(a, a, V::fma(b, b, V::mul(d, d))); };
    const vec there2 =
        square(V::sub(x, V::set(trace.tx[0])), V::sub(y, V::set(trace.tx[1])), V::sub(z, V::set(trace.tx[2])));
    if constexpr (K == Kind::monostatic) return V::mul(V::set(2.0 / c), V::sqrt(there2));
    const vec dx = V::sub(x, V::set(trace.rx[0])), dy = V::sub(y, V::set(trace.rx[1])),
              dz = V::sub(z, V::set(trace.rx[2]));
    const vec back2 = square(dx, dy, dz);
    if constexpr (K == Kind::stop_and_hop) return V::mul(V::set(1.0 / c), V::add(V::sqrt(there2), V::sqrt(back2)));
    const double* v = trace.velocity;
    const double a = c * c - (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    const vec along = V::fma(dx, V::set(v[0]), V::fma(dy, V::set(v[1]), V::mul(dz, V::set(v[2]))));
    const vec b = V::sub(V::mul(V::set(c), V::sqrt(there2)), along);
    const vec root = V::sqrt(V::fma(b, b, V::mul(V::set(a), V::sub(back2, there2))));
    return V::mul(V::set(1.0 / a), V::add(b, root));
}

enum class Reach { outside, inside, across };

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
    double most = 0;
    for (int i = 0; i < count; ++i) {
        const double d = norm(points[3 * i] - centre[0], points[3 * i + 1] - centre[1], points[3 * i + 2] - centre[2]);
        most = d > most ? d : most;
    }
    return most * (1 + 1e-12);
}

// Whether a sphere about `centre` lies outside, inside or across the beam's cone; `there`: the centre's distance. The
// cone or, beyond a right angle, what it leaves out is convex, so that distances to its surface are those to a plane at
// least.
inline Reach beam(const Trace& g, const Model& model, const double centre[3], double radius, double there) {
    if (model.cos_beam <= -1.0) return Reach::inside;
    const double along = (centre[0] - g.tx[0]) * g.boresight[0] + (centre[1] - g.tx[1]) * g.boresight[1] +
                         (centre[2] - g.tx[2]) * g.boresight[2];
    const double off = there * there - along * along, across = off > 0 ? ::sqrt(off) : 0.0;
    const double sine = ::sqrt((1 - model.cos_beam) * (1 + model.cos_beam));
    const double depth = along * sine - across * model.cos_beam;
    // `across` may lose half of its digits; rounding must never decide what the exact path should
    const double reach = radius + 1e-7 * there;
    return depth > reach ? Reach::inside : depth < -reach ? Reach::outside : Reach::across;
}

// The same of the record's window, where distances out and home sum to `least` to `most`; of rounding, one part in 1e9
// must never decide what the exact path should.
inline Reach window(const Trace& g, const Model& model, double speed, double least, double most) {
    const double low = (least / (model.c + speed) * (1 - 1e-9) - g.t0) * model.fs;
    const double high = (most / (model.c - speed) * (1 + 1e-9) - g.t0) * model.fs;
    if (high < -edge_samples || low > model.last + edge_samples) return Reach::outside;
    return low >= edge_margin && high <= model.last - edge_margin ? Reach::inside : Reach::across;
}

inline Reach both(Reach one, Reach other) {
    if (one == Reach::outside || other == Reach::outside) return Reach::outside;
    return one == Reach::inside ? other : one;
}

// Whether a sphere lies outside, inside or across the record's window and the beam; `nearest`: its least distance.
inline Reach reach(const Trace& g, const Model& model, const double centre[3], double radius, double& nearest) {
    const double there = norm(centre[0] - g.tx[0], centre[1] - g.tx[1], centre[2] - g.tx[2]);
    const double back = norm(centre[0] - g.rx[0], centre[1] - g.rx[1], centre[2] - g.rx[2]);
    const double least = there < back ? there : back;
    nearest = least > radius ? least - radius : 0.0;
    const double out = there > radius ? there - radius : 0.0, home = back > radius ? back - radius : 0.0;
    const double speed = norm(g.velocity[0], g.velocity[1], g.velocity[2]);
    return both(window(g, model, speed, out + home, there + back + 2 * radius), beam(g, model, centre, radius, there));
}

// Lines of a tile from end to end.
struct Segments {
    alignas(64) double begin[3][tile_rows], along[3][tile_rows], scale[tile_rows];  // 1 / along^2
};

// Whether pixels of a line of `count`, `half` either side of number `middle`, lie outside, inside or across the
// record's window and the beam, of which the line as a whole is `heard` and `lit`.
inline Reach reach(const Trace& g, const Model& model, const Segments& lines, int r, double middle, double half,
                   int count, Reach heard, Reach lit) {
    if (model.cos_beam <= -1.0) lit = Reach::inside;
    if (heard != Reach::across && lit != Reach::across) return both(heard, lit);
    double at[3], length2 = 0, there2 = 0, back2 = 0;
    for (int axis = 0; axis < 3; ++axis) {
        const double step = count > 1 ? lines.along[axis][r] / (count - 1) : 0.0;
        at[axis] = lines.begin[axis][r] + middle * step;
        length2 += step * step;
        there2 += (at[axis] - g.tx[axis]) * (at[axis] - g.tx[axis]);
        back2 += (at[axis] - g.rx[axis]) * (at[axis] - g.rx[axis]);
    }
    const double radius = half * ::sqrt(length2), there = ::sqrt(there2);
    if (lit == Reach::across) lit = beam(g, model, at, radius, there);
    if (heard == Reach::across) {
        const double way = there + ::sqrt(back2), speed = norm(g.velocity[0], g.velocity[1], g.velocity[2]);
        heard = window(g, model, speed, way > 2 * radius ? way - 2 * radius : 0.0, way + 2 * radius);
    }
    return both(heard, lit);
}

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
        V::store(least + r, V::sqrt(nearest));
        V::store(most + r, V::sqrt(V::max(first, last)));
    }
}
