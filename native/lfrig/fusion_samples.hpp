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

// `count` rays at one plane: where their voxels lie in the source's arrays, and what is read there. Reading is a loop of
// its own: loads from anywhere do not vectorise, and what compilers make of them inside a vectorised loop is slower.
template <int kCount>
struct Footprints {
    alignas(64) int32_t at[kCount];        // first of the eight voxels, or first of the four pixels
    alignas(64) int32_t nearest[kCount];   // pixel
    alignas(64) int32_t inside[kCount];
    alignas(64) float fu[kCount], fv[kCount], fq[kCount];  // shares of the later pixel, row and plane
    alignas(64) float width[kCount];       // target plane in planes of the source; 0 beyond them
    alignas(64) float bound[kCount];       // the surface hides the voxel from this disparity on
    alignas(64) uint32_t corner[4][kCount];
    alignas(64) float seen[kCount];        // disparity of the surface
};

// Keeps a value out of the vectoriser's sight.
LFRIG_INLINE size_t opaque(int32_t index) {
    size_t at = size_t(index);
    __asm__("" : "+r"(at));
    return at;
}

// 32 bits from each of four neighbours: pixels a, b, and c, d in the next row.
template <int kCount>
LFRIG_INLINE void read_corners(const void *data, size_t pixel_bytes, size_t row_bytes, int unit_bytes,
                               Footprints<kCount> &f) {
    const char *base = static_cast<const char *>(data);
    for (int i = 0; i < kCount; ++i) {
        const char *from = base + opaque(f.at[i]) * unit_bytes;
        std::memcpy(&f.corner[0][i], from, 4), std::memcpy(&f.corner[1][i], from + pixel_bytes, 4);
        std::memcpy(&f.corner[2][i], from + row_bytes, 4);
        std::memcpy(&f.corner[3][i], from + row_bytes + pixel_bytes, 4);
    }
}

template <int kCount>
LFRIG_INLINE void read_surface(const FusionSource &s, Footprints<kCount> &f) {
    for (int i = 0; i < kCount; ++i) f.seen[i] = s.disparity[opaque(f.nearest[i])];
}

// How far the source's own surface hides a voxel, 0..1.
LFRIG_INLINE float hidden(float seen, float bound, float per_px) {
    return std::min(1.0f, std::max(0.0f, (seen - bound) * per_px));
}

// Between two neighbouring planes of one pixel, packed.
LFRIG_INLINE float along_planes(uint32_t both, float share) {
    const float a = float(int32_t(both & 0xffff)), b = float(int32_t(both >> 16));
    return a + share * (b - a);
}

// Finds the footprints of a brick: rays [kRays] at plane index `k`.
template <bool kKnownInside>
LFRIG_INLINE void find_footprints(const FusionSource &s, const Rays &rays, const TargetPlanes &t, float margin, int k,
                                  Footprints<kRays> &f) {
    const float w = t.w0 + t.dw * float(k), stretch = std::fabs(t.dw / (s.scale_a * s.step));
    const PlaneIndex index = plane_index(s, t, w);
    const int32_t last = s.planes - 1, width = s.width, height = s.height, planes = s.planes;
    const float step = s.step, offset = s.first + margin, end = float(last);
    for (int i = 0; i < kRays; ++i) {
        const Place p = place<kKnownInside>(s, rays.x[i], rays.y[i], rays.z[i], w, index);
        const bool known = (p.q >= 0) & (p.q < end);
        const float q = known ? p.q : 0;
        const int32_t iu = before(p.u, width - 1), iv = before(p.v, height - 1), iq = int32_t(q);
        f.at[i] = (iv * width + iu) * planes + iq;
        f.fu[i] = p.u - float(iu), f.fv[i] = p.v - float(iv), f.fq[i] = q - float(iq);
        // Mass per target plane: the source's planes are stretched along this ray by |d delta / d w|.
        const float wide = std::min(4.0f, stretch * std::fabs(rays.z[i]) * (p.inverse * p.inverse));
        f.width[i] = known ? wide : 0;
        f.bound[i] = p.q * step + offset;
        f.nearest[i] = int32_t(p.v + 0.5f) * width + int32_t(p.u + 0.5f);
        f.inside[i] = p.inside;
    }
}

