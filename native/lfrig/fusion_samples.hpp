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
template <bool kKnownInside>
LFRIG_INLINE int32_t before(float at, int32_t last) {
    return kKnownInside ? int32_t(at) : std::min(int32_t(at), last - 1);
}

LFRIG_INLINE int32_t nearest_pixel(const Place &p, int32_t width) {
    return int32_t(p.v + 0.5f) * width + int32_t(p.u + 0.5f);
}

// Keeps a load out of the vectoriser's sight. Reading from anywhere is a loop of its own: such loads do not vectorise,
// and what compilers make of them inside a vectorised loop is slower, hardware gathers included.
LFRIG_INLINE size_t opaque(int32_t index) {
    size_t at = size_t(index);
    __asm__ volatile("" : "+r"(at) : : "memory");
    return at;
}

// Where the voxels of a brick lie in the source's volume, and what is read there.
struct Footprints {
    alignas(64) int32_t at[kRays];       // the first of the eight voxels
    alignas(64) int32_t nearest[kRays];  // pixel
    alignas(64) int32_t inside[kRays];
    alignas(64) float fu[kRays], fv[kRays], fq[kRays];  // shares of the later pixel, row and plane
    alignas(64) float factor[kRays];     // from values between the voxels to probability; 0 beyond the planes
    alignas(64) float bound[kRays];      // the surface hides the voxel from this disparity on
    alignas(64) uint32_t corners[kRays][4];  // two planes each, of pixels a, b, and c, d in the next row
    alignas(64) float seen[kRays];       // disparity of the surface
};

// `scale`: of the values; target planes are `stretch` / (ratio of depths)^2 of the source's planes wide at pixel z.
template <bool kKnownInside, bool kMass, bool kVisible, bool kStretched>
LFRIG_INLINE void find_footprints(const FusionSource &s, const Rays &rays, const TargetPlanes &t, float margin,
                                  float scale, float stretch, int k, Footprints &f) {
    const float w = t.w0 + t.dw * float(k), widest = 4.0f * scale, wide = stretch * scale;
    const PlaneIndex index = plane_index(s, t, w);
    const int32_t last = s.planes - 1, width = s.width, height = s.height, planes = s.planes;
    const float step = s.step, offset = s.first + margin, end = float(last);
    for (int i = 0; i < kRays; ++i) {
        const Place p = place<kKnownInside>(s, rays.x[i], rays.y[i], rays.z[i], w, index);
        if (kMass) {
            const bool known = (p.q >= 0) & (p.q < end);
            const float q = known ? p.q : 0;
            const int32_t iu = before<kKnownInside>(p.u, width - 1), iv = before<kKnownInside>(p.v, height - 1);
            const int32_t iq = int32_t(q);
            f.at[i] = (iv * width + iu) * planes + iq;
            f.fu[i] = p.u - float(iu), f.fv[i] = p.v - float(iv), f.fq[i] = q - float(iq);
            // Mass per target plane: the source's planes are stretched along this ray by |d delta / d w|.
            const float factor = std::min(widest, wide * std::fabs(rays.z[i]) * (p.inverse * p.inverse));
            f.factor[i] = known ? (kStretched ? factor : scale) : 0;
        }
        if (!kVisible) {
            f.bound[i] = p.q * step + offset;
            f.nearest[i] = nearest_pixel(p, width);
        }
        if (!kKnownInside) f.inside[i] = p.inside;
    }
}

LFRIG_INLINE void read_volume(const FusionSource &s, Footprints &f) {
    const size_t pixel = size_t(s.planes), row = size_t(s.width) * pixel;
    for (int i = 0; i < kRays; ++i) {
        const uint16_t *from = s.probability + opaque(f.at[i]);
        uint32_t *to = f.corners[i];
        std::memcpy(to, from, 4), std::memcpy(to + 1, from + pixel, 4);
        std::memcpy(to + 2, from + row, 4), std::memcpy(to + 3, from + row + pixel, 4);
    }
}

// Between two neighbouring planes of one pixel, packed.
LFRIG_INLINE float along_planes(uint32_t both, float share) {
    const float a = float(int32_t(both & 0xffff)), b = float(int32_t(both >> 16));
    return a + share * (b - a);
}

// Trilinear value in the volume, 0..65535.
LFRIG_INLINE float value_at(const Footprints &f, int i) {
    const uint32_t *corner = f.corners[i];
    const float a = along_planes(corner[0], f.fq[i]), b = along_planes(corner[1], f.fq[i]);
    const float c = along_planes(corner[2], f.fq[i]), d = along_planes(corner[3], f.fq[i]);
    const float top = a + f.fu[i] * (b - a), low = c + f.fu[i] * (d - c);
    return top + f.fv[i] * (low - top);
}

// How far the source's own surface hides a voxel, 0..1.
LFRIG_INLINE float hidden(float seen, float bound, float per_px) {
    return std::min(1.0f, std::max(0.0f, (seen - bound) * per_px));
}

