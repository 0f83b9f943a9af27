// Pixels of a map, on a line that leads away from a group when looked at from above, read from its sub-image. Included
// after lines.inl.
//
// A group on a line sees a pixel by its slant range and its place along the group's axis. Of lines of constant slope
// the latter follows from the range, as of a straight line on the sub-image's plane: rays are crossed along that one,
// and each pixel is read at its own range. Where heights off the slope would turn the bearing by too much, rays are
// crossed for the lowest and for the highest of them, between which pixels lie.

// Where a sub-image's plane has a line's pixel number `at`, `up` m above the line's slope, beside the sub-image's foot.
struct OnPlane {
    double x, y;

    OnPlane(const ColumnJob& job, double at, double slope, double up) {
        const SubImage& image = *job.image;
        const double* axis = job.stack->axis;
        const double across = ::sqrt(axis[0] * axis[0] + axis[1] * axis[1]), height = image.centre[2] - image.plane;
        const double ax = axis[0] / across, ay = axis[1] / across;
        const double dx = job.first[0] + at * job.step[0] - image.centre[0],
                     dy = job.first[1] + at * job.step[1] - image.centre[1],
                     dz = job.heights[0] + at * slope + up - image.centre[2];
        const double along = dx * ax + dy * ay + (dz + height) * axis[2] / across;
        const double rest = dx * dx + dy * dy + dz * dz - height * height - along * along;
        const double off = ::copysign(::sqrt(rest > 0 ? rest : 0), dy * ax - dx * ay);
        x = along * ax - off * ay;
        y = along * ay + off * ax;
    }
};

// Metres of range by which a stack's own trace is off, through the first, middle and last place of a line on its
// lowest, middle and highest heights: in powers of places in [-1, 1] of powers of heights in [-1, 1].
struct Turning {
    double power[3][3] = {};

    Turning() = default;

    Turning(const ColumnJob& job, double slope, double low, double high) {
        using D = Double;
        static_assert(16 % D::n == 0, "whole vectors");
        const SubImage& image = *job.image;
        const double half = static_cast<double>(job.count - 1) / 2;
        alignas(64) double place[16] = {}, up[16] = {}, later[16];
        for (int i = 0; i < 9; ++i) {
            place[i] = half * (i % 3);
            up[i] = low + (high - low) / 2 * (i / 3);
        }
        const double* axis = job.stack->axis;
        const double across = ::sqrt(axis[0] * axis[0] + axis[1] * axis[1]), height = image.centre[2] - image.plane;
        const double ax = axis[0] / across, ay = axis[1] / across;
        for (int i = 0; i < 9; i += D::n) {
            const auto at = D::load(place + i);
            const auto x = D::fma(at, D::set(job.step[0]), D::set(job.first[0])),
                       y = D::fma(at, D::set(job.step[1]), D::set(job.first[1])),
                       z = D::add(D::fma(at, D::set(slope), D::set(job.heights[0])), D::load(up + i));
            const auto dx = D::sub(x, D::set(image.centre[0])), dy = D::sub(y, D::set(image.centre[1])),
                       dz = D::sub(z, D::set(image.centre[2]));
            const auto along = D::fma(
                dx, D::set(ax), D::fma(dy, D::set(ay), D::mul(D::add(dz, D::set(height)), D::set(axis[2] / across))));
            const auto rest = D::sub(D::sub(square_of(dx, dy, dz), D::mul(along, along)), D::set(height * height));
            const auto side = D::fma(dy, D::set(ax), D::mul(dx, D::set(-ay)));
            const auto right = D::one_where_le(side, D::set(0.0));
            const auto off = D::mul(D::root(D::max(rest, D::set(1e-12))), D::sub(D::set(1.0), D::add(right, right)));
            D::store(later + i, farther(*job.stack, x, y, z,
                                        D::fma(along, D::set(ax), D::fma(off, D::set(-ay), D::set(image.centre[0]))),
                                        D::fma(along, D::set(ay), D::fma(off, D::set(ax), D::set(image.centre[1]))),
                                        D::set(image.plane)));
        }
        double along[3][3];
        for (int k = 0; k < 3; ++k) fit(later[3 * k], later[3 * k + 1], later[3 * k + 2], along[k]);
        for (int q = 0; q < 3; ++q) fit(along[0][q], along[1][q], along[2][q], power[q]);
    }

    static void fit(double first, double middle, double last, double (&out)[3]) {
        out[0] = middle;
        out[1] = (last - first) / 2;
        out[2] = (last + first) / 2 - middle;
    }

    Double::vec operator()(Double::vec x, Double::vec up) const {
        using D = Double;
        const auto along = [&](int q) {
            return D::fma(D::fma(D::set(power[q][2]), up, D::set(power[q][1])), up, D::set(power[q][0]));
        };
        return D::fma(D::fma(along(2), x, along(1)), x, along(0));
    }
};

