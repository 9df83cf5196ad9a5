// Projective fusion, part 2: evidence and colours at the voxels of a brick. Used by fusion.cpp.
#pragma once
#include <cmath>
#include <cstring>

#include "lfrig/fusion_source.hpp"
#include "lfrig/logarithm.hpp"

namespace lfrig {

struct Pool {
    float floor_share, margin;
    float neutral;     // what a source says of a voxel that it does not see
    float floor_mass;  // probability that every plane has whatever the source says
};

// One ray at one plane, as the source sees it.
struct Place {
    float u, v, q, inverse;  // px, px, plane index, 1 / ratio of depths
    int32_t inside;
};

template <bool kKnownInside>
LFRIG_INLINE Place place(const FusionSource &s, float x, float y, float z, float w, PlaneIndex index) {
    const float right = float(s.width - 1), bottom = float(s.height - 1);
    const float depth = z + s.b[2] * w;
    Place p;
    p.inverse = 1.0f / (kKnownInside || depth > kNearest ? depth : kNearest);
    p.u = (x + s.b[0] * w) * p.inverse, p.v = (y + s.b[1] * w) * p.inverse;
    p.q = p.inverse * index.slope + index.level;
    p.inside = 1;
    if (!kKnownInside) {
        p.inside = (depth > kNearest) & (p.u > -kRim) & (p.v > -kRim) & (p.u < right + kRim) & (p.v < bottom + kRim);
        p.u = p.u > 0 ? p.u : 0, p.v = p.v > 0 ? p.v : 0;
        p.u = p.u < right ? p.u : right, p.v = p.v < bottom ? p.v : bottom;
    }
    return p;
}

// The pixel before a coordinate in [0, last], such that there is one after it.
LFRIG_INLINE int32_t before(float at, int32_t last) { return std::min(int32_t(at), last - 1); }

// Between two neighbouring planes of one pixel.
LFRIG_INLINE float along_planes(const uint16_t *at, float share) {
    uint32_t both;
    std::memcpy(&both, at, sizeof both);
    const float a = float(int32_t(both & 0xffff)), b = float(int32_t(both >> 16));
    return a + share * (b - a);
}

// Trilinear probability; 0 beyond the planes.
LFRIG_INLINE float probability_at(const FusionSource &s, const Place &p) {
    const int32_t last = s.planes - 1, iu = before(p.u, s.width - 1), iv = before(p.v, s.height - 1);
    const bool known = (p.q >= 0) & (p.q < float(last));
    const float q = known ? p.q : 0;
    const int32_t iq = int32_t(q), row = s.width * s.planes, at = iv * row + iu * s.planes + iq;
    const float fu = p.u - float(iu), fv = p.v - float(iv), fq = q - float(iq);
    const uint16_t *volume = s.probability;
    const float a = along_planes(volume + at, fq), b = along_planes(volume + (at + s.planes), fq);
    const float c = along_planes(volume + (at + row), fq), d = along_planes(volume + (at + row + s.planes), fq);
    const float top = a + fu * (b - a), low = c + fu * (d - c);
    // A factor, not a branch: loads must not depend on it, or the loop is not vectorised.
    return (top + fv * (low - top)) * (known ? 1.0f / 65535.0f : 0.0f);
}

// How far the source's own surface hides the voxel, 0..1.
LFRIG_INLINE float hidden_at(const FusionSource &s, const Place &p, float margin) {
    const float seen = s.disparity[int32_t(p.v + 0.5f) * s.width + int32_t(p.u + 0.5f)];
    const float depth = (seen - (p.q * s.step + s.first) - margin) / (0.5f * margin);
    return std::min(1.0f, std::max(0.0f, depth));
}

// Adds the log evidence of bricks `ks` to `evidence` [planes][kRays]; counts the rays inside in `inside`.
template <bool kKnownInside, bool kMass, bool kVisible>
LFRIG_INLINE void add_scores(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const Pool &pool,
                             const int *ks, int count, const int32_t *valid, float *evidence, int32_t &inside) {
    const float share = 1.0f - pool.floor_share;
    const float stretch = std::fabs(t.dw / (s.scale_a * s.step));
    const float neutral = pool.neutral, floor_mass = pool.floor_mass, nothing = log_of(floor_mass);
    for (int n = 0; n < count; ++n) {
        const float w = t.w0 + t.dw * float(ks[n]);
        const PlaneIndex index = plane_index(s, t, w);
        float *__restrict row = evidence + size_t(ks[n]) * kRays;
        const float *x = rays.x, *y = rays.y, *z = rays.z;
        int32_t seen = 0;
#pragma GCC ivdep
        for (int i = 0; i < kRays; ++i) {
            const Place p = place<kKnownInside>(s, x[i], y[i], z[i], w, index);
            float score = nothing;
            if (kMass) {
                // Mass per target plane: the source's planes are stretched along this ray by |d delta / d w|.
                const float width = stretch * std::fabs(z[i]) * (p.inverse * p.inverse);
                score = log_of(share * probability_at(s, p) * std::min(4.0f, width) + floor_mass);
            }
            if (!kVisible) score = std::max(score, score + hidden_at(s, p, pool.margin) * (neutral - score));
            if (!kKnownInside) score = p.inside ? score : neutral, seen += p.inside & valid[i];
            row[i] += score;
        }
        inside += seen;
    }
}

// The same for the mean pool: sums of probabilities and, in `mass`, of sources.
template <bool kKnownInside, bool kMass>
LFRIG_INLINE void add_means(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const int *ks, int count,
                            const int32_t *valid, float *evidence, float *mass, int32_t &inside) {
    for (int n = 0; n < count; ++n) {
        const float w = t.w0 + t.dw * float(ks[n]);
        const PlaneIndex index = plane_index(s, t, w);
        float *__restrict row = evidence + size_t(ks[n]) * kRays, *__restrict weight = mass + size_t(ks[n]) * kRays;
        const float *x = rays.x, *y = rays.y, *z = rays.z;
        int32_t seen = 0;
        for (int i = 0; i < kRays; ++i) {
            const Place p = place<kKnownInside>(s, x[i], y[i], z[i], w, index);
            if (kMass) row[i] += float(p.inside) * probability_at(s, p);
            weight[i] += float(p.inside);
            seen += p.inside & valid[i];
        }
        if (!kKnownInside) inside += seen;
    }
}

// A brick's kinds that are sampled in different ways.
enum Sampling { kPlain, kStraddling, kSurfaceOnly, kRimmed, kRimmedSurface, kSamplings };

LFRIG_CLONES inline void add_log_evidence(const FusionSource &s, const Rays &rays, const TargetPlanes &t,
                                          const Pool &pool, Sampling how, const int *ks, int count,
                                          const int32_t *valid, float *evidence, int32_t &inside) {
    if (how == kPlain) add_scores<true, true, true>(s, rays, t, pool, ks, count, valid, evidence, inside);
    if (how == kStraddling) add_scores<true, true, false>(s, rays, t, pool, ks, count, valid, evidence, inside);
    if (how == kSurfaceOnly) add_scores<true, false, false>(s, rays, t, pool, ks, count, valid, evidence, inside);
    if (how == kRimmed) add_scores<false, true, false>(s, rays, t, pool, ks, count, valid, evidence, inside);
    if (how == kRimmedSurface) add_scores<false, false, false>(s, rays, t, pool, ks, count, valid, evidence, inside);
}

LFRIG_CLONES inline void add_mean_evidence(const FusionSource &s, const Rays &rays, const TargetPlanes &t, Sampling how,
                                           const int *ks, int count, const int32_t *valid, float *evidence, float *mass,
                                           int32_t &inside) {
    if (how == kPlain || how == kStraddling) add_means<true, true>(s, rays, t, ks, count, valid, evidence, mass, inside);
    if (how == kSurfaceOnly) add_means<true, false>(s, rays, t, ks, count, valid, evidence, mass, inside);
    if (how == kRimmed) add_means<false, true>(s, rays, t, ks, count, valid, evidence, mass, inside);
    if (how == kRimmedSurface) add_means<false, false>(s, rays, t, ks, count, valid, evidence, mass, inside);
}

struct ColourTerm {
    float weight, sigma, cap, unknown;
    float reach;  // log evidence below a ray's best from which on colours are not asked
};

// A block's pixels: colours and whether they may be compared where the source is brighter.
struct PhotoBlock {
    alignas(64) float colour[3][kRays], bounded[kRays];
};

LFRIG_INLINE float channel(uint32_t colour, int c) { return float(int32_t(colour >> (8 * c) & 0xff)); }

// What the photo's pixel i has against the colour that the source shows, mean over r, g, b [grey levels].
LFRIG_INLINE float mismatch(const FusionSource &s, const PhotoBlock &photo, int i, const Place &p) {
    const int32_t iu = before(p.u, s.width - 1), iv = before(p.v, s.height - 1), at = 4 * (iv * s.width + iu);
    const float fu = p.u - float(iu), fv = p.v - float(iv);
    uint32_t a, b, c, d;
    std::memcpy(&a, s.colour + at, 4), std::memcpy(&b, s.colour + (at + 4), 4);
    std::memcpy(&c, s.colour + (at + 4 * s.width), 4), std::memcpy(&d, s.colour + (at + 4 * s.width + 4), 4);
    // A saturated value is a lower bound: being brighter than it says nothing.
    const float under = (a | b | c | d) >> 24 ? 0.0f : 1.0f, over = photo.bounded[i];
    float sum = 0;
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j) {
        const float top = channel(a, j) + fu * (channel(b, j) - channel(a, j));
        const float low = channel(c, j) + fu * (channel(d, j) - channel(c, j));
        const float rise = photo.colour[j][i] - (top + fv * (low - top));
        sum += under * std::max(rise, 0.0f) + over * std::max(-rise, 0.0f);
    }
    return sum * (1.0f / 3.0f);
}

