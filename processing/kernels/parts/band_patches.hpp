// The photo's patches for matching in a narrow band (band_cost.cpp): weights, and where they read their pixels' rows.
#pragma once
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "lfrig/exponential.hpp"
#include "lfrig/parallel.hpp"

namespace {

constexpr int kRun = 64;  // pixels of a line whose patches are weighed together

struct Tap {
    int dx, dy;
};

struct Band {
    int height, width, labels, reach, slots, radius;
    std::vector<Tap> taps;
    const float *depth, *slope_x, *slope_y;  // [H, W] inverse depth of the middle label, and its slopes per pixel
    // photo, red, green, blue, depth: [5, H + 2 radius, W + 2 radius]; the depth around the frame is NaN
    std::vector<float> padded;
    float step, sigma_grey, cap, least, unit;

    const float *plane(int n, int y, int x) const {
        const size_t high = size_t(height) + 2 * radius, wide = size_t(width) + 2 * radius;
        return padded.data() + (n * high + size_t(y + radius)) * wide + size_t(x + radius);
    }
};

// The taps of a run of pixels, [taps, kRun] each; what does not count has weight 0 and slot 0.
struct Patches {
    std::vector<float> weight, product;  // product: weight * (grey - mean)
    std::vector<float> fraction;         // how far beyond slot `slot` label 0 lies
    std::vector<int32_t> slot;
    float mass[kRun], variance[kRun];

    explicit Patches(int taps)
        : weight(size_t(taps) * kRun), product(weight), fraction(weight), slot(size_t(taps) * kRun) {}
};

// Every other place of a grid, like the squares of one colour on a chessboard: neighbours' patches overlap, and half of
// the places say as much of a label as all.
std::vector<Tap> chessboard(int radius, int stride) {
    std::vector<Tap> taps;
    for (int row = 0; row * stride <= 2 * radius; ++row)
        for (int column = row % 2; column * stride <= 2 * radius; column += 2)
            taps.push_back({column * stride - radius, row * stride - radius});
    return taps;
}

struct Line {  // of the photo, from the first pixel of a run
    const float *photo, *red, *green, *blue, *depth;

    Line(const Band &s, int y, int x)
        : photo(s.plane(0, y, x)), red(s.plane(1, y, x)), green(s.plane(2, y, x)), blue(s.plane(3, y, x)),
          depth(s.plane(4, y, x)) {}
};

// One tap of a run: neighbours of the pixel's colour weigh most, those whose row does not reach the plane nothing.
// `product` gets the grey levels.
LFRIG_CLONES void weigh(const Line &here, const Line &there, const float *__restrict slope_x,
                        const float *__restrict slope_y, float dx, float dy, float away, float per_grey,
                        float per_step, float reach, int width, float *__restrict weight, float *__restrict product,
                        float *__restrict fraction, int32_t *__restrict slot) {
    for (int i = 0; i < width; ++i) {
        const float colour = std::fabs(there.red[i] - here.red[i]) + std::fabs(there.green[i] - here.green[i]) +
                             std::fabs(there.blue[i] - here.blue[i]);
        const float q = lfrig::exp_of_minus(colour * per_grey + away);
        const float plane = here.depth[i] + slope_x[i] * dx + slope_y[i] * dy;
        float at = (plane - there.depth[i]) * per_step + reach;
        const bool inside = at >= 0.0f && at < 2.0f * reach;
        at = inside ? at : 0.0f;
        weight[i] = inside ? q : 0.0f;
        product[i] = there.photo[i];
        slot[i] = int(at);
        fraction[i] = at - float(slot[i]);
    }
}

// Weighted mean and variance of every patch of a run; grey levels become products.
LFRIG_CLONES void normalise(const float *__restrict weight, float *__restrict product, int taps, int width,
                            float *__restrict mass, float *__restrict variance) {
    alignas(64) float mean[kRun];
    for (int i = 0; i < width; ++i) mass[i] = mean[i] = variance[i] = 0.0f;
    for (int n = 0; n < taps; ++n)
        for (int i = 0; i < width; ++i) {
            mass[i] += weight[n * kRun + i];
            mean[i] += weight[n * kRun + i] * product[n * kRun + i];
        }
    for (int i = 0; i < width; ++i) mean[i] /= mass[i];
    for (int n = 0; n < taps; ++n)
        for (int i = 0; i < width; ++i) {
            const float away = product[n * kRun + i] - mean[i];
            variance[i] += weight[n * kRun + i] * away * away;
            product[n * kRun + i] = weight[n * kRun + i] * away;
        }
    for (int i = 0; i < width; ++i) variance[i] /= mass[i];
}

// The patches of the pixels [x, x + width) of line y.
void collect(const Band &s, int y, int x, int width, Patches &t) {
    const Line here(s, y, x);
    const size_t at = size_t(y) * s.width + x;
    const float per_square = 1.0f / (1.5f * float(s.radius) * float(s.radius));
    size_t n = 0;
    for (const Tap &tap : s.taps) {
        const float dx = float(tap.dx), dy = float(tap.dy);
        weigh(here, Line(s, y + tap.dy, x + tap.dx), s.slope_x + at, s.slope_y + at, dx, dy,
              (dx * dx + dy * dy) * per_square, 1.0f / s.sigma_grey, 1.0f / s.step, float(s.reach), width,
              &t.weight[n], &t.product[n], &t.fraction[n], &t.slot[n]);
        n += kRun;
    }
    normalise(t.weight.data(), t.product.data(), int(s.taps.size()), width, t.mass, t.variance);
}

}  // namespace
