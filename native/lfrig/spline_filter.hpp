// A picture as coefficients of a cubic B-spline: the recursive filter of Unser, Aldroubi & Eden, IEEE Trans. Signal
// Processing 41, 1993. NumPy form: processing/kernels/spline.py.
#pragma once
#include <algorithm>
#include <cstddef>
#include <vector>

namespace lfrig {

constexpr int SPLINE_PAD = 10;  // border by which a picture is continued before it is filtered: |pole|^10 is 2e-6

// Coefficients float32 [height + 2 PAD, width + 2 PAD, 4]; fill them with `set`, then filter() once.
struct SplinePicture {
    int height, width;  // with the border
    std::vector<float> data;

    // `pixel(y, x, out)` writes the four channels of a pixel of the picture without its border.
    template <class Pixel>
    SplinePicture(int rows, int cols, Pixel pixel)
        : height(rows + 2 * SPLINE_PAD), width(cols + 2 * SPLINE_PAD), data(size_t(height) * width * 4) {
        for (int y = 0; y < rows; ++y) {
            float *row = data.data() + size_t(y + SPLINE_PAD) * width * 4;
            for (int x = 0; x < cols; ++x) pixel(y, x, row + 4 * (x + SPLINE_PAD));
            for (int x = 0; x < SPLINE_PAD; ++x) {
                std::copy_n(row + 4 * SPLINE_PAD, 4, row + 4 * x);
                std::copy_n(row + 4 * (cols - 1 + SPLINE_PAD), 4, row + 4 * (cols + SPLINE_PAD + x));
            }
        }
        const size_t stride = size_t(width) * 4;
        for (int y = 0; y < SPLINE_PAD; ++y) {
            std::copy_n(data.data() + SPLINE_PAD * stride, stride, data.data() + y * stride);
            std::copy_n(data.data() + (rows - 1 + SPLINE_PAD) * stride, stride,
                        data.data() + (rows + SPLINE_PAD + y) * stride);
        }
        filter();
    }

  private:
    void filter();
};

}  // namespace lfrig
