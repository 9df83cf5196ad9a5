// Planes that spread from seeds along shortest paths, as far as they do not float before what a source sees.
// Twin: spread.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <functional>
#include <queue>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "parts/ways.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

struct Seed {
    int32_t x, y;
    float value, slope_x, slope_y;
};

// The seed's plane at (x, y); slopes are followed up to `reach`.
inline float plane_at(const Seed &s, int x, int y, float reach) {
    const float dx = float(x - s.x), dy = float(y - s.y);
    const float away = std::max(std::sqrt(dx * dx + dy * dy), 1.0f);
    return s.value + (s.slope_x * dx + s.slope_y * dy) * std::min(1.0f, reach / away);
}

bool floats(const std::vector<Way> &ways, int x, int y, float inverse_depth, float most) {
    for (const Way &way : ways) {
        const Spot spot = land(way, float(x), float(y), inverse_depth);
        if (spot.inside && -ahead(way, spot) > most) return true;
    }
    return false;
}

using I2 = ndarray<const int32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using U2 = ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using U3 = ndarray<const uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// domain uint8 [H, W]; guide uint8 [H, W, 3]; places int32 [M, 2] (x, y) and planes float32 [M, 3] of the seeds; out
// int32 [H, W]. See spread.py.
void spread(U2 domain, U3 guide, I2 places, Grid planes, const Maps &disparity, const Flats &numbers, int straight,
            int diagonal, int step_grey, float reach, float most, int longest,
            ndarray<int32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu> out) {
    const int height = int(domain.shape(0)), width = int(domain.shape(1)), count = int(places.shape(0));
    const size_t area = size_t(height) * size_t(width);
    if (guide.size() != 3 * area || out.size() != area || places.shape(1) != 2 || int(planes.shape(0)) != count ||
        planes.shape(1) != 3)
        throw std::invalid_argument("spread: shapes do not match");
    const std::vector<Way> ways = ways_of(disparity, numbers);
    std::vector<Seed> seeds;
    for (int i = 0; i < count; ++i) {
        const int32_t *at = places.data() + 2 * i;
        const float *plane = planes.data() + 3 * i;
        if (at[0] < 0 || at[0] >= width || at[1] < 0 || at[1] >= height)
            throw std::invalid_argument("spread: a seed lies outside the map");
        seeds.push_back({at[0], at[1], plane[0], plane[1], plane[2]});
    }
    const uint8_t *inside = domain.data(), *colour = guide.data();
    int32_t *seed_of = out.data();
    nb::gil_scoped_release release;
    std::fill(seed_of, seed_of + area, -1);
    std::vector<int32_t> length(area, INT32_MAX), steps(area, 0);
    // Nearest first, of equal paths that of the first seed: the order of the visits changes nothing.
    using Entry = std::tuple<int32_t, int32_t, int32_t>;  // length, seed, pixel
    std::priority_queue<Entry, std::vector<Entry>, std::greater<Entry>> open;
    for (int i = count - 1; i >= 0; --i) {
        const int32_t pixel = seeds[size_t(i)].y * width + seeds[size_t(i)].x;
        length[size_t(pixel)] = 0, seed_of[pixel] = i;
        open.emplace(0, i, pixel);
    }
    while (!open.empty()) {
        const auto [reached, seed, pixel] = open.top();
        open.pop();
        if (reached != length[size_t(pixel)] || seed != seed_of[pixel] || steps[size_t(pixel)] >= longest) continue;
        const int x0 = pixel % width, y0 = pixel / width;
        for (int dy = -1; dy <= 1; ++dy)
            for (int dx = -1; dx <= 1; ++dx) {
                const int x = x0 + dx, y = y0 + dy;
                if (x < 0 || x >= width || y < 0 || y >= height || !inside[y * width + x]) continue;
                const int32_t next = y * width + x;
                int rough = step_grey;
                for (int c = 0; c < 3; ++c) rough += std::abs(int(colour[3 * next + c]) - int(colour[3 * pixel + c]));
                const int32_t proposed = reached + (dx && dy ? diagonal : straight) * rough;
                if (std::tie(proposed, seed) >= std::tie(length[size_t(next)], seed_of[next])) continue;
                if (floats(ways, x, y, plane_at(seeds[size_t(seed)], x, y, reach), most)) continue;
                length[size_t(next)] = proposed, seed_of[next] = seed;
                steps[size_t(next)] = steps[size_t(pixel)] + 1;
                open.emplace(proposed, seed, next);
            }
    }
}

}  // namespace

void register_spread(nb::module_ &m) {
    m.def("spread", &spread, nb::arg("domain").noconvert(), nb::arg("guide").noconvert(),
          nb::arg("places").noconvert(), nb::arg("planes").noconvert(), nb::arg("disparity"),
          nb::arg("numbers"), nb::arg("straight"), nb::arg("diagonal"), nb::arg("step_grey"),
          nb::arg("reach"), nb::arg("most"), nb::arg("longest"), nb::arg("out").noconvert());
}
