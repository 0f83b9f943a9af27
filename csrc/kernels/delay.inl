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

// Whether a sphere lies outside, inside or across the record's window and the beam; `nearest`: its least distance.
inline Reach reach(const Trace& g, const Model& model, const double centre[3], double radius, double& nearest) {
    const double d[3] = {centre[0] - g.tx[0], centre[1] - g.tx[1], centre[2] - g.tx[2]};
    const double there = norm(d[0], d[1], d[2]);
    const double back = norm(centre[0] - g.rx[0], centre[1] - g.rx[1], centre[2] - g.rx[2]);
    const double least = there < back ? there : back;
    nearest = least > radius ? least - radius : 0.0;
    const double speed = norm(g.velocity[0], g.velocity[1], g.velocity[2]);
    const double out = there > radius ? there - radius : 0.0, home = back > radius ? back - radius : 0.0;
    // one part in 1e9 of slack: rounding must never decide what the exact path should
    const double low = ((out + home) / (model.c + speed) * (1 - 1e-9) - g.t0) * model.fs;
    const double high = ((there + back + 2 * radius) / (model.c - speed) * (1 + 1e-9) - g.t0) * model.fs;
    if (high < 0 || low > model.last) return Reach::outside;
    Reach where = low >= 0 && high <= model.last ? Reach::inside : Reach::across;
    if (model.cos_beam > -1.0) {
        if (there <= radius * (1 + 1e-9)) return Reach::across;
        const double cosine = (d[0] * g.boresight[0] + d[1] * g.boresight[1] + d[2] * g.boresight[2]) / there;
        const double angle = ::acos(cosine < -1 ? -1 : cosine > 1 ? 1 : cosine);
        const double spread = ::asin(radius / there) + 1e-9, limit = ::acos(model.cos_beam);
        if (angle - spread > limit) return Reach::outside;
        if (angle + spread > limit) where = Reach::across;
    }
    return where;
}
