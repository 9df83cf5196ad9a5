// What this machine can do at most: the STREAM triad, chains of multiply-adds, and which versions of the kernels run.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <stdexcept>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using Array = nb::ndarray<float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using ConstArray = nb::ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

namespace {

constexpr int CHAINS = 12;        // as many as hide the latency of two units and leave 16 registers room for constants
constexpr int LANES_BYTES = 64;   // what one chain holds, whatever the registers' width: results are the same
constexpr size_t BLOCK = 1 << 16;

template <class T, int BYTES>
struct Vector {
    typedef T type __attribute__((vector_size(BYTES)));
};

// `rounds` times x = x * factor + term on chains kept in registers of BYTES; out[CHAINS * 64 / sizeof(T)] is read and
// written. With registers narrower than 64 bytes the lanes are done one part after the other.
template <class T, int BYTES>
[[gnu::always_inline]] inline void multiply_add(T *out, T factor, T term, int64_t rounds) {
    using V = typename Vector<T, BYTES>::type;
    constexpr int LANES = BYTES / sizeof(T), ALL = CHAINS * LANES_BYTES / sizeof(T);
    const V f = V{} + factor, t = V{} + term;
    for (int part = 0; part < ALL; part += CHAINS * LANES) {
        V x[CHAINS];
        std::memcpy(x, out + part, sizeof x);
        for (int64_t i = 0; i < rounds; ++i)
#pragma GCC unroll 12
            for (int c = 0; c < CHAINS; ++c) x[c] = x[c] * f + t;
        std::memcpy(out + part, x, sizeof x);
    }
}

// Versions of a function by what the processor has, chosen by the same resolver as those of LFRIG_CLONES.
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && defined(__linux__)
#define LFRIG_VERSIONS(MAKE)                                     \
    MAKE(__attribute__((target("arch=x86-64-v4"))), 64, "AVX-512") \
    MAKE(__attribute__((target("arch=x86-64-v3"))), 32, "AVX2")    \
    MAKE(__attribute__((target("default"))), 16, "baseline")
#else
#define LFRIG_VERSIONS(MAKE) MAKE(, 16, "baseline")
#endif

#define LFRIG_CHAINS(TARGET, BYTES, NAME)                                                    \
    TARGET void chains(uint16_t *out, uint16_t factor, uint16_t term, int64_t rounds) {         \
        multiply_add<uint16_t, BYTES>(out, factor, term, rounds);                             \
    }                                                                                        \
    TARGET void chains(float *out, float factor, float term, int64_t rounds) {               \
        multiply_add<float, BYTES>(out, factor, term, rounds);                               \
    }                                                                                        \
    TARGET const char *level() { return NAME; }
LFRIG_VERSIONS(LFRIG_CHAINS)

LFRIG_CLONES void triad_block(float *__restrict a, const float *__restrict b, const float *__restrict c, float s, size_t n) {
    for (size_t i = 0; i < n; ++i) a[i] = b[i] + s * c[i];
}

void stream_triad(Array a, ConstArray b, ConstArray c, float scalar, int threads) {
    const size_t n = a.shape(0);
    if (b.shape(0) != n || c.shape(0) != n) throw std::invalid_argument("arrays of different lengths");
    float *pa = a.data();
    const float *pb = b.data(), *pc = c.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(int((n + BLOCK - 1) / BLOCK), threads, [&](int block) {
        const size_t start = block * BLOCK;
        triad_block(pa + start, pb + start, pc + start, scalar, std::min(BLOCK, n - start));
    });
}

template <class T>
void run_chains(nb::ndarray<T, nb::ndim<2>, nb::c_contig, nb::device::cpu> out, T factor, T term, int64_t rounds) {
    if (out.shape(1) * sizeof(T) != CHAINS * LANES_BYTES) throw std::invalid_argument("rows must hold 12 × 64 bytes");
    T *data = out.data();
    const size_t width = out.shape(1);
    nb::gil_scoped_release release;
    const int rows = int(out.shape(0));
    lfrig::parallel_for(rows, rows, [&](int row) { chains(data + row * width, factor, term, rounds); });
}

}  // namespace

void register_stream(nb::module_ &m) {
    m.def("vector_level", [] { return level(); });
    m.def("stream_triad", &stream_triad);
    m.def("multiply_add16", &run_chains<uint16_t>);
    m.def("multiply_add32", &run_chains<float>);
}
