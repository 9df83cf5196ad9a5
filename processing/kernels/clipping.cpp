// Blur of grey views around clipped pixels. Twin: clipping.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "lfrig/margin.hpp"
#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kDown = 16, kAcross = 32;  // pixels that are blurred or left alone together
constexpr int kMostRadius = 32;          // of a blur
constexpr int kMostReach = 16;           // of what is near a clipped pixel

LFRIG_CLONES int16_t brightest(const int16_t *__restrict grey, int n) {
    int16_t most = -32768;
    for (int x = 0; x < n; ++x) most = grey[x] > most ? grey[x] : most;
    return most;
}

LFRIG_CLONES int find_clipped(const uint8_t *__restrict rgb, int limit, uint8_t *__restrict clipped, int n) {
    int any = 0;
    for (int x = 0; x < n; ++x) {
        const uint8_t low = std::min(std::min(rgb[3 * x], rgb[3 * x + 1]), rgb[3 * x + 2]);
        clipped[x] = low >= limit;
        any |= clipped[x];
    }
    return any;
}

LFRIG_CLONES void spread_row(const uint8_t *__restrict clipped, int half_width, uint8_t *__restrict near, int width) {
    for (int d = -half_width; d <= half_width; ++d) {
        const int from = std::max(0, -d), past = std::min(width, width - d);
        for (int x = from; x < past; ++x) near[x] |= clipped[x + d];
    }
}

struct Taps {
    const float *weight;
    int radius;
};

// Separable blur of a block of 16 x 32 pixels; `from` is its first pixel.
template <class T>
__attribute__((always_inline)) inline void blur(const T *__restrict from, ptrdiff_t stride, const Taps &taps,
                                                float (*__restrict out)[kAcross]) {
    float across[kDown + 2 * kMostRadius][kAcross], line[kAcross + 2 * kMostRadius];
    const int r = taps.radius;
    for (int y = 0; y < kDown + 2 * r; ++y) {
        const T *__restrict row = from + (y - r) * stride - r;
        for (int x = 0; x < kAcross + 2 * r; ++x) line[x] = float(row[x]);
        float *__restrict sum = across[y];
        for (int x = 0; x < kAcross; ++x) sum[x] = 0;
        for (int i = 0; i <= 2 * r; ++i)
            for (int x = 0; x < kAcross; ++x) sum[x] += taps.weight[i] * line[x + i];
    }
    for (int y = 0; y < kDown; ++y) {
        float *__restrict sum = out[y];
        for (int x = 0; x < kAcross; ++x) sum[x] = 0;
        for (int i = 0; i <= 2 * r; ++i)
            for (int x = 0; x < kAcross; ++x) sum[x] += taps.weight[i] * across[y + i][x];
    }
}

struct View {
    int16_t *out;         // first pixel of the grey image, in place
    ptrdiff_t stride;
    const int16_t *own;   // of a copy of it with a repeated border
    const uint8_t *near;  // 1 where a clipped pixel is near; with a repeated border
    ptrdiff_t wide;       // row length of both
};

LFRIG_CLONES void soften_block(const View &v, const Taps &soft, const Taps &share, int x0, int y0, int n, int rows) {
    float part[kDown][kAcross], grey[kDown][kAcross];
    const ptrdiff_t at = y0 * v.wide + x0;
    blur(v.near + at, v.wide, share, part);
    blur(v.own + at, v.wide, soft, grey);
    for (int y = 0; y < rows; ++y) {
        int16_t *__restrict row = v.out + (y0 + y) * v.stride + x0;
        for (int x = 0; x < n; ++x) {
            const float own = float(row[x]);
            row[x] = int16_t(int32_t(own + part[y][x] * (grey[y][x] - own) + 0.5f));  // never negative
        }
    }
}

// Clipped pixels of one view, and between which rows there are any.
struct Clipped {
    std::vector<uint8_t> pixels, rows;  // of the rows without any, pixels are not set
    int first, past;

    void find(const uint8_t *rgb, const int16_t *grey, ptrdiff_t stride, int height, int width, int limit) {
        pixels.resize(size_t(height) * width);
        rows.assign(size_t(height), 0);
        first = height, past = 0;
        for (int y = 0; y < height; ++y) {
            // Luma is a mean of the channels: where all are at the limit, so is it, but for rounding.
            if (brightest(grey + y * stride, width) < limit * 64 - 1) continue;
            const size_t at = size_t(y) * width;
            if (!find_clipped(rgb + 3 * at, limit, pixels.data() + at, width)) continue;
            rows[y] = 1;
            first = std::min(first, y);
            past = y + 1;
        }
    }
};

// What the blurs of one view read: kept from view to view, for fresh memory costs more than all else.
struct Scratch {
    Clipped clipped;
    std::vector<uint8_t> near, any;  // any: over the rows that a row of blocks reads
    std::vector<int16_t> own;
};

// A row of an image of any height and width to one with a repeated border.
template <class T>
void extend(const T *row, int width, int border, ptrdiff_t wide, T *out) {
    std::fill(out, out + border, row[0]);
    std::copy_n(row, width, out + border);
    std::fill(out + border + width, out + wide, row[width - 1]);
}

LFRIG_CLONES void join_row(const uint8_t *__restrict near, uint8_t *__restrict any, ptrdiff_t wide) {
    for (ptrdiff_t x = 0; x < wide; ++x) any[x] |= near[x];
}