constexpr int kGroup = 16;  // rays that are asked for their colours together
constexpr int kGroups = kRays / kGroup;

template <bool kPlainView>
LFRIG_INLINE void compare(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const PhotoBlock &photo,
                          const ColourTerm &term, float margin, int k, int from, float *__restrict gain) {
    const float w = t.w0 + t.dw * float(k), per_grey = 1.0f / term.sigma;
    const PlaneIndex index = plane_index(s, t, w);
    const float *x = rays.x, *y = rays.y, *z = rays.z;
#pragma GCC ivdep
    for (int i = from; i < from + kGroup; ++i) {
        const Place p = place<kPlainView>(s, x[i], y[i], z[i], w, index);
        const float cost = std::min(mismatch(s, photo, i, p) * per_grey, term.cap);
        float said = term.weight * (term.unknown - cost);
        if (!kPlainView) said *= (1.0f - hidden_at(s, p, margin)) * float(p.inside);
        gain[i - from] += said;
    }
}

// Adds what the colours say to the voxels of a block that come within `reach` of their ray's best.
// `meets` [sources][planes]; `wanted` [planes]: a bit for each group that holds such a voxel.
LFRIG_CLONES inline void add_colours(const FusionSource *sources, int count, const Rays *rays, const TargetPlanes &t,
                                     const PhotoBlock &photo, const ColourTerm &term, float margin,
                                     const int32_t *meets, const uint8_t *wanted, const float *limit, float *evidence) {
    for (int k = 0; k < t.count; ++k)
        for (int g = 0; g < kGroups; ++g) {
            if (!(wanted[k] >> g & 1)) continue;
            alignas(64) float gain[kGroup] = {};
            for (int n = 0; n < count; ++n) {
                const int32_t meeting = meets[n * t.count + k];
                if (meeting & (kOutside | kHidden)) continue;
                if ((meeting & kInside) && (meeting & kVisible))
                    compare<true>(sources[n], rays[n], t, photo, term, margin, k, g * kGroup, gain);
                else
                    compare<false>(sources[n], rays[n], t, photo, term, margin, k, g * kGroup, gain);
            }
            float *row = evidence + size_t(k) * kRays + g * kGroup;
            const float *least = limit + g * kGroup;
            for (int i = 0; i < kGroup; ++i) row[i] += row[i] >= least[i] ? gain[i] : 0.0f;
        }
}

}  // namespace lfrig
