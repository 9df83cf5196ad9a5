// The disparity field of an output view, z-buffered: most of the view by a contraction, what lies near steps by splat.
#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

namespace lfrig {

// A map float32 [height, width] that can be looked up between its pixels; beyond the frame its border counts.
struct Surface {
    int height, width, stride;
    std::vector<float> data;  // one column and row more, and room for a wide load at the end

    Surface(const float *values, int height, int width);

    float at(float x, float y) const {
        const float right = float(width - 1), bottom = float(height - 1);
        x = x > 0.0f ? x : 0.0f, y = y > 0.0f ? y : 0.0f;
        x = x < right ? x : right, y = y < bottom ? y : bottom;
        const int ix = int(x), iy = int(y);
        const float tx = x - float(ix), ty = y - float(iy);
        const float *upper = data.data() + size_t(iy) * stride + ix, *lower = upper + stride;
        const float a = upper[0] + tx * (upper[1] - upper[0]), b = lower[0] + tx * (lower[1] - lower[0]);
        return a + ty * (b - a);
    }
};

// out[i] = surface.at(xs[i] + dc * px[i], ys[i] + dr * px[i])
void look_up(const Surface &surface, const int32_t *xs, const int32_t *ys, const float *px, int count, float dr,
             float dc, float *out);

// A cell between four pixels in which the surface is steep: how much (largest differences), and its lowest and highest.
struct SteepCell {
    int x, y;
    float across, down, lowest, highest;
};

struct FieldKnobs {
    float match_px;   // the polish keeps the splatted value unless it moves less than this
    float hidden_px;  // a gathered sample this much nearer than the field shows the foreground
    bool certain;     // leave out splat and polish where the surface is smooth
};

// What all views share.
struct FieldSource {
    Surface surface;
    FieldKnobs knobs;
    float lowest, highest, middle;
    std::vector<SteepCell> cells;  // sorted by rows

    // `marked` bool [height, width]: pixels whose surroundings need the whole treatment in any case.
    FieldSource(const float *disparity, const uint8_t *marked, int height, int width, float reach_rows,
                float reach_cols, FieldKnobs knobs);
};

// The field of one view at a time. Memory is reused from view to view.
class ViewField {
  public:
    explicit ViewField(const FieldSource &source);

    void find(float dr, float dc);

    const float *row(int y) const { return field_.data() + size_t(y + 1) * stride_ + 1; }
    // Pixels near steps, with what is found of them; the rest of the view shows one smooth surface.
    const std::vector<int32_t> &xs() const { return xs_; }
    const std::vector<int32_t> &ys() const { return ys_; }
    const std::vector<float> &values() const { return values_; }
    const std::vector<uint8_t> &hidden() const { return hidden_; }
    int stride() const { return stride_; }
    // Splat target, -inf everywhere outside of find(); whoever writes into it leaves it so. One pixel of border.
    float *z_row(int y) { return z_.data() + size_t(y + 1) * stride_ + 1; }

  private:
    void mark_steps(float dr, float dc);
    void settle_smooth(float dr, float dc);
    void list_marked();
    void splat(float dr, float dc);
    void fill_holes();
    void polish(float dr, float dc);

    const FieldSource &source_;
    int height_, width_, stride_, mask_stride_;
    std::vector<float> field_, z_;
    std::vector<uint8_t> mask_, across_, wanted_;
    std::vector<int32_t> xs_, ys_, holes_;
    std::vector<float> values_, samples_, lowest_near_;
    std::vector<uint8_t> hidden_;
};

// The up to four pixels that a source pixel at (x, y) of a view covers at twice the density, first and last of each;
// between -1 and the size, so that one pixel of border takes what lies outside.
struct Covered {
    int x0, x1, y0, y1;

    Covered(float x, float y, int height, int width)
        : x0(nearest(x - 0.25f, width)), x1(nearest(x + 0.25f, width)), y0(nearest(y - 0.25f, height)),
          y1(nearest(y + 0.25f, height)) {}

  private:
    static int nearest(float a, int last) {
        constexpr float ROUND = 12582912.0f;  // adding and taking off 1.5 * 2^23 rounds to the nearest, halves to even
        a = a > -1.0f ? a : -1.0f;
        a = a < float(last) ? a : float(last);
        return int((a + ROUND) - ROUND);
    }
};

// Write `value` where nothing nearer is; `z` is the pixel (0, 0) of a map with one pixel of border.
inline void splat_pixel(float *z, int stride, const Covered &at, float value) {
    for (int y = at.y0; y <= at.y1; ++y)
        for (int x = at.x0; x <= at.x1; ++x) {
            float &nearest = z[ptrdiff_t(y) * stride + x];
            if (value > nearest) nearest = value;
        }
}

}  // namespace lfrig
