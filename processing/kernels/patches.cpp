// Patches aligned to a fraction of a pixel. Twin: patches.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <stdexcept>

#include "lfrig/parallel.hpp"
#include "parts/patch_window.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kChannels = 4;  // of a picture: grey, its slopes, and nothing
constexpr int kUnknowns = 4;  // shift and slant

using Four = float __attribute__((vector_size(16)));  // one pixel of a picture

LFRIG_INLINE Four load(const float *p) {
    Four out;
    std::memcpy(&out, p, sizeof out);
    return out;
}

struct Settings {
    int shift_passes, slant_passes;
    double ridge, max_step, settled;
};

// Cholesky solution of a symmetric positive system, in place of its right side.
LFRIG_INLINE void solve(double a[kUnknowns][kUnknowns], double *b, int n) {
    for (int j = 0; j < n; ++j) {
        for (int k = 0; k < j; ++k) a[j][j] -= a[j][k] * a[j][k];
        a[j][j] = std::sqrt(std::max(a[j][j], 1e-300));
        for (int i = j + 1; i < n; ++i) {
            for (int k = 0; k < j; ++k) a[i][j] -= a[i][k] * a[j][k];
            a[i][j] /= a[j][j];
        }
    }
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < i; ++k) b[i] -= a[i][k] * b[k];
        b[i] /= a[i][i];
    }
    for (int i = n - 1; i >= 0; --i) {
        for (int k = i + 1; k < n; ++k) b[i] -= a[k][i] * b[k];
        b[i] /= a[i][i];
    }
}

// Bilinear values of a picture [H, W, 4] at x + full (dx, dy); the border is replicated.
LFRIG_INLINE void sample(const float *picture, int height, int width, const double *xy, const double *full, const Window &w,
                   Sampled &out) {
    alignas(64) float fx[kMaxPixels], fy[kMaxPixels], four[kMaxPixels * kChannels];
    alignas(64) int32_t at[kMaxPixels];
    const float x = float(xy[0]), y = float(xy[1]), right = float(width - 1), bottom = float(height - 1);
    const float xx = float(full[0]), across = float(full[1]), yx = float(full[2]), yy = float(full[3]);
    const int last_x = std::max(width - 2, 0), last_y = std::max(height - 2, 0);
    for (int k = 0; k < w.count; ++k) {
        float u = x + (xx * w.dx[k] + across * w.dy[k]), v = y + (yx * w.dx[k] + yy * w.dy[k]);
        u = u > 0 ? u : 0.0f;  // not a number becomes 0
        v = v > 0 ? v : 0.0f;
        u = u < right ? u : right;
        v = v < bottom ? v : bottom;
        int i = int(u), j = int(v);
        i = i < last_x ? i : last_x;
        j = j < last_y ? j : last_y;
        fx[k] = u - float(i);
        fy[k] = v - float(j);
        at[k] = j * width + i;
    }
    const int next = width > 1 ? kChannels : 0, below = height > 1 ? width * kChannels : 0;
    for (int k = 0; k < w.count; ++k) {
        const float *p = picture + size_t(at[k]) * kChannels, *q = p + below;
        const Four a = load(p), b = load(p + next), c = load(q), d = load(q + next);
        const Four top = a + fx[k] * (b - a), low = c + fx[k] * (d - c), value = top + fy[k] * (low - top);
        std::memcpy(four + k * kChannels, &value, sizeof value);
    }
    for (int k = 0; k < w.count; ++k) {
        out.grey[k] = four[k * kChannels];
        out.slope_x[k] = four[k * kChannels + 1];
        out.slope_y[k] = four[k * kChannels + 2];
    }
}

// Takes the mean out of a patch and makes its contrast 1; returns what the contrast was.
LFRIG_INLINE float standardise(const Window &w, float *values) {
    float lanes[kLanes] = {};
    for (int k = 0; k < w.count; k += kLanes)
        for (int l = 0; l < kLanes; ++l) lanes[l] += values[k + l] * w.weight[k + l];
    const float mean = sum_of(lanes);
    float squares[kLanes] = {};
    for (int k = 0; k < w.count; k += kLanes)
        for (int l = 0; l < kLanes; ++l) {
            const float centred = values[k + l] - mean;
            values[k + l] = centred;
            squares[l] += centred * centred * w.weight[k + l];
        }
    const float contrast = std::sqrt(sum_of(squares)) + 1e-3f;
    for (int k = 0; k < w.count; ++k) values[k] /= contrast;
    return contrast;
}

LFRIG_INLINE float total(int count, const float *a) {
    float lanes[kLanes] = {};
    for (int k = 0; k < count; k += kLanes)
        for (int l = 0; l < kLanes; ++l) lanes[l] += a[k + l];
    return sum_of(lanes);
}

LFRIG_INLINE float likeness(const Window &w, const float *a, const float *b) {
    alignas(64) float weighted[kMaxPixels];
    for (int k = 0; k < w.count; ++k) weighted[k] = a[k] * w.weight[k];
    return dot(w.count, weighted, b);
}

