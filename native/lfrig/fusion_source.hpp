// Projective fusion, part 1: a source, the rays of a block of target pixels, and what those meet in the source plane by
// plane. Used by fusion.cpp.
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "lfrig/parallel.hpp"

#define LFRIG_INLINE __attribute__((always_inline)) inline

namespace lfrig {

constexpr int kSide = 8;             // a block is kSide x kSide target pixels, a brick one plane of it
constexpr int kRays = kSide * kSide;
constexpr int kTile = 8;             // px, of the tables of occupancy.cpp
constexpr float kRim = 1e-3f;        // a ray that meets the frame's rim to within rounding is inside
constexpr float kSlack = 1.0f / 16;  // px by which a brick must clear the rim to count as inside or outside as a whole
constexpr float kNearest = 1e-6f;    // ratio of depths: nearer points count as behind the source

struct FusionSource {
    const uint16_t *probability;  // [height, width, planes]
    const float *disparity;       // [height, width]
    const uint8_t *colour;        // [height, width, 4] in the photo's tone, the last one the share of saturated; or null
    const int32_t *sums;          // occupancy.py: `sums`, `least`, `greatest`
    const float *least, *greatest;
    int height, width, planes, tile_rows, tile_columns;
    float a[9], b[3];         // p = A (x, y, 1) + b w
    float scale_a, scale_c;   // 1/z = scale_a * delta + scale_c
    float first, step;        // disparity planes
    float per_w, level;       // plane index = per_w * inverse depth + level
};

struct TargetPlanes {
    float w0, dw;
    int count;
    bool literal;  // the target's plane is taken for the source's
};

// The index of the source's plane is `slope / z + level` where z is the ratio of depths.
struct PlaneIndex {
    float slope, level;
};

LFRIG_INLINE PlaneIndex plane_index(const FusionSource &s, const TargetPlanes &t, float w) {
    return t.literal ? PlaneIndex{0, s.per_w * w + s.level} : PlaneIndex{s.per_w * w, s.level};
}

// A (x, y, 1) for the pixels of a block; beyond the picture's end the last pixel is repeated.
struct Rays {
    alignas(64) float x[kRays], y[kRays], z[kRays];
    float corner[4][3];
};

inline Rays make_rays(const FusionSource &s, int x0, int y0, int width, int height) {
    Rays rays;
    const int x1 = std::min(x0 + kSide, width) - 1, y1 = std::min(y0 + kSide, height) - 1;
    auto at = [&](int row, int x, int y) { return s.a[3 * row] * x + s.a[3 * row + 1] * y + s.a[3 * row + 2]; };
    for (int i = 0; i < kRays; ++i) {
        const int x = std::min(x0 + i % kSide, x1), y = std::min(y0 + i / kSide, y1);
        rays.x[i] = at(0, x, y), rays.y[i] = at(1, x, y), rays.z[i] = at(2, x, y);
    }
    for (int c = 0; c < 4; ++c)
        for (int row = 0; row < 3; ++row) rays.corner[c][row] = at(row, c & 1 ? x1 : x0, c & 2 ? y1 : y0);
    return rays;
}

// What a brick meets in a source. `kOutside`: nothing; `kInside`: all its rays are in the frame; `kMass`: probability
// may lie within reach; `kVisible`, `kHidden`: the source's own surface lies behind or in front of all of it.
enum Meets : int32_t { kOutside = 1, kInside = 2, kMass = 4, kVisible = 8, kHidden = 16 };

// Bounds of pixel and plane index over a brick, one array entry for each plane.
struct Bounds {
    std::vector<float> u0, u1, v0, v1, q0, q1;
    explicit Bounds(int planes) : u0(planes), u1(planes), v0(planes), v1(planes), q0(planes), q1(planes) {}
};

// The map is projective, so the corners of a block bound it, as long as all of it lies in front of the source.
LFRIG_CLONES inline void bound_bricks(const FusionSource &s, const Rays &rays, const TargetPlanes &t, Bounds &bounds) {
    constexpr float kAnywhere = 1e9f;
    float *u0 = bounds.u0.data(), *u1 = bounds.u1.data(), *v0 = bounds.v0.data(), *v1 = bounds.v1.data();
    float *q0 = bounds.q0.data(), *q1 = bounds.q1.data();
    const float b0 = s.b[0], b1 = s.b[1], b2 = s.b[2], w0 = t.w0, dw = t.dw;
    const float per_w = s.per_w, level = s.level;
    float c[4][3];
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 3; ++j) c[i][j] = rays.corner[i][j];
    const float tilt = t.literal ? 0.0f : 1.0f;
#pragma GCC ivdep
    for (int k = 0; k < t.count; ++k) {
        const float w = w0 + dw * float(k), slope = w * per_w;
        float least_z = kAnywhere, least_u = kAnywhere, most_u = -kAnywhere, least_v = kAnywhere, most_v = -kAnywhere;
        float least_q = kAnywhere, most_q = -kAnywhere;
#pragma GCC unroll 4
        for (int i = 0; i < 4; ++i) {
            const float z = c[i][2] + b2 * w, inverse = 1.0f / z;
            const float u = (c[i][0] + b0 * w) * inverse, v = (c[i][1] + b1 * w) * inverse;
            const float q = (tilt * inverse + (1.0f - tilt)) * slope + level;
            least_z = std::min(least_z, z);
            least_u = std::min(least_u, u), most_u = std::max(most_u, u);
            least_v = std::min(least_v, v), most_v = std::max(most_v, v);
            least_q = std::min(least_q, q), most_q = std::max(most_q, q);
        }
        const bool ahead = least_z > kNearest;
        u0[k] = ahead ? least_u : -kAnywhere, u1[k] = ahead ? most_u : kAnywhere;
        v0[k] = ahead ? least_v : -kAnywhere, v1[k] = ahead ? most_v : kAnywhere;
        q0[k] = ahead ? least_q : -kAnywhere, q1[k] = ahead ? most_q : kAnywhere;
    }
}

