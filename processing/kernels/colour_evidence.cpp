// Evidence of colour: does a source show the photo's colour where a voxel of the target lies? Twin: colour_evidence.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstring>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kChannels = 4;  // r, g, b, and whether the pixel is saturated
constexpr float kSaturated = 0.02f;

struct Source {
    const float *image;      // [H, W, 4], in the photo's colours
    const float *disparity;  // [H, W]
    int height, width;
    float a[9], b[3];        // p = A (x, y, 1) + b w
    float scale_a, scale_c;  // 1/z = scale_a * delta + scale_c
    float margin, weight, sigma, cap, unknown;
};

// What the photo's pixel p has against the colour that the source shows at (u, v), mean over r, g, b.
inline float mismatch(const Source &s, const float *p, float u, float v) {
    const int iu = int(u), iv = int(v);
    const float fu = u - float(iu), fv = v - float(iv);
    const float *q = s.image + (size_t(iv) * s.width + iu) * kChannels;
    const float *r = q + size_t(s.width) * kChannels;
    float c[kChannels];
    for (int i = 0; i < kChannels; ++i) {
        const float top = q[i] + fu * (q[i + kChannels] - q[i]);
        const float low = r[i] + fu * (r[i + kChannels] - r[i]);
        c[i] = top + fv * (low - top);
    }
    // A saturated value is a lower bound: being brighter than it says nothing.
    const float under = c[3] > kSaturated ? 0.0f : 1.0f, over = p[3] > kSaturated ? 0.0f : 1.0f;
    float sum = 0;
    for (int i = 0; i < 3; ++i) sum += p[i] > c[i] ? under * (p[i] - c[i]) : over * (c[i] - p[i]);
    return sum * (1.0f / 3.0f);
}

void add_ray(const Source &s, const float *photo, int x, int y, float w0, float dw, int planes, float *ray) {
    const float px = s.a[0] * x + s.a[1] * y + s.a[2], py = s.a[3] * x + s.a[4] * y + s.a[5];
    const float pz = s.a[6] * x + s.a[7] * y + s.a[8];
    const float right = float(s.width - 1), bottom = float(s.height - 1);
    for (int k = 0; k < planes; ++k) {
        const float w = w0 + dw * float(k), z = pz + s.b[2] * w;
        if (!(z > 1e-6f)) continue;
        const float inverse = 1.0f / z, u = (px + s.b[0] * w) * inverse, v = (py + s.b[1] * w) * inverse;
        if (!(u >= 0 && v >= 0 && u < right && v < bottom)) continue;
        const float delta = (w * inverse - s.scale_c) / s.scale_a;
        const float seen = s.disparity[size_t(v + 0.5f) * s.width + size_t(u + 0.5f)];
        const float hidden = std::min(1.0f, std::max(0.0f, (seen - delta - s.margin) / (0.5f * s.margin)));
        if (hidden >= 1.0f) continue;
        const float cost = std::min(mismatch(s, photo, u, v) / s.sigma, s.cap);
        ray[k] += s.weight * (1.0f - hidden) * (s.unknown - cost);
    }
}

using F3 = ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using F1 = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Out3 = ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

void add(F3 photo, F3 image, F2 disparity, F1 numbers, float w0, float dw, Out3 out, int threads) {
    const int height = int(out.shape(0)), width = int(out.shape(1)), planes = int(out.shape(2));
    Source s{};
    s.image = image.data(), s.disparity = disparity.data();
    s.height = int(image.shape(0)), s.width = int(image.shape(1));
    if (int(photo.shape(0)) != height || int(photo.shape(1)) != width || photo.shape(2) != kChannels ||
        image.shape(2) != kChannels || int(disparity.shape(0)) != s.height || int(disparity.shape(1)) != s.width ||
        numbers.shape(0) != 19)
        throw std::invalid_argument("colour_evidence: shapes do not match");
    const float *n = numbers.data(), *own = photo.data();
    std::memcpy(s.a, n, 9 * sizeof(float));
    std::memcpy(s.b, n + 9, 3 * sizeof(float));
    s.scale_a = n[12], s.scale_c = n[13], s.margin = n[14], s.weight = n[15];
    s.sigma = n[16], s.cap = n[17], s.unknown = n[18];
    float *volume = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        for (int x = 0; x < width; ++x) {
            const size_t i = size_t(y) * width + x;
            add_ray(s, own + i * kChannels, x, y, w0, dw, planes, volume + i * planes);
        }
    });
}

}  // namespace

void register_colour_evidence(nb::module_ &m) {
    m.def("colour_evidence", &add, nb::arg("photo").noconvert(), nb::arg("image").noconvert(),
          nb::arg("disparity").noconvert(), nb::arg("numbers").noconvert(), nb::arg("w0"), nb::arg("dw"),
          nb::arg("out").noconvert(), nb::arg("threads"));
}
