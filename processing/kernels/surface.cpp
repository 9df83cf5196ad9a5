// Log evidence → costs; semi-global matching with the surface read from each pixel's sums as they are
// finished, so that they are never written back. Twin: surface.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cfloat>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "lfrig/exponential.hpp"
#include "lfrig/labels.hpp"
#include "lfrig/parallel.hpp"
#include "parts/sgm_arrays.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

using lfrig::kLanes;

LFRIG_CLONES float greatest(const float *__restrict evidence, int planes) {
    float part[kLanes];
    for (float &p : part) p = -FLT_MAX;
    int k = 0;
    for (; k + kLanes <= planes; k += kLanes)
        for (int j = 0; j < kLanes; ++j) part[j] = evidence[k + j] > part[j] ? evidence[k + j] : part[j];
    float top = part[0];
    for (int j = 1; j < kLanes; ++j) top = part[j] > top ? part[j] : top;
    for (; k < planes; ++k) top = evidence[k] > top ? evidence[k] : top;
    return top;
}

// How far the evidence is below its top, rounded; what is not a number counts as the cap.
LFRIG_CLONES void cost_of(const float *__restrict evidence, float top, float unit, float cap, int planes,
                          uint16_t *__restrict cost) {
    for (int k = 0; k < planes; ++k) {
        const float below = (top - evidence[k]) * unit;
        cost[k] = uint16_t(int32_t((below < cap ? below : cap) + 0.5f));
    }
}

// evidence float32 [H, W, N]; cost uint16 [H, W, N]; `cap` in units of the cost.
void evidence_cost(ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu> evidence, float unit, float cap,
                   ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> cost, int threads) {
    const int height = int(evidence.shape(0)), width = int(evidence.shape(1)), planes = int(evidence.shape(2));
    for (int axis = 0; axis < 3; ++axis)
        if (cost.shape(axis) != evidence.shape(axis))
            throw std::invalid_argument("evidence_cost: shapes do not match");
    if (!(unit > 0 && cap >= 0 && cap < 65535)) throw std::invalid_argument("evidence_cost: the cap does not fit");
    const float *from = evidence.data();
    uint16_t *to = cost.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        for (size_t p = size_t(y) * width; p < size_t(y + 1) * width; ++p) {
            const float *pixel = from + p * planes;
            cost_of(pixel, greatest(pixel, planes), unit, cap, planes, to + p * planes);
        }
    });
}

struct Regression {
    float sharpness;  // log evidence per unit of the sums
    int window;       // labels on either side of the peak
    bool all_labels;  // the mean is over all of them instead
    float *index, *peak;
};

// Sum of kLanes values in pairs: one order for every vector width.
LFRIG_INLINE float sum_of_lanes(float *part) {
    for (int j = 0; j < 8; ++j) part[j] += part[j + 8];
    for (int j = 0; j < 4; ++j) part[j] += part[j + 4];
    return (part[0] + part[2]) + (part[1] + part[3]);
}

// weight[k] = exp((low - sum[k]) * sharpness), 0 where inactive.
LFRIG_INLINE void weights_of(const uint16_t *__restrict sum, int low, float sharpness, int count,
                             float *__restrict weight) {
    for (int k = 0; k < count; ++k) {
        const float w = lfrig::exp_of_minus(float(int32_t(sum[k]) - low) * sharpness);
        weight[k] = sum[k] == lfrig::kInactive ? 0.0f : w;
    }
}

struct Mean {
    float label, mass;
};

