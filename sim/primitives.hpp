// Ray intersections of the simulator's primitives, in the primitive's own frame.
//
// Twin: render_numpy.py. Both do the same float64 operations in the same order, so that they agree on which surface a
// ray meets to the last bit; change one and change the other.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>

namespace lfrig::sim {

constexpr double kMiss = std::numeric_limits<double>::infinity();
constexpr double kTiny = 1e-12;
constexpr double kPi = 3.14159265358979323846;
constexpr int kTorusSteps = 96;

// Plain comparisons: one instruction each, where fmin, fmax and floor are library calls on baseline x86-64.
inline double least(double a, double b) { return a < b ? a : b; }
inline double most(double a, double b) { return a > b ? a : b; }
inline double floor_of(double v) {
    const double whole = double(int64_t(v));
    return whole > v ? whole - 1.0 : whole;
}

struct Vec {
    double x, y, z;
};
inline Vec operator+(Vec a, Vec b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vec operator-(Vec a, Vec b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vec operator*(Vec a, double s) { return {a.x * s, a.y * s, a.z * s}; }
inline double dot(Vec a, Vec b) { return a.x * b.x + a.y * b.y + a.z * b.z; }

// Kinds and record layout as in scene.py.
enum Kind { kSphere = 0, kBox, kCylinder, kTorus, kBoard, kDisc, kBackdrop };

struct Primitive {
    double kind;
    double position[3];
    double local_from_world[9];
    double size[3];
    double texture, u_per_m, v_per_m, turns_u, turns_v, u0, v0, texels_per_m;
    double tint[3];
    double specular, shininess, casts_shadow;
};
constexpr int kRecord = sizeof(Primitive) / sizeof(double);

struct Hit {
    double t;
    int face;
};

inline Vec to_local(const Primitive &p, Vec v) {
    const double *m = p.local_from_world;
    return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[3] * v.x + m[4] * v.y + m[5] * v.z,
            m[6] * v.x + m[7] * v.y + m[8] * v.z};
}
inline Vec to_world(const Primitive &p, Vec v) {
    const double *m = p.local_from_world;
    return {m[0] * v.x + m[3] * v.y + m[6] * v.z, m[1] * v.x + m[4] * v.y + m[7] * v.z,
            m[2] * v.x + m[5] * v.y + m[8] * v.z};
}
inline double away_from_zero(double v) { return std::fabs(v) < kTiny ? kTiny : v; }

inline Hit hit_sphere(const Primitive &p, Vec o, Vec d) {
    const double b = dot(o, d), q = dot(o, o) - p.size[0] * p.size[0], disc = b * b - q;
    if (!(disc > 0)) return {kMiss, 0};
    return {-b - std::sqrt(disc), 0};
}

inline Hit hit_box(const Primitive &p, Vec o, Vec d) {
    const double oo[3] = {o.x, o.y, o.z}, dd[3] = {d.x, d.y, d.z};
    double enter = -kMiss, leave = kMiss;
    int face = 0;
    for (int a = 0; a < 3; ++a) {
        const double inverse = 1.0 / away_from_zero(dd[a]);
        const double t0 = (-p.size[a] - oo[a]) * inverse, t1 = (p.size[a] - oo[a]) * inverse;
        const double lo = least(t0, t1), hi = most(t0, t1);
        if (lo > enter) enter = lo, face = a;
        leave = least(leave, hi);
    }
    return {enter <= leave ? enter : kMiss, face};
}

// Capped, along local z: size = (radius, half length).
inline Hit hit_cylinder(const Primitive &p, Vec o, Vec d) {
    const double r2 = p.size[0] * p.size[0], half = p.size[1];
    const double a = d.x * d.x + d.y * d.y, b = o.x * d.x + o.y * d.y, q = o.x * o.x + o.y * o.y - r2;
    const double disc = b * b - a * q;
    Hit hit{kMiss, 0};
    if (disc > 0 && a > kTiny) {
        const double t = (-b - std::sqrt(disc)) / a;
        if (std::fabs(o.z + t * d.z) <= half) hit = {t, 0};
    }
    const double dz = away_from_zero(d.z);
    const double t = ((dz < 0 ? half : -half) - o.z) / dz;
    const double x = o.x + t * d.x, y = o.y + t * d.y;
    if (x * x + y * y <= r2 && t < hit.t) hit = {t, 1};
    return hit;
}

// Around local z: size = (major radius, minor radius). Sphere tracing of the exact distance between the entry to and
// the exit from the bounding box; close to the surface the step is Newton's, at most doubled, so that grazing rays are
// not stepped over. A quartic solver would lose their roots in double precision.
inline Hit hit_torus(const Primitive &p, Vec o, Vec d) {
    const double major = p.size[0], minor = p.size[1], reach = major + minor;
    const double oo[3] = {o.x, o.y, o.z}, dd[3] = {d.x, d.y, d.z}, hh[3] = {reach, reach, minor};
    double t = 0.0, end = kMiss;
    for (int a = 0; a < 3; ++a) {
        const double inverse = 1.0 / away_from_zero(dd[a]);
        const double t0 = (-hh[a] - oo[a]) * inverse, t1 = (hh[a] - oo[a]) * inverse;
        t = most(t, least(t0, t1));
        end = least(end, most(t0, t1));
    }
    if (t > end) return {kMiss, 0};
    double distance = kMiss;
    for (int i = 0; i < kTorusSteps; ++i) {
        const double x = o.x + t * d.x, y = o.y + t * d.y, z = o.z + t * d.z;
        const double radius = std::sqrt(x * x + y * y), ring = radius - major;
        const double tube = std::sqrt(ring * ring + z * z);
        distance = tube - minor;
        if (std::fabs(distance) < 1e-9 || t > end) break;
        const double slope = (ring * ((x * d.x + y * d.y) / most(radius, kTiny)) + z * d.z) / most(tube, kTiny);
        const bool newton = distance < 0.2 * minor && slope < 0;
        t = t + (newton ? distance * least(-1.0 / slope, 2.0) : distance);
    }
    return {std::fabs(distance) < 1e-6 && t <= end ? t : kMiss, 0};
}

inline Hit hit_board(const Primitive &p, Vec o, Vec d) {
    const double t = -o.y / away_from_zero(d.y);
    const bool inside = std::fabs(o.x + t * d.x) <= p.size[0] && std::fabs(o.z + t * d.z) <= p.size[1];
    return {inside ? t : kMiss, 0};
}

inline Hit hit_disc(const Primitive &p, Vec o, Vec d) {
    const double t = -o.z / away_from_zero(d.z);
    const double x = o.x + t * d.x, y = o.y + t * d.y;
    return {x * x + y * y <= p.size[0] * p.size[0] ? t : kMiss, 0};
}

// An upright round wall that is seen from inside only: the ray meets it where it leaves the cylinder.
inline Hit hit_backdrop(const Primitive &p, Vec o, Vec d) {
    const double a = d.x * d.x + d.y * d.y, b = o.x * d.x + o.y * d.y;
    const double q = o.x * o.x + o.y * o.y - p.size[0] * p.size[0], disc = b * b - a * q;
    if (!(disc > 0) || !(a > kTiny)) return {kMiss, 0};
    return {(-b + std::sqrt(disc)) / a, 0};
}

// Half sizes of the bounding box in the local frame.
inline Vec half_extent(const Primitive &p) {
    const double a = p.size[0], b = p.size[1], c = p.size[2];
    switch (int(p.kind)) {
        case kBox: return {a, b, c};
        case kCylinder:
        case kBackdrop: return {a, a, b};
        case kTorus: return {a + b, a + b, b};
        case kBoard: return {a, 0, b};
        case kDisc: return {a, a, 0};
        default: return {a, a, a};
    }
}

// Whether the segment o + s d, s in [0, 1], meets the box of half sizes h (local frame).
inline bool segment_meets_box(Vec o, Vec d, Vec h) {
    const double oo[3] = {o.x, o.y, o.z}, dd[3] = {d.x, d.y, d.z}, hh[3] = {h.x, h.y, h.z};
    double enter = 0.0, leave = 1.0;
    for (int a = 0; a < 3; ++a) {
        const double inverse = 1.0 / away_from_zero(dd[a]);
        const double s0 = (-hh[a] - oo[a]) * inverse, s1 = (hh[a] - oo[a]) * inverse;
        enter = most(enter, least(s0, s1));
        leave = least(leave, most(s0, s1));
    }
    return enter <= leave;
}

// First hit at t > 1e-6 along a unit direction; t = kMiss when there is none.
inline Hit intersect(const Primitive &p, Vec origin, Vec direction) {
    const Vec o = to_local(p, origin - Vec{p.position[0], p.position[1], p.position[2]});
    const Vec d = to_local(p, direction);
    Hit hit{kMiss, 0};
    switch (int(p.kind)) {
        case kSphere: hit = hit_sphere(p, o, d); break;
        case kBox: hit = hit_box(p, o, d); break;
        case kCylinder: hit = hit_cylinder(p, o, d); break;
        case kTorus: hit = hit_torus(p, o, d); break;
        case kBoard: hit = hit_board(p, o, d); break;
        case kDisc: hit = hit_disc(p, o, d); break;
        case kBackdrop: hit = hit_backdrop(p, o, d); break;
    }
    return hit.t > 1e-6 ? hit : Hit{kMiss, 0};
}

// Outward normal and metric texture coordinates at a local point.
struct Surface {
    Vec normal;
    double u, v, stretch;  // stretch: how much denser the texture is than texels_per_m
};

inline Surface surface_at(const Primitive &p, Vec l, int face) {
    const double turn = 1.0 / (2.0 * kPi);
    switch (int(p.kind)) {
        case kSphere: {
            const Vec n = l * (1.0 / p.size[0]);
            const double z = most(-1.0, least(1.0, n.z));
            const double latitude = std::sqrt(most(1.0 - z * z, 0.0));
            return {n, std::atan2(l.y, l.x) * turn * p.turns_u, std::acos(z) / kPi * p.turns_v,
                    1.0 / most(latitude, 0.1)};
        }
        case kBox:
            if (face == 0) return {{l.x > 0 ? 1.0 : -1.0, 0, 0}, l.y * p.u_per_m + 0.37, -l.z * p.v_per_m, 1};
            if (face == 1) return {{0, l.y > 0 ? 1.0 : -1.0, 0}, l.x * p.u_per_m, -l.z * p.v_per_m, 1};
            return {{0, 0, l.z > 0 ? 1.0 : -1.0}, l.x * p.u_per_m + 0.71, -l.y * p.v_per_m + 0.23, 1};
        case kCylinder:
            if (face == 1) return {{0, 0, l.z > 0 ? 1.0 : -1.0}, l.x * p.u_per_m, -l.y * p.v_per_m, 1};
            return {{l.x / p.size[0], l.y / p.size[0], 0}, std::atan2(l.y, l.x) * turn * p.turns_u,
                    -l.z * p.v_per_m, 1};
        case kTorus: {
            const double ring = std::sqrt(l.x * l.x + l.y * l.y), out = ring - p.size[0];
            const double k = out / (p.size[1] * most(ring, kTiny));
            return {{l.x * k, l.y * k, l.z / p.size[1]}, std::atan2(l.y, l.x) * turn * p.turns_u,
                    std::atan2(l.z, out) * turn * p.turns_v, 1};
        }
        case kBoard: return {{0, -1, 0}, l.x * p.u_per_m, -l.z * p.v_per_m, 1};
        case kDisc: return {{0, 0, 1}, l.x * p.u_per_m, -l.y * p.v_per_m, 1};
        default:
            return {{-l.x / p.size[0], -l.y / p.size[0], 0}, std::atan2(l.y, l.x) * turn * p.turns_u,
                    -l.z * p.v_per_m, 1};
    }
}

}  // namespace lfrig::sim
