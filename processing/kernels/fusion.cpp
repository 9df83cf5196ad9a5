// Projective fusion of disparity evidence in the target's frustum, and the first-surface rule. Twin: fusion.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cmath>
#include <cstdint>
#include <cstring>

#include "lfrig/parallel.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

// One source: everything that its pixel loop needs, 21 floats as laid out by fusion.py.
struct SourceView {
    const uint16_t *probability;  // [H, W, D]
    const float *disparity;       // [H, W]
    int height, width, planes;
    float a[9], b[3];        // p = A (x, y, 1) + b w
    float scale_a, scale_c;  // 1/z = scale_a * delta + scale_c
    float first, step;       // disparity planes
    float weight, margin;
};

// A ray that meets the frame's rim to within rounding is inside, whichever way the rounding went.
constexpr float kRim = 1e-3f;

struct Options {
    float w0, dw, floor_share;
    int planes;
    bool log_pool, visibility, literal;
};

// Trilinear probability at (u, v, q), all inside.
inline float sample(const SourceView &s, float u, float v, float q) {
    const int iu = int(u), iv = int(v), iq = int(q);
    const float fu = u - float(iu), fv = v - float(iv), fq = q - float(iq);
    const uint16_t *p = s.probability + (size_t(iv) * s.width + iu) * s.planes + iq;
    const size_t row = size_t(s.width) * s.planes;
    auto along = [&](const uint16_t *r) { return float(r[0]) + fq * (float(r[1]) - float(r[0])); };
    const float top = along(p) + fu * (along(p + s.planes) - along(p));
    const float low = along(p + row) + fu * (along(p + row + s.planes) - along(p + row));
    return (top + fv * (low - top)) * (1.0f / 65535.0f);
}

// Adds one source's evidence along one target ray. Returns the number of planes inside the source's frame.
int add_source(const SourceView &s, const Options &o, int x, int y, float *ray, float *mass) {
    const float px = s.a[0] * x + s.a[1] * y + s.a[2], py = s.a[3] * x + s.a[4] * y + s.a[5];
    const float pz = s.a[6] * x + s.a[7] * y + s.a[8];
    const float neutral = -std::log(float(o.planes));
    const float flat = o.floor_share / float(o.planes);
    int inside = 0;
    for (int k = 0; k < o.planes; ++k) {
        const float w = o.w0 + o.dw * float(k);
        const float z = pz + s.b[2] * w;
        float u = -1, v = -1, inverse = 0;
        if (z > 1e-6f) {
            inverse = 1.0f / z;
            u = (px + s.b[0] * w) * inverse;
            v = (py + s.b[1] * w) * inverse;
        }
        const float right = float(s.width - 1), bottom = float(s.height - 1);
        if (!(u > -kRim && v > -kRim && u < right + kRim && v < bottom + kRim)) {
            if (o.log_pool) ray[k] += s.weight * neutral;
            continue;
        }
        ++inside;
        u = std::min(std::max(u, 0.0f), right - kRim);
        v = std::min(std::max(v, 0.0f), bottom - kRim);
        const float ws = o.literal ? w : w * inverse;
        const float delta = (ws - s.scale_c) / s.scale_a;
        const float q = (delta - s.first) / s.step;
        float p = 0;
        if (q >= 0 && q < float(s.planes - 1)) p = sample(s, u, v, q);
        if (!o.log_pool) {
            ray[k] += s.weight * p;
            mass[k] += s.weight;
            continue;
        }
        // Mass per target plane: the source's planes are stretched along this ray by |d delta / d w|.
        const float stretch = std::fabs(o.dw * pz * inverse * inverse / (s.scale_a * s.step));
        float score = std::log((1.0f - o.floor_share) * p * std::min(4.0f, stretch) + flat);
        if (o.visibility) {
            const float seen = s.disparity[size_t(v + 0.5f) * s.width + size_t(u + 0.5f)];
            const float hidden = std::min(1.0f, std::max(0.0f, (seen - delta - s.margin) / (0.5f * s.margin)));
            score = std::max(score, score + hidden * (neutral - score));
        }
        ray[k] += s.weight * score;
    }
    return inside;
}

