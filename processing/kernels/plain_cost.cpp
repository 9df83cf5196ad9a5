// The gradient constraint of plain areas: sums over views, and what they make of the matching cost. Twins:
// plain_cost.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kTile = 8;  // side of the squares that spans are given for

LFRIG_CLONES void add_row(const int16_t *__restrict view, const int16_t *__restrict own, float by_row, float by_column,
                          int width, float *__restrict rows, float *__restrict columns) {
    for (int x = 0; x < width; ++x) {
        const float difference = float(int(view[x]) - int(own[x]));
        rows[x] += by_row * difference;
        columns[x] += by_column * difference;
    }
}

LFRIG_CLONES void scale_row(float *__restrict row, float factor, int width) {
    for (int x = 0; x < width; ++x) row[x] *= factor;
}

constexpr int kPiece = 64;               // pixels of a row that are summed together
constexpr int kDown = 16, kAcross = 32;  // pixels whose differences are blurred together
constexpr int kMostRadius = 32;

// power += (separable blur of view - own)^2, for a block whose first pixel they point to.
LFRIG_CLONES void add_power(const int16_t *__restrict view, const int16_t *__restrict own, ptrdiff_t stride,
                            const float *__restrict taps, int radius, float *__restrict power) {
    float across[kDown + 2 * kMostRadius][kAcross], line[kAcross + 2 * kMostRadius];
    for (int y = 0; y < kDown + 2 * radius; ++y) {
        const ptrdiff_t at = (y - radius) * stride - radius;
        for (int x = 0; x < kAcross + 2 * radius; ++x) line[x] = float(int(view[at + x]) - int(own[at + x]));
        float *__restrict sum = across[y];
        for (int x = 0; x < kAcross; ++x) sum[x] = 0;
        for (int i = 0; i <= 2 * radius; ++i)
            for (int x = 0; x < kAcross; ++x) sum[x] += taps[i] * line[x + i];
    }
    for (int y = 0; y < kDown; ++y) {
        float sum[kAcross] = {};
        for (int i = 0; i <= 2 * radius; ++i)
            for (int x = 0; x < kAcross; ++x) sum[x] += taps[i] * across[y + i][x];
        for (int x = 0; x < kAcross; ++x) power[y * kAcross + x] += sum[x] * sum[x];
    }
}

using Views = ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Offsets = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Map = ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using CMap = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

using Wanted = ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// views int16 [V, rows, stride] (grey x 64), the image at (pad, pad); offsets float32 [V, 2] (dr, dc); wanted uint8
// [H, W]. Sums over the views of dr x and dc x (view - centre) [grey levels], float32 [H, W] each, which are 0 along
// the pieces of a row without anything wanted.
void view_moments(Views views, int centre, int pad, Offsets offsets, Wanted wanted, Map by_row, Map by_column,
                  int threads) {
    const int count = int(views.shape(0)), rows = int(views.shape(1)), stride = int(views.shape(2));
    const int height = int(by_row.shape(0)), width = int(by_row.shape(1));
    if (int(by_column.shape(0)) != height || int(by_column.shape(1)) != width || int(wanted.shape(0)) != height ||
        int(wanted.shape(1)) != width || rows < height + 2 * pad || stride < width + 2 * pad || pad < 0 ||
        centre < 0 || centre >= count || int(offsets.shape(0)) != count || offsets.shape(1) != 2)
        throw std::invalid_argument("view_moments: shapes do not match");
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        float *r = by_row.data() + size_t(y) * width, *c = by_column.data() + size_t(y) * width;
        std::fill(r, r + width, 0.0f);
        std::fill(c, c + width, 0.0f);
        for (int x = 0; x < width; x += kPiece) {
            const int n = std::min(kPiece, width - x);
            if (!std::memchr(wanted.data() + size_t(y) * width + x, 1, size_t(n))) continue;
            auto line = [&](int v) { return views.data() + (size_t(v) * rows + size_t(y + pad)) * stride + pad + x; };
            for (int v = 0; v < count; ++v)
                if (v != centre)
                    add_row(line(v), line(centre), offsets.data()[2 * v], offsets.data()[2 * v + 1], n, r + x, c + x);
            scale_row(r + x, 1.0f / 64, n);
            scale_row(c + x, 1.0f / 64, n);
        }
    });
}

