// Radiance on the pixels of a plenoptic sensor: one colour each, through the lens that the pixel lies under.
// Twin: plenoptic/render_numpy.py. As in render.cpp, every pixel is computed by one thread from its own jitter.
#include "lenslet.hpp"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "camera.hpp"
#include "lfrig/parallel.hpp"
#include "world.hpp"

namespace nb = nanobind;

namespace lfrig::sim {
namespace {

constexpr int kTile = 32;  // sensor pixels

// Layout as in Lattice.record (plenoptic/lattice.py): lens (i, j) at (i + (j mod 2)/2) pitch, j row_pitch, turned by
// (cos, sin) from the sensor's x towards its y and moved to the origin.
struct Lattice {
    double pitch, row_pitch, cosine, sine, x0, y0;
};

struct Point {
    double x, y;
};

// Offset of a point from the nearest lens, both in the lattice's axes. No lens outside the two rows around the point
// can be the nearest: one within them is never further away than 0.58 pitch.
inline Point from_nearest_lens(Point g, double pitch, double row_pitch) {
    const double below = floor_of(g.y / row_pitch);
    Point best{0, 0};
    double nearest = kMiss;
    for (int k = 0; k < 2; ++k) {
        const double row = below + double(k), shift = 0.5 * (row - 2.0 * floor_of(0.5 * row));
        const double column = floor_of(g.x / pitch - shift + 0.5);
        const double dx = g.x - (column + shift) * pitch, dy = g.y - row * row_pitch, d = dx * dx + dy * dy;
        if (d < nearest) nearest = d, best = {dx, dy};
    }
    return best;
}

struct Sensor {
    Lattice lattice;
    int height, width;
    const uint8_t *colours;  // [2, 2]: which colour pixel (x, y) sees, at [y mod 2, x mod 2]

