// Semi-global matching along 8 paths (Hirschmueller 2008) on a float cost volume. Twin: sgm.py.
//
// L(p, k) = C(p, k) + min(L(q, k), L(q, k +- 1) + P1, min L(q) + P2(p, q)) - min L(q);  the paths are averaged.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstring>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr float kWall = 1e30f;  // guards on both sides of a label row

// One pixel on one path; `prev` has a guard at [-1] and [planes]. Returns the minimum of `next`.
LFRIG_CLONES float path_step(const float *__restrict cost, const float *__restrict prev, float prev_min, float p1,
                             float p2, float *__restrict next, float *__restrict sum, int planes) {
    float lowest = kWall;
    const float jump = prev_min + p2;
    for (int k = 0; k < planes; ++k) {
        const float side = std::min(prev[k - 1], prev[k + 1]) + p1;
        const float best = std::min(std::min(prev[k], side), jump);
        const float value = cost[k] + (best - prev_min);
        next[k] = value;
        sum[k] += value;
        lowest = std::min(lowest, value);
    }
    return lowest;
}

struct Volume {
    int height, width, planes;
    const float *cost;
    const float *p2_right;  // [H, W] P2 between (y, x) and (y, x + 1)
    const float *p2_down;   // [H, W] P2 between (y, x) and (y + 1, x)
    const float *p2_diag;   // [H, W] P2 between (y, x) and (y + 1, x + 1)
    const float *p2_anti;   // [H, W] P2 between (y, x) and (y + 1, x - 1)
    // [4, H, W] or null: label k of a pixel continues as label k + shift of its right, lower, ... neighbour
    const int16_t *shift;
    float p1;
};

// Shift of the step towards neighbour `dir`, whose first pixel is `at`; walked backwards its sign turns.
inline int shift_of(const Volume &v, int dir, size_t at, bool backwards) {
    if (!v.shift) return 0;
    const int j = v.shift[size_t(dir) * v.height * v.width + at];
    const int held = std::min(std::max(j, -v.planes - 1), v.planes + 1);
    return backwards ? held : -held;
}

// Floats of a label row with its guards: one on each side, or a row of guards where labels may be shifted.
inline int guard_of(const Volume &v) { return v.shift ? v.planes + 2 : 1; }

void start(const float *cost, float *next, float *sum, int planes, float *lowest) {
    *lowest = kWall;
    for (int k = 0; k < planes; ++k) {
        next[k] = cost[k];
        sum[k] += cost[k];
        *lowest = std::min(*lowest, cost[k]);
    }
}

// The two horizontal paths of one row.
void horizontal(const Volume &v, int y, float *sum, float *scratch) {
    const int guard = guard_of(v), stride = v.planes + 2 * guard;
    for (int dir = 0; dir < 2; ++dir) {
        float *a = scratch + guard, *b = scratch + stride + guard;
        float low = 0;
        for (int i = 0; i < v.width; ++i) {
            const int x = dir ? v.width - 1 - i : i;
            const size_t p = size_t(y) * v.width + x;
            if (i == 0)
                start(v.cost + p * v.planes, b, sum + p * v.planes, v.planes, &low);
            else {
                const size_t at = dir ? p : p - 1;
                low = path_step(v.cost + p * v.planes, a + shift_of(v, 0, at, dir == 1), low, v.p1, v.p2_right[at], b,
                                sum + p * v.planes, v.planes);
            }
            std::swap(a, b);
        }
    }
}

// The three paths that come from the row above (or, when `up`, from the row below).
void vertical(const Volume &v, bool up, float *sum) {
    const int guard = guard_of(v), stride = v.planes + 2 * guard;
    std::vector<float> buffer(size_t(6) * v.width * stride, kWall), lows(size_t(6) * v.width, 0.0f);
    const int from[3] = {0, -1, 1};
    for (int i = 0; i < v.height; ++i) {
        const int y = up ? v.height - 1 - i : i, yp = up ? y + 1 : y - 1;
        for (int x = 0; x < v.width; ++x) {
            const size_t p = size_t(y) * v.width + x;
            for (int d = 0; d < 3; ++d) {
                const size_t now = size_t(d * 2 + (i & 1)) * v.width, before = size_t(d * 2 + 1 - (i & 1)) * v.width;
                float *next = buffer.data() + (now + x) * stride + guard;
                const int xp = x + from[d];
                if (i == 0 || xp < 0 || xp >= v.width) {
                    start(v.cost + p * v.planes, next, sum + p * v.planes, v.planes, &lows[now + x]);
                    continue;
                }
                const size_t q = size_t(yp) * v.width + xp, top = up ? p : q;
                const int kind = d == 0 ? 1 : ((xp < x) != up ? 2 : 3);
                const float p2 = (kind == 1 ? v.p2_down : kind == 2 ? v.p2_diag : v.p2_anti)[top];
                const float *prev = buffer.data() + (before + xp) * stride + guard + shift_of(v, kind, top, up);
                lows[now + x] = path_step(v.cost + p * v.planes, prev, lows[before + xp], v.p1, p2, next,
                                          sum + p * v.planes, v.planes);
            }
        }
    }
}

using F3 = ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using CS3 = ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using CF3 = ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// p2 float32 [4, H, W]: right, down, diagonal, anti-diagonal; shift int16 [4, H, W] likewise, or empty.
// out float32 [H, W, D], the mean of the 8 paths.
void sgm(CF3 cost, CF3 p2, CS3 shift, float p1, F3 out, int threads) {
    Volume v{int(cost.shape(0)), int(cost.shape(1)), int(cost.shape(2)), cost.data(), nullptr, nullptr,
             nullptr,            nullptr,            nullptr,            p1};
    const size_t pixels = size_t(v.height) * v.width, voxels = pixels * v.planes;
    if (p2.shape(0) != 4 || int(p2.shape(1)) != v.height || int(p2.shape(2)) != v.width || out.size() != voxels)
        throw std::invalid_argument("sgm: shapes do not match");
    v.p2_right = p2.data();
    v.p2_down = v.p2_right + pixels;
    v.p2_diag = v.p2_down + pixels;
    v.p2_anti = v.p2_diag + pixels;
    if (shift.size() && (shift.shape(0) != 4 || shift.size() != 4 * pixels))
        throw std::invalid_argument("sgm: shapes do not match");
    if (shift.size()) v.shift = shift.data();
    float *down = out.data();
    nb::gil_scoped_release release;
    std::vector<float> up(voxels);
    // Each pass owns its sum; they are added in one fixed order, so the thread count changes nothing.
    lfrig::parallel_for(2, threads, [&](int pass) {
        float *sum = pass ? up.data() : down;
        std::memset(sum, 0, voxels * sizeof(float));
        vertical(v, pass == 1, sum);
    });
    lfrig::parallel_for(v.height, threads, [&](int y) {
        std::vector<float> scratch(size_t(2) * (v.planes + 2 * guard_of(v)), kWall);
        horizontal(v, y, down, scratch.data());
        float *a = down + size_t(y) * v.width * v.planes;
        const float *b = up.data() + size_t(y) * v.width * v.planes;
        for (size_t i = 0; i < size_t(v.width) * v.planes; ++i) a[i] = (a[i] + b[i]) * 0.125f;
    });
}

}  // namespace

void register_sgm(nb::module_ &m) {
    m.def("sgm", &sgm, nb::arg("cost").noconvert(), nb::arg("p2").noconvert(),
          nb::arg("shift").noconvert(), nb::arg("p1"),
          nb::arg("out").noconvert(), nb::arg("threads"));
}