LFRIG_INLINE int32_t count_inside(const int32_t *inside, const int32_t *valid) {
    int32_t count = 0;
    for (int i = 0; i < kRays; ++i) count += inside[i] & valid[i];
    return count;
}

// Adds the log evidence of bricks `ks` to `evidence` [planes][kRays]; returns the rays inside, when that was asked.
template <bool kKnownInside, bool kMass, bool kVisible>
LFRIG_INLINE int32_t add_scores(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const Pool &pool,
                                const int *ks, int count, const int32_t *valid, float *evidence) {
    const float scale = (1.0f - pool.floor_share) * (1.0f / 65535.0f), per_px = 2.0f / pool.margin;
    const float stretch = std::fabs(t.dw * s.per_w);
    const float neutral = pool.neutral, floor_mass = pool.floor_mass, nothing = log_of(floor_mass);
    int32_t inside = 0;
    for (int n = 0; n < count; ++n) {
        Footprints f;
        find_footprints<kKnownInside, kMass, kVisible, true>(s, rays, t, pool.margin, scale, stretch, ks[n], f);
        if (kMass) read_volume(s, f);
        if (!kVisible)
            for (int i = 0; i < kRays; ++i) f.seen[i] = s.disparity[opaque(f.nearest[i])];
        float *__restrict row = evidence + size_t(ks[n]) * kRays;
        for (int i = 0; i < kRays; ++i) {
            float score = kMass ? log_of(value_at(f, i) * f.factor[i] + floor_mass) : nothing;
            if (!kVisible) score = std::max(score, score + hidden(f.seen[i], f.bound[i], per_px) * (neutral - score));
            if (!kKnownInside) score = f.inside[i] ? score : neutral;
            row[i] += score;
        }
        if (!kKnownInside) inside += count_inside(f.inside, valid);
    }
    return inside;
}

