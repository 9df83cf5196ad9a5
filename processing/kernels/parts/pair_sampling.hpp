// Rows of RGB samples of a view, four taps each way: 8 bits from a fixed-point picture, 16 bits from a float one.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "lfrig/taps.hpp"

namespace lfrig {

constexpr int PAIR_SCALE = 16;  // of a grey level; coefficients of an 8-bit picture stay below 1300 in size

// A padded picture [height, width] of four channels (the fourth is 0) in units of 1/PAIR_SCALE grey level. Each pixel
// holds, channel by channel, its own value and that of the pixel below: one multiply-add weighs both.
struct PairPicture {
    int height, width, pad;
    std::vector<int16_t> data;

    PairPicture(int height, int width, int pad)
        : height(height), width(width), pad(pad), data(size_t(height) * width * 8) {}
    // Write row y: float32 [width, 4] grey levels.
    void set_row(int y, const float *rgba);
};

// One row of a view: out[x] = picture(y + dr * field[x], x + dc * field[x]) for x in [0, count), uint8 [count, 3].
// Positions are those of the picture without its padding; a field that is not finite counts as 0.
void sample_pairs_row(const PairPicture &picture, const Taps &taps, const float *field, float dr, float dc, int y,
                      int count, uint8_t *out);

// The same, uint16 [count, 3], from a padded picture float32 [height, width, 4], its values times `scale`.
void sample_float_row(const float *picture, int height, int width, int pad, Kernel kernel, const float *field,
                      float dr, float dc, int y, int count, float scale, uint16_t *out);

// All four channels at single pixels of a view: float32 [n, 4],
// out[i] = picture(ys[i] + dr * px[i], xs[i] + dc * px[i]).
void sample_float_list(const float *picture, int height, int width, int pad, const Taps &taps, const int32_t *xs,
                       const int32_t *ys, const float *px, int count, float dr, float dc, float *out);

}  // namespace lfrig
