#include "parts/view_field.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "lfrig/cpu.hpp"
#include "lfrig/parallel.hpp"

namespace lfrig {

namespace {

constexpr float NOTHING = -std::numeric_limits<float>::infinity();
constexpr float CONTRACTION = 0.25f;  // of a step of the fixed-point iteration, where the surface counts as smooth
constexpr float SMOOTH_PX = 0.1f;     // neighbours that differ by more are never smooth
constexpr float SETTLED_PX = 0.03f;   // no sample moves by more in the photo: at most a third of it is left
constexpr int POLISH_ROUNDS = 3;

// out |= mask, moved by every (dy, dx) of a box; both uint8 [height, stride].
LFRIG_CLONES void widen(const uint8_t *__restrict mask, int height, int width, int stride, int top, int bottom,
                        int left, int right, uint8_t *__restrict across, uint8_t *__restrict out) {
    for (int y = 0; y < height; ++y) {
        const uint8_t *from = mask + size_t(y) * stride;
        uint8_t *to = across + size_t(y) * stride;
        std::memset(to, 0, stride);
        for (int dx = left; dx <= right; ++dx) {
            const int begin = std::max(0, dx), end = std::min(width, width + dx);
            for (int x = begin; x < end; ++x) to[x] |= from[x - dx];
        }
    }
    for (int y = 0; y < height; ++y) {
        uint8_t *to = out + size_t(y) * stride;
        std::memset(to, 0, stride);
        for (int dy = top; dy <= bottom; ++dy) {
            if (y - dy < 0 || y - dy >= height) continue;
            const uint8_t *from = across + size_t(y - dy) * stride;
            for (int x = 0; x < stride; ++x) to[x] |= from[x];
        }
    }
}

// A few bytes, and often: eight at a time, of which what is too much stays as it was.
inline void fill_ones(uint8_t *at, int count) {
    for (; count >= 8; count -= 8, at += 8) std::memset(at, 1, 8);
    uint64_t eight;
    std::memcpy(&eight, at, 8);
    eight |= uint64_t(0x0101010101010101) & ((uint64_t(1) << (8 * count)) - 1);
    std::memcpy(at, &eight, 8);
}

// Adding and taking off 1.5 * 2^23 rounds to the nearest, halves to even.
inline int nearest(float a, float last) {
    constexpr float ROUND = 12582912.0f;
    a = a > -1.0f ? a : -1.0f;
    a = a < last ? a : last;
    return int((a + ROUND) - ROUND);
}

LFRIG_CLONES void land_all(const float *__restrict xs, const float *__restrict ys, const float *__restrict px,
                           int count, float dr, float dc, int height, int width, int32_t *__restrict first,
                           uint8_t *__restrict more) {
    const float right = float(width), bottom = float(height);
    const int stride = width + 2;
    for (int i = 0; i < count; ++i) {
        const float x = xs[i] - dc * px[i], y = ys[i] - dr * px[i];
        const int x0 = nearest(x - 0.25f, right), y0 = nearest(y - 0.25f, bottom);
        const int x1 = nearest(x + 0.25f, right), y1 = nearest(y + 0.25f, bottom);
        first[i] = (y0 + 1) * stride + x0 + 1;
        more[i] = uint8_t((x1 - x0) | ((y1 - y0) << 1));
    }
}

}  // namespace

void Carried::land(float dr, float dc, int height, int width) {
    first.resize(px.size()), more.resize(px.size());
    land_all(xs.data(), ys.data(), px.data(), int(px.size()), dr, dc, height, width, first.data(), more.data());
}

void Carried::splat(float *z, int stride) const {
    for (size_t i = 0; i < px.size(); ++i) {
        float *at = z + first[i];
        const float value = px[i];
        at[0] = std::max(at[0], value);
        if (more[i] & 1) at[1] = std::max(at[1], value);
        if (more[i] & 2) at[stride] = std::max(at[stride], value);
        if (more[i] == 3) at[stride + 1] = std::max(at[stride + 1], value);
    }
}

FieldSource::FieldSource(const float *disparity, const uint8_t *marked, int height, int width, float reach_rows,
                         float reach_cols, FieldKnobs with)
    : surface(disparity, height, width), knobs(with) {
    const auto ends = std::minmax_element(surface.data.data(), surface.data.data() + size_t(height) * surface.stride);
    lowest = *ends.first, highest = *ends.second;
    if (!knobs.certain) return;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const float *p = surface.data.data() + size_t(y) * surface.stride + x, *q = p + surface.stride;
            const float across = std::max(std::fabs(p[1] - p[0]), std::fabs(q[1] - q[0]));
            const float down = std::max(std::fabs(q[0] - p[0]), std::fabs(q[1] - p[1]));
            const bool steep =
                across * reach_cols + down * reach_rows > CONTRACTION || std::max(across, down) > SMOOTH_PX;
            if (!steep && !marked[size_t(y) * width + x]) continue;
            const float infinite = std::numeric_limits<float>::infinity();
            const bool always = marked[size_t(y) * width + x] != 0;
            cells.push_back({x, y, always ? infinite : across, down, std::min({p[0], p[1], q[0], q[1]}),
                             std::max({p[0], p[1], q[0], q[1]})});
        }
}

