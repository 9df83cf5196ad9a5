// Grey views with a margin of repeated border pixels, and the same at half size. Twin: grey.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "lfrig/margin.hpp"
#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

// Rec. 601 luma x 64 in 1/1024: the weights sum to 65536.
LFRIG_CLONES void grey_row(const uint8_t *__restrict rgb, int16_t *__restrict grey, int width) {
    for (int x = 0; x < width; ++x)
        grey[x] = int16_t((rgb[3 * x] * 19595 + rgb[3 * x + 1] * 38470 + rgb[3 * x + 2] * 7471 + 512) >> 10);
}

LFRIG_CLONES void halve_row(const int16_t *__restrict upper, const int16_t *__restrict lower, int16_t *__restrict half,
                            int width) {
    for (int x = 0; x < width; ++x)
        half[x] = int16_t((upper[2 * x] + upper[2 * x + 1] + lower[2 * x] + lower[2 * x + 1] + 2) >> 2);
}

using Padded = ndarray<int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// views uint8 [V, H, W, 3] -> out int16 [V, rows, stride]; the image is at (pad, pad).
void grey_views(ndarray<const uint8_t, nb::ndim<4>, nb::c_contig, nb::device::cpu> views, int pad, Padded out,
                int threads) {
    const int count = int(views.shape(0)), height = int(views.shape(1)), width = int(views.shape(2));
    const int rows = int(out.shape(1)), stride = int(out.shape(2));
    if (int(out.shape(0)) != count || views.shape(3) != 3 || pad < 0 || rows < height + 2 * pad ||
        stride < width + 2 * pad || height < 1 || width < 1)
        throw std::invalid_argument("grey_views: shapes do not match");
    const uint8_t *from = views.data();
    int16_t *to = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(count, threads, [&](int v) {
        int16_t *view = to + size_t(v) * rows * stride;
        for (int y = 0; y < height; ++y) {
            int16_t *row = view + size_t(y + pad) * stride;
            grey_row(from + (size_t(v) * height + y) * width * 3, row + pad, width);
            lfrig::extend_row(row, pad, width, stride);
        }
        lfrig::extend_rows(view, pad, height, rows, stride);
    });
}

// views int16 [V, rows, stride] with an image [height, width] at (pad, pad) -> out likewise, of half the size.
void halve_views(ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> views, int pad, int height,
                 int width, int half_pad, Padded out, int threads) {
    const int count = int(views.shape(0)), rows = int(views.shape(1)), stride = int(views.shape(2));
    const int half_rows = int(out.shape(1)), half_stride = int(out.shape(2));
    const int half_height = std::max(1, height / 2), half_width = std::max(1, width / 2);
    if (int(out.shape(0)) != count || pad < 0 || half_pad < 0 || rows < height + 2 * pad ||
        stride < width + 2 * pad || half_rows < half_height + 2 * half_pad ||
        half_stride < half_width + 2 * half_pad || height < 1 || width < 1 || rows < pad + 2 || stride < pad + 2)
        throw std::invalid_argument("halve_views: shapes do not match");
    const int16_t *from = views.data();
    int16_t *to = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(count, threads, [&](int v) {
        int16_t *view = to + size_t(v) * half_rows * half_stride;
        for (int y = 0; y < half_height; ++y) {
            const int16_t *upper = from + (size_t(v) * rows + size_t(2 * y + pad)) * stride + pad;
            int16_t *row = view + size_t(y + half_pad) * half_stride;
            halve_row(upper, upper + stride, row + half_pad, half_width);
            lfrig::extend_row(row, half_pad, half_width, half_stride);
        }
        lfrig::extend_rows(view, half_pad, half_height, half_rows, half_stride);
    });
}

}  // namespace

void register_grey(nb::module_ &m) {
    m.def("grey_views", &grey_views, nb::arg("views").noconvert(), nb::arg("pad"), nb::arg("out").noconvert(),
          nb::arg("threads"));
    m.def("halve_views", &halve_views, nb::arg("views").noconvert(), nb::arg("pad"), nb::arg("height"),
          nb::arg("width"), nb::arg("half_pad"), nb::arg("out").noconvert(), nb::arg("threads"));
}