    Point in_lattice(double x, double y) const {
        const double dx = x - lattice.x0, dy = y - lattice.y0;
        return {lattice.cosine * dx + lattice.sine * dy, lattice.cosine * dy - lattice.sine * dx};
    }
    // Where the middle of the sensor is: the principal point of the views.
    Point middle() const { return in_lattice(double(width - 1) * 0.5, double(height - 1) * 0.5); }
};

struct Sampling {
    int side;
    uint32_t seed;
};

// Pixels x0..x1 − 1 of row y. Flattened, so that all of the inner loop exists per instruction set.
LFRIG_CLONES __attribute__((flatten)) void shade_lenslets(const World &world, const Camera &k, const Sensor &sensor,
                                                          const Sampling &how, int y, int x0, int x1,
                                                          const std::vector<int> &candidates, const double *near_depth,
                                                          float *row) {
    const Lattice &l = sensor.lattice;
    const Point middle = sensor.middle();
    const int samples = how.side * how.side;
    const double step = 1.0 / double(how.side), sample_angle = step / k.focal, row_step = l.row_pitch / l.pitch;
    for (int x = x0; x < x1; ++x) {
        const uint32_t pixel = hash32(how.seed + uint32_t(y) * uint32_t(sensor.width) + uint32_t(x));
        const int colour = sensor.colours[(y & 1) * 2 + (x & 1)];
        const Point g = sensor.in_lattice(x, y), offset = from_nearest_lens(g, l.pitch, l.row_pitch);
        const double lens_x = (g.x - offset.x - middle.x) / l.pitch + k.cx;
        const double lens_y = (g.y - offset.y - middle.y) / l.pitch + k.cy;
        // Each pixel moves the pattern of its samples over the lens: in itself it favours parts of the hexagon.
        const double shift_a = unit(hash32(pixel + 1000U)), shift_b = unit(hash32(pixel + 1001U));
        double total[3] = {0, 0, 0};
        for (int s = 0; s < samples; ++s) {
            const uint32_t key = pixel + uint32_t(s) * 4U;
            // Multi-jittered, as in render.cpp, over the lens and over the pixel. Over the lens: a parallelogram that
            // tiles as the lenses do, each point of it moved by whole lenses to where it lies on this one.
            const double i = double(s % how.side), j = double(s / how.side);
            const double a = (i + (j + unit(hash32(key))) * step) * step + shift_a;
            const double b = (j + (i + unit(hash32(key + 1U))) * step) * step + shift_b;
            const Point on_lens = from_nearest_lens({a + 0.5 * b, b * row_step}, 1.0, row_step);
            const double px = (j + unit(hash32(key + 2U))) * step - 0.5, py = (i + unit(hash32(key + 3U))) * step - 0.5;
            const double du = offset.x + (l.cosine * px + l.sine * py), dv = offset.y + (l.cosine * py - l.sine * px);
            const Ray ray = view_ray(k, lens_x + on_lens.x, lens_y + on_lens.y, du, dv);
            int index;
            const Hit hit = world.nearest(ray, candidates, near_depth, index);
            if (index >= 0) world.shade(ray, hit, index, sample_angle, s, samples, total);
        }
        row[x] = float(total[colour] / double(samples));
    }
}

// The part of the view that the pixels x0..x1, y0..y1 (inclusive) see, with a lens's width around it.
void seen_part(const Camera &k, const Sensor &sensor, double x0, double y0, double x1, double y1, double out[4]) {
    const Point middle = sensor.middle();
    out[0] = out[1] = kMiss;
    out[2] = out[3] = -kMiss;
    for (int corner = 0; corner < 4; ++corner) {
        const Point g = sensor.in_lattice(corner & 1 ? x1 : x0, corner & 2 ? y1 : y0);
        const double x = (g.x - middle.x) / sensor.lattice.pitch + k.cx;
        const double y = (g.y - middle.y) / sensor.lattice.pitch + k.cy;
        out[0] = least(out[0], x - 1.25);
        out[1] = least(out[1], y - 1.25);
        out[2] = most(out[2], x + 1.25);
        out[3] = most(out[3], y + 1.25);
    }
}

void lenslets(Array<double, 2> primitives, Array<float, 1> texels, Array<int64_t, 3> table,
              Array<double, 2> light_points, Array<double, 1> light, Array<double, 2> light_rects,
              Array<double, 1> camera, Array<double, 1> lattice, Array<double, 2> rects, Array<double, 1> near_depth,
              Array<uint8_t, 2> colours, uint32_t seed, int side, int first_row, int sensor_height,
              Output<float, 2> out, int threads) {
    const World world = make_world(primitives, texels, table, light_points, light, light_rects);
    if (camera.shape(0) != 17 || lattice.shape(0) != 6 || int(rects.shape(0)) != world.count || rects.shape(1) != 4 ||
        int(near_depth.shape(0)) != world.count || colours.shape(0) != 2 || colours.shape(1) != 2 || side < 1 ||
        first_row < 0 || first_row + int(out.shape(0)) > sensor_height)
        throw std::invalid_argument("lenslets: shapes do not match");
    const Camera &k = *reinterpret_cast<const Camera *>(camera.data());
    const int height = int(out.shape(0)), width = int(out.shape(1));
    const Sensor sensor{*reinterpret_cast<const Lattice *>(lattice.data()), sensor_height, width, colours.data()};
    const Sampling how{side, seed};
    float *pixels = out.data();
    nb::gil_scoped_release release;
    const int last = first_row + height;
    lfrig::parallel_for((height + kTile - 1) / kTile, threads, [&](int band) {
        const int y0 = first_row + band * kTile, y1 = std::min(y0 + kTile, last);
        std::vector<int> candidates;
        double part[4];
        for (int x0 = 0; x0 < width; x0 += kTile) {
            const int x1 = std::min(x0 + kTile, width);
            seen_part(k, sensor, x0, y0, x1 - 1, y1 - 1, part);
            tile_candidates(rects.data(), near_depth.data(), world.count, part[0], part[1], part[2], part[3],
                            candidates);
            for (int y = y0; y < y1; ++y)
                shade_lenslets(world, k, sensor, how, y, x0, x1, candidates, near_depth.data(),
                               pixels + size_t(y - first_row) * width);
        }
    });
}

}  // namespace

void bind_lenslets(nb::module_ &m) { m.def("lenslets", &lenslets); }

}  // namespace lfrig::sim
