// Softmax of a cost volume and the windowed mean around its peak. Twin: softmax.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "lfrig/exponential.hpp"
#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kLanes = 16;  // sums are kept in as many parts, whatever the vector width, and added in one order

LFRIG_CLONES float least(const float *__restrict cost, int planes) {
    float part[kLanes];
    for (float &p : part) p = cost[0];
    int k = 0;
    for (; k + kLanes <= planes; k += kLanes)
        for (int j = 0; j < kLanes; ++j) part[j] = cost[k + j] < part[j] ? cost[k + j] : part[j];
    float low = part[0];
    for (int j = 1; j < kLanes; ++j) low = part[j] < low ? part[j] : low;
    for (; k < planes; ++k) low = cost[k] < low ? cost[k] : low;
    return low;
}

// weight[k] = exp((low - cost[k]) * sharpness); returns their sum.
LFRIG_CLONES float exponentials(const float *__restrict cost, float low, float sharpness, int planes,
                                float *__restrict weight) {
    float part[kLanes] = {};
    int k = 0;
    for (; k + kLanes <= planes; k += kLanes)
        for (int j = 0; j < kLanes; ++j) {
            const float w = lfrig::exp_of_minus((cost[k + j] - low) * sharpness);
            weight[k + j] = w;
            part[j] += w;
        }
    float sum = 0;
    for (float p : part) sum += p;
    for (; k < planes; ++k) sum += weight[k] = lfrig::exp_of_minus((cost[k] - low) * sharpness);
    return sum;
}

LFRIG_CLONES void quantise(const float *__restrict weight, float scale, int planes, uint16_t *__restrict out) {
    for (int k = 0; k < planes; ++k) out[k] = uint16_t(int32_t(weight[k] * scale + 0.5f));
}

// cost float32 [H, W, D]; probability uint16 [H, W, D] (65535 = 1), peak index and mass float32 [H, W].
void softmax_peak(ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu> cost, float sharpness, int window,
                  ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> probability,
                  ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> index,
                  ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> confidence, int threads) {
    const int height = int(cost.shape(0)), width = int(cost.shape(1)), planes = int(cost.shape(2));
    for (int axis = 0; axis < 3; ++axis)
        if (probability.shape(axis) != cost.shape(axis) ||
            (axis < 2 && (index.shape(axis) != cost.shape(axis) || confidence.shape(axis) != cost.shape(axis))))
            throw std::invalid_argument("softmax_peak: shapes do not match");
    if (planes < 1 || window < 0) throw std::invalid_argument("softmax_peak: no plane, or a negative window");
    const float *from = cost.data();
    uint16_t *to = probability.data();
    float *peak = index.data(), *mass = confidence.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        std::vector<float> weight(planes);
        for (int x = 0; x < width; ++x) {
            const size_t pixel = size_t(y) * width + x;
            const float *c = from + pixel * planes, low = least(c, planes);
            const float sum = exponentials(c, low, sharpness, planes, weight.data());
            quantise(weight.data(), 65535.0f / sum, planes, to + pixel * planes);
            const int best = int(std::find(c, c + planes, low) - c);
            float near = 0, moment = 0;
            for (int k = std::max(0, best - window); k <= std::min(planes - 1, best + window); ++k) {
                near += weight[k];
                moment += weight[k] * float(k - best);
            }
            peak[pixel] = float(best) + moment / near;
            mass[pixel] = std::min(1.0f, near / sum);
        }
    });
}

}  // namespace

void register_softmax(nb::module_ &m) {
    m.def("softmax_peak", &softmax_peak, nb::arg("cost").noconvert(), nb::arg("sharpness"), nb::arg("window"),
          nb::arg("probability").noconvert(), nb::arg("index").noconvert(), nb::arg("confidence").noconvert(),
          nb::arg("threads"));
}