// Trilinear probability per 65535.
LFRIG_INLINE float probability(const Footprints<kRays> &f, int i) {
    const float a = along_planes(f.corner[0][i], f.fq[i]), b = along_planes(f.corner[1][i], f.fq[i]);
    const float c = along_planes(f.corner[2][i], f.fq[i]), d = along_planes(f.corner[3][i], f.fq[i]);
    const float top = a + f.fu[i] * (b - a), low = c + f.fu[i] * (d - c);
    return top + f.fv[i] * (low - top);
}

LFRIG_INLINE void read_volume(const FusionSource &s, Footprints<kRays> &f) {
    const size_t pixel_bytes = size_t(s.planes) * sizeof(uint16_t);
    read_corners(s.probability, pixel_bytes, size_t(s.width) * pixel_bytes, sizeof(uint16_t), f);
}

// Adds the log evidence of bricks `ks` to `evidence` [planes][kRays]; returns the rays inside.
template <bool kKnownInside, bool kMass, bool kVisible>
LFRIG_INLINE int32_t add_scores(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const Pool &pool,
                                const int *ks, int count, const int32_t *valid, float *evidence) {
    const float share = (1.0f - pool.floor_share) * (1.0f / 65535.0f), per_px = 2.0f / pool.margin;
    const float neutral = pool.neutral, floor_mass = pool.floor_mass, nothing = log_of(floor_mass);
    int32_t inside = 0;
    for (int n = 0; n < count; ++n) {
        Footprints<kRays> f;
        find_footprints<kKnownInside>(s, rays, t, pool.margin, ks[n], f);
        if (kMass) read_volume(s, f);
        if (!kVisible) read_surface(s, f);
        float *__restrict row = evidence + size_t(ks[n]) * kRays;
        for (int i = 0; i < kRays; ++i) {
            float score = kMass ? log_of(share * probability(f, i) * f.width[i] + floor_mass) : nothing;
            if (!kVisible) score = std::max(score, score + hidden(f.seen[i], f.bound[i], per_px) * (neutral - score));
            if (!kKnownInside) score = f.inside[i] ? score : neutral;
            row[i] += score;
            inside += f.inside[i] & valid[i];
        }
    }
    return inside;
}

// The same for the mean pool: sums of probabilities and, in `mass`, of sources.
template <bool kMass>
LFRIG_INLINE int32_t add_means(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const int *ks, int count,
                               const int32_t *valid, float *evidence, float *mass) {
    int32_t inside = 0;
    for (int n = 0; n < count; ++n) {
        Footprints<kRays> f;
        find_footprints<false>(s, rays, t, 0.0f, ks[n], f);
        if (kMass) read_volume(s, f);
        float *__restrict row = evidence + size_t(ks[n]) * kRays, *__restrict weight = mass + size_t(ks[n]) * kRays;
        for (int i = 0; i < kRays; ++i) {
            const float known = f.width[i] > 0 && f.inside[i] ? 1.0f / 65535.0f : 0.0f;
            if (kMass) row[i] += probability(f, i) * known;
            weight[i] += float(f.inside[i]);
            inside += f.inside[i] & valid[i];
        }
    }
    return inside;
}

// A brick's kinds that are sampled in different ways.
enum Sampling { kPlain, kStraddling, kSurfaceOnly, kRimmed, kRimmedSurface, kSamplings };

