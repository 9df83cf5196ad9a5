// Bilateral plane fits through an inverse-depth map. Twin: plane_fit.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "lfrig/exponential.hpp"
#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kRun = 64;     // pixels of one row that are fitted together
constexpr int kMoments = 9;  // 1, x, y, xx, xy, yy of the weights; 1, x, y of the rise

struct Row {  // of the picture, from the first pixel of the run
    const float *value, *weight, *red, *green, *blue;
};

struct Run {  // what the pixels of a run know of themselves
    float value[kRun], red[kRun], green[kRun], blue[kRun], slope_x[kRun], slope_y[kRun], ceiling[kRun];
    float moments[kMoments][kRun];
};

struct Kernel {
    float per_value, per_grey, per_square;
};

// Adds the neighbours at (dx, dy) to pixels [begin, end) of a run.
LFRIG_CLONES void add_neighbours(const Row &row, int dx, int dy, const Kernel &k, Run &run, int begin, int end) {
    const float fx = float(dx), fy = float(dy), away = float(dx * dx + dy * dy) * k.per_square;
    const float *__restrict value = row.value + dx, *__restrict weight = row.weight + dx;
    const float *__restrict red = row.red + dx, *__restrict green = row.green + dx, *__restrict blue = row.blue + dx;
    for (int i = begin; i < end; ++i) {
        const float rise = value[i] - run.value[i];
        const float residual = (rise - run.slope_x[i] * fx - run.slope_y[i] * fy) * k.per_value;
        const float colour =
            std::fabs(red[i] - run.red[i]) + std::fabs(green[i] - run.green[i]) + std::fabs(blue[i] - run.blue[i]);
        float q = weight[i] * lfrig::exp_of_minus(residual * residual + colour * k.per_grey + away);
        q = value[i] <= run.ceiling[i] ? q : 0.0f;
        const float t = q * rise;
        run.moments[0][i] += q;
        run.moments[1][i] += q * fx;
        run.moments[2][i] += q * fy;
        run.moments[3][i] += q * (fx * fx);
        run.moments[4][i] += q * (fx * fy);
        run.moments[5][i] += q * (fy * fy);
        run.moments[6][i] += t;
        run.moments[7][i] += t * fx;
        run.moments[8][i] += t * fy;
    }
}

// The symmetric 3x3 system of one pixel, in double precision.
void solve(const Run &run, int i, double ridge, float *rise, float *slope_x, float *slope_y) {
    double m[kMoments];
    for (int j = 0; j < kMoments; ++j) m[j] = run.moments[j][i];
    const double s0 = m[0] + 1e-9, sx = m[1], sy = m[2], sxx = m[3] + ridge, sxy = m[4], syy = m[5] + ridge;
    const double m00 = sxx * syy - sxy * sxy, m01 = sy * sxy - sx * syy, m02 = sx * sxy - sy * sxx;
    const double m11 = s0 * syy - sy * sy, m12 = sx * sy - s0 * sxy, m22 = s0 * sxx - sx * sx;
    const double determinant = s0 * m00 + sx * m01 + sy * m02;
    *rise = float((m00 * m[6] + m01 * m[7] + m02 * m[8]) / determinant);
    *slope_x = float((m01 * m[6] + m11 * m[7] + m12 * m[8]) / determinant);
    *slope_y = float((m02 * m[6] + m12 * m[7] + m22 * m[8]) / determinant);
}