// The same for the mean pool: sums of probabilities and, in `mass`, of sources.
template <bool kMass>
LFRIG_INLINE int32_t add_means(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const int *ks, int count,
                               const int32_t *valid, float *evidence, float *mass) {
        int32_t inside = 0;
    for (int n = 0; n < count; ++n) {
        Footprints f;
        find_footprints<false, kMass, true, false>(s, rays, t, 0.0f, 1.0f / 65535.0f, 0.0f, ks[n], f);
        if (kMass) read_volume(s, f);
        float *__restrict row = evidence + size_t(ks[n]) * kRays, *__restrict weight = mass + size_t(ks[n]) * kRays;
        for (int i = 0; i < kRays; ++i) {
            if (kMass) row[i] += value_at(f, i) * f.factor[i] * float(f.inside[i]);
            weight[i] += float(f.inside[i]);
        }
        inside += count_inside(f.inside, valid);
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

constexpr int32_t kSaturated = 5;  // /255: share of saturated pixels in the blur up to which a value is a value
constexpr int kGroup = 16;  // rays that are asked for their colours together
constexpr int kGroups = kRays / kGroup;
constexpr int kBatch = 8;   // groups that are read one after the other: values just stored are slow to load again

// A block's pixels: colours, and a mask of ones where they are no lower bounds.
struct PhotoBlock {
    alignas(64) int32_t colour[3][kRays], exact[kRays];
};

// A voxel group: plane index * kGroups + number of the group in the block.
using VoxelGroup = int;

// Where groups of voxels lie in the source's picture, and what is read there. Weights of four pixels add up to 256.
struct ColourFootprints {
    alignas(64) int32_t at[kBatch * kGroup], nearest[kBatch * kGroup], inside[kBatch * kGroup];
    alignas(64) uint32_t weight[4][kBatch * kGroup];
    alignas(64) float bound[kBatch * kGroup], seen[kBatch * kGroup];
    alignas(64) uint32_t row[2][2 * kBatch * kGroup];  // two pixels each
};

template <bool kPlainView>
LFRIG_INLINE void find_colours(const FusionSource &s, const Rays &rays, const TargetPlanes &t, float margin,
                               VoxelGroup group, int to, ColourFootprints &f) {
    const int from = group % kGroups * kGroup;
    const float w = t.w0 + t.dw * float(group / kGroups), offset = s.first + margin, step = s.step;
    const PlaneIndex index = plane_index(s, t, w);
    const float *x = rays.x + from, *y = rays.y + from, *z = rays.z + from;
    const int32_t width = s.width, height = s.height;
    for (int i = 0; i < kGroup; ++i) {
        const Place p = place<kPlainView>(s, x[i], y[i], z[i], w, index);
        const int32_t iu = before<kPlainView>(p.u, width - 1), iv = before<kPlainView>(p.v, height - 1);
        const uint32_t fu = uint32_t(int32_t((p.u - float(iu)) * 256.0f + 0.5f));
        const uint32_t fv = uint32_t(int32_t((p.v - float(iv)) * 256.0f + 0.5f)), both = (fu * fv) >> 8;
        f.weight[0][to + i] = 256 - fu - fv + both, f.weight[1][to + i] = fu - both;
        f.weight[2][to + i] = fv - both, f.weight[3][to + i] = both;
        f.at[to + i] = iv * width + iu;
        if (!kPlainView) {
            f.bound[to + i] = p.q * step + offset;
            f.nearest[to + i] = nearest_pixel(p, width);
            f.inside[to + i] = p.inside;
        }
    }
}

// What the photo's pixels have against the colours that the source shows: mean over r, g, b times 768. Two channels
// share a word: with weights that add up to 256 neither overflows its 16 bits.
LFRIG_INLINE int32_t mismatch(const PhotoBlock &photo, int pixel, const ColourFootprints &f, int i) {
    constexpr uint32_t kOdd = 0x00ff00ff;
    const uint32_t a = f.row[0][2 * i], b = f.row[0][2 * i + 1], c = f.row[1][2 * i], d = f.row[1][2 * i + 1];
    const uint32_t wa = f.weight[0][i], wb = f.weight[1][i], wc = f.weight[2][i], wd = f.weight[3][i];
    const uint32_t red_blue = (a & kOdd) * wa + (b & kOdd) * wb + (c & kOdd) * wc + (d & kOdd) * wd;
    const uint32_t green_mark =
        (a >> 8 & kOdd) * wa + (b >> 8 & kOdd) * wb + (c >> 8 & kOdd) * wc + (d >> 8 & kOdd) * wd;
    const int32_t red = photo.colour[0][pixel] - int32_t(red_blue & 0xffff);
    const int32_t green = photo.colour[1][pixel] - int32_t(green_mark & 0xffff);
    const int32_t blue = photo.colour[2][pixel] - int32_t(red_blue >> 16);
    const int32_t rise = std::max(red, 0) + std::max(green, 0) + std::max(blue, 0);
    const int32_t fall = rise - red - green - blue;
    // A saturated value is a lower bound: being brighter than it says nothing.
    const int32_t exact = int32_t(green_mark >> 16) > 256 * kSaturated ? 0 : -1;
    return (rise & exact) + (fall & photo.exact[pixel]);
}

// Adds what one source's colours say of `groups` to `evidence` [planes][kRays]; `wanted` has a bit for each voxel.
template <bool kPlainView>
LFRIG_INLINE void compare(const FusionSource &s, const Rays &rays, const TargetPlanes &t, const PhotoBlock &photo,
                          const ColourTerm &term, float margin, const VoxelGroup *groups, int count,
                          const uint16_t *wanted, float *evidence) {
    const float per_count = 1.0f / (768.0f * term.sigma), per_px = 2.0f / margin;
    const float weight = term.weight, unknown = term.unknown, cap = term.cap;
    const size_t row = 4 * size_t(s.width);
    ColourFootprints f;
    for (int done = 0; done < count; done += kBatch) {
        const int batch = std::min(kBatch, count - done);
        for (int j = 0; j < batch; ++j)
            find_colours<kPlainView>(s, rays, t, margin, groups[done + j], j * kGroup, f);
        for (int i = 0; i < batch * kGroup; ++i) {
            const uint8_t *pixel = s.colour + 4 * opaque(f.at[i]);
            std::memcpy(&f.row[0][2 * i], pixel, 8), std::memcpy(&f.row[1][2 * i], pixel + row, 8);
            if (!kPlainView) f.seen[i] = s.disparity[opaque(f.nearest[i])];
        }
        for (int j = 0; j < batch; ++j) {
            const VoxelGroup group = groups[done + j];
            const int from = group % kGroups * kGroup;
            const int32_t bits = wanted[group];
            float *__restrict voxels = evidence + size_t(group) * kGroup;
            for (int i = 0; i < kGroup; ++i) {
                const int at = j * kGroup + i;
                const float cost = std::min(float(mismatch(photo, from + i, f, at)) * per_count, cap);
                float said = weight * (unknown - cost);
                if (!kPlainView) said *= (1.0f - hidden(f.seen[at], f.bound[at], per_px)) * float(f.inside[at]);
                voxels[i] += bits >> i & 1 ? said : 0.0f;
            }
        }
    }
}

// `plain`: groups that are in the frame and visible; `other`: at the rim of the frame or of a surface.
LFRIG_CLONES inline void add_colours(const FusionSource &s, const Rays &rays, const TargetPlanes &t,
                                     const PhotoBlock &photo, const ColourTerm &term, float margin,
                                     const std::vector<VoxelGroup> &plain, const std::vector<VoxelGroup> &other,
                                     const uint16_t *wanted, float *evidence) {
    compare<true>(s, rays, t, photo, term, margin, plain.data(), int(plain.size()), wanted, evidence);
    compare<false>(s, rays, t, photo, term, margin, other.data(), int(other.size()), wanted, evidence);
}

}  // namespace lfrig
