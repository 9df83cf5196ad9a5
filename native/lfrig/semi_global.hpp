// Semi-global matching on a fixed-point cost volume: the passes over the image, free of Python.
//
// Two passes, one from the top and one from the bottom, each with the four paths that arrive from pixels it has already
// seen; so the costs are read twice. In each pass a pixel's labels are handled for its four paths at once. Rows run in
// parallel as a wavefront: a row waits until the row before it is a pixel ahead. Sums are integers that cannot
// overflow, so no order of the threads changes a bit.
#pragma once
#include <algorithm>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <thread>
#include <utility>
#include <vector>

#include "lfrig/parallel.hpp"
#include "lfrig/path_rows.hpp"
#include "lfrig/path_step.hpp"

namespace lfrig {

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

// Pixels of one row, one after the other in the order of a pass, and the labels that are active in each.
struct Chunk {
    static constexpr int kPixels = 16;
    size_t first;    // pixel; the second pass runs back from it
    int count;
    Span span[kPixels];
    uint16_t *sums;    // where the second pass leaves the first pixel's sums
    ptrdiff_t stride;  // from there to the next pixel's
};

// One row of one pass. `row` and `at` count in the order of the pass; the second pass runs from the last pixel back.
// Paths 0 to 3 run along the row, straight, and along the two diagonals, as the penalties and shifts are ordered.
template <bool kSecond>
class PassRow {
  public:
    PassRow(const SemiGlobal &volume, PathRows &rows, int row)
        : v_(volume), rows_(rows), row_(row), y_(kSecond ? volume.height - 1 - row : row),
          line_(size_t(3) * rows.stride() + 2 * rows.guard(), kWall) {
        // Where a path starts: zeros, so that its value is the cost. Behind them, the row's own path in two halves.
        const int guard = rows.guard();
        start_ = line_.data() + guard;
        before_ = start_ + rows.stride() + guard;
        after_ = before_ + rows.stride();
        fill16(line_.data(), start_ + v_.labels + guard, 0);
        constexpr int kBack[kPaths] = {-1, 0, -1, 1};
        for (int d = 0; d < kPaths; ++d) {
            if (d > 0) origin_[d] = rows.origin(d, row), origin_above_[d] = rows.origin(d, std::max(0, row - 1));
            // A step is written down at the upper or left one of its pixels.
            const ptrdiff_t from = kSecond ? 0 : kBack[d] - (d > 0 ? v_.width : 0);
            entry_[d] = (ptrdiff_t(d) * v_.height + y_) * v_.width + from;
        }
    }

    // The pixels `from` to `to`, without a place for their sums.
    Chunk chunk(int from, int to) const {
        Chunk c{};
        const int x = kSecond ? v_.width - 1 - from : from;
        c.first = size_t(y_) * v_.width + x;
        c.count = to - from;
        for (int i = 0; i < c.count; ++i) {
            const int xi = kSecond ? x - i : x + i;
            const bool entered = i == 0 || (v_.span && xi % kSpanTile == (kSecond ? kSpanTile - 1 : 0));
            c.span[i] = entered ? span_of(v_, y_, xi) : c.span[i - 1];
        }
        return c;
    }

    LFRIG_INLINE void pixels(const Chunk &chunk, int from) {
        for (int i = 0; i < chunk.count; ++i) {
            const size_t p = kSecond ? chunk.first - i : chunk.first + i;
            uint16_t *other_sum = v_.sum + p * v_.labels;
            pixel(from + i, p, chunk.span[i], other_sum, kSecond ? chunk.sums + i * chunk.stride : other_sum);
        }
    }

  private:
    static constexpr size_t kAhead = 8;  // pixels
    static constexpr int kCacheLine = 64 / sizeof(uint16_t);

    LFRIG_INLINE void pixel(int at, size_t p, const Span &span, const uint16_t *other_sum, uint16_t *sum) {
        const int x = kSecond ? v_.width - 1 - at : at;
        const int first = span.first, labels = span.last - span.first;
        fetch_ahead(kSecond ? p - kAhead : p + kAhead, first, labels);
        PathStep step;
        step.cost = v_.cost + p * v_.labels;
        step.other_sum = other_sum;
        step.sum = sum;
        const bool above = row_ > 0;
        come_from<0>(step, x, at > 0, before_, line_low_);
        come_from_above<1>(step, x, above, at);
        come_from_above<2>(step, x, above && at > 0, at - 1);
        come_from_above<3>(step, x, above && at + 1 < v_.width, at + 1);
        int slots[kPaths];
        step.next[0] = after_;
        for (int d = 1; d < kPaths; ++d) {
            slots[d] = rows_.slot(d, origin_[d], at);
            step.next[d] = rows_.values(slots[d]);
        }
        if (labels > 0) {
            take_step<kSecond>(step, v_.p1, v_.cap, first, labels);
            if (v_.span) wall_off(step, x, span);
        } else {
            for (uint16_t &low : step.next_low) low = kInactive;
        }
        for (int d = 1; d < kPaths; ++d) rows_.low(slots[d]) = step.next_low[d];
        line_low_ = step.next_low[0];
        std::swap(before_, after_);
    }

