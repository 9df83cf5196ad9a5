// What lies behind and beside the rims of near surfaces, grown ring by ring. Twins: rims.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>
#include <vector>

namespace nb = nanobind;
using nb::ndarray;

namespace {

struct Frame {
    int height, width;

    bool holds(int y, int x) const { return y >= 0 && y < height && x >= 0 && x < width; }
};

// Calls fn(index, dy, dx) for the eight neighbours of a pixel that are in the frame, row by row.
template <class F>
inline void around(const Frame &frame, int at, F &&fn) {
    const int y = at / frame.width, x = at % frame.width;
    for (int dy = -1; dy <= 1; ++dy)
        for (int dx = -1; dx <= 1; ++dx)
            if ((dy || dx) && frame.holds(y + dy, x + dx)) fn(at + dy * frame.width + dx, dy, dx);
}

// Values of `known` pixels continued to `wanted` ones, in place; `known` takes in what was reached.
struct Grower {
    Frame frame;
    int channels, radius;
    const float *weights;  // [2 radius + 1, 2 radius + 1]
    float *values;
    uint8_t *known;

    bool reachable(int at) const {
        bool found = false;
        around(frame, at, [&](int other, int, int) { found |= known[other] != 0; });
        return found;
    }
    void mean(int at, float *out) const {
        const int y = at / frame.width, x = at % frame.width, size = 2 * radius + 1;
        float total = 0.0f;
        std::fill_n(out, channels, 0.0f);
        for (int dy = -radius; dy <= radius; ++dy)
            for (int dx = -radius; dx <= radius; ++dx) {
                if (!frame.holds(y + dy, x + dx)) continue;
                const int other = at + dy * frame.width + dx;
                if (!known[other]) continue;
                const float weight = weights[(dy + radius) * size + dx + radius];
                total += weight;
                for (int c = 0; c < channels; ++c) out[c] += weight * values[size_t(other) * channels + c];
            }
        for (int c = 0; c < channels; ++c) out[c] /= total;
    }
    void grow(std::vector<int32_t> wanted, int rounds) {
        std::vector<int32_t> ring, rest;
        std::vector<float> means;
        for (int round = 0; round < rounds && !wanted.empty(); ++round) {
            ring.clear(), rest.clear();
            for (const int32_t at : wanted) (reachable(at) ? ring : rest).push_back(at);
            if (ring.empty()) break;
            means.resize(ring.size() * channels);
            for (size_t i = 0; i < ring.size(); ++i) mean(ring[i], means.data() + i * channels);
            for (size_t i = 0; i < ring.size(); ++i) {
                std::copy_n(means.data() + i * channels, channels, values + size_t(ring[i]) * channels);
                known[ring[i]] = 1;
            }
            wanted.swap(rest);
        }
    }
};

using Map = ndarray<const float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Flags = ndarray<uint8_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

void grow(ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu> values, Flags known, Flags wanted, Map weights,
          int rounds) {
    const int height = int(values.shape(0)), width = int(values.shape(1));
    if (int(known.shape(0)) != height || int(known.shape(1)) != width || int(wanted.shape(0)) != height ||
        int(wanted.shape(1)) != width || weights.shape(0) != weights.shape(1) || weights.shape(0) % 2 != 1)
        throw std::invalid_argument("grow: shapes do not match");
    Grower grower{{height, width}, int(values.shape(2)), int(weights.shape(0)) / 2, weights.data(), values.data(),
                  known.data()};
    const uint8_t *want = wanted.data();
    nb::gil_scoped_release release;
    std::vector<int32_t> open;
    for (int i = 0; i < height * width; ++i)
        if (want[i] && !grower.known[i]) open.push_back(i);
    grower.grow(std::move(open), rounds);
}

struct Slope {
    float down, right;
};

struct Peeler {
    Frame frame;
    const float *surface, *lowest;  // the surface, and its lowest value in the slope's window
    float step_px, limit_px;        // neighbours that differ by more: two surfaces; no slope
    int window_px, least;           // slopes are means over a window, of at least so many differences
    float *behind;
    uint8_t *done;
    std::vector<Slope> slopes;

