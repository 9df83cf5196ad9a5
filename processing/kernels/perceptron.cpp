// A small multilayer perceptron, evaluated for every pixel. Twin: perceptron.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstddef>
#include <stdexcept>
#include <utility>
#include <vector>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kBlock = 64;  // pixels that go through together
constexpr int kMost = 256;  // units of a layer

struct Layer {
    int outputs, inputs;
    const float *weight, *bias;  // [outputs, inputs], [outputs]
};

// One layer: `in` [inputs, kBlock] to `out` [outputs, kBlock]; negative sums are scaled by `leak`.
LFRIG_CLONES void apply(const Layer &layer, float leak, const float *__restrict in, float *__restrict out) {
    for (int o = 0; o < layer.outputs; ++o) {
        float *__restrict sum = out + o * kBlock;
        const float *weight = layer.weight + size_t(o) * layer.inputs;
        for (int i = 0; i < kBlock; ++i) sum[i] = layer.bias[o];
        int n = 0;
        for (; n + 4 <= layer.inputs; n += 4) {
            const float a = weight[n], b = weight[n + 1], c = weight[n + 2], d = weight[n + 3];
            const float *v = in + n * kBlock;
            for (int i = 0; i < kBlock; ++i)
                sum[i] += (a * v[i] + b * v[kBlock + i]) + (c * v[2 * kBlock + i] + d * v[3 * kBlock + i]);
        }
        for (; n < layer.inputs; ++n)
            for (int i = 0; i < kBlock; ++i) sum[i] += weight[n] * in[n * kBlock + i];
        for (int i = 0; i < kBlock; ++i) {
            const float scaled = leak * sum[i];
            sum[i] = sum[i] > scaled ? sum[i] : scaled;
        }
    }
}

LFRIG_CLONES void standardise(const float *__restrict from, float mean, float per_spread, float limit, int count,
                              float *__restrict to) {
    for (int i = 0; i < count; ++i) {
        const float v = (from[i] - mean) * per_spread;
        to[i] = v > -limit ? (v < limit ? v : limit) : -limit;
    }
}

using F1 = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// features: F maps float32 [N]; mean, spread float32 [F]; weights [out, in] and biases [out] of the layers, the last
// one's output is 1; out float32 [N]. See perceptron.py.
void perceptron(const std::vector<F1> &features, F1 mean, F1 spread, const std::vector<F2> &weights,
                const std::vector<F1> &biases, float limit, float leak,
                ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu> out, int threads) {
    const size_t inputs = features.size(), total = out.shape(0);
    if (inputs < 1 || inputs > kMost || mean.shape(0) != inputs || spread.shape(0) != inputs || weights.empty() ||
        weights.size() != biases.size())
        throw std::invalid_argument("perceptron: shapes do not match");
    std::vector<const float *> maps;
    for (const F1 &feature : features) {
        if (feature.shape(0) != total) throw std::invalid_argument("perceptron: features differ in size");
        maps.push_back(feature.data());
    }
    std::vector<Layer> layers;
    size_t units = inputs;
    for (size_t n = 0; n < weights.size(); ++n) {
        if (weights[n].shape(1) != units || weights[n].shape(0) != biases[n].shape(0) || weights[n].shape(0) > kMost)
            throw std::invalid_argument("perceptron: layers do not fit");
        units = weights[n].shape(0);
        layers.push_back({int(units), int(weights[n].shape(1)), weights[n].data(), biases[n].data()});
    }
    if (units != 1) throw std::invalid_argument("perceptron: the last layer has one output");
    const float *means = mean.data(), *spreads = spread.data();
    float *to = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(int((total + kBlock - 1) / kBlock), threads, [&](int block) {
        alignas(64) static thread_local float buffers[2][kMost * kBlock];
        float *in = buffers[0], *result = buffers[1];
        const size_t first = size_t(block) * kBlock;
        const int count = int(std::min(size_t(kBlock), total - first));
        for (size_t n = 0; n < inputs; ++n) {
            standardise(maps[n] + first, means[n], 1.0f / spreads[n], limit, count, in + n * kBlock);
            std::fill(in + n * kBlock + count, in + (n + 1) * kBlock, 0.0f);
        }
        for (size_t n = 0; n < layers.size(); ++n) {
            apply(layers[n], n + 1 < layers.size() ? leak : 1.0f, in, result);
            std::swap(in, result);
        }
        std::copy(in, in + count, to + first);
    });
}

}  // namespace

void register_perceptron(nb::module_ &m) {
    m.def("perceptron", &perceptron, nb::arg("features"), nb::arg("mean").noconvert(), nb::arg("spread").noconvert(),
          nb::arg("weights"), nb::arg("biases"), nb::arg("limit"), nb::arg("leak"), nb::arg("out").noconvert(),
          nb::arg("threads"));
}
