// Transposes of small blocks of 16-bit values: 128-bit vectors, which every target has.
#pragma once
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace lfrig {

#if defined(__GNUC__)
typedef uint16_t u16x8 __attribute__((vector_size(16)));

// to[j * to_stride + i] = from[i * from_stride + j] for i, j in [0, 8).
inline void transpose8x8(const uint16_t *from, size_t from_stride, uint16_t *to, size_t to_stride) {
    u16x8 r[8], s[8];
    for (int i = 0; i < 8; ++i) std::memcpy(&r[i], from + i * from_stride, sizeof r[i]);
    // Three rounds of interleaving row i with row i + 4.
    for (int round = 0; round < 3; ++round) {
        for (int i = 0; i < 4; ++i) {
            s[2 * i] = __builtin_shufflevector(r[i], r[i + 4], 0, 8, 1, 9, 2, 10, 3, 11);
            s[2 * i + 1] = __builtin_shufflevector(r[i], r[i + 4], 4, 12, 5, 13, 6, 14, 7, 15);
        }
        for (int i = 0; i < 8; ++i) r[i] = s[i];
    }
    for (int i = 0; i < 8; ++i) std::memcpy(to + i * to_stride, &r[i], sizeof r[i]);
}
#else
inline void transpose8x8(const uint16_t *from, size_t from_stride, uint16_t *to, size_t to_stride) {
    for (int i = 0; i < 8; ++i)
        for (int j = 0; j < 8; ++j) to[j * to_stride + i] = from[i * from_stride + j];
}
#endif

}  // namespace lfrig
