// Photo-consistency sweep of a light field: mean truncated absolute difference per disparity plane, box-aggregated.
// Twin: plane_cost.py. Arithmetic is 16-bit fixed point (grey x 64), which the compiler turns into pmulhrsw.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstdint>
#include <cstring>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

struct Shift {
    int dx, dy;
    int16_t wx, wy;  // fractions in 1/32768
};

Shift make_shift(float sx, float sy) {
    Shift s;
    s.dx = int(std::floor(sx));
    s.dy = int(std::floor(sy));
    s.wx = int16_t(std::min(32767, int(std::lrint((sx - s.dx) * 32768.0f))));
    s.wy = int16_t(std::min(32767, int(std::lrint((sy - s.dy) * 32768.0f))));
    return s;
}

// acc[x] += min(|bilinear(view, x + shift) - centre[x]|, truncation)
LFRIG_CLONES void accumulate_row(const int16_t *__restrict a, const int16_t *__restrict b, int16_t wx, int16_t wy,
                                 const int16_t *__restrict centre, int16_t truncation, uint16_t *__restrict acc,
                                 int width) {
    for (int x = 0; x < width; ++x) {
        const int16_t t0 = int16_t(a[x] + int16_t(((a[x + 1] - a[x]) * wx + 0x4000) >> 15));
        const int16_t t1 = int16_t(b[x] + int16_t(((b[x + 1] - b[x]) * wx + 0x4000) >> 15));
        const int16_t v = int16_t(t0 + int16_t(((t1 - t0) * wy + 0x4000) >> 15));
        const int16_t e = int16_t(v - centre[x]);
        const int16_t m = e < 0 ? int16_t(-e) : e;
        acc[x] = uint16_t(acc[x] + (m < truncation ? m : truncation));
    }
}

LFRIG_CLONES void box_rows(const uint16_t *__restrict up, const uint16_t *__restrict mid,
                           const uint16_t *__restrict down, float *__restrict sum, int width) {
    for (int x = 0; x < width; ++x) sum[x] = float(up[x]) + float(mid[x]) + float(down[x]);
}

constexpr int kBlock = 64;  // pixels of a row that are computed or skipped together

// views: int16 [V, H + 2 pad, W + 2 pad] (grey x 64), offsets [V, 2] (dr, dc), out float32 [H, W, D] in grey levels.
// active: uint8 [H, ceil(W / 64)]; blocks with 0 are skipped and keep an unspecified cost.
void plane_cost(ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> views,
                ndarray<const int16_t, nb::ndim<2>, nb::c_contig, nb::device::cpu> centre_view,
                ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu> offsets,
                ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu> active, int pad, float first,
                float step, int truncation, ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu> out,
                int threads) {
    const int count = int(views.shape(0)), rows = int(views.shape(1)), stride = int(views.shape(2));
    const int height = int(out.shape(0)), width = int(out.shape(1)), planes = int(out.shape(2));
    float reach = 0;
    for (int v = 0; v < 2 * count; ++v) reach = std::max(reach, std::fabs(offsets.data()[v]));
    reach *= std::max(std::fabs(first), std::fabs(first + step * float(planes - 1)));
    if (reach > float(pad - 2)) throw std::invalid_argument("plane_cost: the views are not padded enough");
    if (rows != height + 2 * pad || stride != width + 2 * pad || int(offsets.shape(0)) != count ||
        int(centre_view.shape(0)) != rows || int(centre_view.shape(1)) != stride || count < 1 || count > 512 ||
        int(active.shape(0)) != height || int(active.shape(1)) != (width + kBlock - 1) / kBlock || truncation < 1 ||
        truncation > 32767)
        throw std::invalid_argument("plane_cost: shapes do not match");
    const int16_t *src = views.data(), *centre = centre_view.data();
    const float *off = offsets.data();
    const uint8_t *on = active.data();
    const int blocks = int(active.shape(1));
    float *dst = out.data();
    nb::gil_scoped_release release;
    // At most this many views fit a 16-bit sum before it is folded into the 32-bit one.
    const int fold = std::max(1, 65535 / truncation);
    std::vector<uint16_t> cost(size_t(height) * planes * width);
    lfrig::parallel_for(height * blocks, threads, [&](int item) {
        if (!on[item]) return;
        const int y = item / blocks, x0 = (item % blocks) * kBlock, n = std::min(kBlock, width - x0);
        uint16_t acc[kBlock];
        uint32_t total[kBlock];
        const int16_t *c = centre + size_t(y + pad) * stride + pad + x0;
        for (int k = 0; k < planes; ++k) {
            const float delta = first + step * float(k);
            std::fill(total, total + n, 0u);
            std::fill(acc, acc + n, uint16_t(0));
            int held = 0;
            for (int v = 0; v < count; ++v) {
                const Shift s = make_shift(-off[2 * v + 1] * delta, -off[2 * v] * delta);
                const int16_t *a = src + (size_t(v) * rows + size_t(y + pad + s.dy)) * stride + pad + x0 + s.dx;
                accumulate_row(a, a + stride, s.wx, s.wy, c, int16_t(truncation), acc, n);
                if (++held == fold || v == count - 1) {
                    for (int x = 0; x < n; ++x) total[x] += acc[x];
                    std::fill(acc, acc + n, uint16_t(0));
                    held = 0;
                }
            }
            uint16_t *o = cost.data() + (size_t(y) * planes + k) * width + x0;
            for (int x = 0; x < n; ++x) o[x] = uint16_t((total[x] + unsigned(count) / 2) / unsigned(count));
        }
    });
    lfrig::parallel_for(height, threads, [&](int y) {
        std::vector<float> sum(width + 2);
        const int y0 = std::max(0, y - 1), y1 = std::min(height - 1, y + 1);
        for (int k = 0; k < planes; ++k) {
            auto row = [&](int r) { return cost.data() + (size_t(r) * planes + k) * width; };
            box_rows(row(y0), row(y), row(y1), sum.data() + 1, width);
            sum[0] = sum[1];
            sum[width + 1] = sum[width];
            float *o = dst + size_t(y) * width * planes + k;
            for (int x = 0; x < width; ++x)
                if (on[size_t(y) * blocks + x / kBlock])
                    o[size_t(x) * planes] = (sum[x] + sum[x + 1] + sum[x + 2]) * (1.0f / (9.0f * 64.0f));
        }
    });
}

}  // namespace

void register_plane_cost(nb::module_ &m) {
    m.def("plane_cost", &plane_cost, nb::arg("views").noconvert(), nb::arg("centre").noconvert(),
          nb::arg("offsets").noconvert(), nb::arg("active").noconvert(), nb::arg("pad"), nb::arg("first"), nb::arg("step"), nb::arg("truncation"),
          nb::arg("out").noconvert(), nb::arg("threads"));
}
