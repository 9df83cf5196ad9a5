// What a volume of aggregated costs says: its softmax with the windowed mean around the peak, and a summary of it per
// pixel. Twins: softmax.py.
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
constexpr int kTile = 8;    // side of the squares that spans are given for

LFRIG_CLONES uint16_t least(const uint16_t *__restrict cost, int planes) {
    uint16_t low = 65535;
    for (int k = 0; k < planes; ++k) low = cost[k] < low ? cost[k] : low;
    return low;
}

LFRIG_CLONES uint32_t sum_of(const uint16_t *__restrict cost, int planes) {
    uint32_t sum = 0;
    for (int k = 0; k < planes; ++k) sum += cost[k];
    return sum;
}

// weight[k] = exp((low - cost[k]) * sharpness); returns their sum.
LFRIG_CLONES float exponentials(const uint16_t *__restrict cost, uint16_t low, float sharpness, int planes,
                                float *__restrict weight) {
    float part[kLanes] = {};
    int k = 0;
    for (; k + kLanes <= planes; k += kLanes)
        for (int j = 0; j < kLanes; ++j) {
            const float w = lfrig::exp_of_minus(float(int(cost[k + j]) - int(low)) * sharpness);
            weight[k + j] = w;
            part[j] += w;
        }
    float sum = 0;
    for (float p : part) sum += p;
    for (; k < planes; ++k) sum += weight[k] = lfrig::exp_of_minus(float(int(cost[k]) - int(low)) * sharpness);
    return sum;
}

LFRIG_CLONES void quantise(const float *__restrict weight, float scale, int planes, uint16_t *__restrict out) {
    for (int k = 0; k < planes; ++k) out[k] = uint16_t(int32_t(weight[k] * scale + 0.5f));
}

using Cost = ndarray<const uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Span = ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
template <class T>
using Map = ndarray<T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// The planes of each tile of 8 x 8 pixels, or all planes.
struct Planes {
    const int16_t *span;  // [ceil(H / 8), ceil(W / 8), 2] or null
    int across, count;

    Planes(const Span &given, const Cost &cost)
        : span(given.size() ? given.data() : nullptr),
          across((int(cost.shape(1)) + kTile - 1) / kTile),
          count(int(cost.shape(2))) {
        const int down = (int(cost.shape(0)) + kTile - 1) / kTile;
        if (span && (int(given.shape(0)) != down || int(given.shape(1)) != across || given.shape(2) != 2))
            throw std::invalid_argument("the span does not match the volume");
    }

    // First plane and number of planes of a pixel; at least one.
    void of(int y, int x, int *first, int *planes) const {
        *first = 0;
        *planes = count;
        if (!span) return;
        const int16_t *s = span + 2 * (size_t(y / kTile) * across + x / kTile);
        *first = std::min(std::max(int(s[0]), 0), count - 1);
        *planes = std::max(1, std::min(int(s[1]), count) - *first);
    }
};

template <class A>
bool same(const A &map, size_t height, size_t width) {
    return map.shape(0) == height && map.shape(1) == width;
}

// cost uint16 [H, W, D]; probability uint16 [H, W, D] (65535 = 1), peak index and mass float32 [H, W].
void softmax_peak(Cost cost, Span span, float sharpness, int window,
                  ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> probability, Map<float> index,
                  Map<float> confidence, int threads) {
    const size_t height = cost.shape(0), width = cost.shape(1), planes = cost.shape(2);
    if (!same(probability, height, width) || probability.shape(2) != planes || !same(index, height, width) ||
        !same(confidence, height, width))
        throw std::invalid_argument("softmax_peak: shapes do not match");
    if (planes < 1 || window < 0) throw std::invalid_argument("softmax_peak: no plane, or a negative window");
    const Planes active(span, cost);
    const uint16_t *from = cost.data();
    uint16_t *to = probability.data();
    float *peak = index.data(), *mass = confidence.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(int(height), threads, [&](int y) {
        std::vector<float> weight(planes);
        for (int x = 0; x < int(width); ++x) {
            int first, n;
            active.of(y, x, &first, &n);
            const size_t pixel = size_t(y) * width + x;
            const uint16_t *c = from + pixel * planes + first;
            const uint16_t low = least(c, n);
            const float sum = exponentials(c, low, sharpness, n, weight.data());
            quantise(weight.data(), 65535.0f / sum, n, to + pixel * planes + first);
            const int best = int(std::find(c, c + n, low) - c);
            float near = 0, moment = 0;
            for (int k = std::max(0, best - window); k <= std::min(n - 1, best + window); ++k) {
                near += weight[k];
                moment += weight[k] * float(k - best);
            }
            peak[pixel] = float(first + best) + moment / near;
            mass[pixel] = std::min(1.0f, near / sum);
        }
    });
}

// Per pixel of every `every`-th row and column: lowest and mean cost uint16 [h, w]; best, and first and one past last
// plane within `margin` of the lowest, int16 [h, w].
void summarise(Cost cost, Span span, int every, int margin, Map<uint16_t> lowest, Map<uint16_t> mean,
               Map<int16_t> best, Map<int16_t> first_near, Map<int16_t> past_near, int threads) {
    const size_t planes = cost.shape(2), width = cost.shape(1), down = lowest.shape(0), across = lowest.shape(1);
    if (every < 1 || down != (cost.shape(0) + every - 1) / every || across != (width + every - 1) / every ||
        !same(mean, down, across) || !same(best, down, across) || !same(first_near, down, across) ||
        !same(past_near, down, across) || planes < 1)
        throw std::invalid_argument("summarise: shapes do not match");
    const Planes active(span, cost);
    const uint16_t *from = cost.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(int(down), threads, [&](int row) {
        for (size_t column = 0; column < across; ++column) {
            int first, n;
            active.of(row * every, int(column) * every, &first, &n);
            const size_t at = size_t(row) * across + column;
            const uint16_t *c = from + (size_t(row) * every * width + column * every) * planes + first;
            const uint16_t low = least(c, n);
            const int limit = int(low) + margin;
            int a = 0, b = n - 1;
            while (c[a] > limit) ++a;
            while (c[b] > limit) --b;
            lowest.data()[at] = low;
            mean.data()[at] = uint16_t((sum_of(c, n) + unsigned(n) / 2) / unsigned(n));
            best.data()[at] = int16_t(first + (std::find(c + a, c + b, low) - c));
            first_near.data()[at] = int16_t(first + a);
            past_near.data()[at] = int16_t(first + b + 1);
        }
    });
}

}  // namespace

void register_softmax(nb::module_ &m) {
    m.def("softmax_peak", &softmax_peak, nb::arg("cost").noconvert(), nb::arg("span").noconvert(),
          nb::arg("sharpness"), nb::arg("window"), nb::arg("probability").noconvert(), nb::arg("index").noconvert(),
          nb::arg("confidence").noconvert(), nb::arg("threads"));
    m.def("summarise", &summarise, nb::arg("cost").noconvert(), nb::arg("span").noconvert(), nb::arg("every"),
          nb::arg("margin"), nb::arg("lowest").noconvert(), nb::arg("mean").noconvert(), nb::arg("best").noconvert(),
          nb::arg("first_near").noconvert(), nb::arg("past_near").noconvert(), nb::arg("threads"));
}