using U3 = ndarray<const uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using F2 = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using F1 = ndarray<const float, nb::ndim<1>, nb::c_contig, nb::device::cpu>;
using Out3 = ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

SourceView make_source(const U3 &probability, const F2 &disparity, const F1 &numbers) {
    SourceView s;
    s.probability = probability.data();
    s.disparity = disparity.data();
    s.height = int(probability.shape(0));
    s.width = int(probability.shape(1));
    s.planes = int(probability.shape(2));
    if (int(disparity.shape(0)) != s.height || int(disparity.shape(1)) != s.width || numbers.shape(0) != 18)
        throw std::invalid_argument("fuse: shapes do not match");
    const float *n = numbers.data();
    std::memcpy(s.a, n, 9 * sizeof(float));
    std::memcpy(s.b, n + 9, 3 * sizeof(float));
    s.scale_a = n[12];
    s.scale_c = n[13];
    s.first = n[14];
    s.step = n[15];
    s.weight = n[16];
    s.margin = n[17];
    return s;
}

// Adds one source to out [H, W, N]; `mass` [H, W, N] only for the mean pool. Returns voxels inside its frame.
long add(U3 probability, F2 disparity, F1 numbers, float w0, float dw, float floor_share, bool log_pool,
         bool visibility, bool literal, Out3 out, Out3 mass, int threads) {
    const SourceView source = make_source(probability, disparity, numbers);
    const int height = int(out.shape(0)), width = int(out.shape(1));
    const Options o{w0, dw, floor_share, int(out.shape(2)), log_pool, visibility, literal};
    if (!log_pool && mass.size() != out.size()) throw std::invalid_argument("fuse: mass must be shaped like out");
    float *dst = out.data(), *sum = mass.data();
    nb::gil_scoped_release release;
    std::vector<long> inside(height, 0);
    lfrig::parallel_for(height, threads, [&](int y) {
        for (int x = 0; x < width; ++x) {
            const size_t i = (size_t(y) * width + x) * o.planes;
            inside[y] += add_source(source, o, x, y, dst + i, log_pool ? nullptr : sum + i);
        }
    });
    long total = 0;
    for (long n : inside) total += n;
    return total;
}

// Planes behind strong nearer evidence pay beta * max(0, best nearer evidence - tau), capped. In place.
void first_surface(Out3 volume, float neutral, int gap, float tau, float beta, float cap, int threads) {
    const int height = int(volume.shape(0)), width = int(volume.shape(1)), planes = int(volume.shape(2));
    float *data = volume.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        std::vector<float> penalty(planes);
        for (int x = 0; x < width; ++x) {
            float *v = data + (size_t(y) * width + x) * planes, worst = 0;
            for (int k = planes - 1; k >= 0; --k) {
                penalty[k] = worst;
                worst = std::max(worst, std::min(cap, beta * (v[k] - neutral - tau)));
            }
            for (int k = 0; k + gap < planes; ++k) v[k] -= penalty[k + gap - 1];
        }
    });
}

}  // namespace

void register_fusion(nb::module_ &m) {
    m.def("fuse_add", &add, nb::arg("probability").noconvert(), nb::arg("disparity").noconvert(),
          nb::arg("numbers").noconvert(), nb::arg("w0"), nb::arg("dw"), nb::arg("floor_share"), nb::arg("log_pool"),
          nb::arg("visibility"), nb::arg("literal"), nb::arg("out").noconvert(), nb::arg("mass").noconvert(),
          nb::arg("threads"));
    m.def("first_surface", &first_surface, nb::arg("volume").noconvert(), nb::arg("neutral"), nb::arg("gap"),
          nb::arg("tau"), nb::arg("beta"), nb::arg("cap"), nb::arg("threads"));
}
