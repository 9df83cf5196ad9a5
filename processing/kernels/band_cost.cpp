// Wide-baseline matching in a narrow band: slanted, bilateral ZNCC of the photo against the sources. Twin: band_cost.py.
//
// Every pixel is sampled once, in a row of slots along its epipolar line, one label apart and centred on its own
// inverse depth. A patch reads the rows of its pixels, each shifted by where the patch's plane passes that pixel:
// a label costs one gather instead of one per tap. Rows live in a ring of lines, one per tile and source.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "parts/band_patches.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kMaxLabels = 128, kMaxSide = 21;  // places of the taps' grid along one side
constexpr int kGroup = 7;  // taps that are summed together
constexpr int kTile = 2 * kRun, kTileLines = 64;

struct View {
    int height, width;
    std::vector<uint32_t> squares;  // [Hs, Ws] grey levels of a pixel, its right, lower and lower right neighbour
    std::vector<uint8_t> wanted;    // [H, W] whether a patch reads the pixel's row
    const float *visible;           // [H, W] 0..1
    float map[12];                  // A row-major, then b: p = A (x, y, 1) + b w
    float noise;

    // p at inverse depth w
    void place(int x, int y, float w, float *p) const {
        const float fx = float(x), fy = float(y), *b = map + 9;
        for (int i = 0; i < 3; ++i) p[i] = map[3 * i] * fx + map[3 * i + 1] * fy + map[3 * i + 2] + b[i] * w;
    }
};

// ---- rows of slots -------------------------------------------------------------------------------------------------

// Samples at p = start + k * move, k < slots; beyond its rim a picture goes on as it is there.
LFRIG_CLONES void sample(const uint32_t *__restrict squares, int width, float right, float bottom, const float *start,
                         const float *move, int slots, float *__restrict row) {
    const float x0 = start[0], y0 = start[1], z0 = start[2], xs = move[0], ys = move[1], zs = move[2];
    for (int k = 0; k < slots; ++k) {
        const float inverse = 1.0f / (z0 + float(k) * zs);
        float u = (x0 + float(k) * xs) * inverse, v = (y0 + float(k) * ys) * inverse;
        u = u > 0.0f ? u : 0.0f;  // NaN too
        v = v > 0.0f ? v : 0.0f;
        u = u < right ? u : right;
        v = v < bottom ? v : bottom;
        const int iu = int(u), iv = int(v), p = iv * width + iu;
        const float fu = u - float(iu), fv = v - float(iv);
        const uint32_t four = squares[p];
        const float a = float(int(four & 0xffu)), b = float(int((four >> 8) & 0xffu));
        const float c = float(int((four >> 16) & 0xffu)), d = float(int(four >> 24));
        const float top = a + fu * (b - a), low = c + fu * (d - c);
        row[k] = top + fv * (low - top);
    }
}

// Rows of the pixels [x0, x1) of line y.
void sample_line(const Band &s, const View &v, int y, int x0, int x1, float *rows) {
    const float right = float(v.width) - 1.001f, bottom = float(v.height) - 1.001f;
    const float move[3] = {v.map[9] * s.step, v.map[10] * s.step, v.map[11] * s.step};
    for (int x = x0; x < x1; ++x, rows += s.slots) {
        const size_t i = size_t(y) * s.width + x;
        if (!v.wanted[i]) continue;
        float start[3];
        v.place(x, y, s.depth[i] - float(s.reach + s.labels / 2) * s.step, start);
        sample(v.squares.data(), v.width, right, bottom, start, move, s.slots, rows);
    }
}

// ---- correlation ---------------------------------------------------------------------------------------------------

struct Match {  // of one pixel with one source
    int groups, labels;
    float mass, own, noise, cap, weight, right, bottom;  // own: the patch's variance, noise included
    float start[3], move[3];
};

