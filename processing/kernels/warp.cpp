// The 49-view warp: every output view gathers the photo along its own disparity field. Twin: warp.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstdint>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

// Catmull-Rom weights (Keys 1981, a = -1/2) of the four taps around a fraction t in [0, 1).
inline void cubic_weights(float t, float w[4]) {
    const float t2 = t * t, t3 = t2 * t;
    w[0] = -0.5f * t3 + t2 - 0.5f * t;
    w[1] = 1.5f * t3 - 2.5f * t2 + 1.0f;
    w[2] = -1.5f * t3 + 2.0f * t2 + 0.5f * t;
    w[3] = 0.5f * t3 - 0.5f * t2;
}

inline int clamp_index(int i, int n) { return i < 0 ? 0 : (i >= n ? n - 1 : i); }

// One output row: out[x] = image(y + dr * field[x], x + dc * field[x]), bicubic, border replicated.
template <class T>
void warp_row(const T *image, int height, int width, const float *field, float dr, float dc, int y, T *out) {
    const float limit = sizeof(T) == 1 ? 255.0f : 65535.0f;
    for (int x = 0; x < width; ++x) {
        float d = field[x];
        if (!std::isfinite(d)) d = 0.0f;
        const float fx = std::fmin(std::fmax(float(x) + dc * d, -1.0f), float(width));
        const float fy = std::fmin(std::fmax(float(y) + dr * d, -1.0f), float(height));
        const int ix = int(std::floor(fx)), iy = int(std::floor(fy));
        float wx[4], wy[4];
        cubic_weights(fx - float(ix), wx);
        cubic_weights(fy - float(iy), wy);
        float sum[3] = {0, 0, 0};
        for (int j = 0; j < 4; ++j) {
            const T *row = image + size_t(clamp_index(iy - 1 + j, height)) * width * 3;
            float part[3] = {0, 0, 0};
            for (int i = 0; i < 4; ++i) {
                const T *p = row + size_t(clamp_index(ix - 1 + i, width)) * 3;
                for (int c = 0; c < 3; ++c) part[c] += wx[i] * float(p[c]);
            }
            for (int c = 0; c < 3; ++c) sum[c] += wy[j] * part[c];
        }
        for (int c = 0; c < 3; ++c) out[3 * x + c] = T(std::fmin(std::fmax(sum[c], 0.0f), limit) + 0.5f);
    }
}

template <class T>
void warp(ndarray<const T, nb::ndim<3>, nb::c_contig, nb::device::cpu> image,
          ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu> fields,
          ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu> offsets,
          ndarray<T, nb::ndim<4>, nb::c_contig, nb::device::cpu> out, int threads) {
    const int height = int(image.shape(0)), width = int(image.shape(1)), views = int(fields.shape(0));
    if (image.shape(2) != 3 || int(fields.shape(1)) != height || int(fields.shape(2)) != width ||
        int(offsets.shape(0)) != views || offsets.shape(1) != 2 || int(out.shape(0)) != views ||
        int(out.shape(1)) != height || int(out.shape(2)) != width || out.shape(3) != 3)
        throw std::invalid_argument("warp_views: shapes do not match");
    const T *src = image.data();
    const float *field = fields.data(), *offset = offsets.data();
    T *dst = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(views * height, threads, [&](int i) {
        const int v = i / height, y = i % height;
        warp_row(src, height, width, field + size_t(i) * width, offset[2 * v], offset[2 * v + 1], y,
                 dst + size_t(i) * width * 3);
    });
}

}  // namespace

void register_warp(nb::module_ &m) {
    m.def("warp_views", &warp<uint8_t>, nb::arg("image").noconvert(), nb::arg("fields").noconvert(),
          nb::arg("offsets").noconvert(), nb::arg("out").noconvert(), nb::arg("threads"));
    m.def("warp_views", &warp<uint16_t>, nb::arg("image").noconvert(), nb::arg("fields").noconvert(),
          nb::arg("offsets").noconvert(), nb::arg("out").noconvert(), nb::arg("threads"));
}