    // Mean slope of the far surface around a pixel, steps and what stands before a step left out.
    Slope slope(int at) const {
        const int y = at / frame.width, x = at % frame.width, r = window_px / 2;
        float sum[2] = {0.0f, 0.0f};
        int count[2] = {0, 0};
        for (int v = std::max(0, y - r); v <= std::min(frame.height - 1, y + r); ++v)
            for (int u = std::max(0, x - r); u <= std::min(frame.width - 1, x + r); ++u) {
                const int here = v * frame.width + u;
                if (!(surface[here] - lowest[here] <= step_px)) continue;
                const float down = v + 1 < frame.height ? surface[here + frame.width] - surface[here] : limit_px * 2;
                const float right = u + 1 < frame.width ? surface[here + 1] - surface[here] : limit_px * 2;
                if (std::fabs(down) <= limit_px) sum[0] += down, ++count[0];
                if (std::fabs(right) <= limit_px) sum[1] += right, ++count[1];
            }
        return {count[0] >= least ? sum[0] / float(count[0]) : 0.0f,
                count[1] >= least ? sum[1] / float(count[1]) : 0.0f};
    }

    struct Peel {
        float value;
        Slope slope;
    };

    // The far surface under a pixel, continued from its neighbours; false where none of them is farther.
    bool continued(int at, bool first, Peel &out) const {
        float sum = 0.0f, down = 0.0f, right = 0.0f, count = 0.0f;
        around(frame, at, [&](int other, int dy, int dx) {
            if (!(surface[at] - behind[other] > step_px) || !(first || done[other])) return;
            const Slope s = first ? slope(other) : slopes[other];
            sum += behind[other] - float(dx) * s.right - float(dy) * s.down;
            down += s.down, right += s.right, count += 1.0f;
        });
        if (count == 0.0f) return false;
        out = {std::min(sum / count, surface[at]), {down / count, right / count}};
        return true;
    }

    void peel(std::vector<int32_t> ring, int rounds) {
        std::vector<int32_t> hit;
        std::vector<Peel> peels;
        for (int round = 0; round < rounds && !ring.empty(); ++round) {
            hit.clear(), peels.clear();
            for (const int32_t at : ring) {
                Peel peel;
                if (!continued(at, round == 0, peel)) continue;
                hit.push_back(at), peels.push_back(peel);
            }
            for (size_t i = 0; i < hit.size(); ++i) {
                behind[hit[i]] = peels[i].value, slopes[hit[i]] = peels[i].slope;
                done[hit[i]] = 1;
            }
            ring.clear();
            for (const int32_t at : hit)
                around(frame, at, [&](int other, int, int) {
                    if (done[other]) return;
                    ring.push_back(other);
                });
            std::sort(ring.begin(), ring.end());
            ring.erase(std::unique(ring.begin(), ring.end()), ring.end());
        }
    }
};

void peel(Map surface, Map lowest, Flags rim, ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu> behind,
          Flags done, float step_px, float limit_px, int window_px, int least, int rounds) {
    const int height = int(surface.shape(0)), width = int(surface.shape(1));
    const auto fits = [&](const auto &a) { return int(a.shape(0)) == height && int(a.shape(1)) == width; };
    if (!fits(lowest) || !fits(rim) || !fits(behind) || !fits(done))
        throw std::invalid_argument("peel: shapes do not match");
    Peeler peeler{{height, width}, surface.data(), lowest.data(), step_px,      limit_px, window_px,
                  least,           behind.data(),  done.data(),   {}};
    const uint8_t *start = rim.data();
    nb::gil_scoped_release release;
    const size_t size = size_t(height) * width;
    peeler.slopes.assign(size, {0.0f, 0.0f});
    std::copy_n(peeler.surface, size, peeler.behind);
    std::fill_n(peeler.done, size, uint8_t(0));
    std::vector<int32_t> ring;
    for (size_t i = 0; i < size; ++i)
        if (start[i]) ring.push_back(int32_t(i));
    peeler.peel(std::move(ring), rounds);
}

}  // namespace

void register_rims(nb::module_ &m) {
    m.def("grow", &grow, nb::arg("values").noconvert(), nb::arg("known").noconvert(), nb::arg("wanted").noconvert(),
          nb::arg("weights").noconvert(), nb::arg("rounds"));
    m.def("peel", &peel, nb::arg("surface").noconvert(), nb::arg("lowest").noconvert(), nb::arg("rim").noconvert(),
          nb::arg("behind").noconvert(), nb::arg("done").noconvert(), nb::arg("step_px"), nb::arg("limit_px"),
          nb::arg("window_px"), nb::arg("least"), nb::arg("rounds"));
}
