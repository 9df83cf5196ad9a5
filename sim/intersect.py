"""NumPy twin of primitives.hpp: rays against one primitive, in float64 and in the same order of operations.

Vectors are triples of arrays [N]; a primitive is a row of `scene.PackedScene.primitives`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from lfrig.sim.scene import F64, Kind

MISS = np.inf
TINY = 1e-12
TORUS_STEPS = 96
Triple = tuple[F64, F64, F64]
I64 = NDArray[np.int64]
Number = TypeVar("Number", float, F64)


@dataclass(frozen=True)
class Ray:
    """Rays: origins and unit directions (triples of [N]), and z-depth per unit of distance [N]."""

    origin: Triple
    direction: Triple
    depth_per_t: F64

    def take(self, rows: NDArray[np.int64]) -> Ray:
        """The rays at ``rows``."""
        o, d = self.origin, self.direction
        return Ray((o[0][rows], o[1][rows], o[2][rows]), (d[0][rows], d[1][rows], d[2][rows]), self.depth_per_t[rows])


def dot(a: tuple[F64 | float, ...], b: tuple[F64 | float, ...]) -> F64:
    """Scalar product of triples."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def to_local(record: F64, v: Triple) -> Triple:
    """Rotate a vector into the primitive's frame."""
    m = record[4:13]
    return (
        m[0] * v[0] + m[1] * v[1] + m[2] * v[2],
        m[3] * v[0] + m[4] * v[1] + m[5] * v[2],
        m[6] * v[0] + m[7] * v[1] + m[8] * v[2],
    )


def to_world(record: F64, v: Triple) -> Triple:
    """Rotate a vector out of the primitive's frame."""
    m = record[4:13]
    return (
        m[0] * v[0] + m[3] * v[1] + m[6] * v[2],
        m[1] * v[0] + m[4] * v[1] + m[7] * v[2],
        m[2] * v[0] + m[5] * v[1] + m[8] * v[2],
    )


def intersect(record: F64, ray: Ray) -> tuple[F64, I64]:
    """(t, face) of the first hit at t > 1e-6; t = inf where there is none."""
    p, o = record, ray.origin
    local = to_local(p, (o[0] - p[1], o[1] - p[2], o[2] - p[3]))
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        t, face = _HITS[Kind(int(p[0]))](record[13:16], local, to_local(p, ray.direction))
    return np.where(t > 1e-6, t, MISS), face


def _away_from_zero(v: F64) -> F64:
    return np.where(np.abs(v) < TINY, TINY, v)


def segment_meets_box(o: Triple, d: Triple, half: F64) -> NDArray[np.bool_]:
    """Whether the segments o + s d, s in [0, 1], meet boxes of half sizes ``half`` [3, N] (local frame)."""
    enter, leave = np.zeros(len(o[0])), np.ones(len(o[0]))
    for axis in range(3):
        inverse = 1.0 / _away_from_zero(d[axis])
        s0, s1 = (-half[axis] - o[axis]) * inverse, (half[axis] - o[axis]) * inverse
        enter, leave = np.maximum(enter, np.minimum(s0, s1)), np.minimum(leave, np.maximum(s0, s1))
    return np.asarray(enter <= leave)


def _no_face(t: F64) -> I64:
    return np.zeros(len(t), np.int64)


def _hit_sphere(size: F64, o: Triple, d: Triple) -> tuple[F64, I64]:
    b, q = dot(o, d), dot(o, o) - size[0] * size[0]
    disc = b * b - q
    t = np.where(disc > 0, -b - np.sqrt(np.maximum(disc, 0)), MISS)
    return t, _no_face(t)


def _hit_box(size: F64, o: Triple, d: Triple) -> tuple[F64, I64]:
    enter, leave = np.full(len(o[0]), -MISS), np.full(len(o[0]), MISS)
    face = np.zeros(len(o[0]), np.int64)
    for axis in range(3):
        inverse = 1.0 / _away_from_zero(d[axis])
        t0, t1 = (-size[axis] - o[axis]) * inverse, (size[axis] - o[axis]) * inverse
        low, high = np.minimum(t0, t1), np.maximum(t0, t1)
        face = np.where(low > enter, axis, face)
        enter, leave = np.maximum(enter, low), np.minimum(leave, high)
    return np.where(enter <= leave, enter, MISS), face


def _hit_cylinder(size: F64, o: Triple, d: Triple) -> tuple[F64, I64]:
    r2, half = size[0] * size[0], size[1]
    a, b, q = d[0] * d[0] + d[1] * d[1], o[0] * d[0] + o[1] * d[1], o[0] * o[0] + o[1] * o[1] - r2
    disc = b * b - a * q
    side = (-b - np.sqrt(np.maximum(disc, 0))) / a
    on_side = (disc > 0) & (a > TINY) & (np.abs(o[2] + side * d[2]) <= half)
    best = np.where(on_side, side, MISS)
    dz = _away_from_zero(d[2])
    cap = (np.where(dz < 0, half, -half) - o[2]) / dz
    x, y = o[0] + cap * d[0], o[1] + cap * d[1]
    on_cap = (x * x + y * y <= r2) & (cap < best)
    return np.where(on_cap, cap, best), on_cap.astype(np.int64)


