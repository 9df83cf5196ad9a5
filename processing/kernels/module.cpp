// The extension module lfrig.processing.kernels._native: each kernel registers itself in its own file.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void register_band_cost(nb::module_ &m);
void register_colour_evidence(nb::module_ &m);
void register_fusion(nb::module_ &m);
void register_lenslet(nb::module_ &m);
void register_plane_cost(nb::module_ &m);
void register_plane_fit(nb::module_ &m);
void register_sgm(nb::module_ &m);
void register_sgm_u16(nb::module_ &m);
void register_softmax(nb::module_ &m);
void register_spline(nb::module_ &m);
void register_stream(nb::module_ &m);
void register_unpack(nb::module_ &m);
void register_warp(nb::module_ &m);

NB_MODULE(_native, m) {
    m.doc() = "lfrig's native kernels; each has a NumPy twin in the Python file of its name.";
    register_band_cost(m);
    register_colour_evidence(m);
    register_fusion(m);
    register_lenslet(m);
    register_plane_cost(m);
    register_plane_fit(m);
    register_sgm(m);
    register_sgm_u16(m);
    register_softmax(m);
    register_spline(m);
    register_stream(m);
    register_unpack(m);
    register_warp(m);
}