// Mean label and mass near the peak of `count` sums; what follows them up to whole kLanes is inactive. `weight` has
// room for a window and kLanes on either side, and zeros before it.
LFRIG_CLONES Mean mean_near_peak(const uint16_t *__restrict sum, int count, const Regression &settings,
                                 float *__restrict weight) {
    const int padded = lfrig::whole_lanes(count), reach = settings.window + 1;
    const int best = lfrig::first_least(sum, padded);
    weights_of(sum, sum[best], settings.sharpness, padded, weight);
    float whole[kLanes] = {}, moments[kLanes] = {};
    for (int k = 0; k < padded; k += kLanes)
        for (int j = 0; j < kLanes; ++j) whole[j] += weight[k + j];
    const float total = sum_of_lanes(whole);
    std::memset(weight + padded, 0, sizeof(float) * size_t(reach + kLanes));
    const float top = lfrig::parabola(sum, best, count), end = float(settings.window) + 0.5f;
    float part[kLanes] = {}, first[kLanes] = {};
    for (int k = -reach; k <= reach; k += kLanes)
        for (int j = 0; j < kLanes; ++j) {
            const float away = std::abs(float(k + j) - top);
            const float share = end - away < 0.0f ? 0.0f : end - away > 1.0f ? 1.0f : end - away;
            const float held = share * weight[best + k + j];
            part[j] += held;
            first[j] += held * float(k + j);
        }
    const float near = sum_of_lanes(part), near_moment = sum_of_lanes(first);
    const float mass = std::min(1.0f, near / total);
    if (!settings.all_labels) return {float(best) + near_moment / std::max(near, 1e-20f), mass};
    for (int k = 0; k < padded; k += kLanes)
        for (int j = 0; j < kLanes; ++j) moments[j] += weight[k + j] * float(k + j);
    return {sum_of_lanes(moments) / total, mass};
}

// Takes sums and leaves each pixel's mean label and the share of its mass near the peak.
class Regress {
  public:
    Regress(const Regression &settings, int labels)
        : settings_(settings), buffer_(labels), weight_(labels + 4 * (settings.window + 1 + kLanes)) {}

    void place(lfrig::Chunk &chunk) { buffer_.place(chunk); }

    void finished(const lfrig::Chunk &chunk) {
        for (int i = 0; i < chunk.count; ++i) {
            const lfrig::Span &span = chunk.span[i];
            Mean mean{0, 0};
            if (span.first < span.last) {
                const uint16_t *sum = buffer_.closed(chunk, i) + span.first;
                mean = mean_near_peak(sum, span.last - span.first, settings_, weight_.data() + settings_.window + 1);
                mean.label += float(span.first);
            }
            settings_.index[chunk.first - i] = mean.label;
            settings_.peak[chunk.first - i] = mean.mass;
        }
    }

  private:
    const Regression settings_;
    lfrig::SumBuffer buffer_;
    std::vector<float> weight_;
};

// scratch uint16 [H, W, D]; index, peak float32 [H, W]; the others as for `semi_global_of`.
void sgm_surface(CU3 cost, CU3 penalty, CI3 span, int p1, int cap, float sharpness, int window, bool all_labels,
                 ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> scratch,
                 ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> index,
                 ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> peak, int threads) {
    lfrig::SemiGlobal v = semi_global_of(cost, penalty, CI3(), span, p1, cap);
    for (int axis = 0; axis < 3; ++axis)
        if (scratch.shape(axis) != cost.shape(axis) ||
            (axis < 2 && (index.shape(axis) != cost.shape(axis) || peak.shape(axis) != cost.shape(axis))))
            throw std::invalid_argument("sgm_surface: shapes do not match");
    if (window < 0 || !(sharpness >= 0)) throw std::invalid_argument("sgm_surface: a negative window or sharpness");
    v.sum = scratch.data();
    const Regression settings{sharpness, window, all_labels, index.data(), peak.data()};
    nb::gil_scoped_release release;
    lfrig::aggregate(v, threads, [&] { return Regress(settings, v.labels); });
}

}  // namespace

void register_surface(nb::module_ &m) {
    m.def("evidence_cost", &evidence_cost, nb::arg("evidence").noconvert(), nb::arg("unit"), nb::arg("cap"),
          nb::arg("cost").noconvert(), nb::arg("threads"));
    m.def("sgm_surface", &sgm_surface, nb::arg("cost").noconvert(), nb::arg("penalty").noconvert(),
          nb::arg("span").noconvert(), nb::arg("p1"), nb::arg("cap"), nb::arg("sharpness"), nb::arg("window"),
          nb::arg("all_labels"), nb::arg("scratch").noconvert(), nb::arg("index").noconvert(),
          nb::arg("peak").noconvert(), nb::arg("threads"));
}