def _hit_torus(size: F64, o: Triple, d: Triple) -> tuple[F64, I64]:
    major, minor = float(size[0]), float(size[1])
    t, end = np.zeros(len(o[0])), np.full(len(o[0]), MISS)
    for axis, half in enumerate((major + minor, major + minor, minor)):
        inverse = 1.0 / _away_from_zero(d[axis])
        t0, t1 = (-half - o[axis]) * inverse, (half - o[axis]) * inverse
        t, end = np.maximum(t, np.minimum(t0, t1)), np.minimum(end, np.maximum(t0, t1))
    result = np.full(len(t), MISS)
    rows = np.flatnonzero(t <= end)
    t, end = t[rows], end[rows]
    ox, oy, oz = (c[rows] for c in o)
    dx, dy, dz = (c[rows] for c in d)
    distance = np.full(len(rows), MISS)
    for _ in range(TORUS_STEPS):
        x, y, z = ox + t * dx, oy + t * dy, oz + t * dz
        radius = np.sqrt(x * x + y * y)
        ring = radius - major
        tube = np.sqrt(ring * ring + z * z)
        distance = tube - minor
        arrived = (np.abs(distance) < 1e-9) | (t > end)
        result[rows[arrived]] = np.where((np.abs(distance) < 1e-6) & (t <= end), t, MISS)[arrived]
        if arrived.all():
            return result, _no_face(result)
        slope = (ring * ((x * dx + y * dy) / np.maximum(radius, TINY)) + z * dz) / np.maximum(tube, TINY)
        newton = (distance < 0.2 * minor) & (slope < 0)
        step = np.where(newton, distance * np.minimum(-1.0 / np.where(newton, slope, -1.0), 2.0), distance)
        on = ~arrived
        rows, end, t, distance = rows[on], end[on], (t + step)[on], distance[on]
        ox, oy, oz, dx, dy, dz = ox[on], oy[on], oz[on], dx[on], dy[on], dz[on]
    # Out of steps: only rays that graze get here.
    result[rows] = np.where((np.abs(distance) < 1e-6) & (t <= end), t, MISS)
    return result, _no_face(result)


def _hit_board(size: F64, o: Triple, d: Triple) -> tuple[F64, I64]:
    t = -o[1] / _away_from_zero(d[1])
    inside = (np.abs(o[0] + t * d[0]) <= size[0]) & (np.abs(o[2] + t * d[2]) <= size[1])
    return np.where(inside, t, MISS), _no_face(t)


def _hit_disc(size: F64, o: Triple, d: Triple) -> tuple[F64, I64]:
    t = -o[2] / _away_from_zero(d[2])
    x, y = o[0] + t * d[0], o[1] + t * d[1]
    return np.where(x * x + y * y <= size[0] * size[0], t, MISS), _no_face(t)


def _hit_backdrop(size: F64, o: Triple, d: Triple) -> tuple[F64, I64]:
    a, b = d[0] * d[0] + d[1] * d[1], o[0] * d[0] + o[1] * d[1]
    disc = b * b - a * (o[0] * o[0] + o[1] * o[1] - size[0] * size[0])
    t = (-b + np.sqrt(np.maximum(disc, 0))) / a
    return np.where((disc > 0) & (a > TINY), t, MISS), _no_face(t)


_HITS = {
    Kind.SPHERE: _hit_sphere,
    Kind.BOX: _hit_box,
    Kind.CYLINDER: _hit_cylinder,
    Kind.TORUS: _hit_torus,
    Kind.BOARD: _hit_board,
    Kind.DISC: _hit_disc,
    Kind.BACKDROP: _hit_backdrop,
}


def surface_at(record: F64, local: Triple, face: I64) -> tuple[Triple, F64, F64, F64]:
    """Outward normal (local), texture coordinates u, v in repetitions, and the texture's stretch; all [N]."""
    kind, size = Kind(int(record[0])), record[13:16]
    u_per_m, v_per_m, turns_u, turns_v = record[17:21]
    x, y, z = local
    turn = 1.0 / (2.0 * np.pi)
    zero, one = np.zeros(len(x)), np.ones(len(x))
    around = np.arctan2(y, x) * turn * turns_u
    up_z = np.where(z > 0, 1.0, -1.0)
    if kind == Kind.SPHERE:
        k = 1.0 / size[0]
        n = (x * k, y * k, z * k)
        nz = np.clip(n[2], -1.0, 1.0)
        latitude = np.sqrt(np.maximum(1.0 - nz * nz, 0.0))
        return n, around, np.arccos(nz) / np.pi * turns_v, 1.0 / np.maximum(latitude, 0.1)
    if kind == Kind.BOX:
        fx, fy = face == 0, face == 1
        n = (
            np.where(fx, np.where(x > 0, 1.0, -1.0), 0.0),
            np.where(fy, np.where(y > 0, 1.0, -1.0), 0.0),
            np.where(fx | fy, 0.0, up_z),
        )
        u = np.where(fx, y * u_per_m + 0.37, np.where(fy, x * u_per_m, x * u_per_m + 0.71))
        return n, u, np.where(fx | fy, -z * v_per_m, -y * v_per_m + 0.23), one
    if kind == Kind.CYLINDER:
        cap = face == 1
        n = (np.where(cap, 0.0, x / size[0]), np.where(cap, 0.0, y / size[0]), np.where(cap, up_z, 0.0))
        return n, np.where(cap, x * u_per_m, around), np.where(cap, -y * v_per_m, -z * v_per_m), one
    if kind == Kind.TORUS:
        ring = np.sqrt(x * x + y * y)
        out = ring - size[0]
        k = out / (size[1] * np.maximum(ring, TINY))
        return (x * k, y * k, z / size[1]), around, np.arctan2(z, out) * turn * turns_v, one
    if kind == Kind.BOARD:
        return (zero, -one, zero), x * u_per_m, -z * v_per_m, one
    if kind == Kind.DISC:
        return (zero, zero, one), x * u_per_m, -y * v_per_m, one
    return (-x / size[0], -y / size[0], zero), around, -z * v_per_m, one
