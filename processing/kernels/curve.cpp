// A piecewise linear curve, evaluated for every pixel. Twin: curve.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstddef>
#include <stdexcept>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kMost = 256;    // pieces
constexpr int kBlock = 4096;  // values that a thread takes together
constexpr int kTogether = 64;

struct Pieces {
    int count;
    float x[kMost], y[kMost], slope[kMost];  // left ends
};

LFRIG_CLONES void evaluate(const Pieces &pieces, const float *__restrict from, int count, float *__restrict to) {
    for (int first = 0; first < count; first += kTogether) {
        const int n = std::min(kTogether, count - first);
        float value[kTogether] = {};
        int piece[kTogether] = {};
        for (int i = 0; i < n; ++i) value[i] = from[first + i];
        for (int k = 1; k < pieces.count; ++k)
            for (int i = 0; i < kTogether; ++i) piece[i] += value[i] >= pieces.x[k] ? 1 : 0;
        for (int i = 0; i < n; ++i) {
            const int k = piece[i];
            to[first + i] = pieces.y[k] + pieces.slope[k] * (value[i] - pieces.x[k]);
        }
    }
}

using Values = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// values float32 [N]; starts float32 [K, 3]: x, y and slope of each piece's left end; out float32 [N].
void curve(Values values, ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu> starts,
           ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu> out, int threads) {
    const size_t total = values.shape(0);
    if (out.shape(0) != total || starts.shape(0) < 1 || starts.shape(0) > kMost || starts.shape(1) != 3)
        throw std::invalid_argument("curve: shapes do not match");
    Pieces pieces{};
    pieces.count = int(starts.shape(0));
    for (int k = 0; k < pieces.count; ++k) {
        pieces.x[k] = starts.data()[3 * k];
        pieces.y[k] = starts.data()[3 * k + 1];
        pieces.slope[k] = starts.data()[3 * k + 2];
    }
    const float *from = values.data();
    float *to = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(int((total + kBlock - 1) / kBlock), threads, [&](int block) {
        const size_t first = size_t(block) * kBlock;
        evaluate(pieces, from + first, int(std::min(size_t(kBlock), total - first)), to + first);
    });
}

}  // namespace

void register_curve(nb::module_ &m) {
    m.def("curve", &curve, nb::arg("values").noconvert(), nb::arg("starts").noconvert(), nb::arg("out").noconvert(),
          nb::arg("threads"));
}
