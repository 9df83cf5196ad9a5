// Means over windows, of neighbours on the pixel's own layer. Twin: layer_mean.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "lfrig/exponential.hpp"
#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

LFRIG_CLONES void add_neighbours(const float *__restrict values, const float *__restrict layer,
                                 const float *__restrict own, float per_sigma, int width, float *__restrict total,
                                 float *__restrict mass) {
    for (int x = 0; x < width; ++x) {
        const float away = (layer[x] - own[x]) * per_sigma;
        const float weight = lfrig::exp_of_minus(away * away);
        total[x] += weight * values[x];
        mass[x] += weight;
    }
}

using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// values, layer float32 [H, W]; out float32 [H, W]. See layer_mean.py.
void layer_mean(F2 values, F2 layer, float sigma, int reach, int stride,
                ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> out, int threads) {
    const int height = int(values.shape(0)), width = int(values.shape(1));
    if (layer.size() != values.size() || out.size() != values.size() || values.size() < 1 || reach < 0 || stride < 1)
        throw std::invalid_argument("layer_mean: shapes do not match");
    const size_t wide = size_t(width) + 2 * size_t(reach);
    const float *from[2] = {values.data(), layer.data()};
    float *to = out.data();
    nb::gil_scoped_release release;
    // Lines go on beyond their ends as they are there.
    std::vector<float> padded[2];
    for (int n = 0; n < 2; ++n) {
        padded[n].resize(size_t(height) * wide);
        for (int y = 0; y < height; ++y)
            for (int x = -reach; x < width + reach; ++x)
                padded[n][size_t(y) * wide + size_t(x + reach)] =
                    from[n][size_t(y) * size_t(width) + size_t(std::clamp(x, 0, width - 1))];
    }
    lfrig::parallel_for(height, threads, [&](int y) {
        std::vector<float> mass(size_t(width), 0.0f);
        float *total = to + size_t(y) * size_t(width);
        std::fill(total, total + width, 0.0f);
        for (int dy = -reach; dy <= reach; dy += stride) {
            const size_t line = size_t(std::clamp(y + dy, 0, height - 1)) * wide;
            for (int dx = 0; dx <= 2 * reach; dx += stride)
                add_neighbours(padded[0].data() + line + dx, padded[1].data() + line + dx,
                               from[1] + size_t(y) * size_t(width), 1.0f / sigma, width, total, mass.data());
        }
        for (int x = 0; x < width; ++x) total[x] /= mass[size_t(x)] > 1e-6f ? mass[size_t(x)] : 1e-6f;
    });
}

}  // namespace

void register_layer_mean(nb::module_ &m) {
    m.def("layer_mean", &layer_mean, nb::arg("values").noconvert(), nb::arg("layer").noconvert(), nb::arg("sigma"),
          nb::arg("reach"), nb::arg("stride"), nb::arg("out").noconvert(), nb::arg("threads"));
}
