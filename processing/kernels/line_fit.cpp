// Robust lines through points: the least median of residuals among candidates, and Tukey's biweight. Twin: line_fit.py.
//
// One thread: some hundred points are less than what starting threads costs, and sums in one order are the same bits
// everywhere.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kNormal = 1.4826;  // standard deviations of a normal distribution per median of magnitudes
constexpr double kTukey = 4.685;    // standard deviations from which a point does not count

struct Points {
    const double *x, *y;
    int count;
};

// Magnitudes of the residuals (what is no number counts as infinite), and how many are below a limit.
LFRIG_CLONES int magnitudes(const Points &p, double slope, double offset, double limit, double *out) {
    int below = 0;
    for (int k = 0; k < p.count; ++k) {
        const double distance = std::fabs(p.y[k] - (slope * p.x[k] + offset));
        const double known = distance <= kInfinity ? distance : kInfinity;
        out[k] = known;
        below += known < limit;
    }
    return below;
}

// The median, which changes the order.
double median(std::vector<double> &values) {
    const size_t half = values.size() / 2;
    std::nth_element(values.begin(), values.begin() + half, values.end());
    if (values.size() % 2) return values[half];
    return (*std::max_element(values.begin(), values.begin() + half) + values[half]) / 2;
}

int least_median(const Points &p, const double *slopes, const double *offsets, int candidates) {
    std::vector<double> values(size_t(p.count));
    double least = kInfinity;
    int best = 0;
    for (int k = 0; k < candidates; ++k) {
        // With fewer than half of the residuals below the least median, this one's is above.
        if (magnitudes(p, slopes[k], offsets[k], least, values.data()) < (p.count + 1) / 2) continue;
        const double found = median(values);
        if (found < least) {
            least = found;
            best = k;
        }
    }
    return best;
}

struct Prior {  // of slope and offset: values, and 1/σ², 0 where nothing is known
    double slope, offset, slope_precision, offset_precision;
};

struct Line {
    double slope, offset, scale;
};

Line biweight(const Points &p, Line line, const Prior &prior, double share, double floor, double settled,
              int iterations) {
    std::vector<double> values(size_t(p.count)), weights(size_t(p.count));
    for (int round = 0; round < iterations; ++round) {
        magnitudes(p, line.slope, line.offset, 0, values.data());
        line.scale = kNormal * median(values) + floor;
        double total = 0, mean = 0;
        for (int k = 0; k < p.count; ++k) {
            const double far = (p.y[k] - (line.slope * p.x[k] + line.offset)) / (kTukey * line.scale);
            const double near = 1 - far * far;
            weights[k] = near > 0 ? near * near : 0;
            total += weights[k];
            mean += weights[k] * p.x[k];
        }
        if (!(total > 0)) break;
        mean /= total;
        // Unknowns: slope and the level at the mean, so that the system is well conditioned.
        double steep = 0, right = 0, level = 0, reach = 0;
        for (int k = 0; k < p.count; ++k) {
            const double x = p.x[k] - mean, weighted = weights[k] * x;
            steep += weighted * x;
            right += weighted * p.y[k];
            level += weights[k] * p.y[k];
            reach = std::max(reach, std::fabs(x));
        }
        const double precision = share / (line.scale * line.scale), q = prior.offset_precision;
        // offset = level − mean · slope: the offset's prior is a row (−mean, 1).
        const double a = precision * steep + prior.slope_precision + mean * mean * q, b = -mean * q;
        const double c = precision * total + q, determinant = a * c - b * b;
        if (!(a > 0) || !(determinant > 0)) break;
        const double by_slope = precision * right + prior.slope * prior.slope_precision - mean * prior.offset * q;
        const double by_level = precision * level + prior.offset * q;
        const double slope = (c * by_slope - b * by_level) / determinant;
        const double offset = (a * by_level - b * by_slope) / determinant - slope * mean;
        const double moved = std::fabs(slope - line.slope) * reach + std::fabs(offset - line.offset);
        line.slope = slope;
        line.offset = offset;
        if (moved < settled * line.scale) break;
    }
    return line;
}

using Values = ndarray<const double, nb::ndim<1>, nb::c_contig, nb::device::cpu>;

Points points_of(const Values &x, const Values &y) {
    if (x.shape(0) == 0 || x.shape(0) != y.shape(0)) throw std::invalid_argument("line_fit: shapes do not match");
    return {x.data(), y.data(), int(x.shape(0))};
}

}  // namespace

void register_line_fit(nb::module_ &m) {
    m.def(
        "line_least_median",
        [](Values x, Values y, Values slopes, Values offsets) {
            const Points p = points_of(x, y);
            if (slopes.shape(0) != offsets.shape(0) || slopes.shape(0) == 0)
                throw std::invalid_argument("line_fit: candidates do not match");
            nb::gil_scoped_release release;
            return least_median(p, slopes.data(), offsets.data(), int(slopes.shape(0)));
        },
        "Index of the candidate line with the least median residual");
    m.def(
        "line_biweight",
        [](Values x, Values y, Values prior, double slope, double offset, double share, double floor, double settled,
           int iterations, ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu> out) {
            const Points p = points_of(x, y);
            if (prior.shape(0) != 4 || out.shape(0) != 3)
                throw std::invalid_argument("line_fit: shapes do not match");
            nb::gil_scoped_release release;
            const Line line = biweight(p, {slope, offset, floor}, {prior(0), prior(1), prior(2), prior(3)}, share,
                                       floor, settled, iterations);
            out(0) = line.slope;
            out(1) = line.offset;
            out(2) = line.scale;
        },
        "Slope, offset and scatter by Tukey's biweight");
}
