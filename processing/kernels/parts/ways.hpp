// Ways into sources as kernels get them from Python (landing.py, `packed`).
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <stdexcept>
#include <vector>

#include "landing.hpp"

namespace {

using Flat = nanobind::ndarray<const float, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;
using Grid = nanobind::ndarray<const float, nanobind::ndim<2>, nanobind::c_contig, nanobind::device::cpu>;
using Maps = std::vector<Grid>;
using Flats = std::vector<Flat>;

// disparity float32 [Hs, Ws] of each source; numbers float32 [16]: A row-major, b, a, c, height and width of its frame.
inline std::vector<Way> ways_of(const Maps &disparity, const Flats &numbers) {
    if (disparity.size() != numbers.size()) throw std::invalid_argument("one row of numbers per source");
    std::vector<Way> out;
    for (size_t i = 0; i < disparity.size(); ++i) {
        const float *n = numbers[i].data();
        if (numbers[i].shape(0) != 16 || disparity[i].size() < 1)
            throw std::invalid_argument("a source needs a disparity map and 16 numbers");
        Way way{int(n[14]), int(n[15]), int(disparity[i].shape(0)), int(disparity[i].shape(1)), disparity[i].data(),
                {}, n[12], n[13]};
        std::copy(n, n + 12, way.map);
        out.push_back(way);
    }
    return out;
}

}  // namespace
