// The margin around an image: its border pixels, repeated.
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>

namespace lfrig {

// Repeats the first and last of `width` values at `pad` over the rest of the row.
inline void extend_row(int16_t *row, int pad, int width, int stride) {
    std::fill(row, row + pad, row[pad]);
    std::fill(row + pad + width, row + stride, row[pad + width - 1]);
}

// Repeats the first and last of `height` rows at `pad` over the rest of the view.
inline void extend_rows(int16_t *view, int pad, int height, int rows, int stride) {
    const size_t bytes = size_t(stride) * sizeof(int16_t);
    for (int y = 0; y < pad; ++y) std::memcpy(view + size_t(y) * stride, view + size_t(pad) * stride, bytes);
    for (int y = pad + height; y < rows; ++y)
        std::memcpy(view + size_t(y) * stride, view + size_t(pad + height - 1) * stride, bytes);
}

}  // namespace lfrig
