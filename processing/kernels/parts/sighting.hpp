// A sighting of a point by a view: residuals, derivatives, and the 3x3 systems of single points. Part of bundle.cpp.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

// Into the function with clones, so that it is compiled for each of their instruction sets.
#if defined(__GNUC__)
#define LFRIG_INLINE inline __attribute__((always_inline))
#else
#define LFRIG_INLINE inline
#endif

#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"  // vectors are handed to inlined functions only: no calling convention
#endif

namespace {

constexpr int kLocal = 9;      // parameters of a view: rotation, translation, log focal, baseline, inverse focus
constexpr int kPadded = 16;    // the same in whole vectors
constexpr int kPixels = 8;     // those that pixels depend on, likewise: all but baseline and inverse focus
constexpr int kView = 17;      // numbers of a view: R, t, focal, principal point, baseline, inverse focus
constexpr int kKinds = 3;      // residuals of a sighting: x, y, disparity
constexpr double kCauchy = 2;  // a residual of this many sigmas has half the weight of a small one
constexpr double kNear = 1e-6;
constexpr double kFlush = 1e100;  // products of costs are taken apart before they overflow

struct Sighting {  // residuals in sigmas and their derivatives, by the point in the camera's frame and by the view
    double residual[kKinds];
    double local[kKinds][3];
    double by_view[kKinds][kPadded] = {};
    double weight[kKinds];
};

struct Table {  // sightings sorted by point
    const int32_t *point, *view;
    const double *measured, *inverse_sigma;  // [M, 3] x, y, disparity; [M, 2] of pixels, of disparity (0 = not seen)
    int count;
};

// The camera's frame, and residuals with their squared lengths, of pixels and of disparity.
LFRIG_INLINE void residuals(const double *v, const double *x, const double *measured, const double *inverse_sigma,
                      double *p, double *residual, double &pixels, double &disparity) {
    for (int i = 0; i < 3; ++i) p[i] = v[3 * i] * x[0] + v[3 * i + 1] * x[1] + v[3 * i + 2] * x[2] + v[9 + i];
    // Behind the camera the projection is meaningless: held just in front, its residual is huge and loses weight.
    const double inverse = 1 / std::max(p[2], kNear), focal = v[12];
    for (int i = 0; i < 2; ++i)
        residual[i] = (p[i] * inverse * focal + v[13 + i] - measured[i]) * inverse_sigma[0];
    residual[2] = (focal * v[15] * (inverse - v[16]) - measured[2]) * inverse_sigma[1];
    pixels = residual[0] * residual[0] + residual[1] * residual[1];
    disparity = residual[2] * residual[2];
}

LFRIG_INLINE void derivatives(const double *v, const double *p, const double *inverse_sigma, Sighting &s) {
    const double inverse = 1 / std::max(p[2], kNear), focal = v[12];
    const double scale = focal * inverse * inverse_sigma[0];
    for (int i = 0; i < 2; ++i) {
        const double slope = p[i] * inverse;
        s.local[i][0] = i == 0 ? scale : 0.0;
        s.local[i][1] = i == 1 ? scale : 0.0;
        s.local[i][2] = -slope * scale;
        s.by_view[i][6] = slope * focal * inverse_sigma[0];
    }
    const double slope = focal * v[15] * inverse_sigma[1], expected = slope * (inverse - v[16]);
    s.local[2][0] = s.local[2][1] = 0;
    s.local[2][2] = -slope * inverse * inverse;
    s.by_view[2][6] = s.by_view[2][7] = expected;
    s.by_view[2][8] = -slope * v[16];
    for (int k = 0; k < kKinds; ++k) {
        const double *d = s.local[k];
        s.by_view[k][0] = p[1] * d[2] - p[2] * d[1];  // ω × p moves r by (p × ∂r/∂p)·ω
        s.by_view[k][1] = p[2] * d[0] - p[0] * d[2];
        s.by_view[k][2] = p[0] * d[1] - p[1] * d[0];
        for (int i = 0; i < 3; ++i) s.by_view[k][3 + i] = d[i];
    }
}

LFRIG_INLINE void linearise(const double *v, const double *x, const double *measured, const double *inverse_sigma,
                      Sighting &s) {
    double p[3], pixels, disparity;
    residuals(v, x, measured, inverse_sigma, p, s.residual, pixels, disparity);
    derivatives(v, p, inverse_sigma, s);
    s.weight[0] = s.weight[1] = 1 / (1 + pixels / (kCauchy * kCauchy));
    s.weight[2] = 1 / (1 + disparity / (kCauchy * kCauchy));
}

// Derivative of a residual by the point in the world: Rᵀ ∂r/∂p.
LFRIG_INLINE void by_point(const double *v, const double *local, double *out) {
    for (int i = 0; i < 3; ++i) out[i] = v[i] * local[0] + v[3 + i] * local[1] + v[6 + i] * local[2];
}

// Cholesky factor (lower: 00 10 11 20 21 22) of a symmetric 3x3 given the same way, damped; in place.
LFRIG_INLINE void factorise(double *a, double damping) {
    const double trace = (a[0] + a[2] + a[5]) * (1 + damping);
    for (int i : {0, 2, 5}) a[i] = a[i] * (1 + damping) + (1e-12 * trace + 1e-30);
    a[0] = std::sqrt(a[0]);
    a[1] /= a[0];
    a[3] /= a[0];
    a[2] = std::sqrt(std::max(a[2] - a[1] * a[1], 1e-300));
    a[4] = (a[4] - a[3] * a[1]) / a[2];
    a[5] = std::sqrt(std::max(a[5] - a[3] * a[3] - a[4] * a[4], 1e-300));
}

// L⁻¹ b, in place.
LFRIG_INLINE void forward(const double *l, double *b) {
    b[0] /= l[0];
    b[1] = (b[1] - l[1] * b[0]) / l[2];
    b[2] = (b[2] - l[3] * b[0] - l[4] * b[1]) / l[5];
}

// L⁻ᵀ b, in place.
LFRIG_INLINE void backward(const double *l, double *b) {
    b[2] /= l[5];
    b[1] = (b[1] - l[4] * b[2]) / l[2];
    b[0] = (b[0] - l[1] * b[1] - l[3] * b[2]) / l[0];
}

}  // namespace
