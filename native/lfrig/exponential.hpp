// An exponential that compilers vectorise, with the same bits for every vector width.
#pragma once
#include <algorithm>
#include <cstdint>
#include <cstring>

namespace lfrig {

// exp(-e) for e >= 0, to 3e-7 of its value: 2^k times a polynomial on [-1/2, 1/2]. Below 2^-126 it stays there.
inline float exp_of_minus(float e) {
    const float t = std::max(-126.0f, -1.44269504f * e);
    const float whole = (t + 12582912.0f) - 12582912.0f;  // rounds to the nearest integer
    const float f = t - whole;
    float p = 1.5403530e-4f;
    p = p * f + 1.3333558e-3f;
    p = p * f + 9.6181291e-3f;
    p = p * f + 5.5504109e-2f;
    p = p * f + 2.4022651e-1f;
    p = p * f + 6.9314718e-1f;
    p = p * f + 1.0f;
    const int32_t bits = (int32_t(whole) + 127) << 23;
    float scale;
    std::memcpy(&scale, &bits, sizeof scale);
    return p * scale;
}

}  // namespace lfrig
