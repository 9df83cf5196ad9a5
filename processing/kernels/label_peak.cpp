// The best label of aggregated costs and how distinct it is, from a volume or as semi-global matching finishes each
// pixel. Twin: label_peak.py.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <vector>

#include "lfrig/labels.hpp"
#include "lfrig/parallel.hpp"
#include "sgm_arrays.hpp"

namespace nb = nanobind;
using nb::ndarray;

namespace {

using F2 = ndarray<float, nb::ndim<2>, nb::c_contig, nb::device::cpu>;

constexpr int kReach = 2;  // labels on either side that count as the same

struct Peak {
    float label, margin, curvature;
};

// Of `count` active sums; what follows them up to whole lanes is inactive.
LFRIG_CLONES Peak peak_of(const uint16_t *__restrict sum, int count, float scale) {
    const int padded = lfrig::whole_lanes(count), best = lfrig::first_least(sum, padded);
    uint16_t other = lfrig::kInactive;
    for (int k = 0; k < padded; ++k) {
        const uint16_t away = k < best - kReach || k > best + kReach ? sum[k] : lfrig::kInactive;
        other = lfrig::least16(other, away);
    }
    const int least = sum[best], left = sum[std::max(0, best - kReach)],
              right = sum[std::min(count - 1, best + kReach)];
    Peak peak;
    peak.label = float(best) + lfrig::parabola(sum, best, count);
    peak.margin = other == lfrig::kInactive ? 0.0f : float(int(other) - least) * scale;
    peak.curvature = float(left + right - 2 * least) * scale;
    return peak;
}

struct Maps {
    float *label, *margin, *curvature;
    float scale;
};

// The peak of one pixel's sums, of which those in the span are active; the span is followed by inactive ones.
void keep_peak(const Maps &maps, size_t pixel, const uint16_t *sum, const lfrig::Span &span) {
    Peak peak{0, 0, 0};
    if (span.first < span.last) {
        peak = peak_of(sum + span.first, span.last - span.first, maps.scale);
        peak.label += float(span.first);
    }
    maps.label[pixel] = peak.label;
    maps.margin[pixel] = peak.margin;
    maps.curvature[pixel] = peak.curvature;
}

// Takes sums and leaves their peaks.
class KeepPeaks {
  public:
    KeepPeaks(const Maps &maps, int labels) : maps_(maps), buffer_(labels) {}

    void place(lfrig::Chunk &chunk) { buffer_.place(chunk); }

    void finished(const lfrig::Chunk &chunk) {
        for (int i = 0; i < chunk.count; ++i)
            keep_peak(maps_, chunk.first - i, buffer_.closed(chunk, i), chunk.span[i]);
    }

  private:
    const Maps maps_;
    lfrig::SumBuffer buffer_;
};

Maps maps_of(const CU3 &volume, float scale, F2 &label, F2 &margin, F2 &curvature) {
    for (const F2 *map : {&label, &margin, &curvature})
        if (map->shape(0) != volume.shape(0) || map->shape(1) != volume.shape(1))
            throw std::invalid_argument("label_peak: shapes do not match");
    if (volume.shape(2) < 1 || volume.shape(2) > 65535 - lfrig::kLanes)
        throw std::invalid_argument("label_peak: no label, or too many");
    return {label.data(), margin.data(), curvature.data(), scale};
}

// total uint16 [H, W, D], 65535 where a label is inactive: before and behind the active ones of a pixel.
void label_peak(CU3 total, float scale, F2 label, F2 margin, F2 curvature, int threads) {
    const Maps maps = maps_of(total, scale, label, margin, curvature);
    const int height = int(total.shape(0)), width = int(total.shape(1)), labels = int(total.shape(2));
    const uint16_t *from = total.data();
    nb::gil_scoped_release release;
    lfrig::parallel_for(height, threads, [&](int y) {
        std::vector<uint16_t> padded(labels + lfrig::kLanes, lfrig::kInactive);
        for (size_t pixel = size_t(y) * width; pixel < size_t(y + 1) * width; ++pixel) {
            const uint16_t *sum = from + pixel * labels;
            lfrig::Span span{0, labels, 0, labels};
            while (span.first < labels && sum[span.first] == lfrig::kInactive) ++span.first;
            while (span.last > span.first && sum[span.last - 1] == lfrig::kInactive) --span.last;
            std::copy(sum, sum + labels, padded.begin());
            keep_peak(maps, pixel, padded.data(), span);
        }
    });
}

// scratch uint16 [H, W, D]; the others as for `semi_global_of`.
void sgm_label_peak(CU3 cost, CU3 penalty, CI3 shift, CI3 span, int p1, int cap, float scale,
                    ndarray<uint16_t, nb::ndim<3>, nb::c_contig, nb::device::cpu> scratch, F2 label, F2 margin,
                    F2 curvature, int threads) {
    lfrig::SemiGlobal v = semi_global_of(cost, penalty, shift, span, p1, cap);
    const Maps maps = maps_of(cost, scale, label, margin, curvature);
    for (int axis = 0; axis < 3; ++axis)
        if (scratch.shape(axis) != cost.shape(axis))
            throw std::invalid_argument("sgm_label_peak: shapes do not match");
    v.sum = scratch.data();
    nb::gil_scoped_release release;
    lfrig::aggregate(v, threads, [&] { return KeepPeaks(maps, v.labels); });
}

}  // namespace

void register_label_peak(nb::module_ &m) {
    m.def("label_peak", &label_peak, nb::arg("total").noconvert(), nb::arg("scale"), nb::arg("label").noconvert(),
          nb::arg("margin").noconvert(), nb::arg("curvature").noconvert(), nb::arg("threads"));
    m.def("sgm_label_peak", &sgm_label_peak, nb::arg("cost").noconvert(), nb::arg("penalty").noconvert(),
          nb::arg("shift").noconvert(), nb::arg("span").noconvert(), nb::arg("p1"), nb::arg("cap"), nb::arg("scale"),
          nb::arg("scratch").noconvert(), nb::arg("label").noconvert(), nb::arg("margin").noconvert(),
          nb::arg("curvature").noconvert(), nb::arg("threads"));
}
