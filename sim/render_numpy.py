"""NumPy twin of the native ray tracer (render.cpp, primitives.hpp, textures.hpp): the same float64 operations in the
same order, over all rays at once. For machines without a compiler, and to check the native core against.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.sim.intersect import MISS, Ray, dot, intersect, surface_at, to_local, to_world
from lfrig.sim.optics import SimCamera
from lfrig.sim.scene import F32, F64, Kind, PackedScene

U32 = NDArray[np.uint32]
Bool = NDArray[np.bool_]
RAYS_AT_ONCE = 1 << 17


def hash32(h: U32) -> U32:
    """Low-bias 32-bit integer mixer ("lowbias32"); uint32 in, uint32 out."""
    h = h ^ (h >> np.uint32(16))
    h = h * np.uint32(0x7FEB352D)
    h = h ^ (h >> np.uint32(15))
    h = h * np.uint32(0x846CA68B)
    return h ^ (h >> np.uint32(16))


def unit(h: U32) -> F64:
    """Uniform in [0, 1)."""
    return np.asarray(h.astype(np.float64) * (1.0 / 4294967296.0))


def radiance(
    scene: PackedScene, camera: SimCamera, offsets: F64, rectangles: F64, lamp_rectangles: F64, seeds: U32,
    side: int, aperture: float, out: F32,
) -> None:  # fmt: skip
    """Fill ``out`` float32 [V, H, W, 3] with linear radiance; arguments as in `renderer.render_radiance`."""
    height, width = out.shape[1:3]
    rows_at_once = max(1, RAYS_AT_ONCE // (width * side * side))
    for view, offset in enumerate(offsets):
        for y0 in range(0, height, rows_at_once):
            y1 = min(y0 + rows_at_once, height)
            out[view, y0:y1] = _radiance_rows(
                scene, camera, offset, rectangles[view], lamp_rectangles, seeds[view], side, aperture, width, y0, y1
            )


def _radiance_rows(
    scene: PackedScene, camera: SimCamera, offset: F64, rectangles: F64, lamp_rectangles: F64, seed: np.uint32,
    side: int, aperture: float, width: int, y0: int, y1: int,
) -> F32:  # fmt: skip
    ys, xs = np.meshgrid(np.arange(y0, y1), np.arange(width), indexing="ij")
    pixel = hash32(np.asarray(seed + ys.astype(np.uint32) * np.uint32(width) + xs.astype(np.uint32), np.uint32))
    step = 1.0 / side
    total = np.zeros((*ys.shape, 3))
    for s in range(side * side):
        key = pixel + np.uint32(s) * np.uint32(4)
        px = xs + ((float(s % side) + unit(hash32(key))) * step - 0.5)
        py = ys + ((float(s // side) + unit(hash32(key + np.uint32(1)))) * step - 0.5)
        du = offset[1] + (unit(hash32(key + np.uint32(2))) - 0.5) * aperture
        dv = offset[0] + (unit(hash32(key + np.uint32(3))) - 0.5) * aperture
        ray = view_rays(camera, px.ravel(), py.ravel(), du.ravel(), dv.ravel())
        t, index, face = nearest(scene, ray, rectangles, xs.ravel(), ys.ravel())
        colour = shade(scene, ray, t, index, face, lamp_rectangles, step / camera.focal_px, s, side * side)
        total += colour.reshape(total.shape)
    return (total / (side * side)).astype(np.float32)


def depth(scene: PackedScene, camera: SimCamera, offsets: F64, rectangles: F64, out: F32) -> None:
    """Fill ``out`` float32 [V, H, W] with the depth along the optical axis at pixel centres [m]."""
    height, width = out.shape[1:]
    ys, xs = (a.ravel() for a in np.meshgrid(np.arange(height), np.arange(width), indexing="ij"))
    for view, (row, col) in enumerate(offsets):
        ray = view_rays(camera, xs.astype(float), ys.astype(float), np.full(len(xs), col), np.full(len(xs), row))
        t, _, _ = nearest(scene, ray, rectangles[view], xs, ys)
        out[view] = (t * ray.depth_per_t).astype(np.float32).reshape(height, width)


def view_rays(camera: SimCamera, px: F64, py: F64, du: F64, dv: F64) -> Ray:
    """Rays through pixels (px, py) of views (du, dv) steps off the axis; all float64 [N]."""
    r, focal, focus, centre = camera.rotation, camera.focal_px, camera.focus_m, camera.centre
    sx, sy = du * camera.baseline_m, dv * camera.baseline_m
    ax, ay = (px - camera.cx) / focal * focus - sx, (py - camera.cy) / focal * focus - sy
    az = focus
    scale = 1.0 / np.sqrt(ax * ax + ay * ay + az * az)
    d = tuple((r[0, i] * ax + r[1, i] * ay + r[2, i] * az) * scale for i in range(3))
    o = tuple(centre[i] + r[0, i] * sx + r[1, i] * sy for i in range(3))
    return Ray((o[0], o[1], o[2]), (d[0], d[1], d[2]), az * scale)


def nearest(
    scene: PackedScene, ray: Ray, rectangles: F64, xs: NDArray[np.int64], ys: NDArray[np.int64]
) -> tuple[F64, NDArray[np.int64], NDArray[np.int64]]:
    """First hit of every ray: distance, primitive (−1 = none), face."""
    best = np.full(len(xs), MISS)
    index, face = np.full(len(xs), -1), np.zeros(len(xs), np.int64)
    for i, (record, rect) in enumerate(zip(scene.primitives, rectangles, strict=True)):
        inside = np.flatnonzero((xs >= rect[0]) & (xs <= rect[2]) & (ys >= rect[1]) & (ys <= rect[3]))
        if not len(inside):
            continue
        t, f = intersect(record, ray.take(inside))
        closer = t < best[inside]
        chosen = inside[closer]
        best[chosen], index[chosen], face[chosen] = t[closer], i, f[closer]
    return best, index, face


@dataclass(frozen=True)
class _Shaded:
    point: tuple[F64, F64, F64]
    normal: tuple[F64, F64, F64]
    albedo: F64
    self_shadow: Bool


def shade(
    scene: PackedScene, ray: Ray, t: F64, index: NDArray[np.int64], face: NDArray[np.int64], lamp_rectangles: F64,
    sample_angle: float, sample: int, samples: int,
) -> F64:  # fmt: skip
    """Radiance [N, 3] leaving the hits towards the camera."""
    colour = np.zeros((len(t), 3))
    lamp = scene.lamp
    for i in np.unique(index[index >= 0]):
        rows = np.flatnonzero(index == i)
        record, part = scene.primitives[i], ray.take(rows)
        surface = _surface(scene, record, part, t[rows], face[rows], sample_angle)
        n, raised = surface.normal, tuple(p + m * 1e-5 for p, m in zip(surface.point, surface.normal, strict=True))
        v = tuple(lamp.position[k] - raised[k] for k in range(3))
        distance2 = dot(v, v)
        inverse = 1.0 / np.sqrt(distance2)
        light = tuple(c * inverse for c in v)
        cosine = dot(n, light)
        seen = np.zeros(len(rows))
        lit = np.flatnonzero(cosine > 0)
        origin = (raised[0][lit], raised[1][lit], raised[2][lit])
        seen[lit] = _visibility(scene, origin, int(i), surface.self_shadow[lit], lamp_rectangles, sample, samples)
        arriving = lamp.power / distance2 * seen
        diffuse = arriving * cosine
        highlight = np.zeros(len(rows))
        if record[27] > 0:
            h = tuple(a - b for a, b in zip(light, part.direction, strict=True))
            along = np.maximum(dot(n, h) / np.sqrt(dot(h, h)), 0.0)
            highlight = np.where(cosine > 0, arriving * record[27] * along ** record[28], 0.0)
        light_in = np.where(cosine > 0, diffuse, 0.0) + lamp.ambient + lamp.ambient_slope * n[2]
        colour[rows] = surface.albedo * record[24:27] * light_in[:, None] + highlight[:, None]
    return colour


def _surface(scene: PackedScene, record: F64, ray: Ray, t: F64, face: NDArray[np.int64], angle: float) -> _Shaded:
    o, d = ray.origin, ray.direction
    point = (o[0] + d[0] * t, o[1] + d[1] * t, o[2] + d[2] * t)
    local = to_local(record, (point[0] - record[1], point[1] - record[2], point[2] - record[3]))
    normal, u, v, stretch = surface_at(record, local, face)
    # Only the inner half of a ring can shade itself; for all else the cosine has told.
    self_shadow = (record[0] == Kind.TORUS) & (normal[0] * local[0] + normal[1] * local[1] < 0)
    n = to_world(record, normal)
    facing = dot(n, d)
    flip = np.where(facing > 0, -1.0, 1.0)
    n, facing = (n[0] * flip, n[1] * flip, n[2] * flip), facing * flip
    footprint = t * ray.depth_per_t * angle * record[23] * np.sqrt(stretch) / np.sqrt(np.maximum(-facing, 0.15))
    albedo = trilinear(scene, int(record[16]), u + record[21], v + record[22], footprint)
    return _Shaded(point, n, albedo, self_shadow)


def _visibility(
    scene: PackedScene, point: tuple[F64, F64, F64], own: int, self_shadow: Bool, lamp_rectangles: F64, sample: int,
    samples: int,
) -> F64:  # fmt: skip
    """Fraction of the lamp points sample, sample + samples, ... that each point sees."""
    lamp, frame = scene.lamp, scene.lamp_frame
    local = [dot(tuple(frame[k]), tuple(p - c for p, c in zip(point, lamp.position, strict=True))) for k in range(3)]
    ahead = local[2] > 1e-3
    z = np.where(ahead, local[2], 1.0)
    x, y = local[0] / z, local[1] / z
    casters: list[tuple[F64, NDArray[np.int64]]] = []
    for i, (record, rect) in enumerate(zip(scene.primitives, lamp_rectangles, strict=True)):
        if record[29] == 0:
            continue
        may = ~ahead | ((x >= rect[0]) & (x <= rect[2]) & (y >= rect[1]) & (y <= rect[3]))
        if i == own:
            may &= self_shadow
        if may.any():
            casters.append((record, np.flatnonzero(may)))
    seen, total = np.zeros(len(x)), 0
    for lamp_point in scene.lamp_points[sample::samples]:
        v = tuple(c - p for c, p in zip(lamp_point, point, strict=True))
        distance = np.sqrt(dot(v, v))
        inverse = 1.0 / distance
        ray = Ray(point, (v[0] * inverse, v[1] * inverse, v[2] * inverse), distance)
        blocked = np.zeros(len(x), bool)
        for record, rows in casters:
            t, _ = intersect(record, ray.take(rows))
            blocked[rows] |= t < distance[rows]
        seen += ~blocked
        total += 1
    return seen / total


def trilinear(scene: PackedScene, texture: int, u: F64, v: F64, footprint: F64) -> F64:
    """Linear RGB [N, 3] of a texture at (u, v) in repetitions, ``footprint`` texels of level 0 wide."""
    levels = scene.table.shape[1]
    lod = np.minimum(np.log2(np.maximum(footprint, 1.0)), float(levels - 1))
    level = np.minimum(lod.astype(np.int64), levels - 1)
    f = (lod - level)[:, None]
    fine = _bilinear(scene, texture, level, u, v)
    coarse = _bilinear(scene, texture, np.minimum(level + 1, levels - 1), u, v)
    return np.where((f > 0) & (level[:, None] + 1 < levels), fine * (1.0 - f) + coarse * f, fine)


def _bilinear(scene: PackedScene, texture: int, level: NDArray[np.int64], u: F64, v: F64) -> F64:
    start, width, height = scene.table[texture, level].T
    x, y = (u - np.floor(u)) * width - 0.5, (v - np.floor(v)) * height - 0.5
    floor_x, floor_y = np.floor(x), np.floor(y)
    fx, fy = (x - floor_x)[:, None], (y - floor_y)[:, None]
    x0, y0 = floor_x.astype(np.int64) & (width - 1), floor_y.astype(np.int64) & (height - 1)
    x1, y1 = (x0 + 1) & (width - 1), (y0 + 1) & (height - 1)
    channel = np.arange(3)

    def texel(tx: NDArray[np.int64], ty: NDArray[np.int64]) -> F64:
        return np.asarray(scene.texels[(start + (ty * width + tx) * 3)[:, None] + channel].astype(np.float64))

    a = texel(x0, y0) * (1.0 - fx) + texel(x1, y0) * fx
    b = texel(x0, y1) * (1.0 - fx) + texel(x1, y1) * fx
    return np.asarray(a * (1.0 - fy) + b * fy)
