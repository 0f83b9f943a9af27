// What of a place a beam lights, and whether pixels lie within a trace's window and beam. Included inside a namespace
// of one instruction set, after delay.inl.

// How what reaches `reach` about a place is lit, by how deep that place lies within the edge, where all is lit alike,
// and before the transmitter.
inline Reach by_depths(double edge, double full, double before, double reach) {
    if (edge < -reach || before < -reach) return Reach::outside;
    if (edge <= reach || before <= reach) return Reach::across;
    return full > reach ? Reach::inside : Reach::fading;
}

constexpr double no_side = 1e300;  // before a transmitter whose beam has no side

// Whether a sphere about `centre` lies where a beam lights nothing, or where it lights all alike, within the edge where
// its light fades, or across that; `there`: the centre's distance. Cones and what fans leave out are convex (beyond a
// right angle what cones leave out is), so that distances to their surfaces are those to a plane at least.
inline Reach lit_of(const Trace& g, const Light& light, const double centre[3], double radius, double there) {
    if (light.shape == no_beam) return Reach::inside;
    const double d[3] = {centre[0] - g.tx[0], centre[1] - g.tx[1], centre[2] - g.tx[2]};
    const double before = d[0] * g.boresight[0] + d[1] * g.boresight[1] + d[2] * g.boresight[2];
    const double aside = d[0] * g.axis[0] + d[1] * g.axis[1] + d[2] * g.axis[2];
    const bool flat = light.shape == fan;
    const double known = flat ? aside : before, off = there * there - known * known, rest = off > 0 ? ::sqrt(off) : 0.0;
    const double across = flat ? ::fabs(aside) : rest, along = flat ? rest : before;
    // `rest` may lose half of its digits; rounding must never decide what the exact path should
    const double reach = radius + 1e-7 * there;
    return by_depths(along * light.sine_half - across * light.cosine_half,
                     along * light.sine_full - across * light.cosine_full, flat ? before : no_side, reach);
}

// What terms weigh at places d from the transmitter, and 1 in `counts` where they count. Without its `side` a fan's
// weights go on smoothly behind boresight, as nodes of sub-images need them. Angles are compared by sines,
// sin(angle - limit) <= 0, which keep the smallest apart; cosines do not.
inline Double::vec brightness(const Trace& g, const Light& light, const Double::vec (&d)[3], Double::vec& counts,
                              bool side = true) {
    using V = Double;
    using vec = V::vec;
    const bool flat = light.shape == fan;
    const double* to = flat ? g.axis : g.boresight;
    const auto dot = [&d](const double* a) {
        return V::fma(d[0], V::set(a[0]), V::fma(d[1], V::set(a[1]), V::mul(d[2], V::set(a[2]))));
    };
    const auto minor = [&](int i, int j) { return V::fma(d[i], V::set(to[j]), V::mul(d[j], V::set(-to[i]))); };
    const vec cx = minor(1, 2), cy = minor(2, 0), cz = minor(0, 1), known = dot(to);
    const vec rest = V::sqrt(V::fma(cx, cx, V::fma(cy, cy, V::mul(cz, cz))));
    const vec across = flat ? V::abs(known) : rest, along = flat ? rest : known;
    counts = V::one_where_le(V::mul(across, V::set(light.cosine_half)), V::mul(along, V::set(light.sine_half)));
    if (flat && side) {
        const vec away = V::sqrt(V::fma(d[0], d[0], V::fma(d[1], d[1], V::mul(d[2], d[2]))));
        counts = V::mul(counts, V::one_where_le(V::mul(away, V::set(-edge_angle)), dot(g.boresight)));
    }
    if (light.terms == 0) return counts;
    const vec zero = V::set(0.0), one = V::set(1.0);
    const vec sine = V::max(zero, V::fma(across, V::set(light.cosine_full), V::mul(along, V::set(-light.sine_full))));
    const vec cosine = V::fma(along, V::set(light.cosine_full), V::mul(across, V::set(light.sine_full)));
    // tangents of the half and of the quarter of the angle beyond full_angle; nothing over nothing at the transmitter
    const vec size = V::sqrt(V::fma(sine, sine, V::mul(cosine, cosine)));
    const vec half = V::min(V::div(sine, V::add(V::add(size, cosine), V::set(1e-300))), V::set(1e150));
    const vec quarter = V::div(half, V::add(one, V::sqrt(V::fma(half, half, one))));
    const vec e = V::max(zero, V::fnma(quarter, V::set(light.per_quarter), one));
    const vec twice = V::fma(V::set(4.0), e, V::set(-2.0));  // Clenshaw's sum
    vec b1 = zero, b2 = zero;
    for (int k = light.terms - 1; k > 0; --k) {
        const vec b = V::add(V::sub(V::mul(twice, b1), b2), V::set(light.chebyshev[k]));
        b2 = b1;
        b1 = b;
    }
    const vec q = V::add(V::sub(V::mul(V::mul(twice, V::set(0.5)), b1), b2), V::set(light.chebyshev[0]));
    return V::mul(counts, V::mul(V::mul(e, e), q));
}

