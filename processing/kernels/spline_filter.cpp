#include "lfrig/spline_filter.hpp"

#include <cmath>

#include "lfrig/parallel.hpp"

namespace lfrig {

namespace {

const float POLE = float(std::sqrt(3.0) - 2.0);

// One causal and one anticausal recursion over `count` groups of `lanes` numbers that lie `stride` apart.
LFRIG_CLONES void filter_along(float *data, int count, size_t stride, int lanes) {
    const float pole = POLE;
    // The border is continued by a constant, whose causal sum is the geometric series.
    for (int k = 0; k < lanes; ++k) data[k] = data[k] / (1.0f - pole);
    for (int i = 1; i < count; ++i) {
        float *own = data + i * stride;
        const float *before = own - stride;
        for (int k = 0; k < lanes; ++k) own[k] = own[k] + pole * before[k];
    }
    float *last = data + (count - 1) * stride;
    const float start = pole / (pole * pole - 1.0f);
    for (int k = 0; k < lanes; ++k) last[k] = start * (last[k] + pole * last[k - ptrdiff_t(stride)]);
    for (int i = count - 2; i >= 0; --i) {
        float *own = data + i * stride;
        const float *after = own + stride;
        for (int k = 0; k < lanes; ++k) own[k] = pole * (after[k] - own[k]);
    }
    for (int i = 0; i < count; ++i)
        for (int k = 0; k < lanes; ++k) data[i * stride + k] *= 6.0f;
}

}  // namespace

void SplinePicture::filter() {
    filter_along(data.data(), height, size_t(width) * 4, width * 4);
    for (int y = 0; y < height; ++y) filter_along(data.data() + size_t(y) * width * 4, width, 4, 4);
}

}  // namespace lfrig
