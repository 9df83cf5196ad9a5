// The 49-view warp: every output view gathers the photo along its own disparity field. Twin: warp.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "lfrig/cpu.hpp"
#include "lfrig/parallel.hpp"
#include "lfrig/taps.hpp"
#include "parts/pair_sampling.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int PAD = 3;  // beyond it all taps are the border's

// One row of the image with its border continued: float32 [width + 2 PAD, 4].
template <class T>
void padded_row(const T *image, int height, int width, int y, float *out) {
    const T *row = image + size_t(std::clamp(y - PAD, 0, height - 1)) * width * 3;
    for (int x = 0; x < width + 2 * PAD; ++x) {
        const T *pixel = row + size_t(std::clamp(x - PAD, 0, width - 1)) * 3;
        for (int c = 0; c < 3; ++c) out[4 * x + c] = float(pixel[c]);
        out[4 * x + 3] = 0.0f;
    }
}

// 8 bits: the image in fixed point.
struct Source8 {
    lfrig::PairPicture picture;

    Source8(const uint8_t *image, int height, int width) : picture(height + 2 * PAD, width + 2 * PAD, PAD) {
        std::vector<float> row(size_t(picture.width) * 4);
        for (int y = 0; y < picture.height; ++y) {
            padded_row(image, height, width, y, row.data());
            picture.set_row(y, row.data());
        }
    }
    void row(const float *field, float dr, float dc, int y, int count, uint8_t *out) const {
        lfrig::sample_pairs_row(picture, lfrig::keys_taps(), field, dr, dc, y, count, out);
    }
};

// 16 bits: fixed point would be too coarse.
struct Source16 {
    int height, width;
    std::vector<float> picture;

    Source16(const uint16_t *image, int rows, int cols)
        : height(rows + 2 * PAD), width(cols + 2 * PAD), picture(size_t(height) * width * 4) {
        for (int y = 0; y < height; ++y) padded_row(image, rows, cols, y, picture.data() + size_t(y) * width * 4);
    }
    void row(const float *field, float dr, float dc, int y, int count, uint16_t *out) const {
        lfrig::sample_float_row(picture.data(), height, width, PAD, lfrig::keys_weights, field, dr, dc, y, count, 1.0f,
                                out);
    }
};

template <class T, class Source>
void warp(ndarray<const T, nb::ndim<3>, nb::c_contig, nb::device::cpu> image,
          ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu> fields,
          ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu> offsets,
          ndarray<T, nb::ndim<4>, nb::c_contig, nb::device::cpu> out, int threads) {
    const int height = int(image.shape(0)), width = int(image.shape(1)), views = int(fields.shape(0));
    if (image.shape(2) != 3 || int(fields.shape(1)) != height || int(fields.shape(2)) != width ||
        int(offsets.shape(0)) != views || offsets.shape(1) != 2 || int(out.shape(0)) != views ||
        int(out.shape(1)) != height || int(out.shape(2)) != width || out.shape(3) != 3)
        throw std::invalid_argument("warp_views: shapes do not match");
    const T *from = image.data();
    const float *field = fields.data(), *offset = offsets.data();
    T *to = out.data();
    nb::gil_scoped_release release;
    if (height == 0 || width == 0) return;
    const Source source(from, height, width);
    lfrig::parallel_for(views * height, threads, [&](int i) {
        const int v = i / height, y = i % height;
        source.row(field + size_t(i) * width, offset[2 * v], offset[2 * v + 1], y, width, to + size_t(i) * width * 3);
    });
}

}  // namespace

void register_warp(nb::module_ &m) {
    m.def(
        "use_plain_loops", [](bool plain) { lfrig::plain_loops = plain; }, nb::arg("plain"),
        "Leave hand-written vector code unused: for the tests that it gives the bits of the plain loops.");
    m.def("warp_views", &warp<uint8_t, Source8>, nb::arg("image").noconvert(), nb::arg("fields").noconvert(),
          nb::arg("offsets").noconvert(), nb::arg("out").noconvert(), nb::arg("threads"));
    m.def("warp_views", &warp<uint16_t, Source16>, nb::arg("image").noconvert(), nb::arg("fields").noconvert(),
          nb::arg("offsets").noconvert(), nb::arg("out").noconvert(), nb::arg("threads"));
}
