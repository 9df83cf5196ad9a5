// The simulator's ray tracer: radiance and depth of off-axis pinhole views. Twin: render_numpy.py.
//
// Every pixel is computed by one thread from its own hashed jitter, so the thread count changes nothing. Culling
// (screen rectangles per primitive, computed in culling.py) only skips primitives that cannot be met.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "camera.hpp"
#include "lenslet.hpp"
#include "lfrig/parallel.hpp"
#include "world.hpp"

namespace nb = nanobind;
using namespace lfrig::sim;

namespace {

constexpr int kTile = 16;

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
    bind_lenslets(m);
}
