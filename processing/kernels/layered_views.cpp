// The views of a light field from its centre view, the centre's disparity and its two layers. Twin: layered_views.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <limits>
#include <stdexcept>
#include <utility>
#include <vector>

#include "lfrig/parallel.hpp"
#include "lfrig/spline_filter.hpp"
#include "parts/pair_sampling.hpp"
#include "parts/view_field.hpp"

namespace nb = nanobind;
using nb::ndarray;
using namespace lfrig;

namespace {

constexpr int POLISH_ROUNDS = 2, FAR_ROUNDS = 6;

struct Layers {
    const Surface &behind, &near_px;
    const SplinePicture &far, &near;
    const uint8_t *far_drawn;  // bool [height, width]
    Carried near_drawn;        // pixels that are drawn as near layer
};

// The photo, sampled row by row: 8 bits from fixed point, 16 bits from the coefficients themselves.
struct Photo8 {
    PairPicture pairs;

    explicit Photo8(const SplinePicture &photo) : pairs(photo.height, photo.width, SPLINE_PAD) {
        for (int y = 0; y < photo.height; ++y) pairs.set_row(y, photo.data.data() + size_t(y) * photo.width * 4);
    }
    void row(const float *field, float dr, float dc, int y, int count, uint8_t *out) const {
        sample_pairs_row(pairs, spline_taps(), field, dr, dc, y, count, out);
    }
};

struct Photo16 {
    const SplinePicture &photo;

    explicit Photo16(const SplinePicture &photo) : photo(photo) {}
    void row(const float *field, float dr, float dc, int y, int count, uint16_t *out) const {
        sample_float_row(photo.data.data(), photo.height, photo.width, SPLINE_PAD, spline_weights, field, dr, dc, y,
                         count, 257.0f, out);
    }
};

template <class T>
inline void write(const float grey[3], T *out) {
    constexpr float scale = sizeof(T) == 1 ? 1.0f : 257.0f, limit = sizeof(T) == 1 ? 255.0f : 65535.0f;
    for (int c = 0; c < 3; ++c) out[c] = T(std::min(std::max(grey[c] * scale, 0.0f), limit) + 0.5f);
}

// Pixels of a view, and the disparity at which each is drawn.
struct Spots {
    std::vector<int32_t> xs, ys;
    std::vector<float> px, samples;

    void clear() { xs.clear(), ys.clear(), px.clear(); }
    void add(int x, int y, float value) { xs.push_back(x), ys.push_back(y), px.push_back(value); }
    int size() const { return int(xs.size()); }
    void keep(int to, int from) { xs[to] = xs[from], ys[to] = ys[from], px[to] = px[from]; }
    void resize(int count) { xs.resize(count), ys.resize(count), px.resize(count); }

    void settle(const Surface &surface, float dr, float dc, int rounds, float limit) {
        samples.resize(4 * px.size());
        settle_list(surface, xs.data(), ys.data(), size(), dr, dc, rounds, limit, px.data(), samples.data());
    }
    void sample(const SplinePicture &picture, float dr, float dc) {
        samples.resize(4 * px.size());
        sample_float_list(picture.data.data(), picture.height, picture.width, SPLINE_PAD, spline_taps(), xs.data(),
                          ys.data(), px.data(), size(), dr, dc, samples.data());
    }
};

constexpr float ANY = std::numeric_limits<float>::infinity();

// Pixels near steps, and the CPU seconds that their disparity took.
struct Work {
    int64_t pixels = 0;
    double cpu_s = 0.0;
};

// One view at a time.
template <class T, class Photo>
class Painter {
  public:
    Painter(const Photo &photo, const Layers &layers, const FieldSource &source)
        : photo_(photo), layers_(layers), knobs_(source.knobs), height_(source.surface.height),
          width_(source.surface.width), field_(source), carried_(layers.near_drawn) {}

    Work paint(float dr, float dc, T *out) {
        field_.find(dr, dc);
        for (int y = 0; y < height_; ++y)
            photo_.row(field_.row(y), dr, dc, y, width_, out + size_t(y) * width_ * 3);
        paint_far(dr, dc, out);
        paint_near_edges(dr, dc, out);
        return {int64_t(field_.xs().size()), field_.worked_s()};
    }

