// Carries a surface into a source: where its points lie there, and whether the source's own surface hides them.
// Twin: landing.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <stdexcept>

#include "lfrig/parallel.hpp"
#include "parts/ways.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

LFRIG_CLONES void land_line(const Way &into, const float *__restrict inverse_depth, int y, int width,
                            float *__restrict u, float *__restrict v, float *__restrict before,
                            uint8_t *__restrict inside) {
    const Way way = into;
#pragma GCC ivdep  // what is written is not read
    for (int x = 0; x < width; ++x) {
        const Spot spot = land(way, float(x), float(y), inverse_depth[x]);
        u[x] = spot.u;
        v[x] = spot.v;
        inside[x] = uint8_t(spot.inside);
        before[x] = ahead(way, spot);
    }
}

using O2 = ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// See landing.py; inside uint8 [H, W].
void landing(Grid inverse_depth, const Maps &disparity, const Flats &numbers, O2 u, O2 v, O2 before,
             ndarray<uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu> inside, int threads) {
    const int height = int(inverse_depth.shape(0)), width = int(inverse_depth.shape(1));
    const size_t area = size_t(height) * size_t(width);
    const std::vector<Way> ways = ways_of(disparity, numbers);
    if (ways.size() != 1 || u.size() != area || v.size() != area || before.size() != area || inside.size() != area)
        throw std::invalid_argument("landing: shapes do not match");
    const Way &way = ways[0];
    const float *from = inverse_depth.data();
    float *to_u = u.data(), *to_v = v.data(), *to_before = before.data();
    uint8_t *to_inside = inside.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        const size_t at = size_t(y) * size_t(width);
        land_line(way, from + at, y, width, to_u + at, to_v + at, to_before + at, to_inside + at);
    });
}

}  // namespace

void register_landing(nb::module_ &m) {
    m.def("landing", &landing, nb::arg("inverse_depth").noconvert(), nb::arg("disparity"), nb::arg("numbers"),
          nb::arg("u").noconvert(), nb::arg("v").noconvert(), nb::arg("before").noconvert(),
          nb::arg("inside").noconvert(), nb::arg("threads"));
}
