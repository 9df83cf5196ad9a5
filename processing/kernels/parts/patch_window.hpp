// The pixels of patches that are cut around points. Used by patches.cpp and corner_disparity.cpp.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <stdexcept>

#include "patch_sums.hpp"

namespace {

constexpr int kPointsPerItem = 64;

struct Window {  // offsets and weights of a patch's pixels; those that fill the last lanes have no weight
    int count = 0;
    float dx[kMaxPixels], dy[kMaxPixels], weight[kMaxPixels];
};

struct Sampled {  // a patch and its slopes
    float grey[kMaxPixels], slope_x[kMaxPixels], slope_y[kMaxPixels];
};

using Points = nanobind::ndarray<const double, nanobind::ndim<2>, nanobind::c_contig, nanobind::device::cpu>;
using Line = nanobind::ndarray<const float, nanobind::ndim<1>, nanobind::c_contig, nanobind::device::cpu>;

inline Window window_of(const Line &dx, const Line &dy, const Line &weight) {
    const int pixels = int(dx.shape(0));
    if (int(dy.shape(0)) != pixels || int(weight.shape(0)) != pixels || pixels > kMaxPixels || pixels == 0)
        throw std::invalid_argument("patches: a window of a wrong shape");
    Window w;
    w.count = whole_lanes(pixels);
    for (int k = 0; k < w.count; ++k) {
        w.dx[k] = k < pixels ? dx(k) : 0;
        w.dy[k] = k < pixels ? dy(k) : 0;
        w.weight[k] = k < pixels ? weight(k) : 0;
    }
    return w;
}

}  // namespace
