// Where a source's volume holds mass and how near its surface comes, tile by tile. Twin: occupancy.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

using U3 = ndarray<const uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using OutI3 = ndarray<int32_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using OutF2 = ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

// The greatest value of each plane among `count` pixels in a row, joined to what `most` holds.
LFRIG_CLONES void join_most(const uint16_t *__restrict pixels, int count, int planes, uint16_t *__restrict most) {
    for (int x = 0; x < count; ++x)
        for (int k = 0; k < planes; ++k) most[k] = std::max(most[k], pixels[size_t(x) * planes + k]);
}

// sums[y][x][k]: how many of the cells (tile row < y, tile column < x, plane < k) hold a value above the level.
void sum_occupied(U3 probability, int level, int tile, OutI3 sums, int threads) {
    const int height = int(probability.shape(0)), width = int(probability.shape(1)), planes = int(probability.shape(2));
    const int rows = (height + tile - 1) / tile, columns = (width + tile - 1) / tile;
    if (int(sums.shape(0)) != rows + 1 || int(sums.shape(1)) != columns + 1 || int(sums.shape(2)) != planes + 1)
        throw std::invalid_argument("occupancy: shapes do not match");
    const uint16_t *volume = probability.data();
    int32_t *out = sums.data();
    const size_t row_size = size_t(columns + 1) * (planes + 1);
    nb::gil_scoped_release release;
    std::fill(out, out + row_size, 0);
    lfrig::parallel_for(rows, threads, [&](int ty) {
        std::vector<uint16_t> most(planes);
        std::vector<int32_t> before(planes + 1, 0);  // of this row's tiles to the left
        int32_t *row = out + size_t(ty + 1) * row_size;
        std::fill(row, row + planes + 1, 0);
        for (int tx = 0; tx < columns; ++tx) {
            std::fill(most.begin(), most.end(), uint16_t(0));
            const int x0 = tx * tile, count = std::min(tile, width - x0);
            for (int y = ty * tile; y < std::min(height, (ty + 1) * tile); ++y)
                join_most(volume + (size_t(y) * width + x0) * planes, count, planes, most.data());
            int32_t *cell = row + size_t(tx + 1) * (planes + 1), along = 0;
            cell[0] = 0;
            for (int k = 0; k < planes; ++k) {
                along += most[k] > level;
                cell[k + 1] = before[k + 1] += along;
            }
        }
    });
    for (int ty = 1; ty < rows; ++ty) {
        const int32_t *above = out + size_t(ty) * row_size;
        int32_t *row = out + size_t(ty + 1) * row_size;
        for (size_t i = 0; i < row_size; ++i) row[i] += above[i];
    }
}

// Least and greatest value in each window of 2 x 2 tiles; a value that is not a number is as far away as can be.
void extremes(F2 disparity, int tile, OutF2 least, OutF2 greatest) {
    const int height = int(disparity.shape(0)), width = int(disparity.shape(1));
    const int rows = (height + tile - 1) / tile, columns = (width + tile - 1) / tile;
    if (int(least.shape(0)) != rows || int(least.shape(1)) != columns || int(greatest.shape(0)) != rows ||
        int(greatest.shape(1)) != columns)
        throw std::invalid_argument("extremes: shapes do not match");
    constexpr float kFar = std::numeric_limits<float>::infinity();
    const float *data = disparity.data();
    float *low = least.data(), *high = greatest.data();
    nb::gil_scoped_release release;
    std::fill(low, low + size_t(rows) * columns, kFar);
    std::fill(high, high + size_t(rows) * columns, -kFar);
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const float value = data[size_t(y) * width + x];
            const float d = value == value ? value : -kFar;
            const size_t i = size_t(y / tile) * columns + x / tile;
            low[i] = std::min(low[i], d);
            high[i] = std::max(high[i], d);
        }
    for (int y = 0; y < rows; ++y)
        for (int x = 0; x < columns; ++x) {
            const size_t i = size_t(y) * columns + x;
            const size_t right = x + 1 < columns ? 1 : 0, below = y + 1 < rows ? size_t(columns) : 0;
            low[i] = std::min(std::min(low[i], low[i + right]), std::min(low[i + below], low[i + below + right]));
            high[i] = std::max(std::max(high[i], high[i + right]), std::max(high[i + below], high[i + below + right]));
        }
}

}  // namespace

void register_occupancy(nb::module_ &m) {
    m.def("sum_occupied", &sum_occupied, nb::arg("probability").noconvert(), nb::arg("level"), nb::arg("tile"),
          nb::arg("sums").noconvert(), nb::arg("threads"));
    m.def("extremes", &extremes, nb::arg("disparity").noconvert(), nb::arg("tile"), nb::arg("least").noconvert(),
          nb::arg("greatest").noconvert());
}
