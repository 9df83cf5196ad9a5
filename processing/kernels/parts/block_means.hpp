// From sums over views to costs, for a block of 32 x 18 pixels and one disparity: the halves of the aperture, box means
// and what the better half says. 16-bit fixed point. Used by plane_cost.cpp.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>

#include "lfrig/parallel.hpp"
#include "lfrig/view_sums.hpp"

namespace {

using lfrig::kLanes;
using lfrig::kRows;

constexpr int kAcross = kLanes - 2, kDown = kRows - 2;  // what is left of a block after the 3 x 3 box

// Sums of the nine parts of the aperture, `stride` apart, to those of all views and of the four halves [5][18 * 32].
LFRIG_CLONES void join_parts(const uint16_t *__restrict parts, size_t stride, uint16_t *__restrict joined) {
    constexpr int n = kRows * kLanes;
    for (int i = 0; i < n; ++i) {
        const uint16_t *__restrict p = parts + i;
        const uint16_t upper_left = p[0], upper_right = p[2 * stride], left = p[3 * stride], right = p[5 * stride];
        const uint16_t lower_left = p[6 * stride], lower_right = p[8 * stride];
        const uint16_t upper = uint16_t(upper_left + p[stride] + upper_right);
        const uint16_t lower = uint16_t(lower_left + p[7 * stride] + lower_right);
        joined[i] = uint16_t(upper + left + p[4 * stride] + right + lower);
        joined[n + i] = upper;
        joined[2 * n + i] = lower;
        joined[3 * n + i] = uint16_t(upper_left + left + lower_left);
        joined[4 * n + i] = uint16_t(upper_right + right + lower_right);
    }
}

// Means over views to the 3 x 3 box's: total [18][32] -> out [16][32], of which 30 columns are meant. `left` and
// `right` are the columns at the image's sides, or -1; `top` and `bottom` the rows: there the border is repeated.
LFRIG_CLONES void box(const uint16_t *__restrict total, uint32_t to_mean, uint32_t to_out, int top, int bottom,
                      int left, int right, uint16_t *__restrict out) {
    uint16_t mean[kRows][kLanes], sum[kLanes + 2];
    for (int y = 0; y < kRows; ++y)
        for (int x = 0; x < kLanes; ++x) mean[y][x] = uint16_t((total[y * kLanes + x] * to_mean + 0x8000u) >> 16);
    for (int y = 0; y < kDown; ++y) {
        const uint16_t *__restrict a = mean[y == top ? y + 1 : y], *__restrict b = mean[y + 1];
        const uint16_t *__restrict c = mean[y == bottom ? y + 1 : y + 2];
        for (int x = 0; x < kLanes; ++x) sum[x] = uint16_t(a[x] + b[x] + c[x]);
        if (left >= 0) sum[left - 1] = sum[left];
        if (right >= 0) sum[right + 1] = sum[right];
        for (int x = 0; x < kAcross; ++x)
            out[y * kLanes + x] = uint16_t((uint16_t(sum[x] + sum[x + 1] + sum[x + 2]) * to_out + 0x8000u) >> 16);
    }
}

// out = min(out, min(halves) + bias) where `edge`
LFRIG_CLONES void take_halves(const uint16_t *__restrict halves, const uint8_t *__restrict edge, uint16_t bias,
                              uint16_t *__restrict out) {
    constexpr int n = kDown * kLanes;
    for (int i = 0; i < n; ++i) {
        const uint16_t a = std::min(halves[i], halves[n + i]), b = std::min(halves[2 * n + i], halves[3 * n + i]);
        const int best = std::min(a, b) + bias;
        out[i] = edge[i] && best < out[i] ? uint16_t(best) : out[i];
    }
}

}  // namespace
