// Semi-global matching along 8 paths in 16-bit fixed point; the passes are in lfrig/semi_global.hpp. Twin: sgm.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"
#include "parts/sgm_arrays.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

LFRIG_CLONES void absolute_differences(const uint8_t *__restrict a, const uint8_t *__restrict b, int count,
                                       uint8_t *__restrict out) {
    for (int i = 0; i < count; ++i) out[i] = uint8_t(a[i] > b[i] ? a[i] - b[i] : b[i] - a[i]);
}

// guide uint8 [H, W, 3]; table uint16 [766], the penalty by the sum of absolute differences; out uint16 [4, H, W].
void edge_penalties(ndarray<const uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> guide,
                    ndarray<const uint16_t, nb::ndim<1>, nb::c_contig, nb::device::cpu> table,
                    ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> out, int threads) {
    const int height = int(guide.shape(0)), width = int(guide.shape(1));
    if (guide.shape(2) != 3 || table.size() != 766 || out.shape(0) != 4 || int(out.shape(1)) != height ||
        int(out.shape(2)) != width)
        throw std::invalid_argument("edge_penalties: shapes do not match");
    const uint8_t *image = guide.data();
    const uint16_t *of = table.data();
    uint16_t *to = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        constexpr int kRight[4] = {1, 0, 1, -1}, kDown[4] = {0, 1, 1, 1};
        std::vector<uint8_t> step(size_t(3) * width);
        for (int d = 0; d < 4; ++d) {
            uint16_t *row = to + (size_t(d) * height + y) * width;
            const int first = std::max(0, -kRight[d]), last = width - std::max(0, kRight[d]);
            std::fill(row, row + width, of[0]);
            if (y + kDown[d] >= height || first >= last) continue;
            const uint8_t *here = image + (size_t(y) * width + first) * 3;
            const uint8_t *there = image + (size_t(y + kDown[d]) * width + first + kRight[d]) * 3;
            absolute_differences(here, there, 3 * (last - first), step.data());
            for (int x = first, i = 0; x < last; ++x, i += 3) row[x] = of[step[i] + step[i + 1] + step[i + 2]];
        }
    });
}

// out uint16 [H, W, D]; the others as for `semi_global_of`.
void sgm(CU3 cost, CU3 penalty, CI3 shift, CI3 span, int p1, int cap,
             ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> out, int threads) {
    lfrig::SemiGlobal v = semi_global_of(cost, penalty, shift, span, p1, cap);
    for (int axis = 0; axis < 3; ++axis)
        if (out.shape(axis) != cost.shape(axis)) throw std::invalid_argument("sgm: shapes do not match");
    v.sum = out.data();
    nb::gil_scoped_release release;
    lfrig::aggregate(v, threads, [&] { return lfrig::KeepSums{v}; });
}

}  // namespace

void register_sgm(nb::module_ &m) {
    m.def("edge_penalties", &edge_penalties, nb::arg("guide").noconvert(), nb::arg("table").noconvert(),
          nb::arg("out").noconvert(), nb::arg("threads"));
    m.def("sgm", &sgm, nb::arg("cost").noconvert(), nb::arg("penalty").noconvert(),
          nb::arg("shift").noconvert(), nb::arg("span").noconvert(), nb::arg("p1"), nb::arg("cap"),
          nb::arg("out").noconvert(), nb::arg("threads"));
}