LFRIG_CLONES inline int32_t add_log_evidence(const FusionSource &s, const Rays &rays, const TargetPlanes &t,
                                             const Pool &pool, Sampling how, const int *ks, int count,
                                             const int32_t *valid, float *evidence) {
    if (how == kPlain) return add_scores<true, true, true>(s, rays, t, pool, ks, count, valid, evidence);
    if (how == kStraddling) return add_scores<true, true, false>(s, rays, t, pool, ks, count, valid, evidence);
    if (how == kSurfaceOnly) return add_scores<true, false, false>(s, rays, t, pool, ks, count, valid, evidence);
    if (how == kRimmed) return add_scores<false, true, false>(s, rays, t, pool, ks, count, valid, evidence);
    return add_scores<false, false, false>(s, rays, t, pool, ks, count, valid, evidence);
}

LFRIG_CLONES inline int32_t add_mean_evidence(const FusionSource &s, const Rays &rays, const TargetPlanes &t,
                                              Sampling how, const int *ks, int count, const int32_t *valid,
                                              float *evidence, float *mass) {
    if (how == kSurfaceOnly || how == kRimmedSurface)
        return add_means<false>(s, rays, t, ks, count, valid, evidence, mass);
    return add_means<true>(s, rays, t, ks, count, valid, evidence, mass);
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

constexpr int kGroup = 16;  // rays that are asked for their colours together
constexpr int kGroups = kRays / kGroup;

// What the photo's pixel has against the colour that the source shows, mean over r, g, b [grey levels].
LFRIG_INLINE float mismatch(const PhotoBlock &photo, int pixel, const Footprints<kGroup> &f, int i) {
    const uint32_t a = f.corner[0][i], b = f.corner[1][i], c = f.corner[2][i], d = f.corner[3][i];
    // A saturated value is a lower bound: being brighter than it says nothing.
    const float under = (a | b | c | d) >> 24 ? 0.0f : 1.0f, over = photo.bounded[pixel];
    float sum = 0;
#pragma GCC unroll 3
    for (int j = 0; j < 3; ++j) {
        const float top = channel(a, j) + f.fu[i] * (channel(b, j) - channel(a, j));
        const float low = channel(c, j) + f.fu[i] * (channel(d, j) - channel(c, j));
        const float rise = photo.colour[j][pixel] - (top + f.fv[i] * (low - top));
        sum += under * std::max(rise, 0.0f) + over * std::max(-rise, 0.0f);
    }
    return sum * (1.0f / 3.0f);
}

// Adds what one source's colours say to `gain` [kGroup], for the rays from `from` on at plane index `k`.
template <bool kPlainView>
LFRIG_INLINE void compare(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const PhotoBlock &photo,
                          const ColourTerm &term, float margin, int k, int from, float *__restrict gain) {
    const float w = t.w0 + t.dw * float(k), per_grey = 1.0f / term.sigma, per_px = 2.0f / margin;
    const float offset = s.first + margin, step = s.step;
    const PlaneIndex index = plane_index(s, t, w);
    Footprints<kGroup> f;
    for (int i = 0; i < kGroup; ++i) {
        const Place p = place<kPlainView>(s, rays.x[from + i], rays.y[from + i], rays.z[from + i], w, index);
        const int32_t iu = before(p.u, s.width - 1), iv = before(p.v, s.height - 1);
        f.at[i] = iv * s.width + iu;
        f.fu[i] = p.u - float(iu), f.fv[i] = p.v - float(iv);
        f.bound[i] = p.q * step + offset;
        f.nearest[i] = int32_t(p.v + 0.5f) * s.width + int32_t(p.u + 0.5f);
        f.inside[i] = p.inside;
    }
    read_corners(s.colour, 4, size_t(s.width) * 4, 4, f);
    if (!kPlainView) read_surface(s, f);
    for (int i = 0; i < kGroup; ++i) {
        const float cost = std::min(mismatch(photo, from + i, f, i) * per_grey, term.cap);
        float said = term.weight * (term.unknown - cost);
        if (!kPlainView) said *= (1.0f - hidden(f.seen[i], f.bound[i], per_px)) * float(f.inside[i]);
        gain[i] += said;
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
