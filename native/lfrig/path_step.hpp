// One pixel of semi-global matching: its labels on four paths at once. Inlined into the passes (semi_global.hpp).
#pragma once
#include <cstdint>
#include <cstring>

// Inlined by force, and so compiled for the processor that a function with LFRIG_CLONES around it is compiled for.
#if defined(__GNUC__)
#define LFRIG_INLINE __attribute__((always_inline)) inline
#else
#define LFRIG_INLINE inline
#endif

namespace lfrig {

constexpr int kPaths = 4;           // of one pass
constexpr uint16_t kWall = 0x7fff;  // a label that no path comes from; penalties may be added without overflow

// One pixel: its costs, and for each path where the previous pixel's values lie and where its own go.
struct PathStep {
    const uint16_t *cost;
    uint16_t *sum;
    const uint16_t *other_sum;  // of the other pass
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

// `count` labels from `first` on, for the four paths; `held` is what is added to.
template <bool kAdd>
LFRIG_INLINE void walk(const PathStep &step, uint16_t p1, uint16_t cap, int first, int count, const uint16_t *held,
                       uint16_t *lows) {
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
LFRIG_INLINE void walk_blocks(const PathStep &step, uint16_t p1, uint16_t cap, int first, int labels, uint16_t *lows) {
    const int blocks = labels / kBlock;
    const bool rest = labels % kBlock != 0;
    uint16_t held[kBlock];
    const int tail = first + labels - kBlock;
    if (kAdd && rest) std::memcpy(held, step.other_sum + tail, sizeof held);
    walk<kAdd>(step, p1, cap, first, blocks * kBlock, step.other_sum + first, lows);
    if (rest) walk<kAdd>(step, p1, cap, tail, kBlock, held, lows);
}

template <bool kAdd>
LFRIG_INLINE void take_step(PathStep &step, uint16_t p1, uint16_t cap, int first, int labels) {
    uint16_t lows[kPaths] = {kWall, kWall, kWall, kWall};
    if (labels >= 32)
        walk_blocks<kAdd, 32>(step, p1, cap, first, labels, lows);
    else if (labels >= 8)
        walk_blocks<kAdd, 8>(step, p1, cap, first, labels, lows);
    else
        walk<kAdd>(step, p1, cap, first, labels, step.other_sum + first, lows);
    for (int d = 0; d < kPaths; ++d) step.next_low[d] = lows[d];
}

}  // namespace lfrig
