// Samples of a cubic B-spline at scattered positions. Twin, and the filter that makes the coefficients: spline.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int BLOCK = 4096;  // positions per item of work

inline void weights(float t, float w[4]) {
    const float s = 1.0f - t, sixth = float(1.0 / 6.0);
    w[0] = sixth * s * s * s;
    w[1] = sixth * (4.0f - 3.0f * t * t * (2.0f - t));
    w[2] = sixth * (4.0f - 3.0f * s * s * (2.0f - s));
    w[3] = sixth * t * t * t;
}

// Samples [begin, end); C is the number of channels.
template <int C>
void sample(const float *coefficients, int height, int width, const float *x, const float *y, int begin, int end,
            float pad, float *out) {
    for (int n = begin; n < end; ++n) {
        // fmax and fmin drop NaN: it counts as the top left corner.
        const float fx = std::fmin(std::fmax(x[n] + pad, 1.0f), float(width - 2));
        const float fy = std::fmin(std::fmax(y[n] + pad, 1.0f), float(height - 2));
        const int ix = std::min(int(fx), width - 3), iy = std::min(int(fy), height - 3);
        float wx[4], wy[4], sum[C] = {};
        weights(fx - float(ix), wx);
        weights(fy - float(iy), wy);
        for (int j = 0; j < 4; ++j) {
            const float *tap = coefficients + (size_t(iy - 1 + j) * width + (ix - 1)) * C;
            float part[C] = {};
            for (int i = 0; i < 4; ++i)
                for (int c = 0; c < C; ++c) part[c] += wx[i] * tap[C * i + c];
            for (int c = 0; c < C; ++c) sum[c] += wy[j] * part[c];
        }
        for (int c = 0; c < C; ++c) out[size_t(n) * C + c] = sum[c];
    }
}

using Positions = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

void sample_spline(ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu> coefficients, Positions x,
                   Positions y, ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> out, int pad, int threads) {
    const int height = int(coefficients.shape(0)), width = int(coefficients.shape(1));
    const int channels = int(coefficients.shape(2)), count = int(x.shape(0));
    if (int(y.shape(0)) != count || int(out.shape(0)) != count || int(out.shape(1)) != channels)
        throw std::invalid_argument("sample_spline: shapes do not match");
    if (height < 4 || width < 4) throw std::invalid_argument("sample_spline: at least 4x4 coefficients are needed");
    if (channels < 1 || channels > 4) throw std::invalid_argument("sample_spline: 1 to 4 channels");
    const float *from = coefficients.data(), *px = x.data(), *py = y.data();
    float *to = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for((count + BLOCK - 1) / BLOCK, threads, [&](int block) {
        const int begin = block * BLOCK, end = std::min(count, begin + BLOCK);
        const float p = float(pad);
        switch (channels) {
            case 1: return sample<1>(from, height, width, px, py, begin, end, p, to);
            case 2: return sample<2>(from, height, width, px, py, begin, end, p, to);
            case 3: return sample<3>(from, height, width, px, py, begin, end, p, to);
            default: return sample<4>(from, height, width, px, py, begin, end, p, to);
        }
    });
}

}  // namespace

void register_spline(nb::module_ &m) {
    m.def("sample_spline", &sample_spline, nb::arg("coefficients").noconvert(), nb::arg("x").noconvert(),
          nb::arg("y").noconvert(), nb::arg("out").noconvert(), nb::arg("pad"), nb::arg("threads"));
}