// Adds weight * cost of every label to `total`. Tap n of the patch reads its row at rows + offset[n] and its numbers at
// n * kRun.
LFRIG_CLONES void correlate(const float *rows, const int32_t *offset, const float *weight, const float *product,
                            const float *fraction, const Match &m, float *__restrict total) {
    alignas(64) float first[kMaxLabels], second[kMaxLabels], cross[kMaxLabels];
    for (int k = 0; k < m.labels; ++k) first[k] = second[k] = cross[k] = 0.0f;
    for (int g = 0; g < m.groups; ++g, offset += kGroup) {
        static_assert(kGroup == 7, "the taps of a group are written out");
        const float *w = weight + g * kGroup * kRun, *p = product + g * kGroup * kRun, *f = fraction + g * kGroup * kRun;
        const float *r0 = rows + offset[0];
        const float w0 = w[0 * kRun], p0 = p[0 * kRun], f0 = f[0 * kRun];
        const float *r1 = rows + offset[1];
        const float w1 = w[1 * kRun], p1 = p[1 * kRun], f1 = f[1 * kRun];
        const float *r2 = rows + offset[2];
        const float w2 = w[2 * kRun], p2 = p[2 * kRun], f2 = f[2 * kRun];
        const float *r3 = rows + offset[3];
        const float w3 = w[3 * kRun], p3 = p[3 * kRun], f3 = f[3 * kRun];
        const float *r4 = rows + offset[4];
        const float w4 = w[4 * kRun], p4 = p[4 * kRun], f4 = f[4 * kRun];
        const float *r5 = rows + offset[5];
        const float w5 = w[5 * kRun], p5 = p[5 * kRun], f5 = f[5 * kRun];
        const float *r6 = rows + offset[6];
        const float w6 = w[6 * kRun], p6 = p[6 * kRun], f6 = f[6 * kRun];
#pragma GCC ivdep
        for (int k = 0; k < m.labels; ++k) {
            const float a = r0[k] + f0 * (r0[k + 1] - r0[k]), wa = w0 * a;
            const float b = r1[k] + f1 * (r1[k + 1] - r1[k]), wb = w1 * b;
            const float c = r2[k] + f2 * (r2[k + 1] - r2[k]), wc = w2 * c;
            const float d = r3[k] + f3 * (r3[k + 1] - r3[k]), wd = w3 * d;
            const float e = r4[k] + f4 * (r4[k + 1] - r4[k]), we = w4 * e;
            const float h = r5[k] + f5 * (r5[k + 1] - r5[k]), wh = w5 * h;
            const float o = r6[k] + f6 * (r6[k + 1] - r6[k]), wo = w6 * o;
            first[k] += (((((wa + wb) + wc) + wd) + we) + wh) + wo;
            second[k] += (((((wa * a + wb * b) + wc * c) + wd * d) + we * e) + wh * h) + wo * o;
            cross[k] += (((((p0 * a + p1 * b) + p2 * c) + p3 * d) + p4 * e) + p5 * h) + p6 * o;
        }
    }
    const float inverse = 1.0f / m.mass;
#pragma GCC ivdep
    for (int k = 0; k < m.labels; ++k) {
        const float z = m.start[2] + float(k) * m.move[2];
        const float u = (m.start[0] + float(k) * m.move[0]) / z, v = (m.start[1] + float(k) * m.move[1]) / z;
        const int inside = (z > 1e-6f) & (u >= 0.0f) & (v >= 0.0f) & (u <= m.right) & (v <= m.bottom);
        const float mean = first[k] * inverse, square = second[k] * inverse - mean * mean;
        const float other = (square > 0.0f ? square : 0.0f) + m.noise;
        const float cost = 1.0f - cross[k] * inverse / std::sqrt(other * m.own);
        total[k] += m.weight * (inside & (cost < m.cap) ? cost : m.cap);
    }
}

// What one thread works with on one tile.
struct Workspace {
    Patches patches;
    std::vector<float> rings, total;     // rings: [sources, lines, kTile + 2 radius, slots]; total: [kRun, labels]
    std::vector<int32_t> place, offset;  // of every tap in a ring: its pixel's row, and where it is read
    int lines, columns;

    Workspace(const Band &s, size_t sources, int taps)
        : patches(taps), place(size_t(taps)), offset(size_t(taps)), lines(2 * s.radius + 1),
          columns(kTile + 2 * s.radius) {
        rings.assign(sources * size_t(lines) * columns * s.slots, 0.0f);
        total.resize(size_t(kRun) * s.labels);
    }

    int32_t line(const Band &s, int y) const { return y % lines * columns * s.slots; }

    float *ring(const Band &s, size_t source) { return rings.data() + source * size_t(lines) * columns * s.slots; }
};

// Adds the costs of the run [x, x + width) of line y; `x0` is the first pixel of the ring.
void match_run(const Band &s, const std::vector<View> &views, int y, int x, int width, int x0, int taps,
               Workspace &w) {
    const Patches &t = w.patches;
    const int32_t own = w.line(s, y);
    std::fill(w.place.begin(), w.place.end(), own);
    for (size_t n = 0; n < s.taps.size(); ++n) {
        const Tap tap = s.taps[n];
        // Lines beyond the frame are not in the ring; their weight is 0.
        if (y + tap.dy >= 0 && y + tap.dy < s.height) w.place[n] = w.line(s, y + tap.dy) + tap.dx * s.slots;
    }
    Match m{taps / kGroup, s.labels, 0, 0, 0, s.cap, 0, 0, 0, {}, {}};
    for (int i = 0; i < width; ++i) {
        const size_t p = size_t(y) * s.width + x + i;
        for (size_t n = 0; n < size_t(taps); ++n)
            w.offset[n] = (t.weight[n * kRun + i] > 0.0f ? w.place[n] : own) + t.slot[n * kRun + i];
        for (size_t source = 0; source < views.size(); ++source) {
            const View &v = views[source];
            if (!(v.visible[p] > s.least)) continue;
            m.mass = t.mass[i], m.own = t.variance[i] + v.noise, m.noise = v.noise, m.weight = v.visible[p];
            m.right = float(v.width - 1), m.bottom = float(v.height - 1);
            for (int c = 0; c < 3; ++c) m.move[c] = v.map[9 + c] * s.step;
            v.place(x + i, y, s.depth[p] - float(s.labels / 2) * s.step, m.start);
            correlate(w.ring(s, source) + size_t(x + i - x0) * s.slots, w.offset.data(), &t.weight[i], &t.product[i],
                      &t.fraction[i], m, &w.total[size_t(i) * s.labels]);
        }
    }
}

