// Normal equations of a bundle adjustment, points eliminated by their Schur complement. Twin: bundle.py.
//
// One thread: what a handful of cameras and some thousand points cost is less than what starting threads does, and
// sums in one order are the same bits everywhere.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"
#include "parts/sighting.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

// The views' own blocks [V L, V P], right sides [V P], rows of L and columns padded to P.
struct System {
    int views;
    std::vector<double> blocks, right;
    explicit System(int count)
        : views(count), blocks(size_t(count) * kLocal * count * kPadded), right(size_t(count) * kPadded) {}
    double *block(int row, int column) {
        return &blocks[(size_t(row) * kLocal * views + column) * kPadded];
    }
    size_t stride() const { return size_t(views) * kPadded; }
};

// One point: its own system, and what it has in common with each view.
struct Point {
    double own[6], right[3];
    std::vector<double> mixed;  // [V, 3, P]
    std::vector<int> views;     // that see it
    std::vector<int> width;     // [V]: 0 = does not see it, else how many parameters it depends on, in whole vectors
};

LFRIG_INLINE void begin_point(Point &p) {
    std::fill(p.own, p.own + 6, 0.0);
    std::fill(p.right, p.right + 3, 0.0);
    for (int v : p.views) p.width[v] = 0;
    p.views.clear();
}

using Eight = double __attribute__((vector_size(64)));  // lowered to what there is; element by element the same

LFRIG_INLINE Eight load(const double *p) {
    Eight out;
    std::memcpy(&out, p, sizeof out);
    return out;
}

LFRIG_INLINE void add(double *p, const Eight &more) {
    const Eight sum = load(p) + more;
    std::memcpy(p, &sum, sizeof sum);
}

// rows × W of a block: −= Σ_k a[k][row] b[k][column].
template <int W>
LFRIG_INLINE void subtract_products(int rows, size_t stride, const double *a, const double *b, double *block) {
    for (int part = 0; part < W; part += 8) {
        const Eight b0 = load(b + part), b1 = load(b + kPadded + part), b2 = load(b + 2 * kPadded + part);
        for (int i = 0; i < rows; ++i)
            add(block + i * stride + part, -(a[i] * b0 + a[kPadded + i] * b1 + a[2 * kPadded + i] * b2));
    }
}

// Adds one residual of a sighting to its view's block of the system and to its point.
template <int W>
LFRIG_INLINE void add_residual(const double *j, const double *local, double w, double residual, const double *view, int v,
                               System &system, Point &p) {
    double d[3];
    by_point(view, local, d);
    double *block = system.block(v, v), *right = &system.right[size_t(v) * kPadded];
    double *mixed = &p.mixed[size_t(v) * 3 * kPadded];
    for (int part = 0; part < W; part += 8) {
        const Eight columns = load(j + part), weighted = w * columns;
        for (int i = 0; i < (W == kPixels ? 7 : kLocal); ++i) add(block + i * system.stride() + part, j[i] * weighted);
        add(right + part, residual * weighted);
        for (int i = 0; i < 3; ++i) add(mixed + i * kPadded + part, d[i] * weighted);
    }
    for (int i = 0; i < 3; ++i) p.right[i] += w * residual * d[i];
    p.own[0] += w * d[0] * d[0];
    p.own[1] += w * d[1] * d[0];
    p.own[2] += w * d[1] * d[1];
    p.own[3] += w * d[2] * d[0];
    p.own[4] += w * d[2] * d[1];
    p.own[5] += w * d[2] * d[2];
}