// The normal equations of shift (and slant, with four unknowns) of a patch against its reference. Columns are taken
// without their means: weights sum to 1, so that is one product of means less.
LFRIG_INLINE void normal_equations(int n, const Window &w, const Sampled &there, const float *reference, float contrast,
                                   const double *along, double a[kUnknowns][kUnknowns], double *b) {
    alignas(64) float column[kUnknowns][kMaxPixels], weighted[kUnknowns][kMaxPixels], error[kMaxPixels];
    const float ax = float(along[0]), ay = float(along[1]), per_contrast = 1 / contrast;
    for (int k = 0; k < w.count; ++k) {
        error[k] = there.grey[k] - reference[k];
        column[0][k] = there.slope_x[k] * per_contrast;
        column[1][k] = there.slope_y[k] * per_contrast;
        weighted[0][k] = column[0][k] * w.weight[k];
        weighted[1][k] = column[1][k] * w.weight[k];
    }
    if (n > 2)
        for (int k = 0; k < w.count; ++k) {
            const float moving = column[0][k] * ax + column[1][k] * ay;
            column[2][k] = moving * w.dx[k];
            column[3][k] = moving * w.dy[k];
            weighted[2][k] = column[2][k] * w.weight[k];
            weighted[3][k] = column[3][k] * w.weight[k];
        }
    double mean[kUnknowns];
    for (int i = 0; i < n; ++i) {
        mean[i] = total(w.count, weighted[i]);
        b[i] = dot(w.count, weighted[i], error);
        for (int j = 0; j <= i; ++j)
            a[i][j] = a[j][i] = double(dot(w.count, weighted[i], column[j])) - mean[i] * mean[j];
    }
}

// One point: moves ``xy`` in the second picture, returns the likeness there.
LFRIG_INLINE float align_one(const float *first, int first_height, int first_width, const float *second, int height,
                       int width, const Window &w, const Settings &set, const double *here, const double *affine,
                       const double *along, double *xy) {
    static constexpr double kIdentity[4] = {1, 0, 0, 1};
    alignas(64) Sampled reference, there;
    sample(first, first_height, first_width, here, kIdentity, w, reference);
    standardise(w, reference.grey);
    double stretch[2] = {0, 0}, full[4];
    for (int pass = 0;; ++pass) {
        for (int i = 0; i < 4; ++i) full[i] = affine[i] + along[i / 2] * stretch[i % 2];
        sample(second, height, width, xy, full, w, there);
        const float contrast = standardise(w, there.grey);
        if (pass >= set.shift_passes + set.slant_passes) break;
        const bool slant = pass >= set.shift_passes;
        double a[kUnknowns][kUnknowns], step[kUnknowns] = {0, 0, 0, 0};
        if (slant) {
            normal_equations(4, w, there, reference.grey, contrast, along, a, step);
            for (int i : {2, 3}) {
                a[i][i] += set.ridge;
                step[i] += set.ridge * stretch[i - 2];
            }
        } else {
            normal_equations(2, w, there, reference.grey, contrast, along, a, step);
        }
        for (int i : {0, 1}) a[i][i] += 1e-6;
        solve(a, step, slant ? 4 : 2);
        const double length = std::sqrt(step[0] * step[0] + step[1] * step[1]);
        const double kept = std::min(1.0, set.max_step / std::max(length, 1e-6));
        for (int i = 0; i < 2; ++i) {
            xy[i] -= kept * step[i];
            stretch[i] -= kept * step[2 + i];
        }
        const double slanted = std::max(std::fabs(step[2]), std::fabs(step[3]));
        // What has settled goes on to the next kind of pass, or to the last comparison.
        if (length < set.settled && slanted < set.settled)
            pass = slant ? set.shift_passes + set.slant_passes - 1 : set.shift_passes - 1;
    }
    return likeness(w, there.grey, reference.grey);
}

LFRIG_CLONES void align_range(const float *first, int first_height, int first_width, const float *second, int height,
                              int width, const Window &w, const Settings &set, const double *here,
                              const double *affine, const double *along, double *xy, float *alike, int begin,
                              int end) {
    for (int n = begin; n < end; ++n)
        alike[n] = align_one(first, first_height, first_width, second, height, width, w, set, here + 2 * n,
                             affine + 4 * n, along + 2 * n, xy + 2 * n);
}

using Picture = ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

}  // namespace

void register_patches(nb::module_ &m) {
    m.def(
        "patches_align",
        [](Picture first, Picture second, Points here, Points affine, Points along, Line dx, Line dy, Line weight,
           int shift_passes, int slant_passes, double ridge, double max_step, double settled,
           ndarray<double, nb::ndim<2>, nb::c_contig, nb::device::cpu> xy,
           ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu> alike, int threads) {
            const size_t count = here.shape(0);
            if (first.shape(2) != kChannels || second.shape(2) != kChannels || here.shape(1) != 2 ||
                affine.shape(0) != count || affine.shape(1) != 4 || along.shape(0) != count || along.shape(1) != 2 ||
                xy.shape(0) != count || xy.shape(1) != 2 || alike.shape(0) != count)
                throw std::invalid_argument("patches_align: shapes do not match");
            if (first.size() == 0 || second.size() == 0) throw std::invalid_argument("patches_align: empty picture");
            const Window w = window_of(dx, dy, weight);
            const Settings set{shift_passes, slant_passes, ridge, max_step, settled};
            nb::gil_scoped_release release;
            const int items = int((count + kPointsPerItem - 1) / kPointsPerItem);
            lfrig::parallel_for(items, threads, [&](int item) {
                align_range(first.data(), int(first.shape(0)), int(first.shape(1)), second.data(),
                            int(second.shape(0)), int(second.shape(1)), w, set, here.data(), affine.data(),
                            along.data(), xy.data(), alike.data(), item * kPointsPerItem,
                            std::min(int(count), (item + 1) * kPointsPerItem));
            });
        },
        "Align patches of the second picture with those of the first; xy is start and result");
}
