// Corners followed through the views of a light field, by one disparity each. Twin: corner_disparity.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <stdexcept>

#include "lfrig/parallel.hpp"
#include "parts/patch_window.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kRun = 16;  // longest row of a square patch that is copied as a whole

struct Layout {  // of a window's pixels, which are whole ones
    int reach = 0;  // furthest one
    int side = 0;   // of a square in order of rows; 0 = another shape
    int col[kMaxPixels], row[kMaxPixels];
};

Layout layout_of(const Window &w, int pixels) {
    Layout out;
    for (int k = 0; k < w.count; ++k) {
        out.col[k] = int(w.dx[k]);
        out.row[k] = int(w.dy[k]);
        out.reach = std::max({out.reach, std::abs(out.col[k]), std::abs(out.row[k])});
    }
    const int side = 2 * out.reach + 1;
    bool square = pixels == side * side && side <= kRun;
    for (int k = 0; square && k < pixels; ++k)
        square = out.col[k] == k % side - out.reach && out.row[k] == k / side - out.reach;
    out.side = square ? side : 0;
    return out;
}

struct View {
    const uint8_t *picture;  // [height, width]
    int height, width;
    double x, y;  // from the centre view [view steps]
};

struct Views {
    const uint8_t *pictures;  // [V, H, W]
    const double *offsets;    // [V, 2] x, y of the view from the centre view
    int count, height, width;

    LFRIG_INLINE View at(int v) const {
        return {pictures + size_t(v) * height * width, height, width, offsets[2 * v], offsets[2 * v + 1]};
    }
};

struct Neighbours {  // of a patch's pixels in a view: upper left and right, lower left and right
    uint8_t grey[4][kMaxPixels + kRun];
};

LFRIG_INLINE void read_neighbours(const View &view, const Window &w, const Layout &l, int x0, int y0, Neighbours &out) {
    const int height = view.height, width = view.width;
    if (x0 >= l.reach && y0 >= l.reach && x0 + l.reach + 1 < width && y0 + l.reach + 1 < height) {
        const uint8_t *middle = view.picture + size_t(y0) * width + x0, *last = view.picture + size_t(height) * width;
        const uint8_t *corner = middle - l.reach * width - l.reach;
        if (l.side > 0 && corner + size_t(l.side) * width + kRun + 1 <= last) {
            // Whole runs: what is too much of one is overwritten by the next.
            for (int j = 0; j < l.side; ++j) {
                const uint8_t *p = corner + size_t(j) * width, *q = p + width;
                std::memcpy(out.grey[0] + j * l.side, p, kRun);
                std::memcpy(out.grey[1] + j * l.side, p + 1, kRun);
                std::memcpy(out.grey[2] + j * l.side, q, kRun);
                std::memcpy(out.grey[3] + j * l.side, q + 1, kRun);
            }
            return;
        }
        for (int k = 0; k < w.count; ++k) {
            const uint8_t *p = middle + l.row[k] * width + l.col[k], *q = p + width;
            out.grey[0][k] = p[0], out.grey[1][k] = p[1], out.grey[2][k] = q[0], out.grey[3][k] = q[1];
        }
        return;
    }
    for (int k = 0; k < w.count; ++k) {  // the border is replicated
        const int i = x0 + l.col[k], j = y0 + l.row[k];
        const int left = std::clamp(i, 0, width - 1), next = std::clamp(i + 1, 0, width - 1);
        const uint8_t *p = view.picture + size_t(std::clamp(j, 0, height - 1)) * width;
        const uint8_t *q = view.picture + size_t(std::clamp(j + 1, 0, height - 1)) * width;
        out.grey[0][k] = p[left], out.grey[1][k] = p[next], out.grey[2][k] = q[left], out.grey[3][k] = q[next];
    }
}

