// Sensor values to views, tile by tile: flat field, lenses read, lens kernel, colour. Twin: lenslet.py.
//
// A tile of view pixels needs a patch of the sensor; the patch is flat-fielded, each of its lenses is read at every
// view's offset (colours and fraction of a pixel at once), and each view pixel is a weighted sum over the lenses around
// it. Nothing but the views leaves the cache.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

template <class T, size_t N>
using Array = ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class T, size_t N>
using Output = ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

constexpr int TILE = 64;     // view columns
constexpr int CHANNELS = 4;  // red, green, blue, weight
constexpr int REACH = 2;     // of a reading [px]
constexpr int SIDE = 2 * REACH + 1;
constexpr int TAPS = SIDE * SIDE;

struct Sensor {
    const uint16_t *values, *modulation;
    int width, height;
    int colour[4];  // of the 2x2 cell: 0 red, 1 green, 2 blue
    float black[4], scale[4], saturated[4];
    float unit, floor, dark;  // of the modulation
    const int32_t *hot;       // (x, y) sorted by y, then x
    int hot_count;
};

struct Lenses {
    double ox, oy, along_x, along_y, up_x, up_y;  // origin, step of i, step of j without its half shift
    const float *offsets;                         // [views, 2] sensor px
    const float *reading;                         // [4, bins, bins, views, TAPS, CHANNELS]
    int views, bins;
};

struct Patch {
    int x0, y0, width, height;  // in the sensor; beyond its border the pixels are mirrored
    std::vector<float> light;   // [height, width, CHANNELS]: the value three times, and its weight
};

inline int mirrored(int i, int n) { return i < 0 ? -i : (i >= n ? 2 * n - 2 - i : i); }

inline int cell(int x, int y) { return 2 * (y & 1) + (x & 1); }

inline float flat(const Sensor &s, int x, int y) {
    const int k = cell(x, y);
    const size_t at = size_t(y) * s.width + x;
    return (float(s.values[at]) - s.black[k]) * s.scale[k] / std::max(float(s.modulation[at]) * s.unit, s.floor);
}

inline bool is_hot(const Sensor &s, int x, int y) {
    int lo = 0, hi = s.hot_count;
    while (lo < hi) {
        const int mid = (lo + hi) / 2, hx = s.hot[2 * mid], hy = s.hot[2 * mid + 1];
        if (hy < y || (hy == y && hx < x)) lo = mid + 1;
        else hi = mid;
    }
    return lo < s.hot_count && s.hot[2 * lo] == x && s.hot[2 * lo + 1] == y;
}

// Mean of the nearest pixels of the same colour that are not hot themselves.
float without_hot(const Sensor &s, int x, int y) {
    static const int steps[4][2] = {{-2, 0}, {2, 0}, {0, -2}, {0, 2}};
    float sum = 0;
    int count = 0;
    for (const auto &step : steps) {
        const int nx = mirrored(x + step[0], s.width), ny = mirrored(y + step[1], s.height);
        if (is_hot(s, nx, ny)) continue;
        sum += flat(s, nx, ny);
        ++count;
    }
    return count ? sum / float(count) : flat(s, x, y);
}

// One row of flat-fielded mosaic and of weight, x from x0 to x0 + width, borders mirrored.
LFRIG_CLONES void develop_row(const Sensor &s, int x0, int y, int width, float *mosaic, float *weight) {
    const int row = mirrored(y, s.height);
    const int from = std::max(x0, 0), to = std::min(x0 + width, s.width);
    const uint16_t *values = s.values + size_t(row) * s.width, *modulation = s.modulation + size_t(row) * s.width;
    for (int parity = 0; parity < 2; ++parity) {
        const int k = 2 * (row & 1) + parity;
        const float black = s.black[k], scale = s.scale[k], saturated = s.saturated[k];
        for (int x = from + ((from ^ parity) & 1); x < to; x += 2) {
            const float value = float(values[x]), m = float(modulation[x]) * s.unit;
            mosaic[x - x0] = (value - black) * scale / std::max(m, s.floor);
            weight[x - x0] = value < saturated && m >= s.dark ? std::min(m, 1.0f) : 0.0f;
        }
    }
    for (int x = x0; x < from; ++x) {
        mosaic[x - x0] = mosaic[mirrored(x, s.width) - x0];
        weight[x - x0] = weight[mirrored(x, s.width) - x0];
    }
    for (int x = to; x < x0 + width; ++x) {
        mosaic[x - x0] = mosaic[mirrored(x, s.width) - x0];
        weight[x - x0] = weight[mirrored(x, s.width) - x0];
    }
}

