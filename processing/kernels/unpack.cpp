// Packed sensor values to 16 bits. Twin and definition of the packings: unpack.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <stdexcept>

namespace nb = nanobind;
using nb::ndarray;

namespace {

using Bytes = ndarray<const uint8_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Values = ndarray<uint16_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

// 5 bytes, 4 values: bytes 0..3 are their upper 8 bits, bits 2i and 2i+1 of byte 4 the lower 2 of value i.
struct Little10 {
    static constexpr size_t pixels = 4, bytes = 5;
    static void group(const uint8_t *in, uint16_t *out) {
        const unsigned low = in[4];
        out[0] = uint16_t(in[0] << 2 | (low & 3));
        out[1] = uint16_t(in[1] << 2 | (low >> 2 & 3));
        out[2] = uint16_t(in[2] << 2 | (low >> 4 & 3));
        out[3] = uint16_t(in[3] << 2 | low >> 6);
    }
};

// 3 bytes, 2 values: upper 8 bits and lower 4, then upper 4 and lower 8.
struct Big12 {
    static constexpr size_t pixels = 2, bytes = 3;
    static void group(const uint8_t *in, uint16_t *out) {
        out[0] = uint16_t(in[0] << 4 | in[1] >> 4);
        out[1] = uint16_t((in[1] & 15) << 8 | in[2]);
    }
};

template <class Packing>
void unpack(Bytes packed, Values out) {
    const size_t count = out.shape(0), whole = count / Packing::pixels, rest = count % Packing::pixels;
    if (packed.shape(0) != (whole + (rest ? 1 : 0)) * Packing::bytes)
        throw std::invalid_argument("unpack: the number of bytes does not match");
    const uint8_t *in = packed.data();
    uint16_t *values = out.data();
    nb::gil_scoped_release release;
    for (size_t i = 0; i < whole; ++i) Packing::group(in + i * Packing::bytes, values + i * Packing::pixels);
    if (rest) {
        uint16_t last[Packing::pixels];
        Packing::group(in + whole * Packing::bytes, last);
        for (size_t i = 0; i < rest; ++i) values[whole * Packing::pixels + i] = last[i];
    }
}

}  // namespace

void register_unpack(nb::module_ &m) {
    m.def("unpack_little10", &unpack<Little10>, nb::arg("packed").noconvert(), nb::arg("out").noconvert());
    m.def("unpack_big12", &unpack<Big12>, nb::arg("packed").noconvert(), nb::arg("out").noconvert());
}