// Adds to the two sums of Gauss–Newton on a disparity what one view says of a patch whose middle lies at x, y there.
LFRIG_INLINE void compare_view(const View &view, double x, double y, const Window &w, const Layout &layout,
                               const Sampled &patch, float robust, float &slope, float &right) {
    alignas(64) float error[kMaxPixels];
    alignas(64) Neighbours at = {};
    // A patch is not turned or stretched: all its pixels lie at the same fraction between theirs.
    x = x > -1e6 ? std::min(x, 1e6) : -1e6;
    y = y > -1e6 ? std::min(y, 1e6) : -1e6;
    const int x0 = int(std::floor(x)), y0 = int(std::floor(y));
    const float fx = float(x - x0), fy = float(y - y0);
    read_neighbours(view, w, layout, x0, y0, at);
    for (int k = 0; k < w.count; ++k) {
        const float a = at.grey[0][k], b = at.grey[1][k], c = at.grey[2][k], d = at.grey[3][k];
        const float top = a + fx * (b - a), low = c + fx * (d - c);
        error[k] = top + fy * (low - top);
    }
    float lanes[kLanes] = {};
    for (int k = 0; k < w.count; k += kLanes)
        for (int l = 0; l < kLanes; ++l) {
            error[k + l] -= patch.grey[k + l];
            lanes[l] += error[k + l] * w.weight[k + l];
        }
    const float mean = sum_of(lanes), ox = float(view.x), oy = float(view.y);
    float slopes[kLanes] = {}, rights[kLanes] = {};
    for (int k = 0; k < w.count; k += kLanes)
        for (int l = 0; l < kLanes; ++l) {
            const float e = error[k + l] - mean, scaled = e * robust;
            const float derivative = -(ox * patch.slope_x[k + l] + oy * patch.slope_y[k + l]);
            const float weighted = w.weight[k + l] / (1 + scaled * scaled) * derivative;
            slopes[l] += weighted * derivative;
            rights[l] += weighted * e;
        }
    slope += sum_of(slopes);
    right += sum_of(rights);
}

struct Settings {
    int passes;
    double max_step, settled, robust;
};

LFRIG_CLONES void follow_range(const Views &views, const Window &w, const Layout &layout, const Settings &set,
                               const float *grey, const float *slope_x, const float *slope_y, int pixels,
                               const double *xy, double *disparity, double *last, int begin, int end) {
    alignas(64) Sampled patch = {};
    for (int n = begin; n < end; ++n) {
        std::copy(grey + size_t(n) * pixels, grey + size_t(n + 1) * pixels, patch.grey);
        std::copy(slope_x + size_t(n) * pixels, slope_x + size_t(n + 1) * pixels, patch.slope_x);
        std::copy(slope_y + size_t(n) * pixels, slope_y + size_t(n + 1) * pixels, patch.slope_y);
        for (int pass = 0; pass < set.passes; ++pass) {
            float slope = 1e-9f, right = 0;
            for (int v = 0; v < views.count; ++v) {
                const View view = views.at(v);
                const double x = xy[2 * n] - view.x * disparity[n], y = xy[2 * n + 1] - view.y * disparity[n];
                compare_view(view, x, y, w, layout, patch, float(1 / set.robust), slope, right);
            }
            last[n] = -double(right) / double(slope);
            disparity[n] += std::clamp(last[n], -set.max_step, set.max_step);
            if (std::fabs(last[n]) < set.settled) break;
        }
    }
}

using Patch = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

}  // namespace

void register_corner_disparity(nb::module_ &m) {
    m.def(
        "follow_disparities",
        [](ndarray<const uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> pictures, Points offsets, Patch grey,
           Patch slope_x, Patch slope_y, Line dx, Line dy, Line weight, Points xy, int passes, double max_step,
           double settled, double robust, ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu> disparity,
           ndarray<double, nb::ndim<1>, nb::c_contig, nb::device::cpu> last, int threads) {
            const size_t count = xy.shape(0), pixels = dx.shape(0);
            for (const Patch &p : {grey, slope_x, slope_y})
                if (p.shape(0) != count || p.shape(1) != pixels)
                    throw std::invalid_argument("follow_disparities: patches of a wrong shape");
            if (offsets.shape(0) != pictures.shape(0) || offsets.shape(1) != 2 || xy.shape(1) != 2 ||
                disparity.shape(0) != count || last.shape(0) != count || pictures.size() == 0)
                throw std::invalid_argument("follow_disparities: shapes do not match");
            const Window w = window_of(dx, dy, weight);
            const Layout layout = layout_of(w, int(pixels));
            const Settings set{passes, max_step, settled, robust};
            const Views views{pictures.data(), offsets.data(), int(pictures.shape(0)), int(pictures.shape(1)),
                              int(pictures.shape(2))};
            nb::gil_scoped_release release;
            const int items = int((count + kPointsPerItem - 1) / kPointsPerItem);
            lfrig::parallel_for(items, threads, [&](int item) {
                follow_range(views, w, layout, set, grey.data(), slope_x.data(), slope_y.data(), int(pixels),
                             xy.data(), disparity.data(), last.data(), item * kPointsPerItem,
                             std::min(int(count), (item + 1) * kPointsPerItem));
            });
        },
        "Follow patches of a centre view through other views by one disparity each; disparity is start and result");
}
