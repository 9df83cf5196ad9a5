// A scene as the native ray tracer sees it: nearest hit, shadows, shading. Twins: render_numpy.py, shadows_numpy.py.
#pragma once
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "primitives.hpp"
#include "textures.hpp"

namespace lfrig::sim {

template <class T, int N>
using Array = nanobind::ndarray<const T, nanobind::ndim<N>, nanobind::c_contig, nanobind::device::cpu>;

struct Ray {
    Vec origin, direction;
    double depth_per_t;
};

struct Light {
    const double *points;  // [count, 3]
    int count;
    Vec centre, axis[3];  // axis: rows of the light's own frame, z towards the scene
    double power, grid_half;
    int grid;
    double radius;
};

struct World {
    const Primitive *primitives;
    int count;
    Textures textures;
    Light light;
    double ambient, ambient_slope;
    std::vector<std::vector<int>> casters;  // per cell of the light's grid, primitives that may shade it
    std::vector<int> all_casters;
    std::vector<Vec> extent;    // half sizes of each primitive's bounding box
    std::vector<double> reach;  // radius of the sphere about that box

    Hit nearest(const Ray &ray, const std::vector<int> &candidates, const double *near_depth, int &index) const {
        Hit best{kMiss, 0};
        index = -1;
        for (int i : candidates) {
            if (near_depth[i] > best.t * ray.depth_per_t) break;
            const Hit hit = intersect(primitives[i], ray.origin, ray.direction);
            if (hit.t < best.t || (hit.t == best.t && hit.t < kMiss && i < index)) best = hit, index = i;
        }
        return best;
    }

    const std::vector<int> &casters_towards(Vec point) const {
        const Vec v = point - light.centre;
        const double z = dot(light.axis[2], v);
        if (z > kTiny) {
            const double gx = (dot(light.axis[0], v) / z / light.grid_half + 1.0) * 0.5 * light.grid;
            const double gy = (dot(light.axis[1], v) / z / light.grid_half + 1.0) * 0.5 * light.grid;
            if (gx >= 0 && gy >= 0 && gx < light.grid && gy < light.grid)
                return casters[size_t(gy) * light.grid + size_t(gx)];
        }
        return all_casters;
    }

    // Whether the bounding volumes reach into the cone from the point to the lamp's disc. At the fraction s of the way
    // the cone is s * light.radius wide, so the axis against a box grown by the widest such radius is a safe test.
    bool may_block(Vec point, Vec to_lamp, double distance, int i) const {
        const double *c = primitives[i].position;
        const Vec v = Vec{c[0], c[1], c[2]} - point;
        const double along = dot(v, to_lamp) / distance, r = reach[i];
        const double wide = light.radius * least(most((along + r) / distance, 0.0), 1.0) + 1e-6;
        if (along < -r - wide || dot(v, v) - along * along > (r + wide) * (r + wide)) return false;
        const Vec h = extent[i];
        return segment_meets_box(to_local(primitives[i], v * -1.0), to_local(primitives[i], to_lamp),
                                 {h.x + wide, h.y + wide, h.z + wide});
    }

    // Fraction of the light points first, first + step, ... that the point sees. Fixed points: shadows are the same
    // surface pattern in every view, without noise.
    double visibility(Vec point, int self, bool self_shadow, int first, int step) const {
        thread_local std::vector<int> blockers;
        blockers.clear();
        const Vec to_lamp = light.centre - point;
        const double lamp_distance = std::sqrt(dot(to_lamp, to_lamp));
        for (int i : casters_towards(point)) {
            if (i == self && !self_shadow) continue;
            if (may_block(point, to_lamp, lamp_distance, i)) blockers.push_back(i);
        }
        if (blockers.empty()) return 1.0;
        int seen = 0, total = 0;
        for (int j = first; j < light.count; j += step) {
            const Vec v = Vec{light.points[3 * j], light.points[3 * j + 1], light.points[3 * j + 2]} - point;
            const double distance = std::sqrt(dot(v, v));
            const Vec d = v * (1.0 / distance);
            bool blocked = false;
            for (size_t b = 0; b < blockers.size() && !blocked; ++b)
                blocked = intersect(primitives[blockers[b]], point, d).t < distance;
            seen += !blocked;
            ++total;
        }
        return double(seen) / double(total);
    }

