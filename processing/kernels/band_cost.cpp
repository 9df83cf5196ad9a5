// Wide-baseline matching in a narrow band: slanted, bilateral ZNCC of the photo against one source. Twin: band_cost.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstdint>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kMaxLabels = 128, kMaxTaps = 441;

struct Taps {
    int count = 0;
    float weight[kMaxTaps], grey[kMaxTaps], dx[kMaxTaps], dy[kMaxTaps];
};

struct Band {
    int height, width, source_height, source_width, labels, radius, stride;
    const float *photo;    // [H, W] grey
    const uint8_t *guide;  // [H, W, 3]
    const float *source;   // [Hs, Ws] grey
    const float *visible;  // [H, W] 0..1
    const float *depth, *slope_x, *slope_y;  // [H, W] inverse depth of the middle label, and its slopes per pixel
    float map[12];  // A row-major, then b: p = A (x, y, 1) + b w
    float step, sigma_grey, noise, cap;
};

// The patch of one pixel: neighbours of its colour weigh most.
void collect(const Band &s, int y, int x, Taps &t) {
    const uint8_t *own = s.guide + (size_t(y) * s.width + x) * 3;
    const float reach = 1.0f / (1.5f * float(s.radius) * float(s.radius));
    t.count = 0;
    for (int dy = -s.radius; dy <= s.radius; dy += s.stride) {
        if (y + dy < 0 || y + dy >= s.height) continue;
        for (int dx = -s.radius; dx <= s.radius; dx += s.stride) {
            if (x + dx < 0 || x + dx >= s.width) continue;
            const size_t j = size_t(y + dy) * s.width + (x + dx);
            const uint8_t *other = s.guide + 3 * j;
            float step = 0;
            for (int c = 0; c < 3; ++c) step += float(std::abs(int(other[c]) - int(own[c])));
            t.weight[t.count] = std::exp(-step / s.sigma_grey - float(dx * dx + dy * dy) * reach);
            t.grey[t.count] = s.photo[j];
            t.dx[t.count] = float(dx);
            t.dy[t.count] = float(dy);
            ++t.count;
        }
    }
}

// Add one tap's samples at every label to the sums of I, I^2 and I * photo.
LFRIG_CLONES void sample(const float *__restrict image, int width, float right, float bottom, float x0, float y0,
                         float z0, float xs, float ys, float zs, float weight, float grey, int labels,
                         float *__restrict m1, float *__restrict m2, float *__restrict mc) {
    for (int k = 0; k < labels; ++k) {
        const float inverse = 1.0f / (z0 + float(k) * zs);
        float u = (x0 + float(k) * xs) * inverse, v = (y0 + float(k) * ys) * inverse;
        u = std::fmin(std::fmax(u, 0.0f), right);
        v = std::fmin(std::fmax(v, 0.0f), bottom);
        const int iu = int(u), iv = int(v), p = iv * width + iu;
        const float fu = u - float(iu), fv = v - float(iv);
        const float top = image[p] + fu * (image[p + 1] - image[p]);
        const float low = image[p + width] + fu * (image[p + width + 1] - image[p + width]);
        const float value = top + fv * (low - top);
        m1[k] += weight * value;
        m2[k] += weight * value * value;
        mc[k] += weight * value * grey;
    }
}

