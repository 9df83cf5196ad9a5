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

// Fixed-point iteration field <- d(u + field * offset) of row y of a view, from the centre's disparity, until no pixel
// of 16 moves by more than `limit`. Masked pixels need not settle; those that do not, or lie beyond the frame, become
// masked.
void settle_row(const Surface &d, int y, float dr, float dc, float limit, float *field, uint8_t *mask);

// Fixed-point iteration of a list of pixels of a view: px[i] <- surface.at(xs[i] + dc * px[i], ys[i] + dr * px[i])
// where that moves it by less than `limit`, for so many rounds or until its neighbours in the list stand still too.
// `samples` gets what the surface has at the px that came out of it, to within 1e-4.
void settle_list(const Surface &surface, const int32_t *xs, const int32_t *ys, int count, float dr, float dc,
                 int rounds, float limit, float *px, float *samples);

// Pixels of the source and their disparity, on their way to a view.
struct Carried {
    std::vector<float> xs, ys, px;
    // Found by land(): where in the view. The first pixel, as an index into a map with one pixel of border, and which
    // of its neighbours are covered too: bit 0 the one to the right, bit 1 the one below, both: also the fourth.
    std::vector<int32_t> first;
    std::vector<uint8_t> more;

    void clear() { xs.clear(), ys.clear(), px.clear(); }
    void add(int x, int y, float value) { xs.push_back(float(x)), ys.push_back(float(y)), px.push_back(value); }
    void resize(size_t count) { xs.resize(count), ys.resize(count), px.resize(count); }
    void set(size_t at, int x, int y, float value) { xs[at] = float(x), ys[at] = float(y), px[at] = value; }
    // A pixel covers those that it comes within a quarter of a pixel of: a splat at twice the density.
    void land(float dr, float dc, int height, int width);
    // Write every disparity where nothing nearer is in `z`, [height + 2, width + 2] with its border.
    void splat(float *z, int stride) const;
};

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
    float lowest, highest;
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
    // CPU seconds that find() spent on the pixels near steps.
    double worked_s() const { return worked_s_; }

    const float *row(int y) const { return field_.data() + size_t(y + 1) * stride_ + 1; }
    // The same with one pixel of border around, as z() has it.
    const float *with_border() const { return field_.data(); }
    // Pixels near steps, with what is found of them; the rest of the view shows one smooth surface.
    const std::vector<int32_t> &xs() const { return xs_; }
    const std::vector<int32_t> &ys() const { return ys_; }
    const std::vector<float> &values() const { return values_; }
    const std::vector<uint8_t> &hidden() const { return hidden_; }
    int stride() const { return stride_; }
    // Splat target with one pixel of border, -inf everywhere outside of find(); whoever writes into it leaves it so.
    float *z() { return z_.data(); }

  private:
    void mark_steps(float dr, float dc);
    void settle_smooth(float dr, float dc);
    void list_marked();
    void splat(float dr, float dc);
    void fill_holes();
    void polish(float dr, float dc);

    const FieldSource &source_;
    int height_, width_, stride_, mask_stride_;
    double worked_s_ = 0.0;
    std::vector<float> field_, z_;
    std::vector<uint8_t> mask_, across_, wanted_;
    Carried carried_;
    std::vector<int32_t> xs_, ys_, holes_;
    std::vector<float> values_, samples_, lowest_near_;
    std::vector<uint8_t> hidden_;
};

}  // namespace lfrig