LFRIG_CLONES void pack(const float *__restrict total, float scale, float offset, int labels, uint16_t *__restrict out) {
    for (int k = 0; k < labels; ++k) out[k] = uint16_t(int(total[k] * scale + offset));
}

// The mean over the sources that see a pixel, as fixed point; the cap where none does.
void store(const Band &s, const std::vector<View> &views, size_t p, const float *total, uint16_t *out) {
    float seen = 0;
    for (const View &v : views) seen += v.visible[p] > s.least ? v.visible[p] : 0.0f;
    const bool any = seen > 0.0f;
    const float scale = any ? s.unit / seen : 0.0f, offset = any ? 0.5f : s.cap * s.unit + 0.5f;
    pack(total, scale, offset, s.labels, out);
}

void match_tile(const Band &s, const std::vector<View> &views, int x0, int y0, int taps, uint16_t *out) {
    const int x1 = std::min(x0 + kTile, s.width), y1 = std::min(y0 + kTileLines, s.height);
    const int left = std::max(0, x0 - s.radius), right = std::min(s.width, x1 + s.radius);
    Workspace w(s, views.size(), taps);
    for (int y = y0; y < y1; ++y) {
        const int newest = std::min(s.height, y + s.radius + 1);
        for (int line = y == y0 ? std::max(0, y - s.radius) : y + s.radius; line < newest; ++line)
            for (size_t n = 0; n < views.size(); ++n)
                sample_line(s, views[n], line, left, right,
                            w.ring(s, n) + w.line(s, line) + (left - x0 + s.radius) * s.slots);
        for (int x = x0; x < x1; x += kRun) {
            const int width = std::min(kRun, x1 - x);
            const size_t p = size_t(y) * s.width + x;
            bool seen = false;
            for (const View &v : views)
                for (int i = 0; i < width; ++i) seen |= v.visible[p + i] > s.least;
            std::fill(w.total.begin(), w.total.end(), 0.0f);
            if (seen) {
                collect(s, y, x, width, w.patches);
                match_run(s, views, y, x, width, x0 - s.radius, taps, w);
            }
            for (int i = 0; i < width; ++i)
                store(s, views, p + i, &w.total[size_t(i) * s.labels], out + (p + i) * s.labels);
        }
    }
}

// Grey levels of every square of four pixels, as bytes: one read per sample. NaN is black.
std::vector<uint32_t> squared(const float *image, int height, int width) {
    std::vector<uint32_t> out(size_t(height) * width);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const size_t p = size_t(y) * width + x;
            const float level = image[p] + 0.5f;
            const uint32_t held = level > 0.0f ? uint32_t(level < 255.0f ? level : 255.0f) : 0;
            out[p] |= held;
            if (x > 0) out[p - 1] |= held << 8;
            if (y > 0) out[p - width] |= held << 16;
            if (x > 0 && y > 0) out[p - width - 1] |= held << 24;
        }
    return out;
}

// Pixels within `radius` of one that is visible.
std::vector<uint8_t> reached(const float *visible, float least, int height, int width, int radius) {
    std::vector<uint8_t> across(size_t(height) * width), out(across.size());
    for (int y = 0; y < height; ++y)
        for (int x = 0, until = -1; x < width + radius; ++x) {
            if (x < width && visible[size_t(y) * width + x] > least) until = x + radius;
            if (x < width && x <= until) across[size_t(y) * width + x] = 1;
            // What is visible at x reaches back to x - radius.
            if (x < width && until == x + radius)
                for (int k = std::max(0, x - radius); k < x; ++k) across[size_t(y) * width + k] = 1;
        }
    for (int y = 0; y < height; ++y)
        for (int k = std::max(0, y - radius); k <= std::min(height - 1, y + radius); ++k)
            for (int x = 0; x < width; ++x) out[size_t(y) * width + x] |= across[size_t(k) * width + x];
    return out;
}

using F1 = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using U3 = ndarray<const uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using O3 = ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