// The same of lines of a tile whose pixels lie up to `more` off them: how deep their middles lie within the edge and
// where all is lit alike, before the transmitter, and what their halves reach.
struct Depths {
    alignas(64) double edge[tile_rows], full[tile_rows], before[tile_rows], reach[tile_rows];

    void measure(const Trace& g, const Light& light, const Segments& lines, int rows, double more) {
        using V = Double;
        using vec = V::vec;
        const bool flat = light.shape == fan;
        const vec zero = V::set(0.0);
        for (int r = 0; r < rows; r += V::n) {
            vec known = zero, look = zero, there2 = zero;
            for (int axis = 0; axis < 3; ++axis) {
                const vec middle = V::fma(V::set(0.5), V::load(lines.along[axis] + r), V::load(lines.begin[axis] + r));
                const vec d = V::sub(middle, V::set(g.tx[axis]));
                look = V::fma(d, V::set(g.boresight[axis]), look);
                known = V::fma(d, V::set(g.axis[axis]), known);
                there2 = V::fma(d, d, there2);
            }
            if (!flat) known = look;
            const vec rest = V::root(V::max(zero, V::fnma(known, known, there2)));
            const vec across = flat ? V::abs(known) : rest, along = flat ? rest : known;
            const auto depth = [&](double sine, double cosine) {
                return V::fma(along, V::set(sine), V::mul(across, V::set(-cosine)));
            };
            V::store(edge + r, depth(light.sine_half, light.cosine_half));
            V::store(full + r, depth(light.sine_full, light.cosine_full));
            V::store(before + r, flat ? look : V::set(no_side));
            V::store(reach + r, V::fma(V::set(1e-7), V::root(there2), V::add(V::load(lines.half + r), V::set(more))));
        }
    }

    Reach operator[](int r) const { return by_depths(edge[r], full[r], before[r], reach[r]); }
};

// A piece of a line of a tile: the sphere about its pixels, `half` of them either side of number `middle` of `count`.
struct Piece {
    double at[3], radius, there;

    // `more`: what pixels lie off their line at most.
    Piece(const Trace& g, const Segments& lines, int r, double middle, double half, int count, double more) {
        double length2 = 0, there2 = 0;
        for (int axis = 0; axis < 3; ++axis) {
            const double step = count > 1 ? lines.along[axis][r] / (count - 1) : 0.0;
            at[axis] = lines.begin[axis][r] + middle * step;
            length2 += step * step;
            there2 += (at[axis] - g.tx[axis]) * (at[axis] - g.tx[axis]);
        }
        radius = half * ::sqrt(length2) + more;
        there = ::sqrt(there2);
    }
    Reach lit(const Trace& g, const Light& light) const { return lit_of(g, light, at, radius, there); }
    Reach heard(const Trace& g, const Model& model) const {
        const double back = norm(at[0] - g.rx[0], at[1] - g.rx[1], at[2] - g.rx[2]), way = there + back;
        const double speed = norm(g.velocity[0], g.velocity[1], g.velocity[2]);
        return window(g, model, speed, way > 2 * radius ? way - 2 * radius : 0.0, way + 2 * radius);
    }
};