    void shade(const Ray &ray, const Hit &hit, int index, double sample_angle, int sample, int samples,
               double colour[3]) const {
        const Primitive &p = primitives[index];
        const Vec point = ray.origin + ray.direction * hit.t;
        const Vec local = to_local(p, point - Vec{p.position[0], p.position[1], p.position[2]});
        const Surface s = surface_at(p, local, hit.face);
        Vec n = to_world(p, s.normal);
        double facing = dot(n, ray.direction);
        if (facing > 0) n = n * -1.0, facing = -facing;
        const double footprint = hit.t * ray.depth_per_t * sample_angle * p.texels_per_m * std::sqrt(s.stretch) /
                                 std::sqrt(most(-facing, 0.15));
        double albedo[3];
        textures.trilinear(int(p.texture), s.u + p.u0, s.v + p.v0, footprint, albedo);
        const Vec raised = point + n * 1e-5;
        const Vec v = light.centre - raised;
        const double distance2 = dot(v, v), inverse = 1.0 / std::sqrt(distance2);
        const Vec l = v * inverse;
        const double cosine = dot(n, l);
        // Only the inner half of a ring can shade itself; for all else the cosine has told.
        const bool self_shadow = int(p.kind) == kTorus && s.normal.x * local.x + s.normal.y * local.y < 0;
        double diffuse = 0, highlight = 0;
        if (cosine > 0) {
            const double arriving = light.power / distance2 * visibility(raised, index, self_shadow, sample, samples);
            diffuse = arriving * cosine;
            if (p.specular > 0) {
                const Vec h = l - ray.direction;
                const double along = most(dot(n, h) / std::sqrt(dot(h, h)), 0.0);
                highlight = arriving * p.specular * std::pow(along, p.shininess);
            }
        }
        const double light_in = diffuse + ambient + ambient_slope * n.z;
        for (int c = 0; c < 3; ++c) colour[c] += albedo[c] * p.tint[c] * light_in + highlight;
    }
};

inline World make_world(const Array<double, 2> &primitives, const Array<float, 1> &texels, const Array<int64_t, 3> &table,
                 const Array<double, 2> &light_points, const Array<double, 1> &light, const Array<double, 2> &light_rects) {
    if (int(primitives.shape(1)) != kRecord) throw std::invalid_argument("render: primitive record length");
    World w;
    w.primitives = reinterpret_cast<const Primitive *>(primitives.data());
    w.count = int(primitives.shape(0));
    w.textures = {texels.data(), table.data(), int(table.shape(1))};
    const double *l = light.data();  // centre, frame, power, grid half width, grid cells, ambient, slope
    if (light.shape(0) != 17 || light_points.shape(1) != 3 || light_rects.shape(1) != 4 ||
        int(light_rects.shape(0)) != w.count)
        throw std::invalid_argument("render: light record");
    w.light = {light_points.data(), int(light_points.shape(0)), {l[0], l[1], l[2]},
               {{l[3], l[4], l[5]}, {l[6], l[7], l[8]}, {l[9], l[10], l[11]}}, l[12], l[13], int(l[14]), 0.0};
    w.ambient = l[15];
    w.ambient_slope = l[16];
    for (int j = 0; j < w.light.count; ++j) {
        const double *q = w.light.points + 3 * j;
        const Vec v = Vec{q[0], q[1], q[2]} - w.light.centre;
        w.light.radius = most(w.light.radius, std::sqrt(dot(v, v)));
    }
    for (int i = 0; i < w.count; ++i) {
        w.extent.push_back(half_extent(w.primitives[i]));
        w.reach.push_back(std::sqrt(dot(w.extent[i], w.extent[i])));
    }
    const int grid = w.light.grid;
    w.casters.resize(size_t(grid) * grid);
    for (int i = 0; i < w.count; ++i) {
        if (w.primitives[i].casts_shadow == 0) continue;
        w.all_casters.push_back(i);
        const double *rect = light_rects.data() + 4 * i;  // x0 y0 x1 y1 in tangents
        auto cell = [&](double v, int side) {
            const double g = floor_of((v / w.light.grid_half + 1.0) * 0.5 * grid) + side;
            return int(least(most(g, 0.0), double(grid - 1)));
        };
        const int x0 = cell(rect[0], -1), x1 = cell(rect[2], 1), y0 = cell(rect[1], -1), y1 = cell(rect[3], 1);
        for (int y = y0; y <= y1; ++y)
            for (int x = x0; x <= x1; ++x) w.casters[size_t(y) * grid + x].push_back(i);
    }
    return w;
}

}  // namespace lfrig::sim
