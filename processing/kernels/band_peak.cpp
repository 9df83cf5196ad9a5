// The best label of every pixel of an aggregated band, and how distinct it is. Twin: band_peak.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kLabelBits = 8;  // labels share a word with their cost

struct Peaks {
    float *label, *least, *margin, *curvature;
};

LFRIG_CLONES void read_line(const uint16_t *cost, const uint16_t *total, int width, int labels, int reach,
                            const Peaks &out) {
    for (int x = 0; x < width; ++x) {
        const uint16_t *__restrict c = cost + size_t(x) * labels, *__restrict t = total + size_t(x) * labels;
        uint32_t first = UINT32_MAX, least = UINT32_MAX, beyond = UINT32_MAX;
        for (int k = 0; k < labels; ++k) {
            const uint32_t key = uint32_t(t[k]) << kLabelBits | uint32_t(k);
            first = key < first ? key : first;
            least = c[k] < least ? c[k] : least;
        }
        const int best = int(first & ((1u << kLabelBits) - 1));
        const int at = t[best];
        for (int k = 0; k < labels; ++k) {
            const uint32_t other = (k < best - reach) | (k > best + reach) ? t[k] : UINT32_MAX;
            beyond = other < beyond ? other : beyond;
        }
        const int before = t[std::max(best - reach, 0)], after = t[std::min(best + reach, labels - 1)];
        float offset = 0.0f;
        if (best > 0 && best < labels - 1) {
            const int bend = int(t[best - 1]) - 2 * at + int(t[best + 1]);
            if (bend > 0) offset = 0.5f * float(int(t[best - 1]) - int(t[best + 1])) / float(bend);
        }
        out.label[x] = float(best) + offset;
        out.least[x] = float(least);
        out.margin[x] = beyond == UINT32_MAX ? 0.0f : float(int(beyond) - at);
        out.curvature[x] = float(before + after - 2 * at);
    }
}

using V3 = ndarray<const uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// cost, total uint16 [H, W, K]; out float32 [4, H, W]: label, least cost, margin, curvature. See band_peak.py.
void band_peak(V3 cost, V3 total, int reach, ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu> out,
               int threads) {
    const int height = int(cost.shape(0)), width = int(cost.shape(1)), labels = int(cost.shape(2));
    const size_t area = size_t(height) * size_t(width);
    if (total.size() != cost.size() || out.size() != 4 * area || out.shape(0) != 4 || labels < 1 ||
        labels > 1 << kLabelBits || reach < 0)
        throw std::invalid_argument("band_peak: shapes do not match");
    const uint16_t *costs = cost.data(), *totals = total.data();
    float *to = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        const size_t at = size_t(y) * size_t(width);
        const Peaks line{to + at, to + area + at, to + 2 * area + at, to + 3 * area + at};
        read_line(costs + at * labels, totals + at * labels, width, labels, reach, line);
    });
}

}  // namespace

void register_band_peak(nb::module_ &m) {
    m.def("band_peak", &band_peak, nb::arg("cost").noconvert(), nb::arg("total").noconvert(), nb::arg("reach"),
          nb::arg("out").noconvert(), nb::arg("threads"));
}