// Hot pixels of the patch, and their mirror images beyond the sensor's border.
void replace_hot(const Sensor &s, Patch &patch) {
    for (int n = 0; n < s.hot_count; ++n) {
        const int x = s.hot[2 * n], y = s.hot[2 * n + 1];
        const int xs[3] = {x, -x, 2 * (s.width - 1) - x}, ys[3] = {y, -y, 2 * (s.height - 1) - y};
        for (int my : ys) {
            const int py = my - patch.y0;
            if (py < 0 || py >= patch.height) continue;
            for (int mx : xs) {
                const int px = mx - patch.x0;
                if (px < 0 || px >= patch.width) continue;
                float *at = &patch.light[(size_t(py) * patch.width + px) * CHANNELS];
                at[0] = at[1] = at[2] = without_hot(s, x, y);
                at[3] = 0;
            }
        }
    }
}

void develop(const Sensor &s, Patch &patch) {
    std::vector<float> mosaic(patch.width), weight(patch.width);
    patch.light.resize(size_t(patch.width) * patch.height * CHANNELS);
    for (int y = 0; y < patch.height; ++y) {
        develop_row(s, patch.x0, patch.y0 + y, patch.width, mosaic.data(), weight.data());
        float *out = &patch.light[size_t(y) * patch.width * CHANNELS];
        for (int x = 0; x < patch.width; ++x, out += CHANNELS) {
            out[0] = out[1] = out[2] = mosaic[x];
            out[3] = weight[x];
        }
    }
    replace_hot(s, patch);
}

// A position beyond the sensor moves inwards by whole lenses: there the same view is seen, a pixel or two away.
bool inside(const Sensor &s, const Lenses &l, double &x, double &y) {
    bool in = true;
    for (int n = 0; n < 16; ++n) {
        if (x < 0) x += l.along_x, y += l.along_y;
        else if (x > s.width - 1) x -= l.along_x, y -= l.along_y;
        else if (y < 0) x += 2 * l.up_x, y += 2 * l.up_y;
        else if (y > s.height - 1) x -= 2 * l.up_x, y -= 2 * l.up_y;
        else return in;
        in = false;
    }
    x = std::min(std::max(x, 0.0), double(s.width - 1));
    y = std::min(std::max(y, 0.0), double(s.height - 1));
    return false;
}

struct LensBlock {
    int i0, i1, j0, j1;  // inclusive
    int columns() const { return i1 - i0 + 1; }
    int rows() const { return j1 - j0 + 1; }
};

inline void centre(const Lenses &l, int i, int j, double &x, double &y) {
    const double across = i + 0.5 * (j & 1);
    x = l.ox + across * l.along_x + j * l.up_x;
    y = l.oy + across * l.along_y + j * l.up_y;
}

// The part of the sensor that the block's lenses are read from.
Patch patch_of(const Sensor &s, const Lenses &l, const LensBlock &block) {
    double low[2] = {1e30, 1e30}, high[2] = {-1e30, -1e30};
    float reach = 0;
    for (int v = 0; v < 2 * l.views; ++v) reach = std::max(reach, std::fabs(l.offsets[v]));
    for (int corner = 0; corner < 4; ++corner)
        for (int half = 0; half < 2; ++half) {  // the shift of odd rows
            double at[2];
            const int j = corner & 2 ? block.j1 : block.j0;
            const double across = (corner & 1 ? block.i1 : block.i0) + 0.5 * half;
            at[0] = l.ox + across * l.along_x + j * l.up_x;
            at[1] = l.oy + across * l.along_y + j * l.up_y;
            for (int k = 0; k < 2; ++k) low[k] = std::min(low[k], at[k]), high[k] = std::max(high[k], at[k]);
        }
    const double extra = 3 * std::hypot(l.along_x, l.along_y);  // where `inside` may go from beyond a border
    const int size[2] = {s.width, s.height};
    int from[2], to[2];
    for (int k = 0; k < 2; ++k) {
        double a = low[k] - reach - 1, b = high[k] + reach + 2;
        if (a < 1) b = std::max(b, extra);
        if (b > size[k] - 2) a = std::min(a, size[k] - 1 - extra);
        from[k] = std::min(std::max(int(std::floor(a)), 0), size[k] - 1) - REACH;
        to[k] = std::min(std::max(int(std::ceil(b)), 0), size[k] - 1) + REACH;
    }
    return Patch{from[0], from[1], to[0] - from[0] + 1, to[1] - from[1] + 1, {}};
}

// The pixels around a point, weighted: red, green, blue, weight. A column of pixels at a time has its own sums, so that
// they do not wait for each other.
inline void read_point(const float *p, size_t pitch, const float *weights, float *out) {
    constexpr int WIDE = SIDE * CHANNELS;
    float sum[WIDE];
    for (int k = 0; k < WIDE; ++k) sum[k] = weights[k] * p[k];
    for (int dy = 1; dy < SIDE; ++dy)
        for (int k = 0; k < WIDE; ++k) sum[k] += weights[dy * WIDE + k] * p[dy * pitch + k];
    for (int c = 0; c < CHANNELS; ++c) {
        float total = sum[c];
        for (int k = CHANNELS; k < WIDE; k += CHANNELS) total += sum[k + c];
        out[c] = total;
    }
}