    // The second pass runs backwards through memory, which processors do not foresee: without this it takes twice as
    // long.
    LFRIG_INLINE void fetch_ahead(size_t p, int first, int labels) const {
        if (p >= size_t(v_.height) * v_.width) return;
        const uint16_t *cost = v_.cost + p * v_.labels + first, *sum = v_.sum + p * v_.labels + first;
        for (int k = 0; k < labels; k += kCacheLine) {
            fetch(cost + k);
            fetch(sum + k);
        }
        if (labels % kCacheLine && labels > 0) {
            fetch(cost + labels - 1);
            fetch(sum + labels - 1);
        }
    }

    static LFRIG_INLINE void fetch([[maybe_unused]] const uint16_t *address) {
#if defined(__GNUC__)
        __builtin_prefetch(address);
#endif
    }

    template <int kPath>
    LFRIG_INLINE void come_from_above(PathStep &step, int x, bool exists, int at) {
        const int slot = exists ? rows_.slot(kPath, origin_above_[kPath], at) : 0;
        come_from<kPath>(step, x, exists, rows_.values(slot), rows_.low(slot));
    }

    template <int kPath>
    LFRIG_INLINE void come_from(PathStep &step, int x, bool exists, const uint16_t *values, uint16_t low) const {
        if (!exists || low == kInactive) {
            step.previous[kPath] = start_;
            step.low[kPath] = step.penalty[kPath] = 0;
            return;
        }
        const size_t entry = size_t(entry_[kPath] + x);
        int moved = 0;
        if (v_.shift) {
            moved = std::min(std::max<int>(v_.shift[entry], -v_.labels - 1), v_.labels + 1);
            if (!kSecond) moved = -moved;
        }
        step.previous[kPath] = values + moved;
        step.low[kPath] = low;
        step.penalty[kPath] = v_.penalty[entry];
    }

    // Labels outside the span are walls where a neighbour may look: at the tile's border, as far as other tiles do.
    LFRIG_INLINE void wall_off(const PathStep &step, int x, const Span &span) const {
        const int in_tile = x % kSpanTile, down_tile = y_ % kSpanTile, last = kSpanTile - 1;
        if (!v_.shift && in_tile != 0 && in_tile != last && down_tile != 0 && down_tile != last) {
            for (uint16_t *next : step.next) next[span.first - 1] = next[span.last] = kWall;
            return;
        }
        for (uint16_t *next : step.next) {
            fill16(next + span.reach_first - 1, next + span.first, kWall);
            fill16(next + span.last, next + span.reach_last + 1, kWall);
        }
    }

    const SemiGlobal &v_;
    PathRows &rows_;
    const int row_, y_;
    std::vector<uint16_t> line_;
    uint16_t *start_, *before_, *after_;
    uint16_t line_low_ = 0;
    int origin_[kPaths], origin_above_[kPaths];
    ptrdiff_t entry_[kPaths];  // of the row's first pixel's steps
};

LFRIG_CLONES inline void first_pixels(PassRow<false> &row, const Chunk &chunk, int from) { row.pixels(chunk, from); }
LFRIG_CLONES inline void second_pixels(PassRow<true> &row, const Chunk &chunk, int from) { row.pixels(chunk, from); }

// What becomes of the second pass's sums, chunk by chunk: `place` says where they go, `finished` is told that they are
// there. This one keeps them all.
struct KeepSums {
    const SemiGlobal &v;
    void place(Chunk &chunk) const {
        chunk.sums = v.sum + chunk.first * v.labels;
        chunk.stride = -v.labels;
    }
    void finished(const Chunk &chunk) const {
        for (int i = 0; i < chunk.count; ++i) {
            uint16_t *sum = chunk.sums + i * chunk.stride;
            const int first = std::min(chunk.span[i].first, v.labels), last = std::max(first, chunk.span[i].last);
            fill16(sum, sum + first, kInactive);
            fill16(sum + last, sum + v.labels, kInactive);
        }
    }
};

// One pass; `sums_of_row()` makes what takes the sums of a row of the second.
template <bool kSecond, class MakeSums>
void run_pass(const SemiGlobal &v, int threads, MakeSums &&sums_of_row) {
    PathRows rows(v, threads);
    std::vector<std::atomic<int>> finished(v.height);
    for (auto &f : finished) f.store(0);
    parallel_for(v.height, threads, [&](int row) {
        auto sums = sums_of_row();
        PassRow<kSecond> line(v, rows, row);
        for (int from = 0; from < v.width; from += Chunk::kPixels) {
            const int to = std::min(v.width, from + Chunk::kPixels), needed = std::min(v.width, to + 1);
            if (row > 0)
                while (finished[row - 1].load(std::memory_order_acquire) < needed) std::this_thread::yield();
            Chunk chunk = line.chunk(from, to);
            if constexpr (kSecond) {
                sums.place(chunk);
                second_pixels(line, chunk, from);
                finished[row].store(to, std::memory_order_release);
                sums.finished(chunk);
            } else {
                first_pixels(line, chunk, from);
                finished[row].store(to, std::memory_order_release);
            }
        }
    });
}

template <class MakeSums>
void aggregate(const SemiGlobal &v, int threads, MakeSums &&sums_of_row) {
    if (threads <= 0) threads = std::max(1u, std::thread::hardware_concurrency());
    threads = std::min(threads, v.height);
    run_pass<false>(v, threads, sums_of_row);
    run_pass<true>(v, threads, sums_of_row);
}

}  // namespace lfrig
