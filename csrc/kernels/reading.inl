// Pixels read from a sub-image: lines on its plane, or points near it. Included after factorised.inl.

// A line of pixels: the rays and nodes whose intervals they lie in, their places in these along rays, weights across
// them, and what is read.
template <int W>
struct Line {
    alignas(64) float beams[block], nodes[block], node_x[block], weight[W][block], re[block], im[block];
};

template <int W>
void gather_line(const SubImage& image, const Eight::vec (&tap)[W + 1], Line<W>& at, std::int64_t beam0,
                 std::int64_t node0, int count) {
    for (int m = 0; m < count; m += 2) {
        Eight::vec sum_re[2], sum_im[2];
        for (int k = 0; k < 2; ++k) {
            std::int64_t j = beam0 + static_cast<std::int64_t>(at.beams[m + k]) - (W / 2 - 1);
            std::int64_t i = node0 + static_cast<std::int64_t>(at.nodes[m + k]) - (W / 2 - 1);
            j = j < 0 ? 0 : j > image.rays - W ? image.rays - W : j;
            i = i < 0 ? 0 : i > image.stride - 8 ? image.stride - 8 : i;
            const auto x = Eight::set(at.node_x[m + k]);
            auto along = tap[W];
            for (int q = W - 1; q >= 0; --q) along = Eight::fma(along, x, tap[q]);
            const float *a = image.re + j * image.stride + i, *b = image.im + j * image.stride + i;
            auto w = Eight::set(at.weight[0][m + k]);
            sum_re[k] = Eight::mul(w, Eight::load(a));
            sum_im[k] = Eight::mul(w, Eight::load(b));
            for (int t = 1; t < W; ++t) {
                w = Eight::set(at.weight[t][m + k]);
                sum_re[k] = Eight::fma(w, Eight::load(a + t * image.stride), sum_re[k]);
                sum_im[k] = Eight::fma(w, Eight::load(b + t * image.stride), sum_im[k]);
            }
            sum_re[k] = Eight::mul(sum_re[k], along);
            sum_im[k] = Eight::mul(sum_im[k], along);
        }
        Eight::totals(sum_re, sum_im, at.re + m, at.im + m);
    }
}

template <class V, int W>
void read_taps_lines(ReadJob& job) {
    using D = Double;
    const Tree& tree = *job.tree;
    const Taps& taps = *tree.taps;
    const SubImage& image = *job.image;
    const Phase<V, 6> phase(tree.sine, tree.cosine);
    const auto round = V::set(magic<float>());
    const int rows = job.rows, count = job.count;
    // angles are counted from that of the tile's middle
    double tile[3];
    {
        const double *a = job.lines, *b = job.lines + 6 * (rows - 1);
        for (int axis = 0; axis < 3; ++axis) {
            tile[axis] = (a[axis] + b[axis] + (a[3 + axis] + b[3 + axis]) * (count - 1) / 2) / 2 - image.centre[axis];
        }
    }
    const double away = ::sqrt(tile[0] * tile[0] + tile[1] * tile[1]), ex = tile[0] / away, ey = tile[1] / away;
    constexpr double pi = 3.14159265358979323846;
    double angle = ::atan2(ey, ex) - image.angle0;
    angle -= 2 * pi * ::floor((angle - (static_cast<double>(image.rays) * image.dangle - 2 * pi) / 2) / (2 * pi));
    const auto wave = V::set(static_cast<float>(tree.wave * image.step));
    Curves across, out;
    for (int r = 0; r < rows; r += D::n) {
        D::vec bearing[5], range[5];
        alignas(64) double x[D::n], y[D::n], z[D::n];
        for (int j = 0; j < 5; ++j) {
            for (int l = 0; l < D::n; ++l) {
                const double* line = job.lines + 6 * (r + l < rows ? r + l : rows - 1);
                const double at = (tree.nodes.at[j] + 1) * (count - 1) / 2;
                const double px = line[0] + at * line[3] - image.centre[0],
                             py = line[1] + at * line[4] - image.centre[1];
                x[l] = px * ex + py * ey;
                y[l] = (py * ex - px * ey) / x[l];
                z[l] = line[2] + at * line[5] - image.centre[2];
            }
            const auto q = D::load(y), depth = D::load(x), drop = D::load(z);
            bearing[j] = arctangent(q);
            const auto side = D::mul(q, depth), ground2 = D::fma(side, side, D::mul(depth, depth));
            range[j] = D::sqrt(D::fma(drop, drop, ground2));
        }
        curve(tree.nodes, bearing, 1 / image.dangle, across, r);
        curve(tree.nodes, range, 1 / image.step, out, r);
    }
    Eight::vec tap[W + 1];
    for (int q = 0; q <= W; ++q) tap[q] = Eight::load(taps.tap[q]);
    Line<W> at;
    alignas(64) float place[block], cosine[block], sine[block];
    for (int m = 0; m < block; ++m)
        place[m] = static_cast<float>(m < count ? (count > 1 ? 2.0 * m / (count - 1) - 1 : 0.0) : 1.0);
    for (int r = 0; r < rows; ++r) {
        if (!job.active[r]) continue;
        const double beam = across.middle[r] + angle / image.dangle - 0.5;
        const double node = out.middle[r] - static_cast<double>(image.i0) - 0.5;
        const std::int64_t beam0 = nearest_below(beam + 0.5), node0 = nearest_below(node + 0.5);
        const auto beam_rest = V::set(static_cast<float>(beam - static_cast<double>(beam0)));
        const auto node_rest = V::set(static_cast<float>(node - static_cast<double>(node0)));
        const double cycles = out.middle[r] * image.step * tree.wave;
        const auto turned = V::set(static_cast<float>(cycles - ::floor(cycles + 0.5)));
        for (int m = 0; m < count; m += V::n) {
            const auto x = V::load(place + m);
            const auto moved = follow<V>(out, r, x);
            const auto b = V::add(follow<V>(across, r, x), beam_rest), n = V::add(moved, node_rest);
            const auto bk = V::sub(V::add(b, round), round), nk = V::sub(V::add(n, round), round);
            V::store(at.beams + m, bk);
            V::store(at.nodes + m, nk);
            V::store(at.node_x + m, V::sub(n, nk));
            typename V::vec s, c, w[W];
            weigh<V, W>(taps, V::sub(b, bk), w);
            for (int t = 0; t < W; ++t) V::store(at.weight[t] + m, w[t]);
            const auto ph = V::fma(moved, wave, turned);
            phase(V::sub(ph, V::sub(V::add(ph, round), round)), s, c);
            V::store(sine + m, s);
            V::store(cosine + m, c);
        }
        gather_line<W>(image, tap, at, beam0, node0, count);
        for (int m = 0; m < count; m += V::n) {
            add_turned<V>(V::load(at.re + m), V::load(at.im + m), V::load(sine + m), V::load(cosine + m),
                          job.re + r * block + m, job.im + r * block + m);
        }
    }
}