// wanted uint8 [H, W]: where the power is asked for; taps float32 [2 r + 1], r at most the margin. The sum over the
// views of (blurred view - blurred centre)^2 [grey levels^2] to power float32 [H, W], 0 in blocks without any.
void difference_power(Views views, int centre, int pad,
                      ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu> taps, Wanted wanted, Map power,
                      int threads) {
    const int count = int(views.shape(0)), rows = int(views.shape(1)), stride = int(views.shape(2));
    const int height = int(power.shape(0)), width = int(power.shape(1)), radius = int(taps.shape(0)) / 2;
    if (int(wanted.shape(0)) != height || int(wanted.shape(1)) != width || rows < height + 2 * pad + kDown ||
        stride < width + 2 * pad + kAcross || centre < 0 || centre >= count || taps.shape(0) % 2 != 1 || radius > pad ||
        radius > kMostRadius)
        throw std::invalid_argument("difference_power: shapes do not match");
    nb::gil_scoped_release release;
    lfrig::parallel_for((height + kDown - 1) / kDown, threads, [&](int band) {
        const int y0 = band * kDown, down = std::min(kDown, height - y0);
        for (int x0 = 0; x0 < width; x0 += kAcross) {
            const int n = std::min(kAcross, width - x0);
            bool any = false;
            for (int y = y0; y < y0 + down && !any; ++y)
                any = std::memchr(wanted.data() + size_t(y) * width + x0, 1, size_t(n)) != nullptr;
            float sum[kDown * kAcross] = {};
            auto block = [&](int v) {
                return views.data() + (size_t(v) * rows + size_t(y0 + pad)) * stride + pad + x0;
            };
            for (int v = 0; any && v < count; ++v)
                if (v != centre) add_power(block(v), block(centre), stride, taps.data(), radius, sum);
            for (int y = 0; y < down; ++y)
                for (int x = 0; x < n; ++x)
                    power.data()[size_t(y0 + y) * width + x0 + x] = sum[y * kAcross + x] * (1.0f / (64 * 64));
        }
    });
}

LFRIG_CLONES void blend_pixel(uint16_t *__restrict cost, float first, float step, int from, int past, float disparity,
                              float steepness, float cap, float weight) {
    for (int k = from; k < past; ++k) {
        const float away = first + step * float(k) - disparity;
        const float bowl = away * away * steepness, charge = bowl < cap ? bowl : cap;
        cost[k] = uint16_t(int32_t((1.0f - weight) * float(cost[k]) + weight * charge + 0.5f));
    }
}

// cost uint16 [H, W, D], in place; disparity, steepness (cost per px^2) and weight float32 [H, W].
void blend_plain(ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> cost,
                 ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> span, CMap disparity,
                 CMap steepness, CMap weight, float first, float step, float cap, int threads) {
    const int height = int(cost.shape(0)), width = int(cost.shape(1)), planes = int(cost.shape(2));
    const int down = (height + kTile - 1) / kTile, across = (width + kTile - 1) / kTile;
    for (const CMap *map : {&disparity, &steepness, &weight})
        if (int(map->shape(0)) != height || int(map->shape(1)) != width)
            throw std::invalid_argument("blend_plain: shapes do not match");
    if (span.size() && (int(span.shape(0)) != down || int(span.shape(1)) != across || span.shape(2) != 2))
        throw std::invalid_argument("blend_plain: the span does not match");
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        for (int x = 0; x < width; ++x) {
            const size_t at = size_t(y) * width + x;
            if (!(weight.data()[at] > 0)) continue;
            int from = 0, past = planes;
            if (span.size()) {
                const int16_t *s = span.data() + 2 * (size_t(y / kTile) * across + x / kTile);
                from = std::max(0, int(s[0]));
                past = std::min(planes, int(s[1]));
            }
            blend_pixel(cost.data() + at * planes, first, step, from, past, disparity.data()[at],
                        steepness.data()[at], cap, weight.data()[at]);
        }
    });
}

}  // namespace

void register_plain_cost(nb::module_ &m) {
    m.def("view_moments", &view_moments, nb::arg("views").noconvert(), nb::arg("centre"), nb::arg("pad"),
          nb::arg("offsets").noconvert(), nb::arg("wanted").noconvert(), nb::arg("by_row").noconvert(),
          nb::arg("by_column").noconvert(), nb::arg("threads"));
    m.def("difference_power", &difference_power, nb::arg("views").noconvert(), nb::arg("centre"), nb::arg("pad"),
          nb::arg("taps").noconvert(), nb::arg("wanted").noconvert(), nb::arg("power").noconvert(), nb::arg("threads"));
    m.def("blend_plain", &blend_plain, nb::arg("cost").noconvert(), nb::arg("span").noconvert(),
          nb::arg("disparity").noconvert(), nb::arg("steepness").noconvert(), nb::arg("weight").noconvert(),
          nb::arg("first"), nb::arg("step"), nb::arg("cap"), nb::arg("threads"));
}
