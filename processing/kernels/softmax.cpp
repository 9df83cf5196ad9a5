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

// Loops run over whole groups of lanes, behind the last plane over costs that count for nothing: sums are kept in as
// many parts as there are lanes, whatever the vector width, and added in one order.
constexpr int kLanes = 16;
constexpr int kTile = 8;  // side of the squares that spans are given for

int whole(int planes) { return (planes + kLanes - 1) / kLanes * kLanes; }

LFRIG_CLONES uint16_t least(const uint16_t *__restrict cost, int lanes) {
    uint16_t part[kLanes];
    for (uint16_t &p : part) p = 65535;
    for (int k = 0; k < lanes; k += kLanes)
        for (int j = 0; j < kLanes; ++j) part[j] = cost[k + j] < part[j] ? cost[k + j] : part[j];
    uint16_t low = 65535;
    for (uint16_t p : part) low = p < low ? p : low;
    return low;
}

LFRIG_CLONES uint32_t sum_of(const uint16_t *__restrict cost, int planes) {
    uint32_t sum = 0;
    for (int k = 0; k < planes; ++k) sum += cost[k];
    return sum;
}

// weight[k] = exp((low - cost[k]) * sharpness), 0 behind the last plane; returns their sum.
LFRIG_CLONES float exponentials(const uint16_t *__restrict cost, uint16_t low, float sharpness, int planes, int lanes,
                                float *__restrict weight) {
    float part[kLanes] = {};
    for (int k = 0; k < lanes; k += kLanes)
        for (int j = 0; j < kLanes; ++j) {
            const float w = lfrig::exp_of_minus(float(int(cost[k + j]) - int(low)) * sharpness);
            weight[k + j] = k + j < planes ? w : 0.0f;
            part[j] += weight[k + j];
        }
    for (int j = 0; j < 8; ++j) part[j] += part[j + 8];
    for (int j = 0; j < 4; ++j) part[j] += part[j + 4];
    return (part[0] + part[2]) + (part[1] + part[3]);
}

LFRIG_CLONES void quantise(const float *__restrict weight, float scale, int lanes, uint16_t *__restrict out) {
    for (int k = 0; k < lanes; k += kLanes)
        for (int j = 0; j < kLanes; ++j) out[k + j] = uint16_t(int32_t(weight[k + j] * scale + 0.5f));
}

using Cost = ndarray<const uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Span = ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
template <class T>
using Map = ndarray<T, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// The planes of each tile of 8 x 8 pixels, or all planes.
struct Planes {
    const int16_t *span;  // [ceil(H / 8), ceil(W / 8), 2] or null
    int across, count;

    Planes(const Span &given, int height, int width, int planes)
        : span(given.size() ? given.data() : nullptr), across((width + kTile - 1) / kTile), count(planes) {
        const int down = (height + kTile - 1) / kTile;
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

// A pixel's active costs, and 65535 up to a whole group of lanes.
const uint16_t *padded(const uint16_t *cost, int planes, int lanes, std::vector<uint16_t> &buffer) {
    std::copy(cost, cost + planes, buffer.begin());
    std::fill(buffer.begin() + planes, buffer.begin() + lanes, uint16_t(65535));
    return buffer.data();
}

// volume uint16 [H, W, D]: costs, which probabilities (65535 = 1) take the place of; peak index and mass float32
// [H, W].
void softmax_peak(ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> volume, Span span, float sharpness,
                  int window, Map<float> index, Map<float> confidence, int threads) {
    const size_t height = volume.shape(0), width = volume.shape(1), planes = volume.shape(2);
    if (!same(index, height, width) || !same(confidence, height, width))
        throw std::invalid_argument("softmax_peak: shapes do not match");
    if (planes < 1 || window < 0) throw std::invalid_argument("softmax_peak: no plane, or a negative window");
    const Planes active(span, int(height), int(width), int(planes));
    uint16_t *data = volume.data();
    float *peak = index.data(), *mass = confidence.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(int(height), threads, [&](int y) {
        const int most = whole(int(planes));
        std::vector<float> weight(most);
        std::vector<uint16_t> buffer(most), quantised(most);
        for (int x = 0; x < int(width); ++x) {
            int first, n;
            active.of(y, x, &first, &n);
            const int lanes = whole(n);
            const size_t pixel = size_t(y) * width + x;
            uint16_t *out = data + pixel * planes;
            const uint16_t *c = padded(out + first, n, lanes, buffer);
            const uint16_t low = least(c, lanes);
            const float sum = exponentials(c, low, sharpness, n, lanes, weight.data());
            quantise(weight.data(), 65535.0f / sum, lanes, quantised.data());
            std::fill(out, out + first, uint16_t(0));
            std::copy(quantised.begin(), quantised.begin() + n, out + first);
            std::fill(out + first + n, out + planes, uint16_t(0));
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
    const Planes active(span, int(cost.shape(0)), int(width), int(planes));
    const uint16_t *from = cost.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(int(down), threads, [&](int row) {
        std::vector<uint16_t> buffer(whole(int(planes)));
        for (size_t column = 0; column < across; ++column) {
            int first, n;
            active.of(row * every, int(column) * every, &first, &n);
            const size_t at = size_t(row) * across + column;
            const uint16_t *c = from + (size_t(row) * every * width + column * every) * planes + first;
            c = padded(c, n, whole(n), buffer);
            const uint16_t low = least(c, whole(n));
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
    m.def("softmax_peak", &softmax_peak, nb::arg("volume").noconvert(), nb::arg("span").noconvert(),
          nb::arg("sharpness"), nb::arg("window"), nb::arg("index").noconvert(), nb::arg("confidence").noconvert(),
          nb::arg("threads"));
    m.def("summarise", &summarise, nb::arg("cost").noconvert(), nb::arg("span").noconvert(), nb::arg("every"),
          nb::arg("margin"), nb::arg("lowest").noconvert(), nb::arg("mean").noconvert(), nb::arg("best").noconvert(),
          nb::arg("first_near").noconvert(), nb::arg("past_near").noconvert(), nb::arg("threads"));
}
