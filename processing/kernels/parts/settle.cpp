// Looking a surface up between its pixels, and the fixed-point iteration that finds it from a view.
#include <algorithm>
#include <cmath>
#include <cstring>

#include "lfrig/cpu.hpp"
#include "lfrig/parallel.hpp"
#include "view_field.hpp"

namespace lfrig {

namespace {

constexpr int LANES = 16, BLOCK = 32;  // pixels of a row, of a list that settle together
constexpr int SETTLE_ROUNDS = 5;
constexpr float SETTLED = 1e-4f;     // of a disparity: it stands still
constexpr float FARTHEST_PX = 1e6f;  // no disparity is farther from 0; what is not finite becomes finite

// Fixed-point iteration g <- d(u + g * offset) on LANES pixels of row y from x0, starting from the centre's disparity,
// until every pixel that is not masked moves by at most `limit`. Writes the field; pixels that do not settle, or beyond
// the frame, are masked.
inline void settle_plain(const Surface &d, int x0, int y, int count, float dr, float dc, float limit, float *field,
                         uint8_t *mask) {
    float g[LANES], moved[LANES];
    for (int i = 0; i < count; ++i) g[i] = d.data[size_t(y) * d.stride + x0 + i];
    for (int round = 0; round < SETTLE_ROUNDS; ++round) {
        bool more = false;
        for (int i = 0; i < count; ++i) {
            const float sample = d.at(float(x0 + i) + dc * g[i], float(y) + dr * g[i]);
            moved[i] = std::fabs(sample - g[i]);
            g[i] = sample;
            more |= !mask[i] && moved[i] > limit;
        }
        if (!more) break;
    }
    const float right = float(d.width) - 0.5f, bottom = float(d.height) - 0.5f;
    for (int i = 0; i < count; ++i) {
        const float x = float(x0 + i) + dc * g[i], v = float(y) + dr * g[i];
        field[i] = g[i];
        mask[i] |= uint8_t(moved[i] > limit || x < -0.5f || x > right || v < -0.5f || v > bottom);
    }
}

LFRIG_CLONES void settle_row_plain(const Surface &d, int y, float dr, float dc, float limit, float *field,
                                   uint8_t *mask) {
    for (int x0 = 0; x0 < d.width; x0 += LANES) {
        const int count = std::min(LANES, d.width - x0);
        settle_plain(d, x0, y, count, dr, dc, limit, field + x0, mask + x0);
    }
}

#ifdef LFRIG_X86
// Surface::at for 16 pixels that lie next to one another: their samples come from two or three rows of 32 pixels.
// Returns false, with nothing done, where they do not.
LFRIG_AVX512 inline bool look_up_run(const Surface &d, __m512 x, __m512 y, __m512 *out) {
    const __m512 zero = _mm512_setzero_ps();
    x = _mm512_min_ps(_mm512_max_ps(x, zero), _mm512_set1_ps(float(d.width - 1)));
    y = _mm512_min_ps(_mm512_max_ps(y, zero), _mm512_set1_ps(float(d.height - 1)));
    const __m512i ix = _mm512_cvttps_epi32(x), iy = _mm512_cvttps_epi32(y);
    const int first = std::max(0, _mm_cvtsi128_si32(_mm512_castsi512_si128(ix)) - 6);
    const int top = _mm_cvtsi128_si32(_mm512_castsi512_si128(iy));
    const __m512i column = _mm512_sub_epi32(ix, _mm512_set1_epi32(first));
    if (_mm512_cmpgt_epu32_mask(column, _mm512_set1_epi32(30))) return false;
    const __m512 tx = _mm512_sub_ps(x, _mm512_cvtepi32_ps(ix)), ty = _mm512_sub_ps(y, _mm512_cvtepi32_ps(iy));
    const __m512i next = _mm512_add_epi32(column, _mm512_set1_epi32(1));
    const __m512i row = _mm512_sub_epi32(iy, _mm512_set1_epi32(top));
    const __mmask16 above = _mm512_cmplt_epi32_mask(row, _mm512_setzero_si512());
    const __mmask16 below = _mm512_cmpgt_epi32_mask(row, _mm512_setzero_si512());
    if (above && below) return false;
    if (_mm512_cmpgt_epu32_mask(_mm512_abs_epi32(row), _mm512_set1_epi32(1))) return false;
    const float *from = d.data.data() + ptrdiff_t(top - (above ? 1 : 0)) * d.stride + first;
    const auto blend = [&](const float *p) __attribute__((target("arch=x86-64-v4"), always_inline)) {
        const __m512 low = _mm512_loadu_ps(p), high = _mm512_loadu_ps(p + 16);
        const __m512 a = _mm512_permutex2var_ps(low, column, high), b = _mm512_permutex2var_ps(low, next, high);
        return _mm512_add_ps(a, _mm512_mul_ps(tx, _mm512_sub_ps(b, a)));
    };
    __m512 upper = blend(from), lower = blend(from + d.stride);
    if (above || below) {
        const __m512 last = blend(from + 2 * d.stride);
        const __mmask16 one_down = above ? __mmask16(~above) : below;
        upper = _mm512_mask_mov_ps(upper, one_down, lower);
        lower = _mm512_mask_mov_ps(lower, one_down, last);
    }
    *out = _mm512_add_ps(upper, _mm512_mul_ps(ty, _mm512_sub_ps(lower, upper)));
    return true;
}

LFRIG_AVX512 void settle_row_avx512(const Surface &d, int y, float dr, float dc, float limit, float *field,
                                    uint8_t *mask) {
    const __m512 lane = _mm512_setr_ps(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const __m512 rows = _mm512_set1_ps(dr), cols = _mm512_set1_ps(dc), fy = _mm512_set1_ps(float(y));
    const __m512 right = _mm512_set1_ps(float(d.width) - 0.5f), bottom = _mm512_set1_ps(float(d.height) - 0.5f);
    const float *centre = d.data.data() + size_t(y) * d.stride;
    for (int x0 = 0; x0 < d.width; x0 += LANES) {
        const int count = std::min(LANES, d.width - x0);
        const __mmask16 live = __mmask16((1u << count) - 1u);
        const __m128i known = _mm_maskz_loadu_epi8(live, mask + x0);
        const __mmask16 open = live & _mm_cmpeq_epi8_mask(known, _mm_setzero_si128());
        if (!open) continue;
        const __m512 fx = _mm512_add_ps(_mm512_set1_ps(float(x0)), lane);
        __m512 g = _mm512_maskz_loadu_ps(live, centre + x0);
        __mmask16 moving = 0;
        bool together = true;
        for (int round = 0; round < SETTLE_ROUNDS; ++round) {
            __m512 sample;
            const __m512 x = _mm512_add_ps(fx, _mm512_mul_ps(cols, g)), v = _mm512_add_ps(fy, _mm512_mul_ps(rows, g));
            together = look_up_run(d, x, v, &sample);
            if (!together) break;
            const __m512 moved = _mm512_abs_ps(_mm512_sub_ps(sample, g));
            g = sample;
            moving = live & _mm512_cmp_ps_mask(moved, _mm512_set1_ps(limit), _CMP_GT_OQ);
            if (!(moving & open)) break;
        }
        if (!together) {
            settle_plain(d, x0, y, count, dr, dc, limit, field + x0, mask + x0);
            continue;
        }
        _mm512_mask_storeu_ps(field + x0, live, g);
        const __m512 half = _mm512_set1_ps(-0.5f);
        const __m512 x = _mm512_add_ps(fx, _mm512_mul_ps(cols, g)), v = _mm512_add_ps(fy, _mm512_mul_ps(rows, g));
        moving |= _mm512_cmp_ps_mask(x, half, _CMP_LT_OQ) | _mm512_cmp_ps_mask(x, right, _CMP_GT_OQ) |
                  _mm512_cmp_ps_mask(v, half, _CMP_LT_OQ) | _mm512_cmp_ps_mask(v, bottom, _CMP_GT_OQ);
        moving &= live;
        if (moving) _mm_mask_storeu_epi8(mask + x0, moving, _mm_set1_epi8(1));
    }
}
#endif

LFRIG_CLONES void settle_all(const float *__restrict data, int height, int width, int stride,
                             const int32_t *__restrict xs, const int32_t *__restrict ys, int count, float dr, float dc,
                             int rounds, float limit, float *__restrict px, float *__restrict samples) {
    const float right = float(width - 1), bottom = float(height - 1);
    for (int start = 0; start < count; start += BLOCK) {
        const int end = std::min(start + BLOCK, count);
        int moving = 1;
        for (int round = 0; round <= rounds && moving; ++round) {
            const float least = round < rounds ? limit : 0.0f;  // the last round samples, and moves nothing
            moving = 0;
            for (int i = start; i < end; ++i) {
                float x = float(xs[i]) + dc * px[i], y = float(ys[i]) + dr * px[i];
                x = x > 0.0f ? x : 0.0f, y = y > 0.0f ? y : 0.0f;
                x = x < right ? x : right, y = y < bottom ? y : bottom;
                const int ix = int(x), iy = int(y), at = iy * stride + ix;
                const float tx = x - float(ix), ty = y - float(iy);
                const float a = data[at] + tx * (data[at + 1] - data[at]);
                const float b = data[at + stride] + tx * (data[at + stride + 1] - data[at + stride]);
                const float sample = a + ty * (b - a), change = std::fabs(sample - px[i]);
                samples[i] = sample;
                px[i] = change < least ? sample : px[i];
                moving |= int(change < least) & int(change > SETTLED);
            }
        }
    }
}

}  // namespace

Surface::Surface(const float *values, int rows, int cols)
    : height(rows), width(cols), stride(cols + 1), data(size_t(rows + 1) * (cols + 1) + 3 * (cols + 1) + 64) {
    for (int y = 0; y <= height; ++y) {
        float *to = data.data() + size_t(y) * stride;
        const float *from = values + size_t(std::min(y, height - 1)) * width;
        for (int x = 0; x < width; ++x)  // NaN is the lower limit
            to[x] = std::min(std::max(-FARTHEST_PX, from[x]), FARTHEST_PX);
        to[width] = to[width - 1];
    }
}

void settle_row(const Surface &d, int y, float dr, float dc, float limit, float *field, uint8_t *mask) {
#ifdef LFRIG_X86
    if (has_avx512()) return settle_row_avx512(d, y, dr, dc, limit, field, mask);
#endif
    settle_row_plain(d, y, dr, dc, limit, field, mask);
}

void settle_list(const Surface &surface, const int32_t *xs, const int32_t *ys, int count, float dr, float dc,
                 int rounds, float limit, float *px, float *samples) {
    settle_all(surface.data.data(), surface.height, surface.width, surface.stride, xs, ys, count, dr, dc, rounds, limit,
               px, samples);
}

}  // namespace lfrig