LFRIG_INLINE void add_sighting(const Sighting &s, const double *view, int v, const double *inverse_sigma,
                               System &system, Point &p) {
    if (!p.width[v]) {
        p.views.push_back(v);
        std::fill_n(&p.mixed[size_t(v) * 3 * kPadded], 3 * kPadded, 0.0);
        p.width[v] = kPixels;
    }
    if (inverse_sigma[0] != 0)
        for (int k : {0, 1})
            add_residual<kPixels>(s.by_view[k], s.local[k], s.weight[k], s.residual[k], view, v, system, p);
    if (inverse_sigma[1] != 0) {
        p.width[v] = kPadded;
        add_residual<kPadded>(s.by_view[2], s.local[2], s.weight[2], s.residual[2], view, v, system, p);
    }
}

// Eliminates a point: S −= Y Yᵀ on and above the diagonal of blocks, g −= Y y, with Y = W L⁻ᵀ.
LFRIG_INLINE void eliminate(Point &p, double damping, System &system) {
    factorise(p.own, damping);
    forward(p.own, p.right);
    std::sort(p.views.begin(), p.views.end());
    const double *l = p.own;
    const double d0 = 1 / l[0], d1 = 1 / l[2], d2 = 1 / l[5];
    for (int v : p.views) {
        double *m = &p.mixed[size_t(v) * 3 * kPadded], *right = &system.right[size_t(v) * kPadded];
        for (int part = 0; part < p.width[v]; part += 8) {
            const Eight y0 = load(m + part) * d0;
            const Eight y1 = (load(m + kPadded + part) - l[1] * y0) * d1;
            const Eight y2 = (load(m + 2 * kPadded + part) - l[3] * y0 - l[4] * y1) * d2;
            std::memcpy(m + part, &y0, sizeof y0);
            std::memcpy(m + kPadded + part, &y1, sizeof y1);
            std::memcpy(m + 2 * kPadded + part, &y2, sizeof y2);
            add(right + part, -(y0 * p.right[0] + y1 * p.right[1] + y2 * p.right[2]));
        }
    }
    for (size_t i = 0; i < p.views.size(); ++i)
        for (size_t j = i; j < p.views.size(); ++j) {
            const int a = p.views[i], b = p.views[j], rows = p.width[a] == kPixels ? 7 : kLocal;
            const double *y = &p.mixed[size_t(a) * 3 * kPadded], *z = &p.mixed[size_t(b) * 3 * kPadded];
            if (p.width[b] == kPixels)
                subtract_products<kPixels>(rows, system.stride(), y, z, system.block(a, b));
            else
                subtract_products<kPadded>(rows, system.stride(), y, z, system.block(a, b));
        }
}

LFRIG_CLONES void reduce(const double *views, const double *points, const Table &t, int view_count, double damping,
                         System &system, double *factors) {
    Point p;
    p.mixed.resize(size_t(view_count) * 3 * kPadded);
    p.width.assign(size_t(view_count), 0);
    Sighting s;
    for (int m = 0; m < t.count;) {
        const int n = t.point[m];
        begin_point(p);
        for (; m < t.count && t.point[m] == n; ++m) {
            const double *view = views + size_t(t.view[m]) * kView, *sigma = t.inverse_sigma + 2 * size_t(m);
            linearise(view, points + 3 * size_t(n), t.measured + 3 * size_t(m), sigma, s);
            add_sighting(s, view, t.view[m], sigma, system, p);
        }
        eliminate(p, damping, system);
        std::copy(p.own, p.own + 6, factors + 9 * size_t(n));
        std::copy(p.right, p.right + 3, factors + 9 * size_t(n) + 6);
    }
}

// Out of the padding, both halves.
void unpack(System &system, double *full, double *right) {
    const int size = system.views * kLocal;
    for (int v = 0; v < system.views; ++v) {
        std::copy_n(&system.right[size_t(v) * kPadded], kLocal, right + v * kLocal);
        for (int u = v; u < system.views; ++u)
            for (int a = 0; a < kLocal; ++a)
                for (int b = 0; b < kLocal; ++b) {
                    const size_t i = size_t(v) * kLocal + a, j = size_t(u) * kLocal + b;
                    full[i * size + j] = full[j * size + i] = system.block(v, u)[a * system.stride() + b];
                }
    }
}

