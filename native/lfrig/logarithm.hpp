// A logarithm that compilers vectorise, with the same bits for every vector width.
#pragma once
#include <cstdint>
#include <cstring>

namespace lfrig {

// log(x) for finite x > 0, to 3e-6: exponent bits and a polynomial on [2/3, 4/3). Zero gives -88.
inline float log_of(float x) {
    int32_t bits;
    std::memcpy(&bits, &x, sizeof bits);
    const int32_t exponent = (bits - 0x3f2aaaab) >> 23;
    bits -= int32_t(uint32_t(exponent) << 23);
    float mantissa;
    std::memcpy(&mantissa, &bits, sizeof mantissa);
    const float f = mantissa - 1.0f;
    float p = -0.19961216f;
    p = p * f + 0.22632157f;
    p = p * f - 0.24761206f;
    p = p * f + 0.33228390f;
    p = p * f - 0.50004686f;
    return float(exponent) * 0.69314718f + (p * (f * f) + f);
}

}  // namespace lfrig
