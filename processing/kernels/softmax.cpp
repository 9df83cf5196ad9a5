// What costs say: the softmax of semi-global matching's sums with the windowed mean around its peak, and a summary per
// pixel. Twins: softmax.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
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

// Loops run over whole groups of lanes, behind the last plane over costs that count for nothing: sums are kept in as
// many parts as there are lanes, whatever the vector width, and added in one order.
using lfrig::kLanes;
using lfrig::whole_lanes;
constexpr int kTile = 8;  // side of the squares that spans are given for

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

struct Softmax {
    float sharpness;
    int window;           // planes on either side of the peak
    float *index, *mass;  // of all pixels
};

// One pixel after the other to its row of a volume.
class Writer {
  public:
    Writer(const Softmax &settings, uint16_t *volume, int planes)
        : settings_(settings), volume_(volume), planes_(planes), weight_(whole_lanes(planes)),
          quantised_(whole_lanes(planes)) {}

    // `cost` of the planes `first` to `first + count`, 65535 up to whole lanes.
    void write(size_t pixel, const uint16_t *cost, int first, int count) {
        const int lanes = whole_lanes(count), window = settings_.window;
        const float *weight = weight_.data();
        const uint16_t low = least(cost, lanes);
        const float sum = exponentials(cost, low, settings_.sharpness, count, lanes, weight_.data());
        quantise(weight, 65535.0f / sum, lanes, quantised_.data());
        const int best = int(std::find(cost, cost + count, low) - cost);
        float near = 0, moment = 0;
        for (int k = std::max(0, best - window); k <= std::min(count - 1, best + window); ++k) {
            near += weight[k];
            moment += weight[k] * float(k - best);
        }
        uint16_t *out = volume_ + pixel * planes_, *past = out + first + count;
        std::memset(out, 0, sizeof *out * size_t(first));
        std::memcpy(out + first, quantised_.data(), sizeof *out * size_t(count));
        std::memset(past, 0, sizeof *out * size_t(planes_ - first - count));
        settings_.index[pixel] = float(first + best) + moment / near;
        settings_.mass[pixel] = std::min(1.0f, near / sum);
    }

  private:
    const Softmax settings_;
    uint16_t *volume_;
    const int planes_;
    std::vector<float> weight_;
    std::vector<uint16_t> quantised_;
};

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

// Takes sums from semi-global matching and leaves probabilities where the first pass kept its sums.
class Probabilities {
  public:
    Probabilities(const Softmax &settings, const lfrig::SemiGlobal &v, const Planes &active)
        : v_(v), active_(active), buffer_(v.labels), writer_(settings, v.sum, v.labels) {}

    void place(lfrig::Chunk &chunk) { buffer_.place(chunk); }

    void finished(const lfrig::Chunk &chunk) {
        for (int i = 0; i < chunk.count; ++i) {
            const lfrig::Span &span = chunk.span[i];
            const size_t pixel = chunk.first - i;
            if (span.first < span.last) {
                writer_.write(pixel, buffer_.closed(chunk, i) + span.first, span.first, span.last - span.first);
                continue;
            }
            int first, n;  // without any active plane, one is certain
            active_.of(int(pixel / size_t(v_.width)), int(pixel % size_t(v_.width)), &first, &n);
            const uint16_t nothing[kLanes] = {};
            writer_.write(pixel, nothing, first, 1);
        }
    }

  private:
    const lfrig::SemiGlobal &v_;
    const Planes &active_;
    lfrig::SumBuffer buffer_;
    Writer writer_;
};

// out uint16 [H, W, D], probabilities (65535 = 1); peak index and mass float32 [H, W]; the others as for
// `semi_global_of`.
void sgm_softmax(CU3 cost, CU3 penalty, CI3 span, int p1, int cap, float sharpness, int window,
                 ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> out, Map<float> index,
                 Map<float> confidence, int threads) {
    lfrig::SemiGlobal v = semi_global_of(cost, penalty, CI3(), span, p1, cap);
    const size_t height = cost.shape(0), width = cost.shape(1);
    if (out.shape(0) != height || out.shape(1) != width || out.shape(2) != cost.shape(2) ||
        !same(index, height, width) || !same(confidence, height, width))
        throw std::invalid_argument("sgm_softmax: shapes do not match");
    if (window < 0 || !(sharpness >= 0)) throw std::invalid_argument("sgm_softmax: a negative window or sharpness");
    v.sum = out.data();
    const Planes active(span, v.height, v.width, v.labels);
    const Softmax settings{sharpness, window, index.data(), confidence.data()};
    nb::gil_scoped_release release;
    lfrig::aggregate(v, threads, [&] { return Probabilities(settings, v, active); });
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
        std::vector<uint16_t> buffer(whole_lanes(int(planes)));
        for (size_t column = 0; column < across; ++column) {
            int first, n;
            active.of(row * every, int(column) * every, &first, &n);
            const size_t at = size_t(row) * across + column;
            const uint16_t *c = from + (size_t(row) * every * width + column * every) * planes + first;
            c = padded(c, n, whole_lanes(n), buffer);
            const uint16_t low = least(c, whole_lanes(n));
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
    m.def("sgm_softmax", &sgm_softmax, nb::arg("cost").noconvert(), nb::arg("penalty").noconvert(),
          nb::arg("span").noconvert(), nb::arg("p1"), nb::arg("cap"), nb::arg("sharpness"), nb::arg("window"),
          nb::arg("out").noconvert(), nb::arg("index").noconvert(), nb::arg("confidence").noconvert(),
          nb::arg("threads"));
    m.def("summarise", &summarise, nb::arg("cost").noconvert(), nb::arg("span").noconvert(), nb::arg("every"),
          nb::arg("margin"), nb::arg("lowest").noconvert(), nb::arg("mean").noconvert(), nb::arg("best").noconvert(),
          nb::arg("first_near").noconvert(), nb::arg("past_near").noconvert(), nb::arg("threads"));
}