// Steps of the points −L⁻ᵀ (y + L⁻¹ Wᵀ d) that belong to steps d of the views.
LFRIG_CLONES void restore(const double *views, const double *points, const Table &t, const double *factors,
                          const double *step, double *out) {
    Sighting s;
    for (int m = 0; m < t.count;) {
        const int n = t.point[m];
        double moved[3] = {0, 0, 0};
        for (; m < t.count && t.point[m] == n; ++m) {
            const double *view = views + size_t(t.view[m]) * kView, *d = step + size_t(t.view[m]) * kLocal;
            const double *sigma = t.inverse_sigma + 2 * size_t(m);
            linearise(view, points + 3 * size_t(n), t.measured + 3 * size_t(m), sigma, s);
            for (int k = 0; k < kKinds; ++k) {
                double along = 0, world[3];
                for (int a = 0; a < kLocal; ++a) along += s.by_view[k][a] * d[a];
                by_point(view, s.local[k], world);
                for (int i = 0; i < 3; ++i) moved[i] += s.weight[k] * along * world[i];
            }
        }
        const double *l = factors + 9 * size_t(n);
        forward(l, moved);
        for (int i = 0; i < 3; ++i) moved[i] = -(moved[i] + l[6 + i]);
        backward(l, moved);
        std::copy(moved, moved + 3, out + 3 * size_t(n));
    }
}

// Points linear in their sightings, reweighted by depth: each gives two equations (R[:2] − n R[2]) X = n t[2] − t[:2],
// n the normalised pixel.
LFRIG_CLONES void triangulate(const double *views, const Table &t, int passes, double *points) {
    for (int m = 0; m < t.count;) {
        const int n = t.point[m], first = m;
        while (m < t.count && t.point[m] == n) ++m;
        double *x = points + 3 * size_t(n);
        for (int pass = 0; pass < passes; ++pass) {
            double a[6] = {}, b[3] = {};
            for (int k = first; k < m; ++k) {
                const double *v = views + size_t(t.view[k]) * kView, *pixel = t.measured + 3 * size_t(k);
                const double depth = v[6] * x[0] + v[7] * x[1] + v[8] * x[2] + v[11];
                const double weight = pass ? v[12] / std::max(std::fabs(depth), kNear) : v[12], w = weight * weight;
                for (int i = 0; i < 2; ++i) {
                    const double slope = (pixel[i] - v[13 + i]) / v[12], right = slope * v[11] - v[9 + i];
                    const double r[3] = {v[3 * i] - slope * v[6], v[3 * i + 1] - slope * v[7],
                                         v[3 * i + 2] - slope * v[8]};
                    for (int c = 0; c < 3; ++c) b[c] += w * r[c] * right;
                    a[0] += w * r[0] * r[0];
                    a[1] += w * r[1] * r[0];
                    a[2] += w * r[1] * r[1];
                    a[3] += w * r[2] * r[0];
                    a[4] += w * r[2] * r[1];
                    a[5] += w * r[2] * r[2];
                }
            }
            // A trace-relative ridge keeps parallel rays solvable without moving the others.
            factorise(a, 0);
            forward(a, b);
            backward(a, b);
            std::copy(b, b + 3, x);
        }
    }
}

LFRIG_CLONES double cost(const double *views, const double *points, const Table &t) {
    double total = 0, product = 1;
    for (int m = 0; m < t.count; ++m) {
        double p[3], residual[kKinds], pixels, disparity;
        residuals(views + size_t(t.view[m]) * kView, points + 3 * size_t(t.point[m]), t.measured + 3 * size_t(m),
                  t.inverse_sigma + 2 * size_t(m), p, residual, pixels, disparity);
        const double terms = (1 + pixels / (kCauchy * kCauchy)) * (1 + disparity / (kCauchy * kCauchy));
        // The logarithm of a product instead of the sum of logarithms.
        if (terms < kFlush && product < kFlush) {
            product *= terms;
        } else {
            total += std::log(product) + std::log(terms);
            product = 1;
        }
    }
    return kCauchy * kCauchy * (total + std::log(product));
}

