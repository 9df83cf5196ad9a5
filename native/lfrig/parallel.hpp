// Threads for the native core: a plain parallel loop over independent items.
//
// Results never depend on the thread count: each item is computed by one thread from start to end and items share
// nothing. Items are handed out dynamically in order, so uneven rows balance.
#pragma once
#include <algorithm>
#include <atomic>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

// Baseline, AVX2 and AVX-512 versions of one plain loop, chosen when the module is loaded (GCC on x86-64 Linux).
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__linux__)
#define LFRIG_CLONES __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define LFRIG_CLONES
#endif

namespace lfrig {

// Calls fn(i) for i in [0, count) on `threads` threads (0 = all cores). Rethrows the first exception.
template <class F>
void parallel_for(int count, int threads, F &&fn) {
    if (threads <= 0) threads = std::max(1u, std::thread::hardware_concurrency());
    threads = std::min(threads, count);
    if (threads <= 1) {
        for (int i = 0; i < count; ++i) fn(i);
        return;
    }
    std::atomic<int> next{0};
    std::exception_ptr error;
    std::mutex guard;
    auto work = [&] {
        for (int i; (i = next.fetch_add(1)) < count;) {
            try {
                fn(i);
            } catch (...) {
                std::lock_guard<std::mutex> lock(guard);
                if (!error) error = std::current_exception();
                next.store(count);
            }
        }
    };
    std::vector<std::thread> pool;
    for (int t = 1; t < threads; ++t) pool.emplace_back(work);
    work();
    for (auto &t : pool) t.join();
    if (error) std::rethrow_exception(error);
}

}  // namespace lfrig
