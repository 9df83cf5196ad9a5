// Pixels that disagree with the weighted median of their neighbourhood take a neighbour's value. Twin: edge_snap.py.
//
// Whether a pixel disagrees needs no median: it does when more than half of the weight lies beyond the threshold on one
// side. Only those that do are sorted.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "lfrig/exponential.hpp"
#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kRun = 64;

struct Picture {
    int height, width, radius, search;
    size_t wide, area;          // of the padded planes
    std::vector<float> padded;  // value, red, green, blue: [4, H + 2 radius, W + 2 radius]; values around it are NaN
    float per_square, threshold, per_step;

    const float *at(int y, int x) const { return padded.data() + size_t(y + radius) * wide + size_t(x + radius); }
};

// Squared distance of two colours -> weight.
inline float weight_of(float red, float green, float blue, float per_square) {
    return lfrig::exp_of_minus((red * red + green * green + blue * blue) * per_square);
}

// How the weight around the pixels of a run is divided: below their value by more than the threshold, above, in all.
LFRIG_CLONES void weigh(const float *own, const float *other, size_t area, int width, float per_square,
                        float threshold, float *__restrict below, float *__restrict above, float *__restrict all) {
    for (int i = 0; i < width; ++i) {
        const float q = weight_of(other[area + i] - own[area + i], other[2 * area + i] - own[2 * area + i],
                                  other[3 * area + i] - own[3 * area + i], per_square);
        const float off = other[i] - own[i];
        all[i] += off == off ? q : 0.0f;
        below[i] += off < -threshold ? q : 0.0f;
        above[i] += off > threshold ? q : 0.0f;
    }
}

float weighted_median(const Picture &s, int y, int x, std::vector<std::pair<float, float>> &sorted) {
    const float *own = s.at(y, x);
    sorted.clear();
    float half = 0;
    for (int dy = -s.radius; dy <= s.radius; ++dy)
        for (int dx = -s.radius; dx <= s.radius; ++dx) {
            const float *other = own + ptrdiff_t(dy) * ptrdiff_t(s.wide) + dx;
            if (!(other[0] == other[0])) continue;
            const float q = weight_of(other[s.area] - own[s.area], other[2 * s.area] - own[2 * s.area],
                                      other[3 * s.area] - own[3 * s.area], s.per_square);
            sorted.emplace_back(other[0], q);
            half += 0.5f * q;
        }
    std::sort(sorted.begin(), sorted.end());
    float passed = 0;
    for (const auto &[value, q] : sorted)
        if ((passed += q) >= half) return value;
    return sorted.back().first;
}

// The value around (y, x) that is nearest to `wanted`; distance counts a little.
float nearest_value(const Picture &s, const float *values, int y, int x, float wanted) {
    float best = wanted, least = std::numeric_limits<float>::infinity();
    for (int dy = -s.search; dy <= s.search; ++dy)
        for (int dx = -s.search; dx <= s.search; ++dx) {
            const int v = std::min(std::max(y + dy, 0), s.height - 1), u = std::min(std::max(x + dx, 0), s.width - 1);
            const float value = values[size_t(v) * s.width + u];
            const float off = std::fabs(value - wanted) + s.per_step * float(std::abs(dx) + std::abs(dy));
            if (off < least) best = value, least = off;
        }
    return best;
}

void snap_run(const Picture &s, const float *values, int y, int x, int width, float *out) {
    alignas(64) float below[kRun] = {0}, above[kRun] = {0}, all[kRun] = {0};
    const float *own = s.at(y, x);
    for (int dy = -s.radius; dy <= s.radius; ++dy)
        for (int dx = -s.radius; dx <= s.radius; ++dx)
            weigh(own, own + ptrdiff_t(dy) * ptrdiff_t(s.wide) + dx, s.area, width, s.per_square, s.threshold, below,
                  above, all);
    std::vector<std::pair<float, float>> sorted;
    for (int i = 0; i < width; ++i)
        if (std::max(below[i], above[i]) > 0.5f * all[i])
            out[i] = nearest_value(s, values, y, x + i, weighted_median(s, y, x + i, sorted));
}

using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using U2 = ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using U3 = ndarray<const uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// at uint8 [H, W]: pixels that may need it; see edge_snap.py.
void edge_snap(F2 values, U3 guide, U2 at, int radius, int search, float sigma_grey, float threshold, float per_step,
               ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> out, int threads) {
    Picture s{};
    s.height = int(values.shape(0)), s.width = int(values.shape(1)), s.radius = radius, s.search = search;
    const size_t pixels = size_t(s.height) * s.width;
    if (guide.size() != 3 * pixels || at.size() != pixels || out.size() != pixels || radius < 1 || search < 0)
        throw std::invalid_argument("edge_snap: shapes do not match");
    s.per_square = 0.5f / (sigma_grey * sigma_grey), s.threshold = threshold, s.per_step = per_step;
    s.wide = size_t(s.width) + 2 * radius, s.area = s.wide * (size_t(s.height) + 2 * radius);
    const float *from = values.data();
    const uint8_t *colour = guide.data(), *wanted = at.data();
    float *to = out.data();
    nb::gil_scoped_release release;
    s.padded.assign(4 * s.area, 0.0f);
    std::fill(s.padded.begin(), s.padded.begin() + ptrdiff_t(s.area), std::numeric_limits<float>::quiet_NaN());
    for (int y = 0; y < s.height; ++y) {
        float *line = s.padded.data() + size_t(y + radius) * s.wide + size_t(radius);
        const size_t first = size_t(y) * s.width;
        std::copy(from + first, from + first + s.width, line);
        for (int c = 0; c < 3; ++c)
            for (int x = 0; x < s.width; ++x) line[(1 + c) * s.area + x] = float(colour[3 * (first + x) + c]);
    }
    lfrig::parallel_for(s.height, threads, [&](int y) {
        const size_t first = size_t(y) * s.width;
        std::copy(from + first, from + first + s.width, to + first);
        for (int x = 0; x < s.width; x += kRun) {
            const int width = std::min(kRun, s.width - x);
            if (std::any_of(wanted + first + x, wanted + first + x + width, [](uint8_t w) { return w != 0; }))
                snap_run(s, from, y, x, width, to + first + x);
        }
    });
}

}  // namespace

void register_edge_snap(nb::module_ &m) {
    m.def("edge_snap", &edge_snap, nb::arg("values").noconvert(), nb::arg("guide").noconvert(),
          nb::arg("at").noconvert(), nb::arg("radius"), nb::arg("search"), nb::arg("sigma_grey"), nb::arg("threshold"),
          nb::arg("per_step"), nb::arg("out").noconvert(), nb::arg("threads"));
}