ViewField::ViewField(const FieldSource &source)
    : source_(source), height_(source.surface.height), width_(source.surface.width), stride_(width_ + 2),
      mask_stride_((width_ + 63) / 64 * 64) {
    field_.assign(size_t(height_ + 2) * stride_, NOTHING);
    z_.assign(field_.size(), NOTHING);
    mask_.assign(size_t(height_) * mask_stride_ + 8, 0);  // fill_ones() looks eight bytes ahead
    wanted_.assign(mask_.size(), 0);
}

void ViewField::find(float dr, float dc) {
    if (source_.knobs.certain) {
        mark_steps(dr, dc);
        settle_smooth(dr, dc);
    } else {
        std::fill(mask_.begin(), mask_.end(), uint8_t(1));
    }
    const double start = thread_cpu_s();
    list_marked();
    if (!xs_.empty()) {
        splat(dr, dc);
        fill_holes();
        polish(dr, dc);
    }
    worked_s_ = thread_cpu_s() - start;
}

// A pixel of the view has one smooth surface before it unless a ray through it meets a steep cell at a disparity that
// the cell has: only there can d(u + g * offset) = g have several solutions, or one that the iteration does not find.
void ViewField::mark_steps(float dr, float dc) {
    std::fill(mask_.begin(), mask_.end(), uint8_t(0));
    for (const SteepCell &cell : source_.cells) {
        const bool steep = cell.across * std::fabs(dc) + cell.down * std::fabs(dr) > CONTRACTION ||
                           std::max(cell.across, cell.down) > SMOOTH_PX;
        if (!steep) continue;
        const float xa = float(cell.x) - cell.lowest * dc, xb = float(cell.x) - cell.highest * dc;
        const float ya = float(cell.y) - cell.lowest * dr, yb = float(cell.y) - cell.highest * dr;
        const int left = std::max(0, int(std::floor(std::max(std::min(xa, xb), 0.0f))));
        const int right = std::min(width_ - 1, int(std::ceil(std::min(std::max(xa, xb), float(width_)))) + 1);
        const int top = std::max(0, int(std::floor(std::max(std::min(ya, yb), 0.0f))));
        const int bottom = std::min(height_ - 1, int(std::ceil(std::min(std::max(ya, yb), float(height_)))) + 1);
        for (int y = top; y <= bottom && left <= right; ++y)
            fill_ones(mask_.data() + size_t(y) * mask_stride_ + left, right - left + 1);
    }
}

void ViewField::settle_smooth(float dr, float dc) {
    const float farthest = std::max(std::max(std::fabs(dr), std::fabs(dc)), 1e-3f);
    for (int y = 0; y < height_; ++y)
        settle_row(source_.surface, y, dr, dc, SETTLED_PX / farthest, field_.data() + size_t(y + 1) * stride_ + 1,
                   mask_.data() + size_t(y) * mask_stride_);
}

void ViewField::list_marked() {
    xs_.clear(), ys_.clear();
    for (int y = 0; y < height_; ++y) {
        const uint8_t *row = mask_.data() + size_t(y) * mask_stride_;
        for (int x0 = 0; x0 < width_; x0 += 8) {
            uint64_t eight;
            std::memcpy(&eight, row + x0, 8);
            if (!eight) continue;
            for (int x = x0; x < std::min(x0 + 8, width_); ++x)
                if (row[x]) xs_.push_back(x), ys_.push_back(y);
        }
    }
}