// Every lens of the block at every view's offset: out [rows, columns, views, CHANNELS].
LFRIG_CLONES void read_lenses(const Sensor &s, const Lenses &l, const LensBlock &block, const Patch &patch, float *out) {
    const size_t per_view = size_t(TAPS) * CHANNELS, per_bin = per_view * l.views;
    for (int j = block.j0; j <= block.j1; ++j)
        for (int i = block.i0; i <= block.i1; ++i) {
            double cx, cy;
            centre(l, i, j, cx, cy);
            for (int v = 0; v < l.views; ++v, out += CHANNELS) {
                double x = cx + l.offsets[2 * v], y = cy + l.offsets[2 * v + 1];
                const bool in = inside(s, l, x, y);
                const int ix = int(x + 0.5), iy = int(y + 0.5);  // the nearest pixel, and where in it the point lies
                const int bx = std::min(int((x + 0.5 - ix) * l.bins), l.bins - 1);
                const int by = std::min(int((y + 0.5 - iy) * l.bins), l.bins - 1);
                const size_t bin = (size_t(cell(ix, iy)) * l.bins + by) * l.bins + bx;
                const int px = std::min(std::max(ix - REACH - patch.x0, 0), patch.width - SIDE);
                const int py = std::min(std::max(iy - REACH - patch.y0, 0), patch.height - SIDE);
                read_point(&patch.light[(size_t(py) * patch.width + px) * CHANNELS], size_t(patch.width) * CHANNELS,
                           l.reading + bin * per_bin + v * per_view, out);
                if (!in) out[3] = 0;
            }
        }
}

LFRIG_CLONES void accumulate(float *sum, const float *lens, float weight, int count) {
    for (int k = 0; k < count; ++k) sum[k] += weight * lens[k];
}

struct Target {
    int width, height, taps, lut_size;
    const int32_t *lens;  // [height, taps, 2]: i at x = 0, and j
    const float *kernel;  // [height, taps]
    const float *matrix;  // [3, 3]
    const uint8_t *lut;
    uint8_t *views, *weight;
    float *linear;  // or null
};

inline float clamp01(float v) { return v < 0.0f ? 0.0f : (v > 1.0f ? 1.0f : v); }

void write_pixel(const Target &t, const float *sum, int views, int x, int y) {
    const float *m = t.matrix, top = float(t.lut_size - 1);
    for (int v = 0; v < views; ++v, sum += CHANNELS) {
        const size_t at = (size_t(v) * t.height + y) * t.width + x;
        // Clipped before the matrix: a channel that the sensor clipped would tint the others.
        const float r = std::min(sum[0], 1.0f), g = std::min(sum[1], 1.0f), b = std::min(sum[2], 1.0f);
        for (int c = 0; c < 3; ++c) {
            const float value = m[3 * c] * r + m[3 * c + 1] * g + m[3 * c + 2] * b;
            t.views[3 * at + c] = t.lut[int(clamp01(value) * top + 0.5f)];
        }
        t.weight[at] = uint8_t(clamp01(sum[3]) * 255.0f + 0.5f);
        if (t.linear)
            for (int c = 0; c < 3; ++c)
                t.linear[3 * at + c] = m[3 * c] * sum[0] + m[3 * c + 1] * sum[1] + m[3 * c + 2] * sum[2];
    }
}

void decode_tile(const Sensor &s, const Lenses &l, const Target &t, int x0, int x1, int y0, int y1) {
    LensBlock block{INT32_MAX, INT32_MIN, INT32_MAX, INT32_MIN};
    for (int k = y0 * t.taps; k < y1 * t.taps; ++k) {
        block.i0 = std::min(block.i0, t.lens[2 * k] + x0), block.i1 = std::max(block.i1, t.lens[2 * k] + x1 - 1);
        block.j0 = std::min(block.j0, t.lens[2 * k + 1]), block.j1 = std::max(block.j1, t.lens[2 * k + 1]);
    }
    Patch patch = patch_of(s, l, block);
    develop(s, patch);
    const int count = l.views * CHANNELS;
    std::vector<float> lenses(size_t(block.rows()) * block.columns() * count), sum(count);
    read_lenses(s, l, block, patch, lenses.data());
    for (int y = y0; y < y1; ++y)
        for (int x = x0; x < x1; ++x) {
            std::fill(sum.begin(), sum.end(), 0.0f);
            for (int k = y * t.taps; k < (y + 1) * t.taps; ++k) {
                const int i = t.lens[2 * k] + x - block.i0, j = t.lens[2 * k + 1] - block.j0;
                accumulate(sum.data(), &lenses[(size_t(j) * block.columns() + i) * count], t.kernel[k], count);
            }
            write_pixel(t, sum.data(), l.views, x, y);
        }
}

