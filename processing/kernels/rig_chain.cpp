// From the parameters of a turntable rig to its views, and their derivatives. Twin: rig_chain.py.
//
// Tiny, but asked for in every round of every adjustment; as arrays operations its price would be that of the rest.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <stdexcept>

namespace nb = nanobind;
using nb::ndarray;

namespace {

constexpr int kLocal = 9, kView = 17;

struct Matrix {
    double m[3][3];
};

Matrix product(const Matrix &a, const Matrix &b) {
    Matrix out;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) out.m[i][j] = a.m[i][0] * b.m[0][j] + a.m[i][1] * b.m[1][j] + a.m[i][2] * b.m[2][j];
    return out;
}

Matrix skew(const double *v) { return {{{0, -v[2], v[1]}, {v[2], 0, -v[0]}, {-v[1], v[0], 0}}}; }

// 1 + first S + second S², S = [v]×.
Matrix series(const double *v, double first, double second) {
    const Matrix s = skew(v), ss = product(s, s);
    Matrix out;
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) out.m[i][j] = (i == j) + first * s.m[i][j] + second * ss.m[i][j];
    return out;
}

struct Factors {  // sin(a)/a, (1 − cos a)/a², (a − sin a)/a³
    double first, second, third;
};

Factors factors(const double *v) {
    const double a = std::sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
    // Series where the quotients lose their digits.
    if (a < 1e-4) return {1 - a * a / 6, 0.5 - a * a / 24, 1.0 / 6};
    return {std::sin(a) / a, (1 - std::cos(a)) / (a * a), (a - std::sin(a)) / (a * a * a)};
}

struct Rigid {
    Matrix turn;
    double shift[3];
};

// The pose after a small motion in the camera's frame.
Rigid after(const double *motion, const Rigid &rigid) {
    const Factors f = factors(motion);
    const Matrix turn = series(motion, f.first, f.second);
    Rigid out{product(turn, rigid.turn), {}};
    for (int i = 0; i < 3; ++i)
        out.shift[i] = turn.m[i][0] * rigid.shift[0] + turn.m[i][1] * rigid.shift[1] + turn.m[i][2] * rigid.shift[2] +
                       motion[3 + i];
    return out;
}

// [6, 6] with blocks A, 0; [t]× A, B.
void blocks(const double *shift, const Matrix &a, const Matrix &b, double out[6][6]) {
    const Matrix crossed = product(skew(shift), a);
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) {
            out[i][j] = a.m[i][j];
            out[i][3 + j] = 0;
            out[3 + i][j] = crossed.m[i][j];
            out[3 + i][3 + j] = b.m[i][j];
        }
}

void adjoint(const double *motion, double out[6][6]) {
    const Factors f = factors(motion);
    const Matrix turn = series(motion, f.first, f.second);
    blocks(motion + 3, turn, turn, out);
}

void motion_derivative(const double *motion, double out[6][6]) {
    const Factors f = factors(motion);
    blocks(motion + 3, series(motion, f.second, f.third), {{{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}}, out);
}

struct Rig {
    const double *mounts;  // [G, 12]: R by rows, t
    const int32_t *mount;  // [V]
    const double *fixed;   // [V, 6]: angle [rad], focal length, principal point, baseline, inverse focus distance
    int mount_count, view_count;
};

void chain(const Rig &rig, const double *x, double *views, double *derivative) {
    const int count = rig.view_count, size = 6 * rig.mount_count + 10 * count;
    const int turns = 6 * rig.mount_count, wobbles = turns + count, focals = wobbles + 6 * count, lines = focals + count;
    for (int v = 0; v < count; ++v) {
        const double *m = rig.mounts + 12 * rig.mount[v], *fixed = rig.fixed + 6 * v;
        const double *correction = x + 6 * rig.mount[v], *wobble = x + wobbles + 6 * v;
        Rigid mount{{{{m[0], m[1], m[2]}, {m[3], m[4], m[5]}, {m[6], m[7], m[8]}}}, {m[9], m[10], m[11]}};
        Rigid before = after(correction, mount);
        const double angle = fixed[0] + x[turns + v], c = std::cos(angle), s = std::sin(angle);
        before.turn = product(before.turn, {{{c, -s, 0}, {s, c, 0}, {0, 0, 1}}});
        const Rigid pose = after(wobble, before);
        double *out = views + kView * v;
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) out[3 * i + j] = pose.turn.m[i][j];
            out[9 + i] = pose.shift[i];
        }
        out[12] = fixed[1] * std::exp(x[focals + v]);
        out[13] = fixed[2];
        out[14] = fixed[3];
        out[15] = fixed[4] * std::exp(x[lines + 2 * v]);
        out[16] = fixed[5] * std::exp(x[lines + 2 * v + 1]);

        double lift[6][6], by_mount[6][6], by_wobble[6][6];
        adjoint(wobble, lift);
        motion_derivative(correction, by_mount);
        motion_derivative(wobble, by_wobble);
        const double a[3] = {before.turn.m[0][2], before.turn.m[1][2], before.turn.m[2][2]}, *t = before.shift;
        const double swing[6] = {a[0], a[1], a[2], a[2] * t[1] - a[1] * t[2], a[0] * t[2] - a[2] * t[0],
                                 a[1] * t[0] - a[0] * t[1]};
        double *d = derivative + size_t(v) * kLocal * size;
        for (int i = 0; i < 6; ++i) {
            double turned = 0;
            for (int k = 0; k < 6; ++k) turned += lift[i][k] * swing[k];
            d[i * size + turns + v] = turned;
            for (int j = 0; j < 6; ++j) {
                double moved = 0;
                for (int k = 0; k < 6; ++k) moved += lift[i][k] * by_mount[k][j];
                d[i * size + 6 * rig.mount[v] + j] = moved;
                d[i * size + wobbles + 6 * v + j] = by_wobble[i][j];
            }
        }
        d[6 * size + focals + v] = d[7 * size + lines + 2 * v] = d[8 * size + lines + 2 * v + 1] = 1;
    }
}

template <typename T, int Dims>
using Array = ndarray<T, nb::ndim<Dims>, nb::c_contig, nb::device::cpu>;

}  // namespace

void register_rig_chain(nb::module_ &m) {
    m.def(
        "rig_chain",
        [](Array<const double, 2> mounts, Array<const int32_t, 1> mount, Array<const double, 2> fixed,
           Array<const double, 1> x, Array<double, 2> views, Array<double, 3> derivative) {
            const size_t count = mount.shape(0), size = 6 * mounts.shape(0) + 10 * count;
            if (mounts.shape(1) != 12 || fixed.shape(0) != count || fixed.shape(1) != 6 || x.shape(0) != size ||
                views.shape(0) != count || views.shape(1) != kView || derivative.shape(0) != count ||
                derivative.shape(1) != kLocal || derivative.shape(2) != size)
                throw std::invalid_argument("rig_chain: shapes do not match");
            for (size_t v = 0; v < count; ++v)
                if (mount(v) < 0 || size_t(mount(v)) >= mounts.shape(0))
                    throw std::invalid_argument("rig_chain: no such mount");
            nb::gil_scoped_release release;
            chain({mounts.data(), mount.data(), fixed.data(), int(mounts.shape(0)), int(count)}, x.data(), views.data(),
                  derivative.data());
        },
        "Views and their derivatives, the latter into a zeroed array");
}
