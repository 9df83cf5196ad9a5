"""NumPy twin of the shadows in render.cpp: which of the lamp's points a surface point sees."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.sim.intersect import Ray, Triple, dot, intersect, segment_meets_box, to_local
from lfrig.sim.scene import F64, LIGHT_POINTS, PackedScene

I64 = NDArray[np.int64]
Bool = NDArray[np.bool_]


def visibility(
    scene: PackedScene, point: Triple, own: int, self_shadow: Bool, lamp_rectangles: F64, sample: I64, samples: int
) -> F64:
    """Fraction [N] of the lamp points sample, sample + samples, ... that each point sees.

    ``own`` is the primitive that the points lie on, which may shade itself only where ``self_shadow``.
    """
    may = _may_be_shaded(scene, point, lamp_rectangles)
    may[own] &= self_shadow
    # One row per point and lamp point; fewer samples than lamp points, so every sample has one.
    shots = -(-LIGHT_POINTS // samples)
    lamp_point = sample[:, None] + np.arange(shots) * samples
    exists = lamp_point < LIGHT_POINTS
    blocked = np.zeros(lamp_point.shape, bool)
    for record, rows in zip(scene.primitives, may, strict=True):
        chosen = np.flatnonzero((rows[:, None] & exists & ~blocked).ravel())
        if len(chosen):
            blocked.reshape(-1)[chosen] = _blocks(scene, record, point, chosen // shots, lamp_point.ravel()[chosen])
    return np.asarray((exists & ~blocked).sum(1) / exists.sum(1))


def _blocks(scene: PackedScene, record: F64, point: Triple, rows: I64, lamp_point: I64) -> Bool:
    """Whether the primitive stands between points and lamp points."""
    lamp = scene.lamp_points[lamp_point]
    o = (point[0][rows], point[1][rows], point[2][rows])
    v = (lamp[:, 0] - o[0], lamp[:, 1] - o[1], lamp[:, 2] - o[2])
    distance = np.sqrt(dot(v, v))
    inverse = 1.0 / distance
    t, _ = intersect(record, Ray(o, (v[0] * inverse, v[1] * inverse, v[2] * inverse), distance))
    return np.asarray(t < distance)


def _may_be_shaded(scene: PackedScene, point: Triple, lamp_rectangles: F64) -> Bool:
    """Conservative [primitives, N]: within the rectangle on the lamp's grid, and the cone from the point to the lamp
    reaches the bounding box (as `may_block` in render.cpp).
    """
    lamp, frame = scene.lamp, scene.lamp_frame
    result = np.zeros((len(scene.primitives), len(point[0])), bool)
    to_lamp = tuple(c - p for c, p in zip(lamp.position, point, strict=True))
    towards = (to_lamp[0], to_lamp[1], to_lamp[2])
    distance = np.sqrt(dot(towards, towards))
    x, y, z = (-dot(tuple(frame[k]), towards) for k in range(3))
    ahead = z > 1e-3
    depth = np.where(ahead, z, 1.0)
    x, y = x / depth, y / depth
    for i, (record, rect) in enumerate(zip(scene.primitives, lamp_rectangles, strict=True)):
        if record[29] == 0:
            continue
        rows = np.flatnonzero(~ahead | ((x >= rect[0]) & (x <= rect[2]) & (y >= rect[1]) & (y <= rect[3])))
        if not len(rows):
            continue
        half = scene.extents[i]
        reach = float(np.sqrt((half * half).sum()))
        v = (point[0][rows] - record[1], point[1][rows] - record[2], point[2][rows] - record[3])
        ray = (towards[0][rows], towards[1][rows], towards[2][rows])
        along = -dot(v, ray) / distance[rows]
        wide = lamp.radius * np.clip((along + reach) / distance[rows], 0.0, 1.0) + 1e-6
        near = (along >= -reach - wide) & (dot(v, v) - along * along <= (reach + wide) ** 2)
        meets = segment_meets_box(to_local(record, v), to_local(record, ray), half[:, None] + wide)
        result[i, rows] = near & meets
    return result
