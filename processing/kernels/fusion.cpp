// Projective fusion of the sources' evidence in the target's frustum, block by block: evidence, visibility, colours, the
// first-surface rule and the cost volume that regularisation wants, while a block is in the cache. Twin: fusion.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <stdexcept>
#include <vector>

#include "lfrig/fusion_samples.hpp"
#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;
using namespace lfrig;

namespace {

struct SurfaceRule {
    bool enabled;
    float level;  // log evidence from which on a plane hides those behind it
    int gap;
    float beta, cap;
};

struct Job {
    std::vector<FusionSource> sources;
    TargetPlanes planes;
    Pool pool;
    ColourTerm colour;
    SurfaceRule surface;
    bool mean_pool, skip_bricks, skip_sources;
    float per_unit, cost_cap;  // counts per log evidence; counts
    int height, width;
    const uint8_t *photo;  // [height, width, 4], as the sources' colours; null: no colours
    uint16_t *cost;        // [height, width, planes]
    float *best;           // [height, width]
};

struct Counts {
    int64_t inside = 0, sampled = 0, empty = 0, unseen = 0;
};

// What one thread works in. Volumes of a block are [planes][kRays].
struct Workspace {
    Bounds bounds;
    std::vector<float> evidence, mass, constant, constant_mass, ring;
    std::vector<uint32_t> cost;
    std::vector<int32_t> meets;
    std::vector<uint16_t> wanted;  // [planes][kGroups]
    std::vector<VoxelGroup> plain, other;
    std::vector<Rays> rays;
    std::vector<std::vector<int>> lists;  // [sources][kSamplings]
    explicit Workspace(const Job &job)
        : bounds(job.planes.count), evidence(size_t(job.planes.count) * kRays), constant(job.planes.count),
          constant_mass(job.planes.count), ring(size_t(job.surface.gap) * kRays),
          cost(size_t(job.planes.count + 3) / 4 * 2 * kRays), meets(job.sources.size() * job.planes.count),
          wanted(size_t(job.planes.count) * kGroups), rays(job.sources.size()),
          lists(job.sources.size() * kSamplings) {
        if (job.mean_pool) mass.resize(evidence.size());
    }
};

// The greatest evidence of each ray.
LFRIG_CLONES void find_best(const float *evidence, int planes, float *__restrict best) {
    for (int i = 0; i < kRays; ++i) best[i] = evidence[i];
    for (int k = 1; k < planes; ++k)
        for (int i = 0; i < kRays; ++i) best[i] = std::max(best[i], evidence[size_t(k) * kRays + i]);
}

// A bit for each voxel whose colours matter, [planes][kGroups].
LFRIG_CLONES void find_wanted(const float *evidence, int planes, const float *limit, uint16_t *__restrict wanted) {
    for (int k = 0; k < planes; ++k)
        for (int g = 0; g < kGroups; ++g) {
            const float *voxels = evidence + size_t(k) * kRays + g * kGroup, *least = limit + g * kGroup;
            int32_t bits = 0;
#pragma GCC unroll 1
            for (int i = 0; i < kGroup; ++i) bits |= voxels[i] >= least[i] ? 1 << i : 0;
            wanted[k * kGroups + g] = uint16_t(bits);
        }
}

// Planes behind strong nearer evidence pay min(cap, beta * max(0, nearer evidence - level)); nearer planes come last.
// `ring` [gap][kRays] keeps what planes `gap` nearer have found so far. Returns the greatest evidence in `best`.
LFRIG_CLONES void hide_behind(float *evidence, int planes, const SurfaceRule &rule, float *ring,
                              float *__restrict best) {
    alignas(64) float worst[kRays] = {};
    const float beta = rule.beta, level = rule.level, cap = rule.cap;
    for (int i = 0; i < rule.gap * kRays; ++i) ring[i] = 0;
    for (int i = 0; i < kRays; ++i) best[i] = -1e30f;
    for (int k = planes - 1, slot = 0; k >= 0; --k, slot = slot + 1 < rule.gap ? slot + 1 : 0) {
        float *__restrict row = evidence + size_t(k) * kRays, *__restrict held = ring + size_t(slot) * kRays;
        for (int i = 0; i < kRays; ++i) {
            const float value = row[i] - held[i];
            held[i] = worst[i] = std::max(worst[i], std::min(cap, beta * (row[i] - level)));
            row[i] = value;
            best[i] = std::max(best[i], value);
        }
    }
}

LFRIG_CLONES void log_of_means(float *evidence, const float *mass, int planes) {
    for (size_t i = 0; i < size_t(planes) * kRays; ++i)
        evidence[i] = log_of(std::max(evidence[i] / std::max(mass[i], 1e-6f), 1e-6f));
}

inline float nearest_whole(float x) { return (x + 12582912.0f) - 12582912.0f; }  // of |x| < 2^22; ties to even

// Counts below each ray's best evidence, capped, [ceil(planes / 4)][kRays][4]. `best` is rounded.
LFRIG_CLONES void cost_of(const float *evidence, int planes, float per_unit, float cap, uint32_t *__restrict cost,
                          float *__restrict best) {
    alignas(64) float top[kRays];
    for (int i = 0; i < kRays; ++i) top[i] = nearest_whole(best[i] * per_unit), best[i] = top[i] / per_unit;
    for (int k = 0; k < planes; k += 2) {
        const float *far = evidence + size_t(k) * kRays, *near = k + 1 < planes ? far + kRays : far;
        uint32_t *__restrict words = cost + size_t(k / 4) * 2 * kRays + k / 2 % 2;
        for (int i = 0; i < kRays; ++i) {
            const float first = std::min(cap, top[i] - nearest_whole(far[i] * per_unit));
            const float second = std::min(cap, top[i] - nearest_whole(near[i] * per_unit));
            words[2 * i] = uint32_t(int32_t(first)) | uint32_t(int32_t(second)) << 16;
        }
    }
}

// Four planes at a time to planes innermost.
void write_block(const Job &job, const uint32_t *cost, const float *best, int x0, int y0) {
    const int planes = job.planes.count;
    for (int y = y0; y < std::min(y0 + kSide, job.height); ++y)
        for (int x = x0; x < std::min(x0 + kSide, job.width); ++x) {
            const int i = (y - y0) * kSide + x - x0;
            const size_t pixel = size_t(y) * job.width + x;
            uint16_t *out = job.cost + pixel * planes;
            const uint32_t *from = cost + 2 * i;
            for (int k = 0; k + 4 <= planes; k += 4, from += 2 * kRays) std::memcpy(out + k, from, 8);
            std::memcpy(out + planes / 4 * 4, from, size_t(planes % 4) * sizeof(uint16_t));
            job.best[pixel] = best[i];
        }
}

PhotoBlock photo_block(const Job &job, int x0, int y0) {
    PhotoBlock block;
    for (int i = 0; i < kRays; ++i) {
        const int x = std::min(x0 + i % kSide, job.width - 1), y = std::min(y0 + i / kSide, job.height - 1);
        const uint8_t *pixel = job.photo + 4 * (size_t(y) * job.width + x);
        for (int c = 0; c < 3; ++c) block.colour[c][i] = 256 * pixel[c];
        block.exact[i] = pixel[3] > kSaturated ? 0 : -1;
    }
    return block;
}

// What a brick without samples adds: nothing is seen (neutral), or there is no mass at all.
float constant_evidence(const Job &job, int32_t meets) {
    const float nothing = log_of(job.pool.floor_mass);
    if (meets & kOutside) return job.pool.neutral;
    return meets & kHidden ? std::max(nothing, job.pool.neutral) : nothing;
}

// Finds what every brick meets in source `n`, sums up what needs no samples and lists the bricks that do.
void sort_bricks(const Job &job, int n, int pixels, Workspace &work, Counts &counts) {
    const FusionSource &s = job.sources[n];
    int32_t *meets = work.meets.data() + size_t(n) * job.planes.count;
    std::vector<int> *lists = work.lists.data() + size_t(n) * kSamplings;
    for (int how = 0; how < kSamplings; ++how) lists[how].clear();
    const bool usable = std::min(s.width, s.height) > 1;
    if (usable) {
        bound_bricks(s, work.rays[n], job.planes, work.bounds);
        classify_bricks(s, work.bounds, job.planes.count, job.pool.margin, meets);
    }
    for (int k = 0; k < job.planes.count; ++k) {
        if (!usable) meets[k] = kOutside;
        if (usable && !job.skip_sources) meets[k] &= ~kOutside;
        if (usable && !job.skip_bricks) meets[k] = (meets[k] | kMass) & ~(kVisible | kHidden);
        const bool outside = meets[k] & kOutside, inside = meets[k] & kInside, mass = (meets[k] & kMass) && s.planes > 1;
        const bool uniform = job.skip_bricks && (job.mean_pool || (meets[k] & (kVisible | kHidden)));
        if (outside || (inside && !mass && uniform)) {
            work.constant[k] += job.mean_pool ? 0 : constant_evidence(job, meets[k]);
            work.constant_mass[k] += outside ? 0 : 1;
            ++(outside ? counts.unseen : counts.empty);
            counts.inside += outside ? 0 : pixels;
        } else {
            const Sampling rimmed = mass ? kRimmed : kRimmedSurface, whole = meets[k] & kVisible ? kPlain : kStraddling;
            lists[!inside ? rimmed : mass ? whole : kSurfaceOnly].push_back(k);
            ++counts.sampled;
            counts.inside += inside && !job.mean_pool ? pixels : 0;  // others are counted ray by ray
        }
    }
}

// Evidence of a block's voxels from the light fields alone.
void pool_block(const Job &job, int x0, int y0, Workspace &work, Counts &counts) {
    const int planes = job.planes.count;
    const int columns = std::min(kSide, job.width - x0), rows = std::min(kSide, job.height - y0);
    int32_t valid[kRays];
    for (int i = 0; i < kRays; ++i) valid[i] = i % kSide < columns && i / kSide < rows;
    std::fill(work.constant.begin(), work.constant.end(), 0.0f);
    std::fill(work.constant_mass.begin(), work.constant_mass.end(), 0.0f);
    for (size_t n = 0; n < job.sources.size(); ++n) {
        work.rays[n] = make_rays(job.sources[n], x0, y0, job.width, job.height);
        sort_bricks(job, int(n), rows * columns, work, counts);
    }
    float *evidence = work.evidence.data();
    for (int k = 0; k < planes; ++k) std::fill_n(evidence + size_t(k) * kRays, kRays, work.constant[k]);
    for (int k = 0; job.mean_pool && k < planes; ++k)
        std::fill_n(work.mass.data() + size_t(k) * kRays, kRays, work.constant_mass[k]);
    for (size_t n = 0; n < job.sources.size(); ++n)
        for (int how = 0; how < kSamplings; ++how) {
            const std::vector<int> &ks = work.lists[n * kSamplings + how];
            if (ks.empty()) continue;
            const Rays &rays = work.rays[n];
            const FusionSource &s = job.sources[n];
            const int count = int(ks.size());
            counts.inside += job.mean_pool
                                 ? add_mean_evidence(s, rays, job.planes, Sampling(how), ks.data(), count, valid,
                                                     evidence, work.mass.data())
                                 : add_log_evidence(s, rays, job.planes, job.pool, Sampling(how), ks.data(), count,
                                                    valid, evidence);
        }
    if (job.mean_pool) log_of_means(evidence, work.mass.data(), planes);
}

// Adds what the sources' colours say of the voxels that the light fields leave in play.
void ask_colours(const Job &job, int x0, int y0, Workspace &work) {
    const int planes = job.planes.count;
    float *evidence = work.evidence.data();
    alignas(64) float limit[kRays];
    find_best(evidence, planes, limit);
    for (float &least : limit) least -= job.colour.reach;
    find_wanted(evidence, planes, limit, work.wanted.data());
    const PhotoBlock photo = photo_block(job, x0, y0);
    for (size_t n = 0; n < job.sources.size(); ++n) {
        const int32_t *meets = work.meets.data() + n * planes;
        work.plain.clear(), work.other.clear();
        for (VoxelGroup group = 0; group < planes * kGroups; ++group) {
            const int32_t meeting = meets[group / kGroups];
            if ((job.skip_bricks && !work.wanted[group]) || (meeting & (kOutside | kHidden))) continue;
            (((meeting & kInside) && (meeting & kVisible)) ? work.plain : work.other).push_back(group);
        }
        add_colours(job.sources[n], work.rays[n], job.planes, photo, job.colour, job.pool.margin, work.plain, work.other,
                    work.wanted.data(), evidence);
    }
}

void fuse_block(const Job &job, int x0, int y0, Workspace &work, Counts &counts) {
    const int planes = job.planes.count;
    alignas(64) float best[kRays];
    pool_block(job, x0, y0, work, counts);
    float *evidence = work.evidence.data();
    if (job.photo) ask_colours(job, x0, y0, work);
    if (job.surface.enabled)
        hide_behind(evidence, planes, job.surface, work.ring.data(), best);
    else
        find_best(evidence, planes, best);
    cost_of(evidence, planes, job.per_unit, job.cost_cap, work.cost.data(), best);
    write_block(job, work.cost.data(), best, x0, y0);
}

Counts fuse(const Job &job, int threads) {
    const int rows = (job.height + kSide - 1) / kSide;
    std::vector<Counts> counts(rows);
    parallel_for(rows, threads, [&](int row) {
        Workspace work(job);
        for (int x = 0; x < job.width; x += kSide) fuse_block(job, x, row * kSide, work, counts[row]);
    });
    Counts total;
    for (const Counts &c : counts) {
        total.inside += c.inside, total.sampled += c.sampled;
        total.empty += c.empty, total.unseen += c.unseen;
    }
    return total;
}

using U1x3 = ndarray<const uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using U3 = ndarray<const uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using I3 = ndarray<const int32_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using F1 = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using OutU3 = ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using OutF2 = ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

FusionSource make_source(const U3 &probability, const F2 &disparity, const U1x3 &colour, const I3 &sums, const F2 &least,
                         const F2 &greatest, const float *numbers) {
    FusionSource s{};
    s.probability = probability.data(), s.disparity = disparity.data(), s.colour = colour.data(), s.sums = sums.data();
    s.least = least.data(), s.greatest = greatest.data();
    s.height = int(probability.shape(0)), s.width = int(probability.shape(1)), s.planes = int(probability.shape(2));
    s.tile_rows = (s.height + kTile - 1) / kTile, s.tile_columns = (s.width + kTile - 1) / kTile;
    auto like = [](const auto &array, int height, int width) {
        return int(array.shape(0)) == height && int(array.shape(1)) == width;
    };
    if (!like(disparity, s.height, s.width) || !like(least, s.tile_rows, s.tile_columns) ||
        !like(greatest, s.tile_rows, s.tile_columns) || !like(sums, s.tile_rows + 1, s.tile_columns + 1) ||
        int(sums.shape(2)) != s.planes + 1 ||
        (colour.size() && (!like(colour, s.height, s.width) || colour.shape(2) != 4)))
        throw std::invalid_argument("fuse: shapes do not match");
    if (probability.size() > size_t(INT32_MAX)) throw std::invalid_argument("fuse: a source's volume is too large");
    std::memcpy(s.a, numbers, 9 * sizeof(float));
    std::memcpy(s.b, numbers + 9, 3 * sizeof(float));
    s.scale_a = numbers[12], s.scale_c = numbers[13], s.first = numbers[14], s.step = numbers[15];
    s.per_w = 1.0f / (s.scale_a * s.step), s.level = -(s.scale_c / s.scale_a + s.first) / s.step;
    return s;
}

// numbers [sources, 16]: A, b, scale a and c, first plane and step; pool: floor share, margin; colour: weight, sigma,
// cap, unknown, reach; surface: level, gap, beta, cap; photo or surface empty: without; unit: log evidence per count.
nb::tuple fuse_volume(const std::vector<U3> &probability, const std::vector<F2> &disparity,
                      const std::vector<U1x3> &images, const std::vector<I3> &sums, const std::vector<F2> &least,
                      const std::vector<F2> &greatest, F2 numbers, float w0, float dw, F1 pool, U1x3 photo, F1 colour,
                      F1 surface, bool mean_pool, bool literal, bool skip_bricks, bool skip_sources, float unit,
                      float cost_cap, OutU3 cost, OutF2 best, int threads) {
    const size_t count = probability.size();
    if (disparity.size() != count || images.size() != count || sums.size() != count || least.size() != count ||
        greatest.size() != count || numbers.shape(0) != count || numbers.shape(1) != 16 || pool.size() != 2 ||
        colour.size() != 5 || (surface.size() && surface.size() != 4))
        throw std::invalid_argument("fuse: shapes do not match");
    Job job{};
    for (size_t n = 0; n < count; ++n)
        job.sources.push_back(make_source(probability[n], disparity[n], images[n], sums[n], least[n], greatest[n],
                                          numbers.data() + 16 * n));
    job.height = int(cost.shape(0)), job.width = int(cost.shape(1));
    const int planes = int(cost.shape(2));
    if (int(best.shape(0)) != job.height || int(best.shape(1)) != job.width || planes < 1 ||
        (photo.size() && (int(photo.shape(0)) != job.height || int(photo.shape(1)) != job.width || photo.shape(2) != 4)))
        throw std::invalid_argument("fuse: shapes do not match");
    job.planes = {w0, dw, planes, literal};
    job.pool = {pool.data()[0], pool.data()[1], -log_of(float(planes)), pool.data()[0] / float(planes)};
    const float *term = colour.data(), *rule = surface.data();
    job.colour = {term[0], term[1], term[2], term[3], term[4]};
    job.surface = {false, 0, 1, 0, 0};
    if (surface.size()) job.surface = {true, rule[0], std::max(1, int(rule[1])), rule[2], rule[3]};
    job.mean_pool = mean_pool, job.skip_bricks = skip_bricks, job.skip_sources = skip_sources;
    job.per_unit = 1.0f / unit, job.cost_cap = cost_cap;
    job.photo = photo.size() ? photo.data() : nullptr;
    for (const U1x3 &image : images)
        if (job.photo && !image.size()) throw std::invalid_argument("fuse: colours of the photo, but not of a source");
    job.cost = cost.data(), job.best = best.data();
    Counts counts;
    {
        nb::gil_scoped_release release;
        counts = fuse(job, threads);
    }
    return nb::make_tuple(counts.inside, counts.sampled, counts.empty, counts.unseen);
}

}  // namespace

void register_fusion(nb::module_ &m) {
    m.def("fuse_volume", &fuse_volume, nb::arg("probability"), nb::arg("disparity"), nb::arg("images"), nb::arg("sums"),
          nb::arg("least"), nb::arg("greatest"), nb::arg("numbers").noconvert(), nb::arg("w0"), nb::arg("dw"),
          nb::arg("pool").noconvert(), nb::arg("photo").noconvert(), nb::arg("colour").noconvert(),
          nb::arg("surface").noconvert(), nb::arg("mean_pool"), nb::arg("literal"), nb::arg("skip_bricks"),
          nb::arg("skip_sources"), nb::arg("unit"), nb::arg("cost_cap"), nb::arg("cost").noconvert(),
          nb::arg("best").noconvert(), nb::arg("threads"));
}