// cost[k] for one pixel; cap where nothing can be said.
void match(const Band &s, int y, int x, float *cost, Taps &t) {
    const size_t i = size_t(y) * s.width + x;
    for (int k = 0; k < s.labels; ++k) cost[k] = s.cap;
    if (!(s.visible[i] > 0.01f)) return;
    collect(s, y, x, t);
    float mass = 0, sum = 0, square = 0;
    for (int n = 0; n < t.count; ++n) {
        mass += t.weight[n];
        sum += t.weight[n] * t.grey[n];
    }
    const float mean = sum / mass;
    for (int n = 0; n < t.count; ++n) {
        t.grey[n] -= mean;
        square += t.weight[n] * t.grey[n] * t.grey[n];
    }
    const float own = square / mass + s.noise;
    alignas(64) float m1[kMaxLabels] = {0}, m2[kMaxLabels] = {0}, mc[kMaxLabels] = {0};
    const float *a = s.map, *b = s.map + 9;
    const float fx = float(x), fy = float(y), first = s.depth[i] - float(s.labels / 2) * s.step;
    const float right = float(s.source_width) - 1.001f, bottom = float(s.source_height) - 1.001f;
    for (int n = 0; n < t.count; ++n) {
        const float px = fx + t.dx[n], py = fy + t.dy[n];
        const float w = first + s.slope_x[i] * t.dx[n] + s.slope_y[i] * t.dy[n];
        sample(s.source, s.source_width, right, bottom, a[0] * px + a[1] * py + a[2] + b[0] * w,
               a[3] * px + a[4] * py + a[5] + b[1] * w, a[6] * px + a[7] * py + a[8] + b[2] * w, b[0] * s.step,
               b[1] * s.step, b[2] * s.step, t.weight[n], t.grey[n], s.labels, m1, m2, mc);
    }
    const float inverse = 1.0f / mass;
    const float x0 = a[0] * fx + a[1] * fy + a[2], y0 = a[3] * fx + a[4] * fy + a[5], z0 = a[6] * fx + a[7] * fy + a[8];
    for (int k = 0; k < s.labels; ++k) {
        const float w = first + float(k) * s.step, z = z0 + b[2] * w;
        const float u = (x0 + b[0] * w) / z, v = (y0 + b[1] * w) / z;
        if (!(z > 1e-6f && u >= 0 && v >= 0 && u <= float(s.source_width - 1) && v <= float(s.source_height - 1)))
            continue;
        const float m = m1[k] * inverse;
        const float other = std::fmax(m2[k] * inverse - m * m, 0.0f) + s.noise;
        const float zncc = mc[k] * inverse / std::sqrt(other * own);
        cost[k] = std::fmin(1.0f - zncc, s.cap);
    }
}

using F1 = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using U3 = ndarray<const uint8_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using O3 = ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

void band_cost(F2 photo, U3 guide, F2 source, F2 visible, F2 depth, F2 slope_x, F2 slope_y, F1 map, float step,
               int radius, int stride, float sigma_grey, float noise, float cap, O3 out, int threads) {
    Band s{};
    s.height = int(photo.shape(0)), s.width = int(photo.shape(1));
    s.source_height = int(source.shape(0)), s.source_width = int(source.shape(1));
    s.labels = int(out.shape(2)), s.radius = radius, s.stride = stride;
    const auto same = [&](const F2 &m) { return int(m.shape(0)) == s.height && int(m.shape(1)) == s.width; };
    const int side = stride > 0 ? 2 * radius / stride + 1 : 0;
    if (!same(visible) || !same(depth) || !same(slope_x) || !same(slope_y) || int(guide.shape(0)) != s.height ||
        int(guide.shape(1)) != s.width || guide.shape(2) != 3 || int(out.shape(0)) != s.height ||
        int(out.shape(1)) != s.width || map.shape(0) != 12 || s.source_width < 2 || s.source_height < 2)
        throw std::invalid_argument("band_cost: shapes do not match");
    if (s.labels < 1 || s.labels > kMaxLabels || radius < 1 || stride < 1 || side * side > kMaxTaps)
        throw std::invalid_argument("band_cost: too many labels or taps");
    s.photo = photo.data(), s.guide = guide.data(), s.source = source.data(), s.visible = visible.data();
    s.depth = depth.data(), s.slope_x = slope_x.data(), s.slope_y = slope_y.data();
    for (int i = 0; i < 12; ++i) s.map[i] = map.data()[i];
    s.step = step, s.sigma_grey = sigma_grey, s.noise = noise, s.cap = cap;
    float *cost = out.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(s.height, threads, [&](int y) {
        Taps taps;
        for (int x = 0; x < s.width; ++x) match(s, y, x, cost + (size_t(y) * s.width + x) * s.labels, taps);
    });
}

}  // namespace

void register_band_cost(nb::module_ &m) {
    m.def("band_cost", &band_cost, nb::arg("photo").noconvert(), nb::arg("guide").noconvert(),
          nb::arg("source").noconvert(), nb::arg("visible").noconvert(), nb::arg("depth").noconvert(),
          nb::arg("slope_x").noconvert(), nb::arg("slope_y").noconvert(), nb::arg("map").noconvert(), nb::arg("step"),
          nb::arg("radius"), nb::arg("stride"), nb::arg("sigma_grey"), nb::arg("noise"), nb::arg("cap"),
          nb::arg("out").noconvert(), nb::arg("threads"));
}
