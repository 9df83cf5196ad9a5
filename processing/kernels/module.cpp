// The extension module lfrig.processing.kernels._native: each kernel registers itself in its own file.
#include <nanobind/nanobind.h>

namespace nb = nanobind;

void register_band_cost(nb::module_ &m);
void register_band_peak(nb::module_ &m);
void register_bundle(nb::module_ &m);
void register_clipping(nb::module_ &m);
void register_corner_disparity(nb::module_ &m);
void register_correlation(nb::module_ &m);
void register_curve(nb::module_ &m);
void register_edge_cost(nb::module_ &m);
void register_edge_snap(nb::module_ &m);
void register_fusion(nb::module_ &m);
void register_grey(nb::module_ &m);
void register_landing(nb::module_ &m);
void register_layer_mean(nb::module_ &m);
void register_layered_views(nb::module_ &m);
void register_lenslet(nb::module_ &m);
void register_line_fit(nb::module_ &m);
void register_occupancy(nb::module_ &m);
void register_patches(nb::module_ &m);
void register_perceptron(nb::module_ &m);
void register_plain_cost(nb::module_ &m);
void register_plane_cost(nb::module_ &m);
void register_plane_fit(nb::module_ &m);
void register_rig_chain(nb::module_ &m);
void register_rims(nb::module_ &m);
void register_sgm(nb::module_ &m);
void register_softmax(nb::module_ &m);
void register_spline(nb::module_ &m);
void register_spread(nb::module_ &m);
void register_stream(nb::module_ &m);
void register_surface(nb::module_ &m);
void register_unpack(nb::module_ &m);
void register_warp(nb::module_ &m);

NB_MODULE(_native, m) {
    m.doc() = "lfrig's native kernels; each has a NumPy twin in the Python file of its name.";
    register_band_cost(m);
    register_band_peak(m);
    register_bundle(m);
    register_clipping(m);
    register_corner_disparity(m);
    register_correlation(m);
    register_curve(m);
    register_edge_cost(m);
    register_edge_snap(m);
    register_fusion(m);
    register_grey(m);
    register_landing(m);
    register_layer_mean(m);
    register_layered_views(m);
    register_lenslet(m);
    register_line_fit(m);
    register_occupancy(m);
    register_patches(m);
    register_perceptron(m);
    register_plain_cost(m);
    register_plane_cost(m);
    register_plane_fit(m);
    register_rig_chain(m);
    register_rims(m);
    register_sgm(m);
    register_softmax(m);
    register_spline(m);
    register_spread(m);
    register_stream(m);
    register_surface(m);
    register_unpack(m);
    register_warp(m);
}
