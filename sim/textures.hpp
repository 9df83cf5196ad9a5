// Mip-mapped textures: trilinear lookup with wrapped borders. Twin: render_numpy.py.
#pragma once
#include <algorithm>
#include <cmath>
#include <cstdint>

#include "primitives.hpp"

namespace lfrig::sim {

// One row per (texture, level) in `table`: (first texel, width, height); sizes are powers of two.
struct Textures {
    const float *texels;
    const int64_t *table;
    int levels;

    void bilinear(int texture, int level, double u, double v, double out[3]) const {
        const int64_t *entry = table + (size_t(texture) * levels + level) * 3;
        const int64_t width = entry[1], height = entry[2];
        const double x = (u - floor_of(u)) * double(width) - 0.5, y = (v - floor_of(v)) * double(height) - 0.5;
        const double floor_x = floor_of(x), floor_y = floor_of(y), fx = x - floor_x, fy = y - floor_y;
        const int64_t x0 = int64_t(floor_x) & (width - 1), x1 = (x0 + 1) & (width - 1);
        const int64_t y0 = int64_t(floor_y) & (height - 1), y1 = (y0 + 1) & (height - 1);
        const float *top = texels + entry[0] + y0 * width * 3, *bottom = texels + entry[0] + y1 * width * 3;
        for (int c = 0; c < 3; ++c) {
            const double a = double(top[x0 * 3 + c]) * (1.0 - fx) + double(top[x1 * 3 + c]) * fx;
            const double b = double(bottom[x0 * 3 + c]) * (1.0 - fx) + double(bottom[x1 * 3 + c]) * fx;
            out[c] = a * (1.0 - fy) + b * fy;
        }
    }

    // `footprint` is the width of the sample on the surface in texels of level 0.
    void trilinear(int texture, double u, double v, double footprint, double out[3]) const {
        const double lod = least(std::log2(most(footprint, 1.0)), double(levels - 1));
        const int level = std::min(int(lod), levels - 1);
        const double f = lod - double(level);
        bilinear(texture, level, u, v, out);
        if (f <= 0.0 || level + 1 >= levels) return;
        double coarse[3];
        bilinear(texture, level + 1, u, v, coarse);
        for (int c = 0; c < 3; ++c) out[c] = out[c] * (1.0 - f) + coarse[c] * f;
    }
};

}  // namespace lfrig::sim
