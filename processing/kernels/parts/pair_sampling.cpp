#include "pair_sampling.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "lfrig/cpu.hpp"
#include "lfrig/parallel.hpp"

namespace lfrig {

namespace {

constexpr int BLOCK = 64;  // pixels whose positions are worked out together

struct Positions {
    alignas(64) int32_t start[BLOCK];  // of the first tap, in elements
    alignas(64) int32_t tx[BLOCK];     // fraction, the index into the table
    alignas(64) int32_t ty[BLOCK];
};

inline void find_positions(const PairPicture &picture, const float *field, float dr, float dc, int x0, int y,
                           int count, Positions &at) {
    const int width = picture.width, height = picture.height;
    const float fx0 = float(x0), fy0 = float(y), pad = float(picture.pad);
    for (int i = 0; i < count; ++i) {
        const float d = field[x0 + i], known = d - d == 0.0f ? d : 0.0f;
        const int qx = fixed_position(fx0 + float(i) + dc * known + pad, width);
        const int qy = fixed_position(fy0 + dr * known + pad, height);
        at.start[i] = (((qy >> FRACTION_BITS) - 1) * width + ((qx >> FRACTION_BITS) - 1)) * 8;
        at.tx[i] = qx & (FRACTIONS - 1);
        at.ty[i] = qy & (FRACTIONS - 1);
    }
}

constexpr float TO_GREY = 1.0f / (float(PAIR_SCALE) * float(WEIGHT_ONE));

LFRIG_CLONES void sample_row_plain(const PairPicture &picture, const Taps &taps, const float *field, float dr,
                                   float dc, int y, int count, uint8_t *out) {
    Positions at;
    const size_t below = size_t(picture.width) * 16;
    for (int x0 = 0; x0 < count; x0 += BLOCK) {
        const int n = std::min(BLOCK, count - x0);
        find_positions(picture, field, dr, dc, x0, y, n, at);
        for (int i = 0; i < n; ++i) {
            const int16_t *upper = picture.data.data() + at.start[i], *lower = upper + below;
            const int32_t *pair = taps.pair[at.ty[i]];
            const int w0 = int16_t(pair[0] & 0xffff), w1 = pair[0] >> 16;
            const int w2 = int16_t(pair[1] & 0xffff), w3 = pair[1] >> 16;
            const float *wx = taps.weight[at.tx[i]];
            float column[16];
            for (int k = 0; k < 16; ++k)
                column[k] = float((w0 * upper[2 * k] + w1 * upper[2 * k + 1]) +
                                  (w2 * lower[2 * k] + w3 * lower[2 * k + 1])) *
                            wx[k / 4];
            for (int c = 0; c < 3; ++c) {
                const float sum = (column[c] + column[8 + c]) + (column[4 + c] + column[12 + c]);
                const int grey = int(sum * TO_GREY + 0.5f);
                out[3 * (x0 + i) + c] = uint8_t(grey < 0 ? 0 : grey > 255 ? 255 : grey);
            }
        }
    }
}

#ifdef LFRIG_X86
LFRIG_AVX512 inline __m512i fixed_positions(__m512 at, int size) {
    at = _mm512_min_ps(_mm512_max_ps(at, _mm512_set1_ps(1.0f)), _mm512_set1_ps(float(size - 3)));
    return _mm512_cvttps_epi32(
        _mm512_add_ps(_mm512_mul_ps(at, _mm512_set1_ps(float(FRACTIONS))), _mm512_set1_ps(0.5f)));
}

// find_positions() for the 16 pixels from i.
LFRIG_AVX512 inline void find_sixteen(const PairPicture &picture, const float *field, float dr, float dc, int x0, int y,
                                      int count, int i, Positions &at) {
    const __m512 lane = _mm512_setr_ps(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const __m512 pad = _mm512_set1_ps(float(picture.pad));
    const int left = std::min(std::max(count - i, 0), 16);
    const __m512 given = _mm512_maskz_loadu_ps(__mmask16((1u << left) - 1u), field + x0 + i);
    const __mmask16 finite = _mm512_cmp_ps_mask(_mm512_sub_ps(given, given), _mm512_setzero_ps(), _CMP_EQ_OQ);
    const __m512 d = _mm512_maskz_mov_ps(finite, given);
    const __m512 x = _mm512_add_ps(_mm512_set1_ps(float(x0 + i)), lane), v = _mm512_set1_ps(float(y));
    const __m512i qx = fixed_positions(
        _mm512_add_ps(_mm512_add_ps(x, _mm512_mul_ps(_mm512_set1_ps(dc), d)), pad), picture.width);
    const __m512i qy = fixed_positions(
        _mm512_add_ps(_mm512_add_ps(v, _mm512_mul_ps(_mm512_set1_ps(dr), d)), pad), picture.height);
    const __m512i one = _mm512_set1_epi32(1), fraction = _mm512_set1_epi32(FRACTIONS - 1);
    const __m512i row = _mm512_sub_epi32(_mm512_srli_epi32(qy, FRACTION_BITS), one);
    const __m512i column = _mm512_sub_epi32(_mm512_srli_epi32(qx, FRACTION_BITS), one);
    const __m512i tap = _mm512_add_epi32(_mm512_mullo_epi32(row, _mm512_set1_epi32(picture.width)), column);
    _mm512_store_si512(at.start + i, _mm512_slli_epi32(tap, 3));
    _mm512_store_si512(at.tx + i, _mm512_and_si512(qx, fraction));
    _mm512_store_si512(at.ty + i, _mm512_and_si512(qy, fraction));
}

LFRIG_AVX512 void sample_row_avx512(const PairPicture &picture, const Taps &taps, const float *field, float dr,
                                    float dc, int y, int count, uint8_t *out) {
    Positions at;
    alignas(64) uint8_t bytes[3 * BLOCK + 16];
    const int16_t *data = picture.data.data();
    const size_t below = size_t(picture.width) * 16;
    const __m512i spread = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
    const __m128i drop_fourth = _mm_setr_epi8(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, -1, -1, -1, -1);
    for (int x0 = 0; x0 < count; x0 += BLOCK) {
        const int n = std::min(BLOCK, count - x0);
        for (int i = 0; i < BLOCK; i += 16) find_sixteen(picture, field, dr, dc, x0, y, n, i, at);
        // Four pixels are written as 16 bytes, the last four of which belong to the next two pixels.
        uint8_t *to = count - x0 >= BLOCK + 2 ? out + 3 * size_t(x0) : bytes;
        for (int i = 0; i < n; i += 4) {
            __m512 column[4];
            for (int j = 0; j < 4; ++j) {
                const int16_t *upper = data + at.start[i + j];
                const int32_t *pair = taps.pair[at.ty[i + j]];
                const __m512i two = _mm512_madd_epi16(_mm512_loadu_si512(upper), _mm512_set1_epi32(pair[0]));
                const __m512i more = _mm512_madd_epi16(_mm512_loadu_si512(upper + below), _mm512_set1_epi32(pair[1]));
                const __m512 wx = _mm512_permutexvar_ps(
                    spread, _mm512_castps128_ps512(_mm_load_ps(taps.weight[at.tx[i + j]])));
                column[j] = _mm512_mul_ps(_mm512_cvtepi32_ps(_mm512_add_epi32(two, more)), wx);
            }
            const __m512 low = _mm512_add_ps(_mm512_shuffle_f32x4(column[0], column[1], 0x44),
                                             _mm512_shuffle_f32x4(column[0], column[1], 0xee));
            const __m512 high = _mm512_add_ps(_mm512_shuffle_f32x4(column[2], column[3], 0x44),
                                              _mm512_shuffle_f32x4(column[2], column[3], 0xee));
            const __m512 four =
                _mm512_add_ps(_mm512_shuffle_f32x4(low, high, 0x88), _mm512_shuffle_f32x4(low, high, 0xdd));
            const __m512 grey = _mm512_add_ps(_mm512_mul_ps(four, _mm512_set1_ps(TO_GREY)), _mm512_set1_ps(0.5f));
            const __m512i whole = _mm512_max_epi32(_mm512_cvttps_epi32(grey), _mm512_setzero_si512());
            const __m128i rgb = _mm_shuffle_epi8(_mm512_cvtusepi32_epi8(whole), drop_fourth);
            _mm_storeu_si128(reinterpret_cast<__m128i *>(to + 3 * i), rgb);
        }
        if (to == bytes) std::memcpy(out + 3 * size_t(x0), bytes, 3 * size_t(n));
    }
}
#endif

LFRIG_CLONES void float_row(const float *picture, int height, int width, int pad, Kernel kernel, const float *field,
                            float dr, float dc, int y, int count, float scale, uint16_t *out) {
    for (int x = 0; x < count; ++x) {
        const float d = field[x] - field[x] == 0.0f ? field[x] : 0.0f;
        float sample[4];
        sample_four(picture, height, width, kernel, float(x) + dc * d + float(pad), float(y) + dr * d + float(pad),
                    sample);
        for (int c = 0; c < 3; ++c) {
            const int grey = int(sample[c] * scale + 0.5f);
            out[3 * x + c] = uint16_t(grey < 0 ? 0 : grey > 65535 ? 65535 : grey);
        }
    }
}

// Where the taps of BLOCK listed pixels begin.
inline void find_listed(int height, int width, int pad, const int32_t *xs, const int32_t *ys, const float *px,
                        int count, float dr, float dc, Positions &at) {
    for (int i = 0; i < count; ++i) {
        const int qx = fixed_position(float(xs[i]) + dc * px[i] + float(pad), width);
        const int qy = fixed_position(float(ys[i]) + dr * px[i] + float(pad), height);
        at.start[i] = (((qy >> FRACTION_BITS) - 1) * width + ((qx >> FRACTION_BITS) - 1)) * 4;
        at.tx[i] = qx & (FRACTIONS - 1);
        at.ty[i] = qy & (FRACTIONS - 1);
    }
}

LFRIG_CLONES void float_list_plain(const float *picture, int height, int width, int pad, const Taps &taps,
                                   const int32_t *xs, const int32_t *ys, const float *px, int count, float dr,
                                   float dc, float *out) {
    Positions at;
    for (int first = 0; first < count; first += BLOCK) {
        const int n = std::min(BLOCK, count - first);
        find_listed(height, width, pad, xs + first, ys + first, px + first, n, dr, dc, at);
        for (int i = 0; i < n; ++i)
            weigh_taps(picture + at.start[i], width, taps.weight[at.tx[i]], taps.weight[at.ty[i]],
                       out + 4 * (first + i));
    }
}

#ifdef LFRIG_X86
LFRIG_AVX512 void float_list_avx512(const float *picture, int height, int width, int pad, const Taps &taps,
                                    const int32_t *xs, const int32_t *ys, const float *px, int count, float dr,
                                    float dc, float *out) {
    constexpr int AHEAD = 8;  // listed pixels lie apart: their rows are fetched before they are needed
    const __m512i spread = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
    Positions at;
    for (int first = 0; first < count; first += BLOCK) {
        const int n = std::min(BLOCK, count - first);
        find_listed(height, width, pad, xs + first, ys + first, px + first, n, dr, dc, at);
        for (int i = 0; i < n; ++i) {
            if (i + AHEAD < n)
                for (int j = 0; j < 4; ++j)
                    _mm_prefetch(reinterpret_cast<const char *>(picture + at.start[i + AHEAD] + 4 * j * width + 8),
                                 _MM_HINT_T0);
            const float *wy = taps.weight[at.ty[i]], *tap = picture + at.start[i];
            const __m512 wx =
                _mm512_permutexvar_ps(spread, _mm512_castps128_ps512(_mm_load_ps(taps.weight[at.tx[i]])));
            __m512 row[4];
            for (int j = 0; j < 4; ++j)
                row[j] = _mm512_mul_ps(_mm512_set1_ps(wy[j]), _mm512_loadu_ps(tap + size_t(4) * j * width));
            const __m512 column =
                _mm512_mul_ps(wx, _mm512_add_ps(_mm512_add_ps(row[0], row[1]), _mm512_add_ps(row[2], row[3])));
            const __m256 halves = _mm256_add_ps(_mm512_castps512_ps256(column), _mm512_extractf32x8_ps(column, 1));
            _mm_storeu_ps(out + 4 * size_t(first + i),
                          _mm_add_ps(_mm256_castps256_ps128(halves), _mm256_extractf128_ps(halves, 1)));
        }
    }
}
#endif

}  // namespace

void sample_float_list(const float *picture, int height, int width, int pad, const Taps &taps, const int32_t *xs,
                       const int32_t *ys, const float *px, int count, float dr, float dc, float *out) {
#ifdef LFRIG_X86
    if (has_avx512())
        return float_list_avx512(picture, height, width, pad, taps, xs, ys, px, count, dr, dc, out);
#endif
    float_list_plain(picture, height, width, pad, taps, xs, ys, px, count, dr, dc, out);
}

void PairPicture::set_row(int y, const float *rgba) {
    int16_t *own = data.data() + size_t(y) * width * 8;
    int16_t *above = y > 0 ? own - size_t(width) * 8 : nullptr;
    for (int k = 0; k < 4 * width; ++k) {
        const float scaled = rgba[k] * float(PAIR_SCALE);
        const float kept = std::min(std::max(scaled, -32768.0f), 32767.0f);
        const int16_t value = int16_t(std::floor(kept + 0.5f));
        own[2 * k] = value;
        if (above) above[2 * k + 1] = value;
    }
}

void sample_pairs_row(const PairPicture &picture, const Taps &taps, const float *field, float dr, float dc, int y,
                      int count, uint8_t *out) {
#ifdef LFRIG_X86
    if (has_avx512()) return sample_row_avx512(picture, taps, field, dr, dc, y, count, out);
#endif
    sample_row_plain(picture, taps, field, dr, dc, y, count, out);
}

void sample_float_row(const float *picture, int height, int width, int pad, Kernel kernel, const float *field,
                      float dr, float dc, int y, int count, float scale, uint16_t *out) {
    float_row(picture, height, width, pad, kernel, field, dr, dc, y, count, scale, out);
}

}  // namespace lfrig