using Map = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Stack = ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// values, weights float32 [H, W]; guide float32 [3, H, W]; starts int32 [R, 3] (row, first column, length <= 64) of the
// runs of pixels to fit; slopes float32 [2, H, W] or [2, 0, 0]; ceiling float32 [H, W] or [0, 0]; out float32 [4, M]:
// value, slopes along x and y, support, in the order of the runs.
void plane_fit(Map values, Map weights, Stack guide,
               ndarray<const int32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu> runs, Stack slopes, Map ceiling,
               int radius, int stride, float sigma_value, float sigma_grey, float ridge,
               ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> out, int threads) {
    const int height = int(values.shape(0)), width = int(values.shape(1)), count = int(runs.shape(0));
    const size_t area = size_t(height) * size_t(width);
    const bool sloped = slopes.size() > 0, bounded = ceiling.size() > 0;
    if (weights.shape(0) != values.shape(0) || weights.shape(1) != values.shape(1) || guide.size() != 3 * area ||
        (sloped && slopes.size() != 2 * area) || (bounded && ceiling.size() != area) || runs.shape(1) != 3 ||
        out.shape(0) != 4 || radius < 1 || stride < 1)
        throw std::invalid_argument("plane_fit: shapes do not match");
    const int32_t *run_of = runs.data();
    std::vector<size_t> first(size_t(count) + 1, 0);
    for (int r = 0; r < count; ++r) {
        const int32_t *at = run_of + 3 * r;
        if (at[0] < 0 || at[0] >= height || at[1] < 0 || at[2] < 1 || at[2] > kRun || at[1] + at[2] > width)
            throw std::invalid_argument("plane_fit: a run leaves the map");
        first[size_t(r) + 1] = first[size_t(r)] + size_t(at[2]);
    }
    const size_t total = first.back();
    if (out.shape(1) != total) throw std::invalid_argument("plane_fit: out has not one column per pixel");
    const float *value = values.data(), *weight = weights.data(), *colour = guide.data();
    const float *slope = slopes.data(), *top = ceiling.data();
    float *to = out.data();
    const Kernel kernel{1.0f / sigma_value, 1.0f / sigma_grey, 1.0f / float(radius * radius)};
    nb::gil_scoped_release release;
    lfrig::parallel_for(count, threads, [&](int r) {
        const int y = run_of[3 * r], x0 = run_of[3 * r + 1], n = run_of[3 * r + 2];
        const size_t at = size_t(y) * size_t(width) + size_t(x0);
        Run run;
        std::fill(&run.moments[0][0], &run.moments[0][0] + kMoments * kRun, 0.0f);
        for (int i = 0; i < n; ++i) {
            run.value[i] = value[at + i];
            run.red[i] = colour[at + i];
            run.green[i] = colour[area + at + i];
            run.blue[i] = colour[2 * area + at + i];
            run.slope_x[i] = sloped ? slope[at + i] : 0.0f;
            run.slope_y[i] = sloped ? slope[area + at + i] : 0.0f;
            run.ceiling[i] = bounded ? top[at + i] : INFINITY;
        }
        for (int dy = -radius; dy <= radius; dy += stride) {
            if (y + dy < 0 || y + dy >= height) continue;
            const size_t from = size_t(y + dy) * size_t(width) + size_t(x0);
            const Row row{value + from, weight + from, colour + from, colour + area + from, colour + 2 * area + from};
            for (int dx = -radius; dx <= radius; dx += stride)
                add_neighbours(row, dx, dy, kernel, run, std::max(0, -x0 - dx), std::min(n, width - x0 - dx));
        }
        float *o = to + first[size_t(r)];
        for (int i = 0; i < n; ++i) {
            float rise;
            solve(run, i, ridge, &rise, o + total + i, o + 2 * total + i);
            o[i] = run.value[i] + rise;
            o[3 * total + i] = run.moments[0][i];
        }
    });
}

}  // namespace

void register_plane_fit(nb::module_ &m) {
    m.def("plane_fit", &plane_fit, nb::arg("values").noconvert(), nb::arg("weights").noconvert(),
          nb::arg("guide").noconvert(), nb::arg("runs").noconvert(), nb::arg("slopes").noconvert(),
          nb::arg("ceiling").noconvert(), nb::arg("radius"), nb::arg("stride"), nb::arg("sigma_value"),
          nb::arg("sigma_grey"), nb::arg("ridge"), nb::arg("out").noconvert(), nb::arg("threads"));
}
