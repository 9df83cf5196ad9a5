// Semi-global matching on a fixed-point cost volume: the passes over the image, free of Python. Used by sgm_u16.cpp.
//
// Two passes, one from the top and one from the bottom, each with the four paths that arrive from pixels it has already
// seen; so the costs are read twice, and the sum is written twice and read once. In each pass a pixel's labels are
// handled for its four paths at once. Rows run in parallel as a wavefront: a row waits until the row before it is two
// pixels ahead. Sums are integers that cannot overflow, so no order of the threads changes a bit.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <thread>
#include <vector>

#include "lfrig/parallel.hpp"

namespace lfrig {

constexpr int kPaths = 4;       // of one pass
constexpr int kSpanTile = 8;    // pixels; one range of active labels for each tile
constexpr int kPathLimit = 8191;  // what one path may reach: 8 of them fit 16 bits
constexpr uint16_t kWall = 0x7fff;       // a label that no path comes from; penalties may be added without overflow
constexpr uint16_t kInactive = 0xffff;   // the sum at labels outside a tile's span; as a minimum: no label is active

// One pixel: its costs, and for each path where the previous pixel's values lie and where its own go.
struct PathStep {
    const uint16_t *cost;
    uint16_t *sum;
    const uint16_t *previous[kPaths];
    uint16_t *next[kPaths];
    uint16_t low[kPaths];      // least value of the previous pixel
    uint16_t penalty[kPaths];  // P2
    uint16_t next_low[kPaths];
};

// 16-bit arithmetic, spelled out: C++ would widen it, and half as many labels would fit a register.
inline uint16_t add16(uint16_t a, uint16_t b) { return uint16_t(a + b); }
inline uint16_t least16(uint16_t a, uint16_t b) { return a < b ? a : b; }

inline uint16_t path_value(uint16_t cost, const uint16_t *previous, uint16_t p1, uint16_t jump, uint16_t low) {
    const uint16_t side = add16(least16(previous[-1], previous[1]), p1);
    return add16(cost, uint16_t(least16(least16(previous[0], side), jump) - low));
}

// `count` labels from `first` on, for the four paths; `held` is what to add to (null: nothing).
template <bool kAdd>
__attribute__((always_inline)) inline void walk(const PathStep &step, uint16_t p1, uint16_t cap, int first, int count,
                                                const uint16_t *held, uint16_t *lows) {
    const uint16_t *__restrict cost = step.cost + first;
    uint16_t *__restrict sum = step.sum + first;
    const uint16_t *p_0 = step.previous[0] + first, *p_1 = step.previous[1] + first;
    const uint16_t *p_2 = step.previous[2] + first, *p_3 = step.previous[3] + first;
    uint16_t *__restrict n_0 = step.next[0] + first, *__restrict n_1 = step.next[1] + first;
    uint16_t *__restrict n_2 = step.next[2] + first, *__restrict n_3 = step.next[3] + first;
    const uint16_t low_0 = step.low[0], low_1 = step.low[1], low_2 = step.low[2], low_3 = step.low[3];
    const uint16_t jump_0 = add16(low_0, step.penalty[0]), jump_1 = add16(low_1, step.penalty[1]);
    const uint16_t jump_2 = add16(low_2, step.penalty[2]), jump_3 = add16(low_3, step.penalty[3]);
    uint16_t l_0 = lows[0], l_1 = lows[1], l_2 = lows[2], l_3 = lows[3];
#pragma GCC ivdep
    for (int k = 0; k < count; ++k) {
        const uint16_t c = least16(cost[k], cap);
        const uint16_t v_0 = path_value(c, p_0 + k, p1, jump_0, low_0), v_1 = path_value(c, p_1 + k, p1, jump_1, low_1);
        const uint16_t v_2 = path_value(c, p_2 + k, p1, jump_2, low_2), v_3 = path_value(c, p_3 + k, p1, jump_3, low_3);
        n_0[k] = v_0, n_1[k] = v_1, n_2[k] = v_2, n_3[k] = v_3;
        l_0 = least16(l_0, v_0), l_1 = least16(l_1, v_1), l_2 = least16(l_2, v_2), l_3 = least16(l_3, v_3);
        const uint16_t four = add16(add16(v_0, v_1), add16(v_2, v_3));
        sum[k] = kAdd ? add16(held[k], four) : four;
    }
    lows[0] = l_0, lows[1] = l_1, lows[2] = l_2, lows[3] = l_3;
}

// Whole blocks of kBlock labels, then one that ends with the last label and may overlap the one before: values are
// then computed twice and come out the same; what is added to was read before.
template <bool kAdd, int kBlock>
__attribute__((always_inline)) inline void walk_blocks(const PathStep &step, uint16_t p1, uint16_t cap, int first,
                                                       int labels, uint16_t *lows) {
    const int blocks = labels / kBlock;
    const bool rest = labels % kBlock != 0;
    uint16_t held[kBlock];
    const int tail = first + labels - kBlock;
    if (kAdd && rest) std::memcpy(held, step.sum + tail, sizeof held);
    walk<kAdd>(step, p1, cap, first, blocks * kBlock, step.sum + first, lows);
    if (rest) walk<kAdd>(step, p1, cap, tail, kBlock, held, lows);
}

template <bool kAdd>
__attribute__((always_inline)) inline void take_step(PathStep &step, uint16_t p1, uint16_t cap, int first, int labels) {
    uint16_t lows[kPaths] = {kWall, kWall, kWall, kWall};
    if (labels >= 32)
        walk_blocks<kAdd, 32>(step, p1, cap, first, labels, lows);
    else if (labels >= 8)
        walk_blocks<kAdd, 8>(step, p1, cap, first, labels, lows);
    else
        walk<kAdd>(step, p1, cap, first, labels, step.sum + first, lows);
    for (int d = 0; d < kPaths; ++d) step.next_low[d] = lows[d];
}

// The sum's own four paths, and the other four added to them.
LFRIG_CLONES inline void first_step(PathStep &step, uint16_t p1, uint16_t cap, int first, int labels) {
    take_step<false>(step, p1, cap, first, labels);
}
LFRIG_CLONES inline void second_step(PathStep &step, uint16_t p1, uint16_t cap, int first, int labels) {
    take_step<true>(step, p1, cap, first, labels);
}

struct SemiGlobal {
    int height, width, labels;
    const uint16_t *cost;     // [H, W, D]
    uint16_t *sum;            // [H, W, D]
    const uint16_t *penalty;  // [4, H, W] P2 to the right, down, down-right and down-left neighbour
    const int16_t *shift;     // [4, H, W] or null: label k continues as label k + shift of that neighbour
    const int16_t *span;      // [tiles down, tiles across, 2] or null: first and one-past-last active label
    uint16_t p1;
    uint16_t cap;  // costs above it count as it
};

// Path values of the rows that are in flight. A path's values move by -1, -2 or 0 slots a row, so that each pixel
// writes where the row before has just been read for the last time: half the memory of two rows, which is what fits
// the second-level cache.
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

