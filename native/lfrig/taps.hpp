// Weights of the four taps around a position, tabulated over its fraction, and samples of a four-channel picture.
//
// A table makes the weights of a pixel two loads, whatever the kernel; fractions are rounded to 1/1024 px, which moves
// a sample by less than 0.0005 px.
#pragma once
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace lfrig {

constexpr int FRACTION_BITS = 10, FRACTIONS = 1 << FRACTION_BITS;
constexpr int WEIGHT_ONE = 1 << 14;  // weight 1 in fixed point

// Weights of the four taps around a fraction t in 0..1.
using Kernel = void (*)(float t, float w[4]);

// The cubic B-spline.
inline void spline_weights(float t, float w[4]) {
    const float s = 1.0f - t, sixth = float(1.0 / 6.0);
    w[0] = sixth * s * s * s;
    w[1] = sixth * (4.0f - 3.0f * t * t * (2.0f - t));
    w[2] = sixth * (4.0f - 3.0f * s * s * (2.0f - s));
    w[3] = sixth * t * t * t;
}

// Catmull-Rom (Keys, "Cubic convolution interpolation", 1981, a = -1/2).
inline void keys_weights(float t, float w[4]) {
    const float t2 = t * t, t3 = t2 * t;
    w[0] = -0.5f * t3 + t2 - 0.5f * t;
    w[1] = 1.5f * t3 - 2.5f * t2 + 1.0f;
    w[2] = -1.5f * t3 + 2.0f * t2 + 0.5f * t;
    w[3] = 0.5f * t3 - 0.5f * t2;
}

enum class Interpolation { SPLINE, KEYS };

inline Kernel kernel_of(Interpolation kind) { return kind == Interpolation::SPLINE ? spline_weights : keys_weights; }

struct Taps {
    Interpolation kind;
    alignas(64) float weight[FRACTIONS][4];
    alignas(64) int32_t pair[FRACTIONS][2];  // fixed point, two int16 each: (w0, w1), (w2, w3); the four sum to one

    explicit Taps(Interpolation kind) : kind(kind) {
        for (int k = 0; k < FRACTIONS; ++k) {
            float *w = weight[k];
            const float t = float(k) / float(FRACTIONS);
            kernel_of(kind)(t, w);
            int fixed[4], rest = WEIGHT_ONE;
            for (int i = 0; i < 4; ++i) {
                fixed[i] = int(std::floor(w[i] * float(WEIGHT_ONE) + 0.5f));
                rest -= fixed[i];
            }
            fixed[t <= 0.5f ? 1 : 2] += rest;  // the largest takes what rounding lost
            for (int i = 0; i < 2; ++i)
                pair[k][i] = int32_t(uint32_t(uint16_t(fixed[2 * i])) | uint32_t(uint16_t(fixed[2 * i + 1])) << 16);
        }
    }
};

inline const Taps &spline_taps() {
    static const Taps taps(Interpolation::SPLINE);
    return taps;
}

inline const Taps &keys_taps() {
    static const Taps taps(Interpolation::KEYS);
    return taps;
}

// A position in a padded picture in units of 1/FRACTIONS px, kept where all four taps exist; NaN is the first of them.
inline int fixed_position(float at, int size) {
    const float last = float(size - 3);
    at = at > 1.0f ? at : 1.0f;
    at = at < last ? at : last;
    return int(at * float(FRACTIONS) + 0.5f);
}

// The weighted sum over four by four pixels of four channels, the rows `width` pixels apart.
inline void weigh_taps(const float *tap, int width, const float wx[4], const float wy[4], float out[4]) {
    float column[16];
    for (int k = 0; k < 16; ++k)
        column[k] = (wy[0] * tap[k] + wy[1] * tap[4 * width + k]) +
                    (wy[2] * tap[8 * width + k] + wy[3] * tap[12 * width + k]);
    for (int c = 0; c < 4; ++c)
        out[c] = (wx[0] * column[c] + wx[2] * column[8 + c]) + (wx[1] * column[4 + c] + wx[3] * column[12 + c]);
}

// Sample of a picture float32 [height, width, 4] at (x, y), with exact weights; positions as for fixed_position.
inline void sample_four(const float *picture, int height, int width, Kernel kernel, float x, float y, float out[4]) {
    const float last_x = float(width - 3), last_y = float(height - 3);
    x = x > 1.0f ? x : 1.0f, y = y > 1.0f ? y : 1.0f;
    x = x < last_x ? x : last_x, y = y < last_y ? y : last_y;
    const int ix = int(x), iy = int(y);
    float wx[4], wy[4];
    kernel(x - float(ix), wx);
    kernel(y - float(iy), wy);
    weigh_taps(picture + (size_t(iy - 1) * width + (ix - 1)) * 4, width, wx, wy, out);
}

}  // namespace lfrig
