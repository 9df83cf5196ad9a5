// Which of two depths the sources' colours speak for, at chosen pixels. Twin: edge_cost.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"
#include "parts/ways.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

struct View {
    Way way;
    const float *picture;  // [map_height, map_width, 3] in the photo's tone
};

struct Rules {
    float cap, contradiction, contradiction_px, margin_px;
};

inline float between(float t, float lo, float hi) { return t < lo ? lo : (t > hi ? hi : t); }

// Adds one hypothesis' costs in one source for the chosen pixels of a line: `total` what it shows there, `mass` how far
// it sees the points.
LFRIG_CLONES void look(const View &view, const Rules &r, const float *__restrict photo, const float *__restrict xs,
                       float y, const float *__restrict inverse_depth, int count, float *__restrict total,
                       float *__restrict mass) {
    const Way way = view.way;
    const int width = way.map_width;
    const float right = float(width) - 1.001f, bottom = float(way.map_height) - 1.001f;
    const float *__restrict picture = view.picture;
#pragma GCC ivdep  // what is written is not read
    for (int i = 0; i < count; ++i) {
        const Spot spot = land(way, xs[i], y, inverse_depth[i]);
        const float before = ahead(way, spot);
        const float hidden = (before - r.margin_px) / (0.5f * r.margin_px);
        const float seen = between(1.0f - hidden, 0.0f, 1.0f) * float(spot.inside);
        const float floats = between((-before - r.contradiction_px) / (0.5f * r.contradiction_px), 0.0f, 1.0f);
        const float u = between(spot.u, 0.0f, right), v = between(spot.v, 0.0f, bottom);
        const int iu = int(u), iv = int(v), p = 3 * (iv * width + iu);
        const float fu = u - float(iu), fv = v - float(iv);
        float off = 0;
        for (int c = 0; c < 3; ++c) {
            const float *at = picture + p + c;
            const float top = at[0] + fu * (at[3] - at[0]), low = at[3 * width] + fu * (at[3 * width + 3] - at[3 * width]);
            off += std::fabs(photo[3 * i + c] - (top + fv * (low - top)));
        }
        const float cost = off * (1.0f / 3.0f) + r.contradiction * floats;
        total[i] += seen * (cost < r.cap ? cost : r.cap);
        mass[i] += seen;
    }
}

using F3 = ndarray<const float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using U2 = ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// near, far float32 [H, W]; at uint8 [H, W]; photo float32 [H, W, 3]; pictures float32 [Hs, Ws, 3] of the sources; out
// float32 [H, W]. See edge_cost.py.
void edge_cost(Grid near_depth, Grid far_depth, U2 at, F3 photo, const std::vector<F3> &pictures,
               const Maps &disparity, const Flats &numbers, float cap, float contradiction, float contradiction_px,
               float margin_px,
               ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> out, int threads) {
    const int height = int(near_depth.shape(0)), width = int(near_depth.shape(1));
    const size_t area = size_t(height) * size_t(width);
    const std::vector<Way> ways = ways_of(disparity, numbers);
    if (far_depth.size() != area || at.size() != area || photo.size() != 3 * area || out.size() != area ||
        pictures.size() != ways.size())
        throw std::invalid_argument("edge_cost: shapes do not match");
    std::vector<View> views;
    for (size_t n = 0; n < ways.size(); ++n) {
        const Way &way = ways[n];
        if (way.map_height < 2 || way.map_width < 2 || pictures[n].shape(2) != 3 ||
            int(pictures[n].shape(0)) != way.map_height || int(pictures[n].shape(1)) != way.map_width)
            throw std::invalid_argument("edge_cost: a picture is not of its disparity map's size");
        views.push_back({way, pictures[n].data()});
    }
    const Rules rules{cap, contradiction, contradiction_px, margin_px};
    const float *hypotheses[2] = {near_depth.data(), far_depth.data()}, *colour = photo.data();
    const uint8_t *wanted = at.data();
    float *to = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        const size_t line = size_t(y) * size_t(width);
        std::fill(to + line, to + line + width, 0.0f);
        std::vector<float> xs, own;
        for (int x = 0; x < width; ++x)
            if (wanted[line + x]) {
                xs.push_back(float(x));
                own.insert(own.end(), colour + 3 * (line + x), colour + 3 * (line + x + 1));
            }
        std::vector<float> depth(xs.size()), total(xs.size()), mass(xs.size());
        for (int k = 0; k < 2; ++k) {
            for (size_t i = 0; i < xs.size(); ++i) depth[i] = hypotheses[k][line + size_t(xs[i])];
            std::fill(total.begin(), total.end(), 0.0f);
            std::fill(mass.begin(), mass.end(), 0.0f);
            for (const View &view : views)
                look(view, rules, own.data(), xs.data(), float(y), depth.data(), int(xs.size()), total.data(),
                     mass.data());
            for (size_t i = 0; i < xs.size(); ++i) {
                // Where nobody looks, nothing speaks for or against.
                const float cost = mass[i] > 0.05f ? total[i] / mass[i] : 0.5f * cap;
                to[line + size_t(xs[i])] += k ? cost : -cost;
            }
        }
    });
}

}  // namespace

void register_edge_cost(nb::module_ &m) {
    m.def("edge_cost", &edge_cost, nb::arg("near_depth").noconvert(), nb::arg("far_depth").noconvert(),
          nb::arg("at").noconvert(), nb::arg("photo").noconvert(), nb::arg("pictures"), nb::arg("disparity"),
          nb::arg("numbers"), nb::arg("cap"), nb::arg("contradiction"),
          nb::arg("contradiction_px"), nb::arg("margin_px"), nb::arg("out").noconvert(), nb::arg("threads"));
}