// Metres of slant range by which a stack's own trace is farther from points than from the places where a plane has
// them.
inline Double::vec farther(const Stack& stack, Double::vec x, Double::vec y, Double::vec z, Double::vec plane_x,
                           Double::vec plane_y, Double::vec plane_z) {
    using D = Double;
    const auto later = D::sub(delay<Kind::moving>(*stack.own, stack.own->c, x, y, z),
                              delay<Kind::moving>(*stack.own, stack.own->c, plane_x, plane_y, plane_z));
    return D::mul(later, D::set(stack.own->c / 2));
}

// The same of points near the sub-image's plane.
template <class V, int W>
void read_taps_points(ReadJob& job) {
    using D = Double;
    const Tree& tree = *job.tree;
    const Taps& taps = *tree.taps;
    const SubImage& image = *job.image;
    const Stack& stack = *job.stack;
    const Phase<V, 6> phase(tree.sine, tree.cosine);
    constexpr double pi = 3.14159265358979323846;
    const double across = ::sqrt(stack.axis[0] * stack.axis[0] + stack.axis[1] * stack.axis[1]);
    const double ax = stack.axis[0] / across, ay = stack.axis[1] / across;
    const double height = image.centre[2] - image.plane;
    // where on the plane: along the axis and beside it
    const auto onto = [&](D::vec dx, D::vec dy, D::vec dz, D::vec& range, D::vec& along, D::vec& off) {
        const auto square = D::fma(dx, dx, D::fma(dy, dy, D::mul(dz, dz)));
        range = D::sqrt(square);
        along = D::fma(dx, D::set(stack.axis[0] / across),
                       D::fma(dy, D::set(stack.axis[1] / across),
                              D::fma(dz, D::set(stack.axis[2] / across), D::set(height * stack.axis[2] / across))));
        const auto rest = D::sub(D::sub(square, D::mul(along, along)), D::set(height * height));
        // beside it on the side where the point is
        const auto side = D::fma(dy, D::set(ax), D::mul(dx, D::set(-ay)));
        const auto right = D::one_where_le(side, D::set(0.0));
        off = D::mul(D::sqrt(D::max(rest, D::set(1e-12))), D::sub(D::set(1.0), D::add(right, right)));
    };
    const auto from = [&](int r, int m, D::vec& dx, D::vec& dy, D::vec& dz) {
        alignas(64) double x[3][D::n];
        for (int i = 0; i < D::n; ++i) {
            const double* point = job.points + 3 * (r * job.apart + (m + i < job.count ? m + i : job.count - 1));
            for (int axis = 0; axis < 3; ++axis) x[axis][i] = point[axis] - image.centre[axis];
        }
        dx = D::load(x[0]);
        dy = D::load(x[1]);
        dz = D::load(x[2]);
    };
    // bearings are counted from that of a pixel in the middle, angles from the image's first ray
    double ex, ey, angle;
    {
        D::vec dx, dy, dz, range, along, off;
        alignas(64) double p[D::n], q[D::n];
        from(job.rows / 2, job.count / 2, dx, dy, dz);
        onto(dx, dy, dz, range, along, off);
        D::store(p, along);
        D::store(q, off);
        const double x = p[0] * ax - q[0] * ay, y = p[0] * ay + q[0] * ax, away = ::sqrt(x * x + y * y);
        ex = x / away;
        ey = y / away;
        angle = ::atan2(ey, ex) - image.angle0;
        angle -= 2 * pi * ::floor((angle - (static_cast<double>(image.rays) * image.dangle - 2 * pi) / 2) / (2 * pi));
    }
    Eight::vec tap[W + 1];
    for (int q = 0; q <= W; ++q) tap[q] = Eight::load(taps.tap[q]);
    Line<W> at;
    alignas(64) float cycles[block], beam_x[block], share[block];
    const auto half = D::set(0.5);
    for (int r = 0; r < job.rows; ++r) {
        if (!job.active[r]) continue;
        for (int m = 0; m < job.count; m += D::n) {
            D::vec dx, dy, dz, range, along, off;
            from(r, m, dx, dy, dz);
            onto(dx, dy, dz, range, along, off);
            const auto x = D::fma(along, D::set(ax * ex + ay * ey), D::mul(off, D::set(ax * ey - ay * ex)));
            const auto y = D::fma(along, D::set(ay * ex - ax * ey), D::mul(off, D::set(ax * ex + ay * ey)));
            // half the angle, which the series reaches farther with
            const auto away = D::sqrt(D::fma(x, x, D::mul(y, y)));
            const auto bearing = D::mul(D::set(2.0), arctangent(D::div(y, D::add(x, away))));
            const auto beam = D::mul(D::add(bearing, D::set(angle)), D::set(1 / image.dangle));
            if (stack.own) {
                const auto there = [&](double at, double a, double b) {
                    return D::fma(along, D::set(a), D::fma(off, D::set(b), D::set(at)));
                };
                const auto more =
                    farther(stack, D::add(dx, D::set(image.centre[0])), D::add(dy, D::set(image.centre[1])),
                            D::add(dz, D::set(image.centre[2])), there(image.centre[0], ax, -ay),
                            there(image.centre[1], ay, ax), D::set(image.plane));
                range = D::add(more, range);
            }
            const auto turns = D::mul(range, D::set(tree.wave));
            const auto node = D::fma(range, D::set(1 / image.step), D::set(-static_cast<double>(image.i0)));
            const auto j = D::floor(beam), i = D::floor(node);
            D::store(at.beams + m, j);
            D::store(beam_x + m, D::sub(D::sub(beam, j), half));
            D::store(at.nodes + m, i);
            D::store(at.node_x + m, D::sub(D::sub(node, i), half));
            D::store(cycles + m, D::sub(turns, D::floor(D::add(turns, half))));
            auto weight = D::set(1.0);
            for (int k = 0; k < stack.count; ++k) {
                if (k == stack.number) continue;
                const auto above = D::add(dz, D::set(image.centre[2] - stack.height[k]));
                weight = D::mul(weight, D::mul(above, D::set(1 / (stack.height[stack.number] - stack.height[k]))));
            }
            D::store(share + m, weight);
        }
        for (int m = 0; m < job.count; m += V::n) {
            typename V::vec w[W];
            weigh<V, W>(taps, V::load(beam_x + m), w);
            for (int t = 0; t < W; ++t) V::store(at.weight[t] + m, w[t]);
        }
        gather_line<W>(image, tap, at, 0, 0, job.count);
        for (int m = 0; m < job.count; m += V::n) {
            typename V::vec sine, cosine;
            phase(V::load(cycles + m), sine, cosine);
            const auto w = V::load(share + m);
            add_turned<V>(V::mul(w, V::load(at.re + m)), V::mul(w, V::load(at.im + m)), sine, cosine,
                          job.re + r * block + m, job.im + r * block + m);
        }
    }
}

template <class V, int W>
void read_taps_of(ReadJob& job) {
    if (job.lines)
        read_taps_lines<V, W>(job);
    else
        read_taps_points<V, W>(job);
}

template <class V>
void read_pixels(ReadJob& job) {
    if (job.tree->taps->count == 6)
        read_taps_of<V, 6>(job);
    else
        read_taps_of<V, 8>(job);
}
