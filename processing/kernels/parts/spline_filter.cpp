#include "lfrig/spline_filter.hpp"

#include <cmath>

#include "lfrig/parallel.hpp"

namespace lfrig {

namespace {

const float POLE = float(std::sqrt(3.0) - 2.0);

// One causal and one anticausal recursion down `count` rows of `lanes` numbers; a sixth of the coefficients.
LFRIG_CLONES void filter_down(float *data, int count, size_t lanes) {
    const float pole = POLE, start = pole / (pole * pole - 1.0f);
    // The border is continued by a constant, whose causal sum is the geometric series.
    for (size_t k = 0; k < lanes; ++k) data[k] = data[k] / (1.0f - pole);
    for (int i = 1; i < count; ++i) {
        float *own = data + i * lanes;
        const float *before = own - lanes;
        for (size_t k = 0; k < lanes; ++k) own[k] = own[k] + pole * before[k];
    }
    float *last = data + (count - 1) * lanes;
    for (size_t k = 0; k < lanes; ++k) last[k] = start * (last[k] + pole * last[k - ptrdiff_t(lanes)]);
    for (int i = count - 2; i >= 0; --i) {
        float *own = data + i * lanes;
        const float *after = own + lanes;
        for (size_t k = 0; k < lanes; ++k) own[k] = pole * (after[k] - own[k]);
    }
}

// The same along ROWS rows of `count` pixels of four channels at a time, and times the two sixths.
constexpr int ROWS = 4;

LFRIG_CLONES void filter_along(float *data, int count, size_t stride, int rows) {
    const float pole = POLE, start = pole / (pole * pole - 1.0f);
    float state[4 * ROWS];
    float *row[ROWS];
    for (int r = 0; r < ROWS; ++r) row[r] = data + size_t(r < rows ? r : 0) * stride;
    for (int r = 0; r < rows; ++r)
        for (int c = 0; c < 4; ++c) state[4 * r + c] = row[r][c] = row[r][c] / (1.0f - pole);
    for (int i = 1; i < count; ++i)
        for (int r = 0; r < rows; ++r)
            for (int c = 0; c < 4; ++c)
                state[4 * r + c] = row[r][4 * i + c] = row[r][4 * i + c] + pole * state[4 * r + c];
    for (int r = 0; r < rows; ++r)
        for (int c = 0; c < 4; ++c) {
            const float before = row[r][4 * (count - 2) + c];
            state[4 * r + c] = start * (row[r][4 * (count - 1) + c] + pole * before);
            row[r][4 * (count - 1) + c] = 36.0f * state[4 * r + c];
        }
    for (int i = count - 2; i >= 0; --i)
        for (int r = 0; r < rows; ++r)
            for (int c = 0; c < 4; ++c) {
                state[4 * r + c] = pole * (state[4 * r + c] - row[r][4 * i + c]);
                row[r][4 * i + c] = 36.0f * state[4 * r + c];
            }
}

}  // namespace

void SplinePicture::filter() {
    const size_t stride = size_t(width) * 4;
    filter_down(data.data(), height, stride);
    for (int y = 0; y < height; y += ROWS)
        filter_along(data.data() + y * stride, width, stride, std::min(ROWS, height - y));
}

}  // namespace lfrig
