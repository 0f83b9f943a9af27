// Pixels of a straight line that leads away from a group, read from its sub-image as a parent's ray would be: across
// the rays where the line crosses arcs, then along the line. Included after factorised.inl.

// One vector of pixels read W taps wide from the nodes at `re` and `im`, from node k of each pixel on; `Windows`
// vectors in registers hold them all, or none (0).
template <class V, int W, int Windows>
void read_line(const float* re, const float* im, typename V::vec k, const typename V::vec (&weight)[W],
               typename V::vec& out_re, typename V::vec& out_im) {
    const auto round = V::set(magic<float>());
    out_re = out_im = V::set(0);
    for (int t = 0; t < W; ++t) {
        const auto at = V::number(V::add(V::add(k, V::set(static_cast<float>(t))), round));
        typename V::vec a, b;
        if constexpr (Windows == 0) {
            a = V::gather(re, at);
            b = V::gather(im, at);
        } else {
            a = V::template pick<Windows>(re, at);
            b = V::template pick<Windows>(im, at);
        }
        out_re = V::fma(weight[t], a, out_re);
        out_im = V::fma(weight[t], b, out_im);
    }
}

// The same by the fewest vectors that hold `reach` nodes.
template <class V, int W>
void read_nodes(const float* re, const float* im, typename V::vec k, const typename V::vec (&weight)[W], int reach,
                typename V::vec& out_re, typename V::vec& out_im) {
    constexpr int one = V::windows >= 1 ? 1 : 0, two = V::windows >= 2 ? 2 : 0, four = V::windows >= 4 ? 4 : 0;
    if (one && reach <= V::n)
        read_line<V, W, one>(re, im, k, weight, out_re, out_im);
    else if (two && reach <= 2 * V::n)
        read_line<V, W, two>(re, im, k, weight, out_re, out_im);
    else if (four && reach <= 4 * V::n)
        read_line<V, W, four>(re, im, k, weight, out_re, out_im);
    else
        read_line<V, W, 0>(re, im, k, weight, out_re, out_im);
}

template <class V, int W>
void read_column(const ColumnJob& job) {
    using D = Double;
    const Tree& tree = *job.tree;
    const Taps& taps = *tree.taps;
    const SubImage& image = *job.image;
    const Phase<V, 6> phase(tree.sine, tree.cosine);
    constexpr double pi = 3.14159265358979323846;
    const auto round = V::set(magic<float>());
    const double apart = ::sqrt(job.step[0] * job.step[0] + job.step[1] * job.step[1]);
    const double ex = job.step[0] / apart, ey = job.step[1] / apart;
    const double vx = job.first[0] - image.centre[0], vy = job.first[1] - image.centre[1];
    const double along = vx * ex + vy * ey, aside = vy * ex - vx * ey, height = image.centre[2] - image.plane;
    const double away2 = aside * aside + height * height;
    const auto seen = [&](std::int64_t pixel) {
        const double y = along + static_cast<double>(pixel) * apart;
        return ::sqrt(y * y + away2);
    };
    // of the line's middle pixel, whose bearing the rays hold; its direction may lie beside them all
    const double half = along + static_cast<double>(job.count - 1) / 2 * apart;
    double angle = ::atan2(half * ey + aside * ex, half * ex - aside * ey) - image.angle0;
    angle -= 2 * pi * ::floor((angle - (static_cast<double>(image.rays) * image.dangle - 2 * pi) / 2) / (2 * pi));
    angle -= ::atan2(aside, half);
    const LineRooms rooms(job.work, job.room);
    const auto [low, stretches] = cross_rays<V, W>(tree, image, angle, aside, seen(0), seen(job.count - 1), rooms);
    if (stretches <= 0) {
        for (std::int64_t m = 0; m < job.count; ++m) job.re[m] = job.im[m] = 0;
        return;
    }
    const int wide = job.stretch;
    alignas(64) float place[block];
    for (int m = 0; m < block; ++m) place[m] = m < wide && wide > 1 ? static_cast<float>(2.0 * m / (wide - 1) - 1) : 1;
    const auto wave = V::set(static_cast<float>(tree.wave * image.step));
    const std::int64_t most = job.room - W - 4 * V::n;
    Curves out;
    const std::int64_t parts = (job.count + wide - 1) / wide;
    for (std::int64_t s = 0; s < parts; s += tile_rows) {
        const int some = static_cast<int>(parts - s < tile_rows ? parts - s : tile_rows);
        for (int i = 0; i < some; i += D::n) {
            D::vec range[5];
            alignas(64) double at[D::n];
            for (int j = 0; j < 5; ++j) {
                for (int l = 0; l < D::n; ++l)
                    at[l] = along +
                            (static_cast<double>((s + i + l) * wide) + (tree.nodes.at[j] + 1) * (wide - 1) / 2) * apart;
                const auto y = D::load(at);
                range[j] = D::root(D::fma(y, y, D::set(away2)));
            }
            curve(tree.nodes, range, 1 / image.step, out, i);
        }
        for (int i = 0; i < some; ++i) {
            const double middle = out.middle[i] - static_cast<double>(low) - 0.5;
            const std::int64_t base = nearest_below(middle + 0.5), to = (s + i) * wide;
            const auto rest = V::set(static_cast<float>(middle - static_cast<double>(base)));
            const double cycles = out.middle[i] * image.step * tree.wave;
            const auto turned = V::set(static_cast<float>(cycles - ::floor(cycles + 0.5)));
            for (int m = 0; m < wide && to + m < job.count; m += V::n) {
                const auto moved = follow<V>(out, i, V::load(place + m));
                const auto n = V::add(moved, rest), k = V::sub(V::add(n, round), round);
                alignas(64) float each[V::n];
                V::store(each, k);
                const float first = each[0], last = each[V::n - 1];  // ranges grow
                // a node less and two more: places that rounding takes for neighbours'
                std::int64_t from = base + static_cast<std::int64_t>(first) - (W / 2 - 1) - 1;
                from = from < 0 ? 0 : from > most ? most : from;
                const auto own = V::sub(k, V::set(first - 1));
                const float *re = rooms.even_re + from, *im = rooms.even_im + from;
                typename V::vec weight[W], a, b, sine, cosine;
                weigh<V, W>(taps, V::sub(n, k), weight);
                const int reach = static_cast<int>(last - first) + W + 2;
                read_nodes<V, W>(re, im, own, weight, reach, a, b);
                const auto ph = V::fma(moved, wave, turned);
                phase(V::sub(ph, V::sub(V::add(ph, round), round)), sine, cosine);
                V::store(job.re + to + m, V::fnma(b, sine, V::mul(a, cosine)));
                V::store(job.im + to + m, V::fma(b, cosine, V::mul(a, sine)));
            }
        }
    }
}
