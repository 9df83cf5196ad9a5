// What is asked of one pixel's row of aggregated costs. The functions are inlined into
// loops that LFRIG_CLONES compiles.
#pragma once
#include <algorithm>
#include <cstdint>
#include <vector>

#include "lfrig/semi_global.hpp"

namespace lfrig {

constexpr int kLanes = 16;  // rows are padded to whole ones; sums are kept in as many parts and added in one order

LFRIG_INLINE int whole_lanes(int count) { return (count + kLanes - 1) / kLanes * kLanes; }

// The first label of the least sum; `count` is whole kLanes, below 65536.
LFRIG_INLINE int first_least(const uint16_t *__restrict sum, int count) {
    uint32_t low = 0xffffffff;
    for (int k = 0; k < count; ++k) {
        const uint32_t with_label = uint32_t(sum[k]) << 16 | uint32_t(k);
        low = with_label < low ? with_label : low;
    }
    return int(low & 0xffff);
}

// Where a parabola through the least sum and its neighbours has its bottom, beside it; 0 where one is missing.
LFRIG_INLINE float parabola(const uint16_t *sum, int best, int count) {
    if (best == 0 || best == count - 1) return 0;
    const int before = sum[best - 1], at = sum[best], after = sum[best + 1];
    const int bend = before + after - 2 * at;
    return bend > 0 ? 0.5f * float(before - after) / float(bend) : 0.0f;
}

// A chunk's sums in the first-level cache, each row followed by inactive labels up to whole lanes.
class SumBuffer {
  public:
    explicit SumBuffer(int labels) : stride_(labels + kLanes), sums_(size_t(Chunk::kPixels) * stride_) {}

    void place(Chunk &chunk) {
        chunk.sums = sums_.data();
        chunk.stride = stride_;
    }

    // The sums of the chunk's pixel `i`, from label 0 on, with the end of its span closed.
    const uint16_t *closed(const Chunk &chunk, int i) {
        uint16_t *sum = sums_.data() + i * stride_;
        std::fill_n(sum + chunk.span[i].last, kLanes, kInactive);
        return sum;
    }

  private:
    int stride_;
    std::vector<uint16_t> sums_;
};

}  // namespace lfrig