using Doubles = ndarray<const double, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Indices = ndarray<const int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
template <int Dims>
using Out = ndarray<double, nb::ndim<Dims>, nb::c_contig, nb::device::cpu>;

Table table_of(const Indices &point, const Indices &view, const Doubles &measured, const Doubles &inverse_sigma,
               const Doubles &views, const Doubles &points) {
    const size_t count = point.shape(0);
    if (view.shape(0) != count || measured.shape(0) != count || measured.shape(1) != 3 ||
        inverse_sigma.shape(0) != count || inverse_sigma.shape(1) != 2 || views.shape(1) != kView ||
        points.shape(1) != 3)
        throw std::invalid_argument("bundle: shapes do not match");
    for (size_t m = 0; m < count; ++m) {
        if (view(m) < 0 || size_t(view(m)) >= views.shape(0) || point(m) < 0 || size_t(point(m)) >= points.shape(0))
            throw std::invalid_argument("bundle: index out of range");
        if (m && point(m) < point(m - 1)) throw std::invalid_argument("bundle: not sorted by point");
    }
    return {point.data(), view.data(), measured.data(), inverse_sigma.data(), int(count)};
}

}  // namespace

void register_bundle(nb::module_ &m) {
    m.def(
        "bundle_reduce",
        [](Doubles views, Doubles points, Indices point, Indices view, Doubles measured, Doubles inverse_sigma,
           double damping, Out<2> system, Out<1> right, Out<2> factors) {
            const Table t = table_of(point, view, measured, inverse_sigma, views, points);
            const int count = int(views.shape(0)), size = count * kLocal;
            if (int(system.shape(0)) != size || int(system.shape(1)) != size || int(right.shape(0)) != size ||
                factors.shape(0) != points.shape(0) || factors.shape(1) != 9)
                throw std::invalid_argument("bundle: outputs of a wrong shape");
            nb::gil_scoped_release release;
            System found(count);
            reduce(views.data(), points.data(), t, count, damping, found, factors.data());
            unpack(found, system.data(), right.data());
        },
        "Reduced normal equations into zeroed arrays");
    m.def(
        "bundle_restore",
        [](Doubles views, Doubles points, Indices point, Indices view, Doubles measured, Doubles inverse_sigma,
           Doubles factors, ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu> step, Out<2> out) {
            const Table t = table_of(point, view, measured, inverse_sigma, views, points);
            if (factors.shape(0) != points.shape(0) || factors.shape(1) != 9 || out.shape(0) != points.shape(0) ||
                out.shape(1) != 3 || step.shape(0) != views.shape(0) * kLocal)
                throw std::invalid_argument("bundle: shapes do not match");
            nb::gil_scoped_release release;
            restore(views.data(), points.data(), t, factors.data(), step.data(), out.data());
        },
        "Steps of the points into a zeroed array");
    m.def(
        "bundle_triangulate",
        [](Doubles views, Indices point, Indices view, Doubles measured, Doubles inverse_sigma, int passes,
           Out<2> points) {
            const Table t = table_of(point, view, measured, inverse_sigma, views, Doubles(points));
            nb::gil_scoped_release release;
            triangulate(views.data(), t, passes, points.data());
        },
        "Points from their pixels into a zeroed array");
    m.def(
        "bundle_cost",
        [](Doubles views, Doubles points, Indices point, Indices view, Doubles measured, Doubles inverse_sigma) {
            const Table t = table_of(point, view, measured, inverse_sigma, views, points);
            nb::gil_scoped_release release;
            return cost(views.data(), points.data(), t);
        },
        "Robust cost of all residuals");
}