// Pixels of a line as a group sees them: nodes from `base` on, turns of the carrier, heights off the line's slope as
// shares of the way from `low` to `high`, and what of them a stack's plane is given. `least` and `most` of a vector.
template <class V>
struct Seen {
    alignas(64) float node[block], cycles[block], off[block], share[block];
    float least[block / V::n], most[block / V::n];
    double nearest, farthest;  // slant range, m
    std::int64_t base;
    double low, high, slope;

    explicit Seen(const ColumnJob& job) {
        using D = Double;
        alignas(64) double z[block], above[block], range[block];
        alignas(64) static constexpr double number[] = {0, 1, 2, 3, 4, 5, 6, 7};
        static_assert(D::n <= 8, "numbers of all lanes");
        const SubImage& image = *job.image;
        const int count = static_cast<int>(job.count);
        const double last = job.heights[count - 1];
        for (int m = 0; m < count; ++m) z[m] = job.heights[m];
        for (int m = count; m < block; ++m) z[m] = last;
        slope = count > 1 ? (last - z[0]) / (count - 1) : 0.0;
        const double vx = job.first[0] - image.centre[0], vy = job.first[1] - image.centre[1];
        D::vec lowest = D::set(0.0), highest = lowest, closest = D::set(HUGE_VAL), outmost = lowest;
        for (int m = 0; m < block; m += D::n) {
            const D::vec pixel = D::min(D::add(D::load(number), D::set(m)), D::set(count - 1)), height = D::load(z + m);
            const D::vec off = D::sub(height, D::fma(pixel, D::set(slope), D::set(z[0])));
            const D::vec x = D::fma(pixel, D::set(job.step[0]), D::set(vx)),
                         y = D::fma(pixel, D::set(job.step[1]), D::set(vy)),
                         up = D::sub(height, D::set(image.centre[2]));
            const D::vec away = D::root(D::fma(x, x, D::fma(y, y, D::mul(up, up))));
            D::store(above + m, off);
            D::store(range + m, away);
            lowest = D::min(lowest, off);
            highest = D::max(highest, off);
        }
        const auto least_of = [](D::vec a) { return -D::largest(D::sub(D::set(0.0), a)); };
        low = least_of(lowest);
        high = D::largest(highest);
        const double per_off = high > low ? 1 / (high - low) : 0.0;
        const bool own = job.stack->own != nullptr;
        const Turning more = own ? Turning(job, slope, low, high) : Turning();
        const double scale = count > 1 ? 2.0 / (count - 1) : 0.0;
        for (int m = 0; m < block; m += D::n) {
            const D::vec part = D::mul(D::sub(D::load(above + m), D::set(low)), D::set(per_off));
            D::store(off + m, part);
            D::vec away = D::load(range + m);
            if (own) {
                const D::vec pixel = D::min(D::add(D::load(number), D::set(m)), D::set(count - 1));
                away = D::add(
                    away, more(D::fma(pixel, D::set(scale), D::set(-1.0)), D::fma(part, D::set(2.0), D::set(-1.0))));
                D::store(range + m, away);
            }
            closest = D::min(closest, away);
            outmost = D::max(outmost, away);
        }
        nearest = least_of(closest);
        farthest = D::largest(outmost);
        base = nearest_below(nearest / image.step);
        const double wave = job.tree->wave;
        for (int s = 0; s < block / V::n; ++s) {
            D::vec first = D::set(HUGE_VAL), end = D::set(0.0);
            for (int m = s * V::n; m < (s + 1) * V::n; m += D::n) {
                const D::vec away = D::load(range + m), turns = D::mul(away, D::set(wave));
                D::store(cycles + m, D::sub(turns, D::floor(D::add(turns, D::set(0.5)))));
                D::store(node + m, D::fma(away, D::set(1 / image.step), D::set(-static_cast<double>(base))));
                first = D::min(first, away);
                end = D::max(end, away);
                auto weight = D::set(1.0);
                for (int k = 0; k < job.stack->count; ++k) {
                    if (k == job.stack->number) continue;
                    const double own = job.stack->height[job.stack->number], other = job.stack->height[k];
                    weight = D::mul(weight, D::mul(D::sub(D::load(z + m), D::set(other)), D::set(1 / (own - other))));
                }
                D::store(share + m, weight);
            }
            least[s] = static_cast<float>(least_of(first) / image.step - static_cast<double>(base));
            most[s] = static_cast<float>(D::largest(end) / image.step - static_cast<double>(base));
        }
    }
};

