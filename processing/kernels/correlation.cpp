// Patches correlated with what another picture shows in some places around theirs. Twin: correlation.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>

#include "lfrig/parallel.hpp"
#include "parts/patch_sums.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kPatchesPerItem = 64;
constexpr float kLeastScale = 1e-3f;  // a patch without contrast is like nothing

struct Picture {
    const float *values;
    int height, width;
};

struct Bounds {
    float low, high;
};

// Takes the mean of its first ``pixels`` values out of a patch whose last lanes are filled with zeros.
LFRIG_INLINE void centre(int pixels, int count, float *values) {
    float lanes[kLanes] = {};
    for (int k = 0; k < count; k += kLanes)
        for (int l = 0; l < kLanes; ++l) lanes[l] += values[k + l];
    const float mean = sum_of(lanes) / float(pixels);
    for (int k = 0; k < pixels; ++k) values[k] -= mean;
}

LFRIG_INLINE Bounds bounds_of(int pixels, const float *values) {
    Bounds found{values[0], values[0]};
    for (int k = 1; k < pixels; ++k) {
        found.low = std::min(found.low, values[k]);
        found.high = std::max(found.high, values[k]);
    }
    return found;
}

// Where a row or column beyond the border is found again.
LFRIG_INLINE int reflected(int i, int size) {
    i = i < 0 ? -1 - i : i;
    i = i >= size ? 2 * size - 1 - i : i;
    return std::clamp(i, 0, size - 1);
}

// Bilinear values of a picture at shifted places; the border is reflected.
LFRIG_INLINE void sample(const Picture &p, int pixels, const float *us, const float *vs, float dx, float dy, bool inside,
                         float *out) {
    alignas(64) float fx[kMaxPixels], fy[kMaxPixels];
    alignas(64) int32_t col[kMaxPixels], row[kMaxPixels];
    const float width = float(p.width), height = float(p.height);
    for (int k = 0; k < pixels; ++k) {
        float u = us[k] + dx, v = vs[k] + dy;
        u = u > -width ? u : -width;  // so does what is not a number
        v = v > -height ? v : -height;
        u = u < 2 * width ? u : 2 * width;
        v = v < 2 * height ? v : 2 * height;
        const float i = std::floor(u), j = std::floor(v);
        fx[k] = u - i;
        fy[k] = v - j;
        col[k] = int32_t(i);
        row[k] = int32_t(j);
    }
    if (inside) {
        for (int k = 0; k < pixels; ++k) {
            const float *at = p.values + size_t(row[k]) * p.width + col[k], *below = at + p.width;
            const float top = at[0] + fx[k] * (at[1] - at[0]), low = below[0] + fx[k] * (below[1] - below[0]);
            out[k] = top + fy[k] * (low - top);
        }
        return;
    }
    for (int k = 0; k < pixels; ++k) {
        const int i = reflected(col[k], p.width), next = reflected(col[k] + 1, p.width);
        const float *at = p.values + size_t(reflected(row[k], p.height)) * p.width;
        const float *below = p.values + size_t(reflected(row[k] + 1, p.height)) * p.width;
        const float top = at[i] + fx[k] * (at[next] - at[i]), low = below[i] + fx[k] * (below[next] - below[i]);
        out[k] = top + fy[k] * (low - top);
    }
}

LFRIG_CLONES void correlate(const Picture &p, const float *patches, const float *us, const float *vs, int pixels,
                            const float *shifts, int shift_count, int patch_count, float *out, int begin, int end) {
    const int count = whole_lanes(pixels);
    alignas(64) float here[kMaxPixels] = {}, there[kMaxPixels] = {};
    for (int n = begin; n < end; ++n) {
        const float *u = us + size_t(n) * pixels, *v = vs + size_t(n) * pixels;
        std::copy(patches + size_t(n) * pixels, patches + size_t(n + 1) * pixels, here);
        centre(pixels, count, here);
        const float own = dot(count, here, here);
        const Bounds x = bounds_of(pixels, u), y = bounds_of(pixels, v);
        for (int s = 0; s < shift_count; ++s) {
            const float *shift = shifts + 2 * (size_t(s) * patch_count + n), dx = shift[0], dy = shift[1];
            const bool inside = x.low + dx >= 0 && y.low + dy >= 0 && x.high + dx < float(p.width - 1) &&
                                y.high + dy < float(p.height - 1);
            sample(p, pixels, u, v, dx, dy, inside, there);
            centre(pixels, count, there);
            const float scale = std::sqrt(own * dot(count, there, there));
            out[size_t(s) * patch_count + n] = dot(count, here, there) / std::max(scale, kLeastScale);
        }
    }
}

using Table = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

}  // namespace

void register_correlation(nb::module_ &m) {
    m.def(
        "correlation",
        [](Table patches, Table picture, Table u, Table v,
           ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu> shifts,
           ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> out, int threads) {
            const int count = int(patches.shape(0)), pixels = int(patches.shape(1));
            for (const Table &t : {u, v})
                if (int(t.shape(0)) != count || int(t.shape(1)) != pixels)
                    throw std::invalid_argument("correlation: places of a wrong shape");
            if (pixels == 0 || pixels > kMaxPixels || picture.size() == 0 || int(shifts.shape(1)) != count ||
                shifts.shape(2) != 2 || out.shape(0) != shifts.shape(0) || int(out.shape(1)) != count)
                throw std::invalid_argument("correlation: shapes do not match");
            const Picture p{picture.data(), int(picture.shape(0)), int(picture.shape(1))};
            nb::gil_scoped_release release;
            const int items = (count + kPatchesPerItem - 1) / kPatchesPerItem;
            lfrig::parallel_for(items, threads, [&](int item) {
                correlate(p, patches.data(), u.data(), v.data(), pixels, shifts.data(), int(shifts.shape(0)), count,
                          out.data(), item * kPatchesPerItem, std::min(count, (item + 1) * kPatchesPerItem));
            });
        },
        "Correlation of patches with another picture at shifted places, [S, N]");
}
