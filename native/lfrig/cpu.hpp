// Which hand-written form of a loop this machine can run (each has a plain form beside it that gives the same bits),
// and the clock of the calling thread.
#pragma once
#include <atomic>
#include <ctime>

#if defined(__x86_64__) && defined(__GNUC__)
#define LFRIG_X86 1
#define LFRIG_AVX512 __attribute__((target("arch=x86-64-v4")))
#include <immintrin.h>
#endif

namespace lfrig {

// Set by tests: hand-written forms stay unused.
inline std::atomic<bool> plain_loops{false};

inline bool has_avx512() {
#ifdef LFRIG_X86
    if (plain_loops.load(std::memory_order_relaxed)) return false;
    static const bool has = __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
                            __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl");
    return has;
#else
    return false;
#endif
}

// CPU seconds of the calling thread; where there is no such clock, of the process.
inline double thread_cpu_s() {
#ifdef CLOCK_THREAD_CPUTIME_ID
    timespec now{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
    return double(now.tv_sec) + 1e-9 * double(now.tv_nsec);
#else
    return double(std::clock()) / CLOCKS_PER_SEC;
#endif
}

}  // namespace lfrig