template <class V, int W>
void read_relief(const ColumnJob& job) {
    const Tree& tree = *job.tree;
    const SubImage& image = *job.image;
    const Phase<V, 6> phase(tree.sine, tree.cosine);
    constexpr double pi = 3.14159265358979323846;
    const auto round = V::set(magic<float>());
    const Seen<V> seen(job);
    const int count = static_cast<int>(job.count);
    const LineRooms rooms(job.work, job.room);
    const std::int64_t most = job.room - W - 4 * V::n;
    const double middle = (count - 1) / 2.0, reach = middle > 8 ? middle : 8.0;
    // a height off the slope changes the way along the line at which a range is met, and the place along the axis with
    // it
    int lines = 1;
    {
        const double *axis = job.stack->axis, *step = job.step;
        const double apart = ::sqrt(step[0] * step[0] + step[1] * step[1]);
        const double dx = job.first[0] + middle * step[0] - image.centre[0],
                     dy = job.first[1] + middle * step[1] - image.centre[1],
                     dz = job.heights[0] + middle * seen.slope - image.centre[2];
        const double along = (dx * step[0] + dy * step[1]) / apart, away = ::sqrt(dx * dx + dy * dy);
        const double off = (seen.high - seen.low) / 2, way = off * ::fabs(dz / (along + dz * seen.slope / apart));
        const double turn = (::fabs(axis[0] * step[0] + axis[1] * step[1]) / apart * way + ::fabs(axis[2]) * off) /
                            (::sqrt(axis[0] * axis[0] + axis[1] * axis[1]) * away);
        if (!(turn <= job.turn * image.dangle)) lines = 2;
    }
    alignas(64) float sum_re[block], sum_im[block];
    for (int m = 0; m < block; ++m) sum_re[m] = sum_im[m] = 0;
    for (int line = 0; line < lines; ++line) {
        const double up = lines == 1 ? (seen.low + seen.high) / 2 : line == 0 ? seen.low : seen.high;
        OnPlane from(job, middle - reach, seen.slope, up), to(job, middle + reach, seen.slope, up);
        if (from.x * from.x + from.y * from.y > to.x * to.x + to.y * to.y) {
            const OnPlane other = from;
            from = to;
            to = other;
        }
        const double wx = to.x - from.x, wy = to.y - from.y, long_ = ::sqrt(wx * wx + wy * wy);
        const double ex = wx / long_, ey = wy / long_;
        const double half = (from.x + to.x) / 2 * ex + (from.y + to.y) / 2 * ey, aside = from.y * ex - from.x * ey;
        double angle = ::atan2(half * ey + aside * ex, half * ex - aside * ey) - image.angle0;
        angle -= 2 * pi * ::floor((angle - (static_cast<double>(image.rays) * image.dangle - 2 * pi) / 2) / (2 * pi));
        angle -= ::atan2(aside, half);
        const auto [low, stretches] = cross_rays<V, W>(tree, image, angle, aside, seen.nearest, seen.farthest, rooms);
        if (stretches <= 0) continue;
        const double behind = static_cast<double>(seen.base - low);
        const auto shift = V::set(static_cast<float>(behind - 0.5));
        for (int s = 0; s * V::n < count; ++s) {
            const int m = s * V::n;
            const auto n = V::add(V::load(seen.node + m), shift), k = V::sub(V::add(n, round), round);
            // a node less and two more: places that rounding takes for neighbours'
            const double first = ::floor(seen.least[s] + behind), last = ::floor(seen.most[s] + behind);
            std::int64_t begin = static_cast<std::int64_t>(first) - (W / 2 - 1) - 1;
            begin = begin < 0 ? 0 : begin > most ? most : begin;
            const auto own = V::sub(k, V::set(static_cast<float>(first - 1)));
            const float *re = rooms.even_re + begin, *im = rooms.even_im + begin;
            typename V::vec weight[W], a, b;
            weigh<V, W>(*tree.taps, V::sub(n, k), weight);
            const int wide = static_cast<int>(last - first) + W + 2;
            read_nodes<V, W>(re, im, own, weight, wide, a, b);
            auto share = V::load(seen.share + m);
            if (lines == 2) {
                const auto off = V::load(seen.off + m);
                share = V::mul(share, line == 0 ? V::sub(V::set(1), off) : off);
            }
            V::store(sum_re + m, V::fma(share, a, V::load(sum_re + m)));
            V::store(sum_im + m, V::fma(share, b, V::load(sum_im + m)));
        }
    }
    for (int m = 0; m < count; m += V::n) {
        typename V::vec sine, cosine;
        phase(V::load(seen.cycles + m), sine, cosine);
        const auto a = V::load(sum_re + m), b = V::load(sum_im + m);
        V::store(job.re + m, V::fnma(b, sine, V::mul(a, cosine)));
        V::store(job.im + m, V::fma(b, cosine, V::mul(a, sine)));
    }
}

template <class V, int W>
void read_column_of(const ColumnJob& job) {
    if (job.heights)
        read_relief<V, W>(job);
    else
        read_column<V, W>(job);
}

template <class V>
void column(const ColumnJob& job) {
    if (job.tree->taps->count == 6)
        read_column_of<V, 6>(job);
    else
        read_column_of<V, 8>(job);
}