// Decodes view rows y0..y1 of all views. `cells` [4, 4]: colour, black, scale, saturated of each pixel of the 2x2
// cell. `levels`: unit, floor and dark of the modulation. `lattice`: origin, step of i, step of j.
void decode_rows(Array<uint16_t, 2> values, Array<uint16_t, 2> modulation, Array<float, 2> cells,
                 Array<float, 1> levels, Array<int32_t, 2> hot, Array<double, 1> lattice, Array<float, 2> offsets,
                 Array<float, 6> reading, Array<int32_t, 3> lens, Array<float, 2> kernel, Array<float, 2> matrix, Array<uint8_t, 1> lut,
                 Output<uint8_t, 4> views, Output<uint8_t, 3> weight, nb::object linear, int y0, int y1, int threads) {
    Sensor s{};
    s.values = values.data(), s.modulation = modulation.data();
    s.width = int(values.shape(1)), s.height = int(values.shape(0));
    const int height = int(lens.shape(0)), taps = int(lens.shape(1)), count = int(offsets.shape(0));
    const int width = int(views.shape(2));
    if (modulation.shape(0) != values.shape(0) || modulation.shape(1) != values.shape(1) || cells.shape(0) != 4 ||
        cells.shape(1) != 4 || levels.shape(0) != 3 || hot.shape(1) != 2 || lattice.shape(0) != 6 ||
        offsets.shape(1) != 2 || reading.shape(0) != 4 || reading.shape(1) != reading.shape(2) ||
        int(reading.shape(3)) != count || reading.shape(4) != TAPS || reading.shape(5) != CHANNELS || lens.shape(2) != 2 || int(kernel.shape(0)) != height ||
        int(kernel.shape(1)) != taps || matrix.shape(0) != 3 || matrix.shape(1) != 3 || lut.shape(0) < 2 ||
        int(views.shape(0)) != count || int(views.shape(1)) != height || views.shape(3) != 3 ||
        int(weight.shape(0)) != count || int(weight.shape(1)) != height || int(weight.shape(2)) != width || y0 < 0 ||
        y1 > height || s.width < 8 || s.height < 8)
        throw std::invalid_argument("decode_rows: shapes do not match");
    for (int k = 0; k < 4; ++k) {
        const float *row = cells.data() + 4 * k;
        s.colour[k] = int(row[0]), s.black[k] = row[1], s.scale[k] = row[2], s.saturated[k] = row[3];
        if (s.colour[k] < 0 || s.colour[k] > 2) throw std::invalid_argument("decode_rows: unknown colour");
    }
    s.unit = levels.data()[0], s.floor = levels.data()[1], s.dark = levels.data()[2];
    s.hot = hot.data(), s.hot_count = int(hot.shape(0));
    const double *d = lattice.data();
    const Lenses l{d[0], d[1], d[2], d[3], d[4], d[5], offsets.data(), reading.data(), count,
                   int(reading.shape(1))};
    Target t{width, height, taps, int(lut.shape(0)), lens.data(), kernel.data(), matrix.data(), lut.data(),
             views.data(), weight.data(), nullptr};
    if (!linear.is_none()) {
        auto out = nb::cast<Output<float, 4>>(linear);
        if (out.size() != views.size()) throw std::invalid_argument("decode_rows: shapes do not match");
        t.linear = out.data();
    }
    nb::gil_scoped_release release;
    lfrig::parallel_for((width + TILE - 1) / TILE, threads, [&](int tile) {
        decode_tile(s, l, t, tile * TILE, std::min(width, (tile + 1) * TILE), y0, y1);
    });
}

}  // namespace

void register_lenslet(nb::module_ &m) {
    m.def("decode_rows", &decode_rows, nb::arg("values").noconvert(), nb::arg("modulation").noconvert(),
          nb::arg("cells").noconvert(), nb::arg("levels").noconvert(), nb::arg("hot").noconvert(),
          nb::arg("lattice").noconvert(), nb::arg("offsets").noconvert(), nb::arg("reading").noconvert(), nb::arg("lens").noconvert(),
          nb::arg("kernel").noconvert(), nb::arg("matrix").noconvert(), nb::arg("lut").noconvert(),
          nb::arg("views").noconvert(), nb::arg("weight").noconvert(), nb::arg("linear").none(), nb::arg("y0"),
          nb::arg("y1"), nb::arg("threads"));
}