    // Path 0 comes from above, 1 from the pixel before that, 2 from the pixel after it; in the order of the pass.
    // The slot of a row's first pixel, and of its pixel `at`.
    int origin(int path, int row) const {
        const int moved = (path == 0 ? row : path == 1 ? 2 * row : 0) % ring_;
        return moved ? ring_ - moved : 0;
    }
    int slot(int path, int origin, int at) const {
        const int s = origin + at;
        return path * ring_ + (s < ring_ ? s : s - ring_);
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

// Labels that are active in a tile, and how far its neighbours' reach: those between are walls to them.
struct Span {
    int first, last, reach_first, reach_last;
};

inline Span span_of(const SemiGlobal &v, int y, int x) {
    if (!v.span) return {0, v.labels, 0, v.labels};
    const int down = (v.height + kSpanTile - 1) / kSpanTile, across = (v.width + kSpanTile - 1) / kSpanTile;
    const int ty = y / kSpanTile, tx = x / kSpanTile;
    const auto held = [&](int j, int i) {
        const int16_t *s = v.span + (size_t(j) * across + i) * 2;
        const int first = std::max<int>(s[0], 0), last = std::min<int>(s[1], v.labels);
        return first < last ? std::pair<int, int>(first, last) : std::pair<int, int>(v.labels, 0);
    };
    const auto own = held(ty, tx);
    Span out{own.first, own.second, v.shift ? 0 : own.first, v.shift ? v.labels : own.second};
    for (int j = std::max(0, ty - 1); j <= std::min(down - 1, ty + 1); ++j)
        for (int i = std::max(0, tx - 1); i <= std::min(across - 1, tx + 1); ++i) {
            out.reach_first = std::min(out.reach_first, held(j, i).first);
            out.reach_last = std::max(out.reach_last, held(j, i).second);
        }
    return out;
}

inline void fill16(uint16_t *from, const uint16_t *to, uint16_t value) {
    for (; from < to; ++from) *from = value;
}

// One row of one pass. `row` and `at` count in the order of the pass; the second pass runs from the last pixel back.
class PassRow {
  public:
    PassRow(const SemiGlobal &volume, PathRows &rows, bool second, int row)
        : v_(volume), rows_(rows), second_(second), row_(row), y_(second ? volume.height - 1 - row : row),
          guard_(rows.guard()), line_(size_t(3) * rows.stride() + 2 * guard_, kWall) {
        // Where a path starts: zeros, so that the value is the cost. Behind them, the row's own path in two halves.
        start_ = line_.data() + guard_;
        before_ = start_ + rows.stride() + guard_;
        after_ = before_ + rows.stride();
        fill16(line_.data(), start_ + v_.labels + guard_, 0);
        for (int d = 0; d < 3; ++d) {
            origin_[d] = rows.origin(d, row);
            origin_above_[d] = rows.origin(d, std::max(0, row - 1));
        }
    }

    void pixels(int from, int to) {
        for (int at = from; at < to; ++at) {
            const int x = second_ ? v_.width - 1 - at : at;
            if (at == from || (v_.span && (second_ ? x % kSpanTile == kSpanTile - 1 : x % kSpanTile == 0)))
                span_ = span_of(v_, y_, x);
            pixel(at, x);
        }
    }

  private:
    void pixel(int at, int x) {
        const size_t p = size_t(y_) * v_.width + x;
        PathStep step;
        step.cost = v_.cost + p * v_.labels;
        step.sum = v_.sum + p * v_.labels;
        const bool above = row_ > 0, has_before = at > 0, has_after = at + 1 < v_.width;
        comes_from(step, 3, has_before, 0, second_ ? p : p - 1, before_, line_low_);
        vertical(step, 0, above, at, 1, second_ ? p : p - size_t(v_.width));
        vertical(step, 1, above && has_before, at - 1, 2, second_ ? p : p - size_t(v_.width) - 1);
        vertical(step, 2, above && has_after, at + 1, 3, second_ ? p : p - size_t(v_.width) + 1);
        step.next[3] = after_;
        int slots[3];
        for (int d = 0; d < 3; ++d) {
            slots[d] = rows_.slot(d, origin_[d], at);
            step.next[d] = rows_.values(slots[d]);
        }
        if (span_.first < span_.last) {
            if (second_)
                second_step(step, v_.p1, v_.cap, span_.first, span_.last - span_.first);
            else
                first_step(step, v_.p1, v_.cap, span_.first, span_.last - span_.first);
        } else {
            for (uint16_t &low : step.next_low) low = kInactive;
        }
        if (v_.span) wall_off(step);
        for (int d = 0; d < 3; ++d) rows_.low(slots[d]) = step.next_low[d];
        line_low_ = step.next_low[3];
        std::swap(before_, after_);
    }

    void vertical(PathStep &step, int path, bool exists, int at, int direction, size_t first) {
        const int slot = exists ? rows_.slot(path, origin_above_[path], at) : 0;
        comes_from(step, path, exists, direction, first, exists ? rows_.values(slot) : nullptr,
                   exists ? rows_.low(slot) : 0);
    }

    // `first` is the pixel of the two at which the step's penalty and shift are written down.
    void comes_from(PathStep &step, int path, bool exists, int direction, size_t first, const uint16_t *values,
                    uint16_t low) {
        if (!exists || low == kInactive) {
            step.previous[path] = start_;
            step.low[path] = step.penalty[path] = 0;
            return;
        }
        const size_t entry = size_t(direction) * v_.height * v_.width + first;
        int moved = 0;
        if (v_.shift) {
            moved = std::min(std::max<int>(v_.shift[entry], -v_.labels - 1), v_.labels + 1);
            if (!second_) moved = -moved;
        }
        step.previous[path] = values + moved;
        step.low[path] = low;
        step.penalty[path] = v_.penalty[entry];
    }

    // Labels outside the span: walls where a neighbour may look, and no sum.
    void wall_off(const PathStep &step) {
        const int first = span_.first, last = std::max(first, span_.last);
        if (first < last)
            for (uint16_t *next : step.next) {
                fill16(next + span_.reach_first - 1, next + first, kWall);
                fill16(next + last, next + span_.reach_last + 1, kWall);
            }
        if (second_) return;
        fill16(step.sum, step.sum + first, kInactive);
        fill16(step.sum + last, step.sum + v_.labels, kInactive);
    }

    const SemiGlobal &v_;
    PathRows &rows_;
    const bool second_;
    const int row_, y_, guard_;
    std::vector<uint16_t> line_;
    uint16_t *start_, *before_, *after_;
    uint16_t line_low_ = 0;
    int origin_[3], origin_above_[3];
    Span span_{};
};

// Both passes. `done(y)` would be called for finished rows of the second pass.
inline void aggregate(const SemiGlobal &v, int threads) {
    constexpr int kChunk = 16;
    if (threads <= 0) threads = std::max(1u, std::thread::hardware_concurrency());
    threads = std::min(threads, v.height);
    for (const bool second : {false, true}) {
        PathRows rows(v, threads);
        std::vector<std::atomic<int>> finished(v.height);
        for (auto &f : finished) f.store(0);
        parallel_for(v.height, threads, [&](int row) {
            PassRow line(v, rows, second, row);
            for (int from = 0; from < v.width; from += kChunk) {
                const int to = std::min(v.width, from + kChunk), needed = std::min(v.width, to + 1);
                if (row > 0)
                    while (finished[row - 1].load(std::memory_order_acquire) < needed) std::this_thread::yield();
                line.pixels(from, to);
                finished[row].store(to, std::memory_order_release);
            }
        });
    }
}

}  // namespace lfrig