void ViewField::splat(float dr, float dc) {
    const FieldSource &s = source_;
    // Source pixels that can land on a marked one: it lies at s - d * offset, and covers a pixel around.
    const float x0 = std::min(s.lowest * dc, s.highest * dc), x1 = std::max(s.lowest * dc, s.highest * dc);
    const float y0 = std::min(s.lowest * dr, s.highest * dr), y1 = std::max(s.lowest * dr, s.highest * dr);
    const auto bounded = [](float a, int size) { return int(std::min(std::max(a, -float(size)), float(size))); };
    across_.resize(mask_.size());
    widen(mask_.data(), height_, width_, mask_stride_, bounded(std::floor(y0) - 1, height_),
          bounded(std::ceil(y1) + 1, height_), bounded(std::floor(x0) - 1, width_), bounded(std::ceil(x1) + 1, width_),
          across_.data(), wanted_.data());
    carried_.clear();
    for (int y = 0; y < height_; ++y) {
        const uint8_t *row = wanted_.data() + size_t(y) * mask_stride_;
        const float *d = s.surface.data.data() + size_t(y) * s.surface.stride;
        for (int x8 = 0; x8 < width_; x8 += 8) {
            uint64_t eight;
            std::memcpy(&eight, row + x8, 8);
            if (!eight) continue;
            const size_t old = carried_.px.size();
            carried_.resize(old + 8);
            size_t count = old;  // all eight are written, and counted where they are wanted
            for (int x = x8; x < std::min(x8 + 8, width_); ++x) {
                carried_.set(count, x, y, d[x]);
                count += row[x];
            }
            carried_.resize(count);
        }
    }
    carried_.land(dr, dc, height_, width_);
    carried_.splat(z_.data(), stride_);
    values_.resize(xs_.size());
    for (size_t i = 0; i < xs_.size(); ++i) {
        const size_t at = size_t(ys_[i] + 1) * stride_ + xs_[i] + 1;
        field_[at] = z_[at];
    }
    std::fill(z_.begin(), z_.end(), NOTHING);
}

// Holes grow shut from the far side: the lowest disparity next to them.
void ViewField::fill_holes() {
    holes_.clear();
    for (size_t i = 0; i < xs_.size(); ++i) {
        const int at = (ys_[i] + 1) * stride_ + xs_[i] + 1;
        if (field_[at] == NOTHING) holes_.push_back(at);
    }
    while (!holes_.empty()) {
        const float none = std::numeric_limits<float>::infinity();
        lowest_near_.assign(holes_.size(), none);
        for (size_t i = 0; i < holes_.size(); ++i)
            for (int dy = -1; dy <= 1; ++dy)
                for (int dx = -1; dx <= 1; ++dx) {
                    const float near = field_[holes_[i] + dy * stride_ + dx];
                    if (near != NOTHING && near < lowest_near_[i]) lowest_near_[i] = near;
                }
        size_t left = 0;
        for (size_t i = 0; i < holes_.size(); ++i) {
            if (lowest_near_[i] != none) field_[holes_[i]] = lowest_near_[i];
            else holes_[left++] = holes_[i];
        }
        if (left == holes_.size()) break;
        holes_.resize(left);
    }
    for (const int32_t hole : holes_) field_[hole] = 0.0f;  // nothing lands anywhere in the view
}

void ViewField::polish(float dr, float dc) {
    const Surface &d = source_.surface;
    const int count = int(xs_.size());
    samples_.resize(count), hidden_.resize(count);
    for (int i = 0; i < count; ++i) values_[i] = field_[size_t(ys_[i] + 1) * stride_ + xs_[i] + 1];
    settle_list(d, xs_.data(), ys_.data(), count, dr, dc, POLISH_ROUNDS, source_.knobs.match_px, values_.data(),
                samples_.data());
    for (int i = 0; i < count; ++i) {
        hidden_[i] = uint8_t(samples_[i] - values_[i] > source_.knobs.hidden_px);
        field_[size_t(ys_[i] + 1) * stride_ + xs_[i] + 1] = values_[i];
    }
}

}  // namespace lfrig