void pad(Band &s, const float *photo, const uint8_t *guide) {
    const size_t high = size_t(s.height) + 2 * s.radius, wide = size_t(s.width) + 2 * s.radius, area = high * wide;
    s.padded.assign(5 * area, 0.0f);
    std::fill(s.padded.begin() + ptrdiff_t(4 * area), s.padded.end(), std::numeric_limits<float>::quiet_NaN());
    for (int y = 0; y < s.height; ++y)
        for (int x = 0; x < s.width; ++x) {
            const size_t from = size_t(y) * s.width + x, to = size_t(y + s.radius) * wide + size_t(x + s.radius);
            s.padded[to] = photo[from];
            for (int c = 0; c < 3; ++c) s.padded[size_t(1 + c) * area + to] = float(guide[3 * from + c]);
            s.padded[4 * area + to] = s.depth[from];
        }
}

// images: float32 [Hs, Ws] per source; maps float32 [12] per source; see band_cost.py.
void band_cost(F2 photo, U3 guide, const std::vector<F2> &images, const std::vector<F2> &visible,
               const std::vector<F1> &maps, const std::vector<float> &noises, F2 depth, F2 slope_x, F2 slope_y,
               float step, int radius, int stride, int reach, float sigma_grey, float cap, float least, float unit,
               O3 out, int threads) {
    Band s{};
    s.height = int(photo.shape(0)), s.width = int(photo.shape(1)), s.labels = int(out.shape(2));
    s.reach = reach, s.slots = s.labels + 2 * reach, s.radius = radius;
    s.depth = depth.data(), s.slope_x = slope_x.data(), s.slope_y = slope_y.data();
    s.step = step, s.sigma_grey = sigma_grey, s.cap = cap, s.least = least, s.unit = unit;
    const auto same = [&](const F2 &m) { return int(m.shape(0)) == s.height && int(m.shape(1)) == s.width; };
    const int side = stride > 0 ? 2 * radius / stride + 1 : 0;
    if (s.labels < 1 || s.labels > kMaxLabels || side < 1 || side > kMaxSide || radius < 1 || reach < 1)
        throw std::invalid_argument("band_cost: too many labels or taps");
    if (!same(depth) || !same(slope_x) || !same(slope_y) || int(guide.shape(0)) != s.height ||
        int(guide.shape(1)) != s.width || guide.shape(2) != 3 || int(out.shape(0)) != s.height ||
        int(out.shape(1)) != s.width || visible.size() != images.size() || maps.size() != images.size() ||
        noises.size() != images.size())
        throw std::invalid_argument("band_cost: shapes do not match");
    for (size_t n = 0; n < images.size(); ++n)
        if (!same(visible[n]) || maps[n].shape(0) != 12 || images[n].shape(0) < 2 || images[n].shape(1) < 2)
            throw std::invalid_argument("band_cost: shapes do not match");
    const float *grey = photo.data();
    const uint8_t *colours = guide.data();
    uint16_t *cost = out.data();
    s.taps = chessboard(radius, stride);
    const int taps = (int(s.taps.size()) + kGroup - 1) / kGroup * kGroup;
    const int across = (s.width + kTile - 1) / kTile, down = (s.height + kTileLines - 1) / kTileLines;
    std::vector<View> views(images.size());
    nb::gil_scoped_release release;
    pad(s, grey, colours);
    lfrig::parallel_for(int(views.size()), threads, [&](int n) {
        View &v = views[size_t(n)];
        v.height = int(images[size_t(n)].shape(0)), v.width = int(images[size_t(n)].shape(1));
        v.visible = visible[size_t(n)].data(), v.noise = noises[size_t(n)];
        std::copy(maps[size_t(n)].data(), maps[size_t(n)].data() + 12, v.map);
        v.squares = squared(images[size_t(n)].data(), v.height, v.width);
        v.wanted = reached(v.visible, least, s.height, s.width, radius);
    });
    lfrig::parallel_for(across * down, threads, [&](int tile) {
        match_tile(s, views, tile % across * kTile, tile / across * kTileLines, taps, cost);
    });
}

}  // namespace

void register_band_cost(nb::module_ &m) {
    m.def("band_cost", &band_cost, nb::arg("photo").noconvert(), nb::arg("guide").noconvert(), nb::arg("images"),
          nb::arg("visible"), nb::arg("maps"), nb::arg("noises"), nb::arg("depth").noconvert(),
          nb::arg("slope_x").noconvert(), nb::arg("slope_y").noconvert(), nb::arg("step"), nb::arg("radius"),
          nb::arg("stride"), nb::arg("reach"), nb::arg("sigma_grey"), nb::arg("cap"), nb::arg("least"),
          nb::arg("unit"), nb::arg("out").noconvert(), nb::arg("threads"));
}
