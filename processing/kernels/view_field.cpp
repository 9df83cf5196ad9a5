#include "view_field.hpp"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "lfrig/cpu.hpp"
#include "lfrig/parallel.hpp"

namespace lfrig {

namespace {

constexpr int LANES = 16;
constexpr float NOTHING = -std::numeric_limits<float>::infinity();
constexpr float CONTRACTION = 0.25f;   // of a step of the fixed-point iteration, where the surface counts as smooth
constexpr float SMOOTH_PX = 0.1f;      // neighbours that differ by more are never smooth
constexpr float SETTLED_PX = 0.01f;    // the iteration is over when no sample moves by more in the photo
constexpr float SETTLED = 1e-4f;       // of a disparity: it stands still
constexpr int BLOCK = 32;
constexpr int SETTLE_ROUNDS = 5, POLISH_ROUNDS = 3;
constexpr float FARTHEST_PX = 1e6f;     // no disparity is farther from 0; what is not finite becomes finite

// Fixed-point iteration g <- d(u + g * offset) on LANES pixels of row y from x0, starting from the centre's disparity,
// until every pixel that is not masked moves by at most `limit`. Writes the field; pixels that do not settle, or beyond
// the frame, are masked.
inline void settle_plain(const Surface &d, int x0, int y, int count, float dr, float dc, float limit, float *field,
                         uint8_t *mask) {
    float g[LANES], moved[LANES];
    for (int i = 0; i < count; ++i) g[i] = d.data[size_t(y) * d.stride + x0 + i];
    for (int round = 0; round < SETTLE_ROUNDS; ++round) {
        bool more = false;
        for (int i = 0; i < count; ++i) {
            const float sample = d.at(float(x0 + i) + dc * g[i], float(y) + dr * g[i]);
            moved[i] = std::fabs(sample - g[i]);
            g[i] = sample;
            more |= !mask[i] && moved[i] > limit;
        }
        if (!more) break;
    }
    const float right = float(d.width) - 0.5f, bottom = float(d.height) - 0.5f;
    for (int i = 0; i < count; ++i) {
        const float x = float(x0 + i) + dc * g[i], v = float(y) + dr * g[i];
        field[i] = g[i];
        mask[i] |= uint8_t(moved[i] > limit || x < -0.5f || x > right || v < -0.5f || v > bottom);
    }
}

LFRIG_CLONES void settle_row_plain(const Surface &d, int y, float dr, float dc, float limit, float *field,
                                   uint8_t *mask) {
    for (int x0 = 0; x0 < d.width; x0 += LANES) {
        const int count = std::min(LANES, d.width - x0);
        settle_plain(d, x0, y, count, dr, dc, limit, field + x0, mask + x0);
    }
}

#ifdef LFRIG_X86
// Surface::at for 16 pixels that lie next to one another: their samples come from two or three rows of 32 pixels.
// Returns false, with nothing done, where they do not.
LFRIG_AVX512 inline bool look_up_run(const Surface &d, __m512 x, __m512 y, __m512 *out) {
    const __m512 zero = _mm512_setzero_ps();
    x = _mm512_min_ps(_mm512_max_ps(x, zero), _mm512_set1_ps(float(d.width - 1)));
    y = _mm512_min_ps(_mm512_max_ps(y, zero), _mm512_set1_ps(float(d.height - 1)));
    const __m512i ix = _mm512_cvttps_epi32(x), iy = _mm512_cvttps_epi32(y);
    const int first = std::max(0, _mm_cvtsi128_si32(_mm512_castsi512_si128(ix)) - 6);
    const int top = _mm_cvtsi128_si32(_mm512_castsi512_si128(iy));
    const __m512i column = _mm512_sub_epi32(ix, _mm512_set1_epi32(first));
    if (_mm512_cmpgt_epu32_mask(column, _mm512_set1_epi32(30))) return false;
    const __m512 tx = _mm512_sub_ps(x, _mm512_cvtepi32_ps(ix)), ty = _mm512_sub_ps(y, _mm512_cvtepi32_ps(iy));
    const __m512i next = _mm512_add_epi32(column, _mm512_set1_epi32(1));
    const __m512i row = _mm512_sub_epi32(iy, _mm512_set1_epi32(top));
    const __mmask16 above = _mm512_cmplt_epi32_mask(row, _mm512_setzero_si512());
    const __mmask16 below = _mm512_cmpgt_epi32_mask(row, _mm512_setzero_si512());
    if (above && below) return false;
    if (_mm512_cmpgt_epu32_mask(_mm512_abs_epi32(row), _mm512_set1_epi32(1))) return false;
    const float *from = d.data.data() + ptrdiff_t(top - (above ? 1 : 0)) * d.stride + first;
    const auto blend = [&](const float *p) __attribute__((target("arch=x86-64-v4"), always_inline)) {
        const __m512 low = _mm512_loadu_ps(p), high = _mm512_loadu_ps(p + 16);
        const __m512 a = _mm512_permutex2var_ps(low, column, high), b = _mm512_permutex2var_ps(low, next, high);
        return _mm512_add_ps(a, _mm512_mul_ps(tx, _mm512_sub_ps(b, a)));
    };
    __m512 upper = blend(from), lower = blend(from + d.stride);
    if (above || below) {
        const __m512 last = blend(from + 2 * d.stride);
        const __mmask16 one_down = above ? __mmask16(~above) : below;
        upper = _mm512_mask_mov_ps(upper, one_down, lower);
        lower = _mm512_mask_mov_ps(lower, one_down, last);
    }
    *out = _mm512_add_ps(upper, _mm512_mul_ps(ty, _mm512_sub_ps(lower, upper)));
    return true;
}

LFRIG_AVX512 void settle_row_avx512(const Surface &d, int y, float dr, float dc, float limit, float *field,
                                    uint8_t *mask) {
    const __m512 lane = _mm512_setr_ps(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
    const __m512 rows = _mm512_set1_ps(dr), cols = _mm512_set1_ps(dc), fy = _mm512_set1_ps(float(y));
    const __m512 right = _mm512_set1_ps(float(d.width) - 0.5f), bottom = _mm512_set1_ps(float(d.height) - 0.5f);
    const float *centre = d.data.data() + size_t(y) * d.stride;
    for (int x0 = 0; x0 < d.width; x0 += LANES) {
        const int count = std::min(LANES, d.width - x0);
        const __mmask16 live = __mmask16((1u << count) - 1u);
        const __m128i known = _mm_maskz_loadu_epi8(live, mask + x0);
        const __mmask16 open = live & _mm_cmpeq_epi8_mask(known, _mm_setzero_si128());
        if (!open) continue;
        const __m512 fx = _mm512_add_ps(_mm512_set1_ps(float(x0)), lane);
        __m512 g = _mm512_maskz_loadu_ps(live, centre + x0);
        __mmask16 moving = 0;
        bool together = true;
        for (int round = 0; round < SETTLE_ROUNDS; ++round) {
            __m512 sample;
            const __m512 x = _mm512_add_ps(fx, _mm512_mul_ps(cols, g)), v = _mm512_add_ps(fy, _mm512_mul_ps(rows, g));
            together = look_up_run(d, x, v, &sample);
            if (!together) break;
            const __m512 moved = _mm512_abs_ps(_mm512_sub_ps(sample, g));
            g = sample;
            moving = live & _mm512_cmp_ps_mask(moved, _mm512_set1_ps(limit), _CMP_GT_OQ);
            if (!(moving & open)) break;
        }
        if (!together) {
            settle_plain(d, x0, y, count, dr, dc, limit, field + x0, mask + x0);
            continue;
        }
        _mm512_mask_storeu_ps(field + x0, live, g);
        const __m512 half = _mm512_set1_ps(-0.5f);
        const __m512 x = _mm512_add_ps(fx, _mm512_mul_ps(cols, g)), v = _mm512_add_ps(fy, _mm512_mul_ps(rows, g));
        moving |= _mm512_cmp_ps_mask(x, half, _CMP_LT_OQ) | _mm512_cmp_ps_mask(x, right, _CMP_GT_OQ) |
                  _mm512_cmp_ps_mask(v, half, _CMP_LT_OQ) | _mm512_cmp_ps_mask(v, bottom, _CMP_GT_OQ);
        moving &= live;
        if (moving) _mm_mask_storeu_epi8(mask + x0, moving, _mm_set1_epi8(1));
    }
}
#endif

void settle_row(const Surface &d, int y, float dr, float dc, float limit, float *field, uint8_t *mask) {
#ifdef LFRIG_X86
    if (has_avx512()) return settle_row_avx512(d, y, dr, dc, limit, field, mask);
#endif
    settle_row_plain(d, y, dr, dc, limit, field, mask);
}

LFRIG_CLONES void settle_all(const float *__restrict data, int height, int width, int stride,
                             const int32_t *__restrict xs, const int32_t *__restrict ys, int count, float dr, float dc,
                             int rounds, float limit, float *__restrict px, float *__restrict samples) {
    const float right = float(width - 1), bottom = float(height - 1);
    for (int start = 0; start < count; start += BLOCK) {
        const int end = std::min(start + BLOCK, count);
        int moving = 1;
        for (int round = 0; round <= rounds && moving; ++round) {
            const float least = round < rounds ? limit : 0.0f;  // the last round samples, and moves nothing
            moving = 0;
            for (int i = start; i < end; ++i) {
                float x = float(xs[i]) + dc * px[i], y = float(ys[i]) + dr * px[i];
                x = x > 0.0f ? x : 0.0f, y = y > 0.0f ? y : 0.0f;
                x = x < right ? x : right, y = y < bottom ? y : bottom;
                const int ix = int(x), iy = int(y), at = iy * stride + ix;
                const float tx = x - float(ix), ty = y - float(iy);
                const float a = data[at] + tx * (data[at + 1] - data[at]);
                const float b = data[at + stride] + tx * (data[at + stride + 1] - data[at + stride]);
                const float sample = a + ty * (b - a), change = std::fabs(sample - px[i]);
                samples[i] = sample;
                px[i] = change < least ? sample : px[i];
                moving |= int(change < least) & int(change > SETTLED);
            }
        }
    }
}

// out |= mask, moved by every (dy, dx) of a box; both uint8 [height, stride].
LFRIG_CLONES void widen(const uint8_t *__restrict mask, int height, int width, int stride, int top, int bottom, int left,
                        int right, uint8_t *__restrict across, uint8_t *__restrict out) {
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

Surface::Surface(const float *values, int rows, int cols)
    : height(rows), width(cols), stride(cols + 1), data(size_t(rows + 1) * (cols + 1) + 3 * (cols + 1) + 64) {
    for (int y = 0; y <= height; ++y) {
        float *to = data.data() + size_t(y) * stride;
        const float *from = values + size_t(std::min(y, height - 1)) * width;
        for (int x = 0; x < width; ++x)  // NaN is the lower limit
            to[x] = std::min(std::max(-FARTHEST_PX, from[x]), FARTHEST_PX);
        to[width] = to[width - 1];
    }
}

void settle_list(const Surface &surface, const int32_t *xs, const int32_t *ys, int count, float dr, float dc, int rounds,
                 float limit, float *px, float *samples) {
    settle_all(surface.data.data(), surface.height, surface.width, surface.stride, xs, ys, count, dr, dc, rounds, limit,
               px, samples);
}

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
            const bool steep = across * reach_cols + down * reach_rows > CONTRACTION || std::max(across, down) > SMOOTH_PX;
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