  private:
    // The far layer where the photo shows no surface, and where its own colour is mixed.
    void paint_far(float dr, float dc, T *out) {
        far_.clear(), own_.clear();
        for (size_t i = 0; i < field_.xs().size(); ++i) {
            const int x = field_.xs()[i], y = field_.ys()[i];
            const float own = field_.values()[i];
            const bool hidden = field_.hidden()[i] != 0;
            if (!hidden && !far_drawn_at(float(x) + dc * own, float(y) + dr * own)) continue;
            far_.add(x, y, own);
            own_.push_back(hidden ? ANY : own);
        }
        far_.settle(layers_.behind, dr, dc, FAR_ROUNDS - POLISH_ROUNDS, ANY);
        int kept = 0;
        for (int i = 0; i < far_.size(); ++i)
            if (own_[i] == ANY || std::fabs(far_.px[i] - own_[i]) < knobs_.hidden_px) far_.keep(kept++, i);
        far_.resize(kept);
        far_.sample(layers_.far, dr, dc);
        for (int i = 0; i < kept; ++i) write(far_.samples.data() + 4 * i, pixel(out, far_.xs[i], far_.ys[i]));
    }

    // A near surface's edge over the far layer, unless something nearer stands before it.
    void paint_near_edges(float dr, float dc, T *out) {
        find_edges(dr, dc);
        near_.settle(layers_.near_px, dr, dc, POLISH_ROUNDS, knobs_.match_px);
        near_.sample(layers_.near, dr, dc);
        far_.xs = near_.xs, far_.ys = near_.ys, far_.px = near_.px;
        far_.settle(layers_.behind, dr, dc, FAR_ROUNDS, ANY);
        far_.sample(layers_.far, dr, dc);
        for (int i = 0; i < near_.size(); ++i) {
            const float *near = near_.samples.data() + 4 * i, *far = far_.samples.data() + 4 * i;
            const float share = std::min(std::max(near[3], 0.0f), 1.0f);
            float both[3];
            for (int c = 0; c < 3; ++c) both[c] = share * near[c] + (1.0f - share) * far[c];
            write(both, pixel(out, near_.xs[i], near_.ys[i]));
        }
    }

    void find_edges(float dr, float dc) {
        near_.clear();
        float *z = field_.z();
        const float *field = field_.with_border();
        const int stride = field_.stride();
        carried_.land(dr, dc, height_, width_);
        carried_.splat(z, stride);
        for (size_t i = 0; i < carried_.px.size(); ++i)
            for (int k = 0; k < 4; ++k) {
                if ((k & carried_.more[i]) != k) continue;
                const int at = carried_.first[i] + (k & 1) + (k >> 1) * stride;
                const float found = z[at];
                if (found == -ANY) continue;  // found before
                z[at] = -ANY;
                if (!(found > field[at] - knobs_.hidden_px)) continue;
                const int y = at / stride - 1, x = at - (y + 1) * stride - 1;
                if (x >= 0 && x < width_ && y >= 0 && y < height_) near_.add(x, y, found);
            }
    }

    bool far_drawn_at(float x, float y) const {
        if (!(x > -0.5f && x < float(width_) - 0.5f && y > -0.5f && y < float(height_) - 0.5f)) return false;
        const int ix = std::min(int(x + 0.5f), width_ - 1), iy = std::min(int(y + 0.5f), height_ - 1);
        return layers_.far_drawn[size_t(iy) * width_ + ix] != 0;
    }
    T *pixel(T *out, int x, int y) const { return out + (size_t(y) * width_ + x) * 3; }

