// Sums over views of truncated absolute differences from the centre view, for a block of 32 x 18 pixels and one
// disparity. The innermost loop runs down the rows and interpolates each once, for the row above and below; sums stay
// in registers. 16-bit fixed point: the AVX-512 form and the plain one give the same bits. Used by plane_cost.cpp.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "lfrig/parallel.hpp"

#if defined(__x86_64__) && defined(__GNUC__)
#include <immintrin.h>
#define LFRIG_AVX512 __attribute__((target("avx512f,avx512bw,avx512vl")))
#endif

namespace lfrig {

constexpr int kLanes = 32, kRows = 18;  // a block

struct Shift {
    ptrdiff_t at;    // of the sample's upper left pixel, relative to the pixel
    int16_t wx, wy;  // fractions in 1/32768
};

inline Shift shift_of(float sx, float sy, ptrdiff_t view, ptrdiff_t stride) {
    const float fx = std::floor(sx), fy = std::floor(sy);
    auto fraction = [](float f) { return int16_t(std::min(32767, int(std::lrint(f * 32768.0f)))); };
    return {view + ptrdiff_t(fy) * stride + ptrdiff_t(fx), fraction(sx - fx), fraction(sy - fy)};
}

// total[y][x] += (sum over the shifts of min(|bilinear(from + shift) - centre|, cap) + half) >> fold
using Accumulate = void (*)(const int16_t *from, const Shift *shifts, int count, ptrdiff_t stride,
                            const int16_t *centre, uint16_t cap, int fold, uint16_t *total);

inline int16_t mix(int16_t a, int16_t b, int16_t weight) {
    const int16_t d = int16_t(b - a);
    return int16_t(a + int16_t((((int(d) * int(weight)) >> 14) + 1) >> 1));  // the form that becomes pmulhrsw
}

LFRIG_CLONES inline void accumulate_plain(const int16_t *__restrict from, const Shift *__restrict shifts, int count,
                                          ptrdiff_t stride, const int16_t *__restrict centre, uint16_t cap, int fold,
                                          uint16_t *__restrict total) {
    uint16_t sum[kRows][kLanes] = {};
    int16_t across[2][kLanes];
    for (int v = 0; v < count; ++v) {
        const int16_t *__restrict row = from + shifts[v].at;
        const int16_t wx = shifts[v].wx, wy = shifts[v].wy;
        for (int x = 0; x < kLanes; ++x) across[0][x] = mix(row[x], row[x + 1], wx);
        for (int y = 0; y < kRows; ++y) {
            row += stride;
            const int16_t *__restrict upper = across[y & 1];
            int16_t *__restrict lower = across[(y & 1) ^ 1];
            const int16_t *__restrict own = centre + y * stride;
            uint16_t *__restrict s = sum[y];
            for (int x = 0; x < kLanes; ++x) {
                lower[x] = mix(row[x], row[x + 1], wx);
                const int16_t e = int16_t(mix(upper[x], lower[x], wy) - own[x]);
                const uint16_t m = uint16_t(e < 0 ? -e : e);
                s[x] = uint16_t(s[x] + (m < cap ? m : cap));
            }
        }
    }
    const int half = fold ? 1 << (fold - 1) : 0;
    for (int y = 0; y < kRows; ++y)
        for (int x = 0; x < kLanes; ++x)
            total[y * kLanes + x] = uint16_t(total[y * kLanes + x] + uint16_t((sum[y][x] + half) >> fold));
}

#ifdef LFRIG_AVX512
LFRIG_AVX512 inline __m512i mix512(__m512i a, __m512i b, __m512i weight) {
    return _mm512_add_epi16(a, _mm512_mulhrs_epi16(_mm512_sub_epi16(b, a), weight));
}

template <bool kMix>
LFRIG_AVX512 inline __m512i across512(const int16_t *row, __m512i weight) {
    __m512i a = _mm512_loadu_si512(row);
    asm("" : "+v"(a));  // keep it: it would be loaded twice
    return kMix ? mix512(a, _mm512_loadu_si512(row + 1), weight) : a;
}

constexpr int kHeld = 9;  // rows whose sums and centre pixels fit the 32 registers

// kX, kY: whether any shift has a fraction in x, in y.
template <bool kX, bool kY>
LFRIG_AVX512 inline void accumulate_held(const int16_t *from, const Shift *shifts, int count, ptrdiff_t stride,
                                         const int16_t *centre, uint16_t cap, int fold, uint16_t *total) {
    __m512i sum[kHeld], own[kHeld];
#pragma GCC unroll 9
    for (int y = 0; y < kHeld; ++y) {
        sum[y] = _mm512_setzero_si512();
        own[y] = _mm512_loadu_si512(centre + y * stride);
    }
    const __m512i limit = _mm512_set1_epi16(int16_t(cap));
    for (int v = 0; v < count; ++v) {
        const int16_t *row = from + shifts[v].at;
        const __m512i wx = _mm512_set1_epi16(shifts[v].wx), wy = _mm512_set1_epi16(shifts[v].wy);
        __m512i upper = across512<kX>(row, wx);
#pragma GCC unroll 9
        for (int y = 0; y < kHeld; ++y) {
            row += stride;
            const __m512i lower = kY || y + 1 < kHeld ? across512<kX>(row, wx) : upper;
            const __m512i e = _mm512_sub_epi16(kY ? mix512(upper, lower, wy) : upper, own[y]);
            sum[y] = _mm512_add_epi16(sum[y], _mm512_min_epu16(_mm512_abs_epi16(e), limit));
            upper = lower;
        }
    }
    const __m512i half = _mm512_set1_epi16(fold ? int16_t(1 << (fold - 1)) : 0);
    const __m128i by = _mm_cvtsi32_si128(fold);
#pragma GCC unroll 9
    for (int y = 0; y < kHeld; ++y) {
        const __m512i part = _mm512_srl_epi16(_mm512_add_epi16(sum[y], half), by);
        uint16_t *t = total + y * kLanes;
        _mm512_storeu_si512(t, _mm512_add_epi16(_mm512_loadu_si512(t), part));
    }
}

LFRIG_AVX512 inline void accumulate_avx512(const int16_t *from, const Shift *shifts, int count, ptrdiff_t stride,
                                           const int16_t *centre, uint16_t cap, int fold, uint16_t *total) {
    static_assert(kRows % kHeld == 0);
    int x = 0, y = 0;
    for (int v = 0; v < count; ++v) x |= shifts[v].wx, y |= shifts[v].wy;
    const auto held = x ? (y ? accumulate_held<true, true> : accumulate_held<true, false>)
                        : (y ? accumulate_held<false, true> : accumulate_held<false, false>);
    for (int row = 0; row < kRows; row += kHeld)
        held(from + row * stride, shifts, count, stride, centre + row * stride, cap, fold, total + row * kLanes);
}
#endif

inline Accumulate fastest() {
#ifdef LFRIG_AVX512
    if (__builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl")) return accumulate_avx512;
#endif
    return accumulate_plain;
}

}  // namespace lfrig
