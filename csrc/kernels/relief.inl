// Pixels of a map: their heights off the lines of a tile. Included inside a namespace of one instruction set, after its
// vector types.

// Heights of a tile's pixels off its lines, in units of the largest.
template <class V>
struct Relief {
    static constexpr int subs = block / V::n;
    alignas(64) typename V::real height[tile_rows][block];
    alignas(64) double low[subs][tile_rows], high[subs][tile_rows];  // of vectors of pixels
    double most;                                                     // m
    double reach;                                                    // of pixels above and below their line's middle, m
    double steep;  // length of a fitted line, of what it is seen from above, at most

    // Give `lines` (rows, 6) the slopes and heights that are next to the pixels'.
    void fit(const Heights& heights, int rows, int count, double* lines) {
        using D = Double;
        alignas(64) double off[tile_rows][block];
        alignas(64) static constexpr double number[] = {0, 1, 2, 3, 4, 5, 6, 7};
        static_assert(D::n <= 8, "numbers of all lanes");
        most = reach = 0;
        steep = 1;
        for (int r = 0; r < rows; ++r) {
            const double* z = heights.z + r * heights.row;
            const double first = z[0], last = z[(count - 1) * heights.apart];
            const double slope = count > 1 ? (last - first) / (count - 1) : 0.0;
            double* to = off[r];
            if (heights.apart == 1) {
                for (int m = 0; m < count; ++m) to[m] = z[m];
            } else {
                for (int m = 0; m < count; ++m) to[m] = z[m * heights.apart];
            }
            for (int m = count; m < block; ++m) to[m] = last;
            D::vec least = D::set(0.0), largest = least;
            for (int m = 0; m < count; m += D::n) {
                const D::vec pixel = D::min(D::add(D::load(number), D::set(m)), D::set(count - 1));
                const D::vec above = D::sub(D::load(to + m), D::fma(pixel, D::set(slope), D::set(first)));
                D::store(to + m, above);
                least = D::min(least, above);
                largest = D::max(largest, above);
            }
            const double low_end = -D::largest(D::sub(D::set(0.0), least)), high_end = D::largest(largest);
            const double middle = (low_end + high_end) / 2, half = (high_end - low_end) / 2;
            const double dx = lines[6 * r + 3], dy = lines[6 * r + 4], square = dx * dx + dy * dy;
            if (slope != 0) {
                const double longer = square > 0 ? ::sqrt(1 + slope * slope / square) : HUGE_VAL;
                steep = longer > steep ? longer : steep;
            }
            lines[6 * r + 2] = first - heights.origin + middle;
            lines[6 * r + 5] = slope;
            for (int m = 0; m < count; m += D::n) D::store(to + m, D::sub(D::load(to + m), D::set(middle)));
            most = half > most ? half : most;
            const double rise = half + ::fabs(slope) * (count - 1) / 2;
            reach = rise > reach ? rise : reach;
        }
        const D::vec scale = D::set(most > 0 ? 1 / most : 0.0);
        for (int r = 0; r < tile_rows; ++r) {
            for (int s = 0; s < subs; ++s) {
                low[s][r] = high[s][r] = 0;
                if (r >= rows || s * V::n >= count) continue;
                D::vec least = D::set(2.0), largest = D::set(-2.0);
                for (int m = s * V::n; m < (s + 1) * V::n; m += D::n) {
                    // vectors run on behind the last pixel, whose height is repeated there
                    const D::vec value = m < count ? D::mul(D::load(off[r] + m), scale) : least;
                    D::store(height[r] + m, value);
                    if (m >= count) continue;
                    least = D::min(least, value);
                    largest = D::max(largest, value);
                }
                low[s][r] = -D::largest(D::sub(D::set(0.0), least));
                high[s][r] = D::largest(largest);
            }
        }
    }

    // Distance from which polynomials in height hold, and those along lines that hold from `level` on where lines are
    // level: these are wrong by the N-th power of a line's length, over the (N - 1)-th of the distance.
    double near(const Rise& rise, double level) const {
        if (reach > rise.highest || !(steep < HUGE_VAL)) return HUGE_VAL;
        const double cubic = rise.cubic * most * ::sqrt(most), fading = rise.fading * most;
        const double height = cubic > fading ? cubic : fading, along = level * steep * ::sqrt(::sqrt(steep));
        return height > along ? height : along;
    }
};
