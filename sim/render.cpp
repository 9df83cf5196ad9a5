// The simulator's ray tracer: radiance and depth of off-axis pinhole views. Twin: render_numpy.py.
//
// Every pixel is computed by one thread from its own hashed jitter, so the thread count changes nothing. Culling
// (screen rectangles per primitive, computed in culling.py) only skips primitives that cannot be met.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"
#include "primitives.hpp"
#include "textures.hpp"

namespace nb = nanobind;
using namespace lfrig::sim;

namespace {

template <class T, int N>
using Array = nb::ndarray<const T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class T, int N>
using Output = nb::ndarray<T, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

constexpr int kTile = 16;

// hash32 of Wellons' search for low-bias 32-bit integer mixers ("lowbias32").
inline uint32_t hash32(uint32_t h) {
    h ^= h >> 16;
    h *= 0x7feb352dU;
    h ^= h >> 15;
    h *= 0x846ca68bU;
    h ^= h >> 16;
    return h;
}
inline double unit(uint32_t h) { return double(h) * (1.0 / 4294967296.0); }

// Layout as in renderer.py: camera_from_world row-major, centre, F, cx, cy, baseline, focus distance.
struct Camera {
    double rotation[9], centre[3], focal, cx, cy, baseline, focus;
};

struct Ray {
    Vec origin, direction;
    double depth_per_t;
};

// Through the pixel (px, py) of the view whose centre of projection lies (du, dv) view steps off the axis.
inline Ray view_ray(const Camera &k, double px, double py, double du, double dv) {
    const double sx = du * k.baseline, sy = dv * k.baseline;
    const double ax = (px - k.cx) / k.focal * k.focus - sx, ay = (py - k.cy) / k.focal * k.focus - sy, az = k.focus;
    const double scale = 1.0 / std::sqrt(ax * ax + ay * ay + az * az);
    const double *r = k.rotation;
    const Vec d{(r[0] * ax + r[3] * ay + r[6] * az) * scale, (r[1] * ax + r[4] * ay + r[7] * az) * scale,
                (r[2] * ax + r[5] * ay + r[8] * az) * scale};
    const Vec o{k.centre[0] + r[0] * sx + r[3] * sy, k.centre[1] + r[1] * sx + r[4] * sy,
                k.centre[2] + r[2] * sx + r[5] * sy};
    return {o, d, az * scale};
}

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

World make_world(const Array<double, 2> &primitives, const Array<float, 1> &texels, const Array<int64_t, 3> &table,
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

// Primitives that the pixels x0..x1, y0..y1 (inclusive) may meet, nearest first.
void tile_candidates(const double *rects, const double *near_depth, int count, double x0, double y0, double x1,
                     double y1, std::vector<int> &out) {
    out.clear();
    for (int i = 0; i < count; ++i) {
        const double *r = rects + 4 * i;
        if (r[0] <= x1 && r[2] >= x0 && r[1] <= y1 && r[3] >= y0) out.push_back(i);
    }
    std::sort(out.begin(), out.end(), [&](int a, int b) {
        return near_depth[a] < near_depth[b] || (near_depth[a] == near_depth[b] && a < b);
    });
}

// Calls fn(view, y, x0, x1, candidates) for every row of every tile.
template <class F>
void for_tiles(int views, int height, int width, int count, const double *rects, const double *near_depth, int threads,
               F &&fn) {
    const int bands = (height + kTile - 1) / kTile;
    lfrig::parallel_for(views * bands, threads, [&](int item) {
        const int view = item / bands, y0 = item % bands * kTile, y1 = std::min(y0 + kTile, height);
        const double *view_rects = rects + size_t(view) * count * 4, *view_near = near_depth + size_t(view) * count;
        std::vector<int> candidates;
        for (int x0 = 0; x0 < width; x0 += kTile) {
            const int x1 = std::min(x0 + kTile, width);
            tile_candidates(view_rects, view_near, count, x0 - 0.5, y0 - 0.5, x1 - 0.5, y1 - 0.5, candidates);
            for (int y = y0; y < y1; ++y) fn(view, y, x0, x1, candidates, view_near);
        }
    });
}

struct Sampling {
    int side;
    double aperture;
    uint32_t seed;
    double row, col;  // offset of the view
};

// Pixels x0..x1 − 1 of row y of one view. Flattened, so that all of the inner loop exists per instruction set.
LFRIG_CLONES __attribute__((flatten)) void shade_row(const World &world, const Camera &k, const Sampling &how, int y,
                                                     int x0, int x1, int width, const std::vector<int> &candidates,
                                                     const double *near_depth, float *row) {
    const int samples = how.side * how.side;
    const double step = 1.0 / double(how.side), sample_angle = step / k.focal;
    for (int x = x0; x < x1; ++x) {
        const uint32_t pixel = hash32(how.seed + uint32_t(y) * uint32_t(width) + uint32_t(x));
        double colour[3] = {0, 0, 0};
        for (int s = 0; s < samples; ++s) {
            const uint32_t key = pixel + uint32_t(s) * 4U;
            // Multi-jittered (Chiu, Shirley & Wang 1994): every sample has its own column and its own row of the pixel.
            const double i = double(s % how.side), j = double(s / how.side);
            const double px = double(x) + ((i + (j + unit(hash32(key))) * step) * step - 0.5);
            const double py = double(y) + ((j + (i + unit(hash32(key + 1U))) * step) * step - 0.5);
            const double du = how.col + ((j + unit(hash32(key + 2U))) * step - 0.5) * how.aperture;
            const double dv = how.row + ((i + unit(hash32(key + 3U))) * step - 0.5) * how.aperture;
            const Ray ray = view_ray(k, px, py, du, dv);
            int index;
            const Hit hit = world.nearest(ray, candidates, near_depth, index);
            if (index >= 0) world.shade(ray, hit, index, sample_angle, s, samples, colour);
        }
        for (int c = 0; c < 3; ++c) row[3 * x + c] = float(colour[c] / double(samples));
    }
}

void radiance(Array<double, 2> primitives, Array<float, 1> texels, Array<int64_t, 3> table,
              Array<double, 2> light_points, Array<double, 1> light, Array<double, 2> light_rects,
              Array<double, 1> camera, Array<double, 2> offsets, Array<double, 3> rects, Array<double, 2> near_depth,
              Array<uint32_t, 1> view_seeds, int side, double aperture, Output<float, 4> out, int threads) {
    const World world = make_world(primitives, texels, table, light_points, light, light_rects);
    const int views = int(offsets.shape(0)), height = int(out.shape(1)), width = int(out.shape(2));
    if (camera.shape(0) != 17 || int(out.shape(0)) != views || out.shape(3) != 3 || int(rects.shape(0)) != views ||
        int(rects.shape(1)) != world.count || int(near_depth.shape(1)) != world.count ||
        int(view_seeds.shape(0)) != views || side < 1)
        throw std::invalid_argument("render: shapes do not match");
    const Camera &k = *reinterpret_cast<const Camera *>(camera.data());
    const double *offset = offsets.data();
    const uint32_t *seeds = view_seeds.data();
    float *pixels = out.data();
    nb::gil_scoped_release release;
    for_tiles(views, height, width, world.count, rects.data(), near_depth.data(), threads,
              [&](int view, int y, int x0, int x1, const std::vector<int> &candidates, const double *near_z) {
        const Sampling how{side, aperture, seeds[view], offset[2 * view], offset[2 * view + 1]};
        shade_row(world, k, how, y, x0, x1, width, candidates, near_z,
                  pixels + (size_t(view) * height + y) * width * 3);
    });
}

void depth(Array<double, 2> primitives, Array<double, 1> camera, Array<double, 2> offsets, Array<double, 3> rects,
           Array<double, 2> near_depth, Output<float, 3> out, int threads) {
    const int views = int(offsets.shape(0)), height = int(out.shape(1)), width = int(out.shape(2));
    World world{};
    world.primitives = reinterpret_cast<const Primitive *>(primitives.data());
    world.count = int(primitives.shape(0));
    if (int(primitives.shape(1)) != kRecord || camera.shape(0) != 17 || int(out.shape(0)) != views ||
        int(rects.shape(0)) != views || int(rects.shape(1)) != world.count || int(near_depth.shape(1)) != world.count)
        throw std::invalid_argument("render: shapes do not match");
    const Camera &k = *reinterpret_cast<const Camera *>(camera.data());
    const double *offset = offsets.data();
    float *pixels = out.data();
    nb::gil_scoped_release release;
    for_tiles(views, height, width, world.count, rects.data(), near_depth.data(), threads,
              [&](int view, int y, int x0, int x1, const std::vector<int> &candidates, const double *near_z) {
        for (int x = x0; x < x1; ++x) {
            const Ray ray = view_ray(k, x, y, offset[2 * view + 1], offset[2 * view]);
            int index;
            const Hit hit = world.nearest(ray, candidates, near_z, index);
            pixels[(size_t(view) * height + y) * width + x] = float(hit.t * ray.depth_per_t);
        }
    });
}

}  // namespace

NB_MODULE(_render, m) {
    m.doc() = "The simulator's ray tracer; its NumPy twin is lfrig.sim.render_numpy.";
    m.attr("RECORD_LENGTH") = kRecord;
    m.def("radiance", &radiance);
    m.def("depth", &depth);
}