struct Shape {  // by which clipped pixels are spread
    const int32_t *half_widths;  // of its rows
    int reach;
};

// near[x] = 1 where a clipped pixel is near row y.
void spread(const Clipped &clipped, int y, int height, int width, const Shape &shape, uint8_t *near) {
    std::fill(near, near + width, uint8_t(0));
    for (int d = -shape.reach; d <= shape.reach; ++d)
        if (y + d >= 0 && y + d < height && clipped.rows[y + d])
            spread_row(clipped.pixels.data() + size_t(y + d) * width, shape.half_widths[d + shape.reach], near, width);
}

// One view, whose clipped pixels have been found.
void soften_view(int16_t *image, ptrdiff_t stride, int height, int width, const Taps &soft, const Taps &share,
                 const Shape &shape, Scratch &t) {
    // Both blurs read beyond the image, and beyond it by what is left of the last block.
    const int border = std::max(soft.radius, share.radius), reach = shape.reach + share.radius;
    const ptrdiff_t wide = width + 2 * border + kAcross, high = height + 2 * border + kDown;
    t.near.resize(size_t(high * wide));
    t.own.resize(size_t(high * wide));
    const int from = std::max(0, t.clipped.first - reach) / kDown * kDown;
    const int past = std::min(height, t.clipped.past + reach);
    const int last = from + (past - from + kDown - 1) / kDown * kDown + 2 * border;  // row of the copies
    std::vector<uint8_t> line(width);
    for (int row = from; row < last; ++row) {
        const int y = std::min(std::max(row - border, 0), height - 1);
        extend(image + y * stride, width, border, wide, t.own.data() + row * wide);
        spread(t.clipped, y, height, width, shape, line.data());
        extend(line.data(), width, border, wide, t.near.data() + row * wide);
    }
    const ptrdiff_t corner = border * wide + border;
    const View view{image, stride, t.own.data() + corner, t.near.data() + corner, wide};
    for (int y0 = from; y0 < past; y0 += kDown) {
        const int down = std::min(kDown, height - y0);
        t.any.assign(size_t(wide), 0);
        for (int y = y0 - share.radius; y < y0 + down + share.radius; ++y)
            join_row(view.near + y * wide - border, t.any.data(), wide);
        for (int x0 = 0; x0 < width; x0 += kAcross) {
            const int n = std::min(kAcross, width - x0);
            if (std::memchr(t.any.data() + border + x0 - share.radius, 1, size_t(n + 2 * share.radius)))
                soften_block(view, soft, share, x0, y0, n, down);
        }
    }
}

using Taps1 = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// views uint8 [V, H, W, 3]; grey int16 [V, rows, stride] (x 64) with the image at (pad, pad), in place. half_widths
// int32 [2 r + 1]: of the rows of the shape by which clipped pixels are spread; soft and share: taps of the blurs.
void soften_clipped(ndarray<const uint8_t, nb::ndim<4>, nb::c_contig, nb::device::cpu> views,
                    ndarray<int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> grey, int pad, int limit,
                    ndarray<const int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu> half_widths, Taps1 soft_taps,
                    Taps1 share_taps, int threads) {
    const int count = int(views.shape(0)), height = int(views.shape(1)), width = int(views.shape(2));
    const int rows = int(grey.shape(1)), stride = int(grey.shape(2)), reach = int(half_widths.shape(0)) / 2;
    const Taps soft{soft_taps.data(), int(soft_taps.shape(0)) / 2};
    const Taps share{share_taps.data(), int(share_taps.shape(0)) / 2};
    if (int(grey.shape(0)) != count || views.shape(3) != 3 || rows < height + 2 * pad || stride < width + 2 * pad ||
        half_widths.shape(0) % 2 != 1 || soft_taps.shape(0) % 2 != 1 || share_taps.shape(0) % 2 != 1 ||
        soft.radius > kMostRadius || share.radius > kMostRadius || reach > kMostReach || height < 1 || width < 1)
        throw std::invalid_argument("soften_clipped: shapes do not match");
    nb::gil_scoped_release release;
    const Shape shape{half_widths.data(), reach};
    lfrig::parallel_for(count, threads, [&](int v) {
        static thread_local Scratch scratch;
        int16_t *image = grey.data() + (size_t(v) * rows + pad) * stride + pad;
        scratch.clipped.find(views.data() + size_t(v) * height * width * 3, image, stride, height, width, limit);
        if (scratch.clipped.first >= scratch.clipped.past) return;
        soften_view(image, stride, height, width, soft, share, shape, scratch);
        for (int y = 0; y < height; ++y) lfrig::extend_row(image + ptrdiff_t(y) * stride - pad, pad, width, stride);
        lfrig::extend_rows(grey.data() + size_t(v) * rows * stride, pad, height, rows, stride);
    });
}

}  // namespace

void register_clipping(nb::module_ &m) {
    m.def("soften_clipped", &soften_clipped, nb::arg("views").noconvert(), nb::arg("grey").noconvert(), nb::arg("pad"),
          nb::arg("limit"), nb::arg("half_widths").noconvert(), nb::arg("soft").noconvert(),
          nb::arg("share").noconvert(), nb::arg("threads"));
}