// `value` in [low, high] as an integer, rounded towards zero; not a number becomes low.
LFRIG_INLINE int32_t cell(float value, int32_t low, int32_t high) {
    const float most = float(high), at_least = value > float(low) ? value : float(low);
    return int32_t(at_least < most ? at_least : most);
}

// Visible or hidden as a whole: by the extremes of the surface in the tiles that the brick touches, when four windows
// of 2 x 2 tiles cover them.
LFRIG_CLONES inline void classify_bricks(const FusionSource &s, const Bounds &bounds, int count, float margin,
                                         int32_t *__restrict meets) {
    const float *u0 = bounds.u0.data(), *u1 = bounds.u1.data(), *v0 = bounds.v0.data(), *v1 = bounds.v1.data();
    const float *q0 = bounds.q0.data(), *q1 = bounds.q1.data();
    const int32_t *sums = s.sums;
    const float *least = s.least, *greatest = s.greatest;
    const int32_t last_x = s.width - 1, last_y = s.height - 1, planes = s.planes, columns = s.tile_columns;
    const int32_t along_x = planes + 1, along_y = (columns + 1) * along_x;
    const float right = float(last_x), bottom = float(last_y), first = s.first, step = s.step;
#pragma GCC ivdep
    for (int k = 0; k < count; ++k) {
        const bool outside = (u1[k] < -kSlack) | (v1[k] < -kSlack) | (u0[k] > right + kSlack) | (v0[k] > bottom + kSlack);
        const bool inside =
            (u0[k] >= kSlack) & (v0[k] >= kSlack) & (u1[k] <= right - kSlack) & (v1[k] <= bottom - kSlack);
        // Samples take the pixel and plane to either side.
        const int32_t x0 = cell(u0[k], 0, last_x) / kTile, x1 = cell(u1[k] + 1.0f, 0, last_x) / kTile + 1;
        const int32_t y0 = cell(v0[k], 0, last_y) / kTile, y1 = cell(v1[k] + 1.0f, 0, last_y) / kTile + 1;
        const int32_t z0 = cell(q0[k], 0, planes), z1 = cell(q1[k] + 2.0f, 0, planes);
        const int32_t northwest = y0 * along_y + x0 * along_x, northeast = y0 * along_y + x1 * along_x;
        const int32_t southwest = y1 * along_y + x0 * along_x, southeast = y1 * along_y + x1 * along_x;
        const int32_t mass = (sums[southeast + z1] - sums[southwest + z1] - sums[northeast + z1] + sums[northwest + z1]) -
                             (sums[southeast + z0] - sums[southwest + z0] - sums[northeast + z0] + sums[northwest + z0]);
        const bool few = (x1 - x0 <= 4) & (y1 - y0 <= 4);
        const int32_t xb = std::max(x0, x1 - 2), yb = std::max(y0, y1 - 2);
        const int32_t aa = y0 * columns + x0, ab = y0 * columns + xb, ba = yb * columns + x0, bb = yb * columns + xb;
        const float nearest = std::max(std::max(greatest[aa], greatest[ab]), std::max(greatest[ba], greatest[bb]));
        const float farthest = std::min(std::min(least[aa], least[ab]), std::min(least[ba], least[bb]));
        const float qa = q0[k] * step, qb = q1[k] * step;
        const float behind = std::min(qa, qb) + first, before = std::max(qa, qb) + first;
        const bool visible = few & !(nearest - behind > margin), hidden = few & (farthest - before >= 1.5f * margin);
        meets[k] = (outside ? kOutside : 0) | (inside ? kInside : 0) | (mass != 0 ? kMass : 0) |
                   (visible ? kVisible : 0) | (hidden ? kHidden : 0);
    }
}

}  // namespace lfrig
