// What semi-global matching works on, and the values of its paths while a pass runs (semi_global.hpp).
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "lfrig/path_step.hpp"

namespace lfrig {

constexpr int kSpanTile = 8;  // pixels; one range of active labels for each tile
constexpr int kPathLimit = 8191;  // what one path may reach: 8 of them fit 16 bits
constexpr uint16_t kInactive = 0xffff;  // the sum at labels outside a tile's span; as a minimum: no label is active

struct SemiGlobal {
    int height, width, labels;
    const uint16_t *cost;     // [H, W, D]
    uint16_t *sum;            // [H, W, D] of the first pass; the second may leave the whole sum there
    const uint16_t *penalty;  // [4, H, W] P2 to the right, down, down-right and down-left neighbour
    const int16_t *shift;     // [4, H, W] or null: label k continues as label k + shift of that neighbour
    const int16_t *span;      // [tiles down, tiles across, 2] or null: first and one-past-last active label
    uint16_t p1;
    uint16_t cap;  // costs above it count as it
};

// Values of the three paths that come from the row before, for the rows in flight. A path's values move by 1, 2 or 0
// slots a row, so that each pixel writes where the row before has just been read for the last time: half the memory
// of two rows, which is what fits the second-level cache.
class PathRows {
  public:
    PathRows(const SemiGlobal &v, int threads)
        : guard_(v.shift ? v.labels + 2 : 1),
          stride_((v.labels + guard_ + 32) / 32 * 32),
          ring_(v.width + 2 * (threads + 2)),
          values_(size_t(3) * (ring_ + 1) * stride_ + guard_ + 64, kWall),
          lows_(size_t(3) * ring_) {
        const auto address = reinterpret_cast<uintptr_t>(values_.data() + guard_ + 31);
        first_ = values_.data() + guard_ + 31 - address % 64 / sizeof(uint16_t);
    }

    // Path 1 comes from above, 2 from the pixel before that, 3 from the pixel after it; in the order of the pass.
    // The slot of a row's first pixel, and of its pixel `at`.
    int origin(int path, int row) const {
        const int moved = (path == 1 ? row : path == 2 ? 2 * row : 0) % ring_;
        return moved ? ring_ - moved : 0;
    }
    int slot(int path, int origin, int at) const {
        const int s = origin + at;
        return (path - 1) * ring_ + (s < ring_ ? s : s - ring_);
    }
    uint16_t *values(int slot) { return first_ + size_t(slot) * stride_; }
    uint16_t &low(int slot) { return lows_[slot]; }
    int guard() const { return guard_; }
    int stride() const { return stride_; }

  private:
    int guard_, stride_, ring_;
    std::vector<uint16_t> values_;
    std::vector<uint16_t> lows_;
    uint16_t *first_;
};

}  // namespace lfrig
