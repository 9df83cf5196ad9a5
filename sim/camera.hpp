// Cameras and rays of the native ray tracer, and which primitives a patch of a view may meet. Twins: optics.py,
// render_numpy.py.
#pragma once
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "world.hpp"

namespace lfrig::sim {

template <class T, int N>
using Output = nanobind::ndarray<T, nanobind::ndim<N>, nanobind::c_contig, nanobind::device::cpu>;

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

// Layout as in SimCamera.record (optics.py): camera_from_world row-major, centre, F, cx, cy, baseline, focus distance.
struct Camera {
    double rotation[9], centre[3], focal, cx, cy, baseline, focus;
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

// Primitives that the pixels x0..x1, y0..y1 (inclusive) may meet, nearest first.
inline void tile_candidates(const double *rects, const double *near_depth, int count, double x0, double y0, double x1,
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

}  // namespace lfrig::sim
