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
constexpr int kLanes = 16;   // runs are filled up to a multiple of this
constexpr int kMoments = 9;  // 1, x, y, xx, xy, yy of the weights; 1, x, y of the rise

// value, weight, red, green, blue with a margin all around whose weight is 0: [5, H + 2 radius, wide].
struct Picture {
    int radius;
    size_t wide, area;
    std::vector<float> padded;

    const float *at(int y, int x) const { return padded.data() + size_t(y + radius) * wide + size_t(x + radius); }
};

struct Run {  // what the pixels of a run know of themselves
    float slope_x[kRun], slope_y[kRun], ceiling[kRun];
    float line[5][kRun];  // moments of one line of neighbours: 1, x, xx of the weights; 1, x of the rise
    float moments[kMoments][kRun];
};

struct Kernel {
    float per_value, per_grey, per_square;
};

// Adds the neighbours at (dx, dy) to the line moments of the first `width` pixels of a run.
LFRIG_CLONES void add_neighbours(const float *own, const float *other, size_t area, float dx, float dy,
                                 const Kernel &k, Run &run, int width) {
    const float away = (dx * dx + dy * dy) * k.per_square, square = dx * dx;
    const float *__restrict value = own, *__restrict red = own + 2 * area, *__restrict green = own + 3 * area;
    const float *__restrict blue = own + 4 * area, *__restrict weight = other + area;
    for (int i = 0; i < width; ++i) {
        const float rise = other[i] - value[i];
        const float residual = (rise - run.slope_x[i] * dx - run.slope_y[i] * dy) * k.per_value;
        const float colour = std::fabs(other[2 * area + i] - red[i]) + std::fabs(other[3 * area + i] - green[i]) +
                             std::fabs(other[4 * area + i] - blue[i]);
        float q = weight[i] * lfrig::exp_of_minus(residual * residual + colour * k.per_grey + away);
        q = other[i] <= run.ceiling[i] ? q : 0.0f;
        const float t = q * rise;
        run.line[0][i] += q;
        run.line[1][i] += q * dx;
        run.line[2][i] += q * square;
        run.line[3][i] += t;
        run.line[4][i] += t * dx;
    }
}

// Adds the moments of a line of neighbours, dy below, to those of the run and clears them.
LFRIG_CLONES void add_line(Run &run, float dy, int width) {
    for (int i = 0; i < width; ++i) {
        const float one = run.line[0][i], x = run.line[1][i], rise = run.line[3][i];
        run.moments[0][i] += one;
        run.moments[1][i] += x;
        run.moments[2][i] += one * dy;
        run.moments[3][i] += run.line[2][i];
        run.moments[4][i] += x * dy;
        run.moments[5][i] += one * (dy * dy);
        run.moments[6][i] += rise;
        run.moments[7][i] += run.line[4][i];
        run.moments[8][i] += rise * dy;
    }
    for (auto &line : run.line) std::fill(line, line + width, 0.0f);
}

// The symmetric 3x3 systems of a run, in double precision.
LFRIG_CLONES void solve(const Run &run, int width, double ridge, float *__restrict rise, float *__restrict slope_x,
                        float *__restrict slope_y) {
    for (int i = 0; i < width; ++i) {
        const double s0 = double(run.moments[0][i]) + 1e-9, sx = run.moments[1][i], sy = run.moments[2][i];
        const double sxx = run.moments[3][i] + ridge, sxy = run.moments[4][i], syy = run.moments[5][i] + ridge;
        const double t0 = run.moments[6][i], tx = run.moments[7][i], ty = run.moments[8][i];
        const double m00 = sxx * syy - sxy * sxy, m01 = sy * sxy - sx * syy, m02 = sx * sxy - sy * sxx;
        const double m11 = s0 * syy - sy * sy, m12 = sx * sy - s0 * sxy, m22 = s0 * sxx - sx * sx;
        const double one = 1.0 / (s0 * m00 + sx * m01 + sy * m02);
        rise[i] = float((m00 * t0 + m01 * tx + m02 * ty) * one);
        slope_x[i] = float((m01 * t0 + m11 * tx + m12 * ty) * one);
        slope_y[i] = float((m02 * t0 + m12 * tx + m22 * ty) * one);
    }
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
    Picture picture{radius, size_t(width) + 2 * size_t(radius) + kLanes, 0, {}};
    picture.area = picture.wide * (size_t(height) + 2 * size_t(radius));
    picture.padded.assign(5 * picture.area, 0.0f);
    const float *planes[5] = {value, weight, colour, colour + area, colour + 2 * area};
    for (size_t n = 0; n < 5; ++n)
        for (int y = 0; y < height; ++y)
            std::copy(planes[n] + size_t(y) * width, planes[n] + size_t(y + 1) * width,
                      picture.padded.data() + n * picture.area + size_t(y + radius) * picture.wide + radius);
    lfrig::parallel_for(count, threads, [&](int r) {
        const int y = run_of[3 * r], x0 = run_of[3 * r + 1], n = run_of[3 * r + 2];
        const int filled = (n + kLanes - 1) / kLanes * kLanes;
        const size_t at = size_t(y) * size_t(width) + size_t(x0);
        const float *own = picture.at(y, x0);
        Run run{};
        for (int i = 0; i < n; ++i) {
            run.slope_x[i] = sloped ? slope[at + i] : 0.0f;
            run.slope_y[i] = sloped ? slope[area + at + i] : 0.0f;
            run.ceiling[i] = bounded ? top[at + i] : INFINITY;
        }
        for (int dy = -radius; dy <= radius; dy += stride) {
            if (y + dy < 0 || y + dy >= height) continue;
            const float *line = own + ptrdiff_t(dy) * ptrdiff_t(picture.wide);
            for (int dx = -radius; dx <= radius; dx += stride)
                add_neighbours(own, line + dx, picture.area, float(dx), float(dy), kernel, run, filled);
            add_line(run, float(dy), filled);
        }
        float *o = to + first[size_t(r)];
        solve(run, n, ridge, o, o + total, o + 2 * total);
        for (int i = 0; i < n; ++i) {
            o[i] += own[i];
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
