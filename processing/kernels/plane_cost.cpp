// Photo-consistency sweep of a light field: mean truncated absolute difference per disparity plane, box-aggregated.
// Twin: plane_cost.py.
//
// Work is cut into blocks of 32 x 18 pixels, whose box means cover 30 x 16. A block goes through its planes 16 at a
// time and, for these, through the views a few at a time (lfrig/view_sums.hpp), so that views and sums stay in the L1
// cache. Arithmetic is 16-bit fixed point (grey x 64).
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <stdexcept>
#include <vector>

#include "lfrig/parallel.hpp"
#include "lfrig/transpose.hpp"
#include "lfrig/view_sums.hpp"
#include "parts/block_means.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

using lfrig::Shift;

constexpr int kTile = 8;     // side of the squares that spans are given for
constexpr int kPlanes = 16;  // planes of a block that are swept together
constexpr int kViews = 8;    // at most so many views are swept together

struct Group {       // views in one part of the aperture
    int begin, end;  // in the list of chosen views
    int row, column; // -1, 0 or 1: which side of the centre
};

struct Sweep {
    const int16_t *views, *centre;  // centre: of pixel (0, 0)
    ptrdiff_t stride, origin;       // origin: of pixel (0, 0) in a view
    int height, width, planes, count;
    std::vector<Shift> shifts;      // [planes][count]
    std::vector<Group> groups;
    uint16_t cap, bias;
    int fold, together;             // views whose costs fit 16 bits together
    uint32_t to_mean[5], to_out;    // of all views and of the four halves
    const int16_t *span;            // [ceil(H / 8), ceil(W / 8), 2] or null
    const uint8_t *edges;           // [H, W] or null
    bool only_edges;
    lfrig::Accumulate accumulate;
    uint16_t *out;
};

// The planes that any tile of a block needs.
void planes_of(const Sweep &s, int x0, int y0, int n, int rows, int *first, int *last) {
    *first = 0;
    *last = s.planes;
    if (!s.span) return;
    const int across = (s.width + kTile - 1) / kTile;
    int lo = s.planes, hi = 0;
    for (int ty = y0 / kTile; ty <= (y0 + rows - 1) / kTile; ++ty)
        for (int tx = x0 / kTile; tx <= (x0 + n - 1) / kTile; ++tx) {
            const int16_t *p = s.span + 2 * (size_t(ty) * across + tx);
            if (p[0] >= p[1]) continue;
            lo = std::min(lo, int(p[0]));
            hi = std::max(hi, int(p[1]));
        }
    *first = std::max(0, lo);
    *last = std::min(s.planes, hi);
}

// box[k][y][x] of a block to out[y][x][first + k].
void store(const Sweep &s, const uint16_t *from, int x0, int y0, int n, int rows, int first, int planes) {
    for (int y = 0; y < rows; ++y) {
        uint16_t *to = s.out + (size_t(y0 + y) * s.width + x0) * s.planes + first;
        const uint16_t *line = from + y * kLanes;
        for (int k = 0; k < planes; k += 8)
            for (int x = 0; x < n; x += 8) {
                const uint16_t *corner = line + size_t(k) * kDown * kLanes + x;
                if (k + 8 <= planes && x + 8 <= n)
                    lfrig::transpose8x8(corner, kDown * kLanes, to + size_t(x) * s.planes + k, s.planes);
                else
                    for (int i = 0; i < std::min(8, n - x); ++i)
                        for (int j = 0; j < std::min(8, planes - k); ++j)
                            to[size_t(x + i) * s.planes + k + j] = corner[size_t(j) * kDown * kLanes + i];
            }
    }
}

// Likewise, for pixels on edges, where less than what is there.
void store_lower(const Sweep &s, const uint16_t *from, const uint8_t *edge, int x0, int y0, int n, int rows, int first,
                 int planes) {
    for (int y = 0; y < rows; ++y)
        for (int x = 0; x < n; ++x) {
            if (!edge[y * kLanes + x]) continue;
            uint16_t *to = s.out + (size_t(y0 + y) * s.width + x0 + x) * s.planes + first;
            for (int k = 0; k < planes; ++k)
                to[k] = std::min(to[k], from[(size_t(k) * kDown + y) * kLanes + x]);
        }
}

constexpr int kParts = 9;  // of the aperture: 3 x 3, by the side of the centre

struct Scratch {
    uint16_t total[kPlanes][kRows * kLanes];         // sums over all views
    uint16_t part[kParts][kPlanes][kRows * kLanes];  // likewise, of each part; 0 where it has no views
    uint16_t joined[5][kRows * kLanes];              // of one plane: all views, and the four halves
    uint16_t boxed[kPlanes][kDown * kLanes], halves[4][kDown * kLanes];
    uint8_t edge[kDown * kLanes];
};

