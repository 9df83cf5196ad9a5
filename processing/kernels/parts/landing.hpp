// Where a point lands in a source, and what the source's own surface is there. Used by landing.cpp and its neighbours.
#pragma once
#include <cstddef>
#include <cstdint>

namespace {

struct Way {  // into one source
    int height, width;          // of the source's frame
    int map_height, map_width;  // of its disparity map
    const float *disparity;     // [map_height, map_width] px per view step
    float map[12];              // A row-major, then b: p = A (x, y, 1) + b w
    float a, c;                 // 1/z = a disparity + c
};

struct Spot {
    float u, v, w;  // px, px, 1/m there
    int inside;
};

constexpr float kFarOutside = -9e3f, kSane = 1e9f;

// To the nearest integer, halves to even, as one addition that vectorises; |t| < 2^22.
inline int nearest(float t) { return int((t + 12582912.0f) - 12582912.0f); }

inline Spot land(const Way &s, float x, float y, float w) {
    const float z = s.map[6] * x + s.map[7] * y + s.map[8] + s.map[11] * w;
    const float scale = 1.0f / z;
    const float u = (s.map[0] * x + s.map[1] * y + s.map[2] + s.map[9] * w) * scale;
    const float v = (s.map[3] * x + s.map[4] * y + s.map[5] + s.map[10] * w) * scale;
    const int front = (z > 1e-6f) & (u < kSane) & (u > -kSane) & (v < kSane) & (v > -kSane);
    Spot out;
    out.u = front ? u : kFarOutside;
    out.v = front ? v : kFarOutside;
    out.w = front ? w * scale : 0.0f;
    out.inside = (out.u >= 0.0f) & (out.v >= 0.0f) & (out.u <= float(s.width - 1)) & (out.v <= float(s.height - 1));
    return out;
}

// How much nearer the source's own surface is than the point [px per view step]; beyond the rim it goes on as there.
inline float ahead(const Way &s, const Spot &p) {
    const float right = float(s.map_width - 1), bottom = float(s.map_height - 1);
    float u = p.u > 0.0f ? p.u : 0.0f, v = p.v > 0.0f ? p.v : 0.0f;
    u = u < right ? u : right;
    v = v < bottom ? v : bottom;
    return s.disparity[nearest(v) * s.map_width + nearest(u)] - (p.w - s.c) / s.a;
}

}  // namespace
