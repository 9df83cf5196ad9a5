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
constexpr int kMostTaps = 65, kMostReach = 16;

LFRIG_CLONES int find_clipped(const uint8_t *__restrict rgb, int limit, uint8_t *__restrict clipped, int width) {
    int any = 0;
    for (int x = 0; x < width; ++x) {
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

// out[x] += weight * row[x]
LFRIG_CLONES void add_grey(const int16_t *__restrict row, float weight, float *__restrict out, int n) {
    for (int x = 0; x < n; ++x) out[x] += weight * float(row[x]);
}
LFRIG_CLONES void add_mask(const uint8_t *__restrict row, float weight, float *__restrict out, int n) {
    for (int x = 0; x < n; ++x) out[x] += weight * float(row[x]);
}
LFRIG_CLONES void add_float(const float *__restrict row, float weight, float *__restrict out, int n) {
    for (int x = 0; x < n; ++x) out[x] += weight * row[x];
}
LFRIG_CLONES void mix_row(const float *__restrict share, const float *__restrict soft, int16_t *__restrict view,
                          int n) {
    for (int x = 0; x < n; ++x) {
        const float own = float(view[x]);
        view[x] = int16_t(int32_t(own + share[x] * (soft[x] - own) + 0.5f));  // never negative
    }
}

struct View {
    int16_t *out;         // first pixel of the grey image, in place
    ptrdiff_t stride;
    const int16_t *own;   // of a copy of it with a repeated border
    const uint8_t *near;  // 1 where a clipped pixel is near; with a repeated border
    ptrdiff_t wide;       // row length of both
};

// One row of a block: blurred grey and share of clipped surroundings.
void soften_row(const View &v, const Taps &soft, const Taps &share, int x0, int y, int n) {
    float down[kAcross + kMostTaps], grey[kAcross], part[kAcross];
    auto across = [&](const Taps &t, float *out) {
        std::fill(out, out + n, 0.0f);
        for (int i = 0; i <= 2 * t.radius; ++i) add_float(down + i, t.weight[i], out, n);
    };
    std::fill(down, down + n + 2 * share.radius, 0.0f);
    for (int i = -share.radius; i <= share.radius; ++i)
        add_mask(v.near + (y + i) * v.wide + x0 - share.radius, share.weight[i + share.radius], down,
                 n + 2 * share.radius);
    across(share, part);
    std::fill(down, down + n + 2 * soft.radius, 0.0f);
    for (int i = -soft.radius; i <= soft.radius; ++i)
        add_grey(v.own + (y + i) * v.wide + x0 - soft.radius, soft.weight[i + soft.radius], down,
                 n + 2 * soft.radius);
    across(soft, grey);
    mix_row(part, grey, v.out + y * v.stride + x0, n);
}

bool any_near(const View &v, int x0, int y0, int n, int rows, int radius) {
    for (int y = y0 - radius; y < y0 + rows + radius; ++y) {
        const uint8_t *row = v.near + y * v.wide + x0 - radius;
        if (std::memchr(row, 1, size_t(n + 2 * radius))) return true;
    }
    return false;
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
        soft_taps.shape(0) > kMostTaps || share_taps.shape(0) > kMostTaps || reach > kMostReach)
        throw std::invalid_argument("soften_clipped: shapes do not match");
    nb::gil_scoped_release release;
    // Both blurs read beyond the image: its border is repeated as far as they do.
    const int border = std::max(soft.radius, share.radius);
    const ptrdiff_t wide = width + 2 * border;
    lfrig::parallel_for(count, threads, [&](int v) {
        std::vector<uint8_t> clipped(size_t(height) * width), seen(height);
        bool any = false;
        for (int y = 0; y < height; ++y) {
            seen[y] = uint8_t(find_clipped(views.data() + (size_t(v) * height + y) * width * 3, limit,
                                           clipped.data() + size_t(y) * width, width));
            any |= seen[y] != 0;
        }
        if (!any) return;
        std::vector<uint8_t> near(size_t(height + 2 * border) * wide);
        std::vector<int16_t> own(size_t(height + 2 * border) * wide);
        int16_t *image = grey.data() + (size_t(v) * rows + pad) * stride + pad;
        for (int y = 0; y < height; ++y) {
            uint8_t *row = near.data() + size_t(y + border) * wide + border;
            for (int d = -reach; d <= reach; ++d)
                if (y + d >= 0 && y + d < height && seen[y + d])
                    spread_row(clipped.data() + size_t(y + d) * width, half_widths.data()[d + reach], row, width);
            int16_t *copy = own.data() + size_t(y + border) * wide + border;
            std::memcpy(copy, image + size_t(y) * stride, size_t(width) * sizeof *copy);
            std::fill(row - border, row, row[0]);
            std::fill(row + width, row + width + border, row[width - 1]);
            std::fill(copy - border, copy, copy[0]);
            std::fill(copy + width, copy + width + border, copy[width - 1]);
        }
        for (int y = 0; y < border; ++y)
            for (int end = 0; end < 2; ++end) {
                const size_t to = size_t(end ? height + border + y : y) * wide;
                const size_t from = size_t(end ? height + border - 1 : border) * wide;
                std::memcpy(near.data() + to, near.data() + from, size_t(wide));
                std::memcpy(own.data() + to, own.data() + from, size_t(wide) * sizeof(int16_t));
            }
        const size_t corner = size_t(border) * wide + border;
        const View view{image, stride, own.data() + corner, near.data() + corner, wide};
        for (int y0 = 0; y0 < height; y0 += kDown)
            for (int x0 = 0; x0 < width; x0 += kAcross) {
                const int n = std::min(kAcross, width - x0), down = std::min(kDown, height - y0);
                if (!any_near(view, x0, y0, n, down, share.radius)) continue;
                for (int y = y0; y < y0 + down; ++y) soften_row(view, soft, share, x0, y, n);
            }
        for (int y = 0; y < height; ++y) lfrig::extend_row(image + size_t(y) * stride - pad, pad, width, stride);
        lfrig::extend_rows(grey.data() + size_t(v) * rows * stride, pad, height, rows, stride);
    });
}

}  // namespace

void register_clipping(nb::module_ &m) {
    m.def("soften_clipped", &soften_clipped, nb::arg("views").noconvert(), nb::arg("grey").noconvert(), nb::arg("pad"),
          nb::arg("limit"), nb::arg("half_widths").noconvert(), nb::arg("soft").noconvert(),
          nb::arg("share").noconvert(), nb::arg("threads"));
}