bool find_edges(const Sweep &s, int x0, int y0, int n, int rows, uint8_t *edge) {
    if (!s.edges) return false;
    bool any = false;
    std::memset(edge, 0, kDown * kLanes);
    for (int y = 0; y < rows; ++y)
        for (int x = 0; x < n; ++x)
            any |= (edge[y * kLanes + x] = s.edges[size_t(y0 + y) * s.width + x0 + x] != 0);
    return any;
}

// Sums over the views: of all, or of each part of the aperture.
void sum_views(const Sweep &s, ptrdiff_t pixel, int first, int planes, bool parts, Scratch &t) {
    if (!parts) std::memset(t.total, 0, sizeof t.total[0] * planes);
    for (const Group &g : s.groups) {
        auto *sums = parts ? t.part[3 * (g.row + 1) + g.column + 1] : t.total;
        if (parts) std::memset(sums, 0, sizeof sums[0] * planes);
        for (int v = g.begin; v < g.end; v += s.together)
            for (int k = 0; k < planes; ++k)
                s.accumulate(s.views + pixel, s.shifts.data() + size_t(first + k) * s.count + v,
                             std::min(s.together, g.end - v), s.stride, s.centre + (pixel - s.origin), s.cap, s.fold,
                             sums[k]);
    }
}

void sweep_block(const Sweep &s, int x0, int y0, Scratch &t) {
    const int n = std::min(kAcross, s.width - x0), rows = std::min(kDown, s.height - y0);
    const bool halves = find_edges(s, x0, y0, n, rows, t.edge);
    if (s.only_edges && !halves) return;
    int first, last;
    planes_of(s, x0, y0, n, rows, &first, &last);
    const ptrdiff_t pixel = s.origin + ptrdiff_t(y0 - 1) * s.stride + (x0 - 1);
    const int top = y0 == 0 ? 0 : -1, bottom = y0 + rows == s.height ? rows - 1 : -1;
    const int left = x0 == 0 ? 1 : -1, right = x0 + n == s.width ? n : -1;
    for (int k0 = first; k0 < last; k0 += kPlanes) {
        const int planes = std::min(kPlanes, last - k0);
        sum_views(s, pixel, k0, planes, halves, t);
        for (int k = 0; k < planes; ++k) {
            if (halves) join_parts(t.part[0][k], kPlanes * kRows * kLanes, t.joined[0]);
            const uint16_t *all = halves ? t.joined[0] : t.total[k];
            box(all, s.to_mean[0], s.to_out, top, bottom, left, right, t.boxed[k]);
            if (!halves) continue;
            for (int h = 0; h < 4; ++h)
                box(t.joined[h + 1], s.to_mean[h + 1], s.to_out, top, bottom, left, right, t.halves[h]);
            take_halves(t.halves[0], t.edge, s.bias, t.boxed[k]);
        }
        if (s.only_edges)
            store_lower(s, t.boxed[0], t.edge, x0, y0, n, rows, k0, planes);
        else
            store(s, t.boxed[0], x0, y0, n, rows, k0, planes);
    }
}

int side(float offset) { return offset < 0 ? -1 : offset > 0; }

// Views sorted by the part of the aperture that they are in.
void group_views(Sweep &s, const int32_t *chosen, const float *offsets, std::vector<int> &order) {
    for (int row = -1; row <= 1; ++row)
        for (int column = -1; column <= 1; ++column) {
            const int begin = int(order.size());
            for (int i = 0; i < s.count; ++i)
                if (side(offsets[2 * chosen[i]]) == row && side(offsets[2 * chosen[i] + 1]) == column)
                    order.push_back(chosen[i]);
            if (int(order.size()) > begin) s.groups.push_back({begin, int(order.size()), row, column});
        }
}

void count_halves(const Sweep &s, int count[5]) {
    std::fill(count, count + 5, 0);
    for (const Group &g : s.groups) {
        const int n = g.end - g.begin;
        count[0] += n;
        if (g.row) count[g.row < 0 ? 1 : 2] += n;
        if (g.column) count[g.column < 0 ? 3 : 4] += n;
    }
}

using Views = ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu>;