    const Photo &photo_;
    const Layers &layers_;
    FieldKnobs knobs_;
    int height_, width_;
    ViewField field_;
    Carried carried_;
    Spots far_, near_;
    std::vector<float> own_;
};

template <int N>
using Floats = ndarray<const float, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
using Flags = ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

template <class A>
void check(const A &array, int height, int width, int channels = 0) {
    if (int(array.shape(0)) != height || int(array.shape(1)) != width ||
        (channels && int(array.shape(2)) != channels))
        throw std::invalid_argument("layered_views: shapes do not match");
}

// Returns the number of pixels, over all views, that were near steps, and the CPU seconds that their disparity took.
template <class T, class Photo>
std::pair<int64_t, double> layered_views(
    ndarray<const T, nb::ndim<3>, nb::c_contig, nb::device::cpu> image, Floats<2> disparity, Floats<2> behind,
    Floats<3> far_grey, Floats<2> near_px, Floats<3> near_grey, Flags near_drawn, Flags far_drawn, Floats<2> offsets,
    ndarray<T, nb::ndim<4>, nb::c_contig, nb::device::cpu> out, float match_px, float hidden_px, bool certain,
    int threads) {
    const int height = int(image.shape(0)), width = int(image.shape(1)), views = int(offsets.shape(0));
    check(image, height, width, 3), check(disparity, height, width), check(behind, height, width);
    check(far_grey, height, width, 3), check(near_px, height, width), check(near_grey, height, width, 4);
    check(near_drawn, height, width), check(far_drawn, height, width);
    if (offsets.shape(1) != 2 || int(out.shape(0)) != views || int(out.shape(1)) != height ||
        int(out.shape(2)) != width || out.shape(3) != 3)
        throw std::invalid_argument("layered_views: shapes do not match");
    if (height == 0 || width == 0 || views == 0) return {0, 0.0};
    const T *pixels = image.data();
    const float *far = far_grey.data(), *near = near_grey.data(), *offset = offsets.data(), *d = disparity.data();
    const uint8_t *near_flag = near_drawn.data(), *far_flag = far_drawn.data();
    T *to = out.data();
    nb::gil_scoped_release release;
    const size_t row = size_t(width);
    const float scale = sizeof(T) == 1 ? 1.0f : 1.0f / 257.0f;
    const SplinePicture photo(height, width, [=](int y, int x, float *p) {
        for (int c = 0; c < 3; ++c) p[c] = float(pixels[(y * row + x) * 3 + c]) * scale;
        p[3] = 0.0f;
    });
    const SplinePicture far_colours(height, width, [=](int y, int x, float *p) {
        std::copy_n(far + (y * row + x) * 3, 3, p);
        p[3] = 0.0f;
    });
    const SplinePicture near_colours(height, width,
                                     [=](int y, int x, float *p) { std::copy_n(near + (y * row + x) * 4, 4, p); });
    const Surface behind_px(behind.data(), height, width), near_surface(near_px.data(), height, width);
    Layers layers{behind_px, near_surface, far_colours, near_colours, far_flag, {}};
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x)
            if (near_flag[y * row + x]) layers.near_drawn.add(x, y, near_surface.data[y * near_surface.stride + x]);
    float reach_rows = 0.0f, reach_cols = 0.0f;
    for (int v = 0; v < views; ++v) {
        reach_rows = std::max(reach_rows, std::fabs(offset[2 * v]));
        reach_cols = std::max(reach_cols, std::fabs(offset[2 * v + 1]));
    }
    const FieldSource source(d, far_flag, height, width, reach_rows, reach_cols, {match_px, hidden_px, certain});
    const Photo sampled(photo);
    std::vector<Work> near_steps(views);
    // As many items as threads, each with its own memory; which thread draws a view does not change it.
    std::atomic<int> next{0};
    const int cores = int(std::max(1u, std::thread::hardware_concurrency()));
    const int painters = std::min(views, threads > 0 ? threads : cores);
    parallel_for(painters, painters, [&](int) {
        Painter<T, Photo> painter(sampled, layers, source);
        for (int v; (v = next.fetch_add(1)) < views;) {
            T *view = to + size_t(v) * height * width * 3;
            if (offset[2 * v] == 0.0f && offset[2 * v + 1] == 0.0f)
                std::copy_n(pixels, size_t(height) * width * 3, view);
            else
                near_steps[v] = painter.paint(offset[2 * v], offset[2 * v + 1], view);
        }
    });
    Work total;
    for (const Work &work : near_steps) total.pixels += work.pixels, total.cpu_s += work.cpu_s;
    return {total.pixels, total.cpu_s};
}

template <class T, class Photo>
void define(nb::module_ &m) {
    m.def("layered_views", &layered_views<T, Photo>, nb::arg("image").noconvert(), nb::arg("disparity").noconvert(),
          nb::arg("behind").noconvert(), nb::arg("far_grey").noconvert(), nb::arg("near_px").noconvert(),
          nb::arg("near_grey").noconvert(), nb::arg("near_drawn").noconvert(), nb::arg("far_drawn").noconvert(),
          nb::arg("offsets").noconvert(), nb::arg("out").noconvert(), nb::arg("match_px"), nb::arg("hidden_px"),
          nb::arg("certain"), nb::arg("threads"));
}

}  // namespace

void register_layered_views(nb::module_ &m) {
    define<uint8_t, Photo8>(m);
    define<uint16_t, Photo16>(m);
}
