// What semi-global matching works on, from arrays: shapes and ranges checked once for every kernel that runs it.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "lfrig/semi_global.hpp"

using CU3 = nanobind::ndarray<const uint16_t, nanobind::ndim<3>, nanobind::c_contig, nanobind::device::cpu>;
using CI3 = nanobind::ndarray<const int16_t, nanobind::ndim<3>, nanobind::c_contig, nanobind::device::cpu>;

// cost uint16 [H, W, D]; penalty uint16 [4, H, W], P2 to the right, down, down-right and down-left neighbour; shift
// int16 [4, H, W] likewise, or empty; span int16 [ceil(H / 8), ceil(W / 8), 2], or empty. The sum is still to be set.
inline lfrig::SemiGlobal semi_global_of(const CU3 &cost, const CU3 &penalty, const CI3 &shift, const CI3 &span, int p1,
                                        int cap) {
    lfrig::SemiGlobal v{};
    v.height = int(cost.shape(0)), v.width = int(cost.shape(1)), v.labels = int(cost.shape(2));
    const int down = (v.height + lfrig::kSpanTile - 1) / lfrig::kSpanTile;
    const int across = (v.width + lfrig::kSpanTile - 1) / lfrig::kSpanTile;
    const auto fits = [](const auto &a, int n0, int n1, int n2) {
        return int(a.shape(0)) == n0 && int(a.shape(1)) == n1 && int(a.shape(2)) == n2;
    };
    if (!fits(penalty, 4, v.height, v.width) || (shift.size() && !fits(shift, 4, v.height, v.width)) ||
        (span.size() && !fits(span, down, across, 2)))
        throw std::invalid_argument("semi-global matching: shapes do not match");
    if (v.height < 1 || v.width < 1 || v.labels < 1)
        throw std::invalid_argument("semi-global matching: no pixel, or no label");
    const int most = *std::max_element(penalty.data(), penalty.data() + penalty.size());
    if (p1 < 0 || cap < 0 || p1 > lfrig::kPathLimit || cap + most > lfrig::kPathLimit)
        throw std::invalid_argument("semi-global matching: penalties out of range");
    v.cost = cost.data(), v.penalty = penalty.data();
    v.shift = shift.size() ? shift.data() : nullptr;
    v.span = span.size() ? span.data() : nullptr;
    v.p1 = uint16_t(p1), v.cap = uint16_t(cap);
    return v;
}