// views int16 [V, rows, stride] (grey x 64), the image at (pad, pad); offsets float32 [V, 2] (dr, dc); chosen int32
// [n]; span int16 [ceil(H / 8), ceil(W / 8), 2] or empty; edges uint8 [H, W] or empty; out uint16 [H, W, D] in `unit`
// per grey level. `plain` keeps to the form that every machine runs.
void plane_cost(Views views, int centre, ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu> offsets,
                ndarray<const int32_t, nb::ndim<1>, nb::c_contig, nb::device::cpu> chosen,
                ndarray<const int16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> span,
                ndarray<const uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu> edges, bool only_edges, int pad,
                float first, float step, int cap, int unit, int bias,
                ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> out, int threads, bool plain) {
    Sweep s{};
    const int total = int(views.shape(0)), view_rows = int(views.shape(1));
    s.stride = int(views.shape(2));
    s.height = int(out.shape(0)), s.width = int(out.shape(1)), s.planes = int(out.shape(2));
    s.count = int(chosen.shape(0));
    float furthest = 0;
    bool known = centre >= 0 && centre < total && int(offsets.shape(0)) == total && offsets.shape(1) == 2;
    for (int i = 0; i < s.count && known; ++i) {
        const int v = chosen.data()[i];
        if ((known = v >= 0 && v < total))
            for (int j = 0; j < 2; ++j) furthest = std::max(furthest, std::fabs(offsets.data()[2 * v + j]));
    }
    const float reach = furthest * std::max(std::fabs(first), std::fabs(first + step * float(s.planes - 1)));
    if (!(reach <= float(pad - 2))) throw std::invalid_argument("plane_cost: the views are not padded enough");
    const int down = (s.height + kTile - 1) / kTile, across = (s.width + kTile - 1) / kTile;
    if (!known || s.count < 1 || s.count > 4096 || s.height < 1 || s.width < 1 || s.planes < 1 || cap < 1 ||
        cap > 32767 || unit < 1 || bias < 0 || bias > 32767 || view_rows < s.height + 2 * pad + kDown ||
        int(s.stride) < s.width + 2 * pad + kLanes ||
        (span.size() && (int(span.shape(0)) != down || int(span.shape(1)) != across || span.shape(2) != 2)) ||
        (edges.size() && (int(edges.shape(0)) != s.height || int(edges.shape(1)) != s.width)))
        throw std::invalid_argument("plane_cost: shapes do not match");
    s.views = views.data();
    s.origin = ptrdiff_t(pad) * s.stride + pad;
    const ptrdiff_t view_size = ptrdiff_t(view_rows) * s.stride;
    s.centre = s.views + centre * view_size + s.origin;
    s.span = span.size() ? span.data() : nullptr;
    s.edges = edges.size() ? edges.data() : nullptr;
    s.only_edges = only_edges;
    s.cap = uint16_t(cap), s.bias = uint16_t(bias);
    s.accumulate = plain ? lfrig::accumulate_plain : lfrig::fastest();
    s.out = out.data();
    s.together = std::min(kViews, 65534 / cap);
    // Sums over all views are kept in 16 bits, each group's rounded to `fold` bits less.
    const int64_t most = int64_t(s.count) * cap + s.count;
    while ((most >> s.fold) > 65535) ++s.fold;
    // A mean is kept with as many bits as let nine of them fit 16 bits.
    const double fine = 65535.0 / 9 / (cap + 1);
    std::vector<int> order;
    group_views(s, chosen.data(), offsets.data(), order);
    int members[5];
    count_halves(s, members);
    for (int i = 0; i < 5; ++i)
        s.to_mean[i] = members[i] ? uint32_t(std::lrint(65536.0 * double(1 << s.fold) * fine / members[i])) : 0;
    s.to_out = uint32_t(std::lrint(65536.0 * unit / (64.0 * 9.0 * fine)));
    if (s.edges && !(members[1] && members[2] && members[3] && members[4]))
        throw std::invalid_argument("plane_cost: half of the aperture has no view");
    nb::gil_scoped_release release;
    for (int k = 0; k < s.planes; ++k)
        for (int v : order) {
            const float delta = first + step * float(k), *o = offsets.data() + 2 * v;
            s.shifts.push_back(lfrig::shift_of(-o[1] * delta, -o[0] * delta, v * view_size, s.stride));
        }
    const int bands = (s.height + kDown - 1) / kDown;
    lfrig::parallel_for(bands, threads, [&](int band) {
        std::vector<Scratch> scratch(1);
        for (int x0 = 0; x0 < s.width; x0 += kAcross) sweep_block(s, x0, band * kDown, scratch[0]);
    });
}

}  // namespace

void register_plane_cost(nb::module_ &m) {
    m.def("plane_cost", &plane_cost, nb::arg("views").noconvert(), nb::arg("centre"), nb::arg("offsets").noconvert(),
          nb::arg("chosen").noconvert(), nb::arg("span").noconvert(), nb::arg("edges").noconvert(),
          nb::arg("only_edges"), nb::arg("pad"), nb::arg("first"), nb::arg("step"), nb::arg("cap"), nb::arg("unit"),
          nb::arg("bias"), nb::arg("out").noconvert(), nb::arg("threads"), nb::arg("plain"));
}
