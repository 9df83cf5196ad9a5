// Sums over the pixels of a patch. Used by the kernels on patches (patches.cpp and its neighbours).
#pragma once

// Into the function with clones, so that it is compiled for each of their instruction sets.
#if defined(__GNUC__)
#define LFRIG_INLINE inline __attribute__((always_inline))
#else
#define LFRIG_INLINE inline
#endif

namespace {

constexpr int kLanes = 16;       // sums are kept in so many parts: the same bits for every vector width
constexpr int kMaxPixels = 256;  // of a patch, whole lanes

LFRIG_INLINE int whole_lanes(int pixels) { return (pixels + kLanes - 1) / kLanes * kLanes; }

LFRIG_INLINE float sum_of(const float *lanes) {
    float total = 0;
    for (int l = 0; l < kLanes; ++l) total += lanes[l];
    return total;
}

// Σ a b over whole lanes.
LFRIG_INLINE float dot(int count, const float *a, const float *b) {
    float lanes[kLanes] = {};
    for (int k = 0; k < count; k += kLanes)
        for (int l = 0; l < kLanes; ++l) lanes[l] += a[k + l] * b[k + l];
    return sum_of(lanes);
}

}  // namespace
