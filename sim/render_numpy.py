"""NumPy twin of the native ray tracer (render.cpp, primitives.hpp, textures.hpp): the same float64 operations in the
same order, over many rays at once. For machines without a compiler, and to check the native core against.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.sim.intersect import MISS, Ray, Triple, dot, intersect, surface_at, to_local, to_world
from lfrig.sim.optics import SimCamera
from lfrig.sim.scene import F32, F64, Kind, PackedScene
from lfrig.sim.shadows_numpy import visibility
from lfrig.sim.textures_numpy import trilinear

U32 = NDArray[np.uint32]
I64 = NDArray[np.int64]
Bool = NDArray[np.bool_]
RAYS_AT_ONCE = 1 << 16


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
    views, height, width = out.shape[:3]
    samples = side * side
    pixels = out.reshape(-1, 3)
    at_once = max(1, RAYS_AT_ONCE // samples)
    for start in range(0, views * height * width, at_once):
        index = np.arange(start, min(start + at_once, views * height * width))
        view, rest = np.divmod(index, height * width)
        ys, xs = np.divmod(rest, width)
        key = hash32((seeds[view] + rest.astype(np.uint32)).astype(np.uint32))
        # One row per pixel, one column per sample.
        sample = np.tile(np.arange(samples), len(index))
        view, xs, ys, key = (np.repeat(a, samples) for a in (view, xs, ys, key))
        ray = _jittered_rays(camera, offsets[view], xs, ys, key + sample.astype(np.uint32) * np.uint32(4), sample, side,
                             aperture)  # fmt: skip
        t, hit, face = nearest(scene, ray, rectangles, view, xs, ys)
        colour = shade(scene, ray, t, hit, face, lamp_rectangles, 1.0 / side / camera.focal_px, sample, samples)
        total = np.zeros((len(index), 3))
        for s in range(samples):
            total += colour[s::samples]
        pixels[index] = (total / samples).astype(np.float32)


def _jittered_rays(
    camera: SimCamera, offset: F64, xs: I64, ys: I64, key: U32, sample: I64, side: int, aperture: float
) -> Ray:
    """Multi-jittered (Chiu, Shirley & Wang 1994): every sample has its own column and its own row of the pixel."""
    step = 1.0 / side
    i, j = (sample % side).astype(np.float64), (sample // side).astype(np.float64)
    px = xs + ((i + (j + unit(hash32(key))) * step) * step - 0.5)
    py = ys + ((j + (i + unit(hash32(key + np.uint32(1)))) * step) * step - 0.5)
    du = offset[:, 1] + ((j + unit(hash32(key + np.uint32(2)))) * step - 0.5) * aperture
    dv = offset[:, 0] + ((i + unit(hash32(key + np.uint32(3)))) * step - 0.5) * aperture
    return view_rays(camera, px, py, du, dv)


def depth(scene: PackedScene, camera: SimCamera, offsets: F64, rectangles: F64, out: F32) -> None:
    """Fill ``out`` float32 [V, H, W] with the depth along the optical axis at pixel centres [m]."""
    height, width = out.shape[1:]
    ys, xs = np.divmod(np.arange(height * width), width)
    for view, (row, col) in enumerate(offsets):
        ray = view_rays(camera, xs.astype(float), ys.astype(float), np.full(len(xs), col), np.full(len(xs), row))
        t, _, _ = nearest(scene, ray, rectangles, np.full(len(xs), view), xs, ys)
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


def nearest(scene: PackedScene, ray: Ray, rectangles: F64, view: I64, xs: I64, ys: I64) -> tuple[F64, I64, I64]:
    """First hit of every ray: distance, primitive (−1 = none), face. ``rectangles`` float64 [V, N, 4]."""
    best = np.full(len(xs), MISS)
    index, face = np.full(len(xs), -1), np.zeros(len(xs), np.int64)
    for i, record in enumerate(scene.primitives):
        x0, y0, x1, y1 = rectangles[view, i].T
        inside = np.flatnonzero((xs >= x0) & (xs <= x1) & (ys >= y0) & (ys <= y1))
        if not len(inside):
            continue
        t, f = intersect(record, ray.take(inside))
        closer = t < best[inside]
        chosen = inside[closer]
        best[chosen], index[chosen], face[chosen] = t[closer], i, f[closer]
    return best, index, face


@dataclass(frozen=True)
class _Surface:
    """Hits on one primitive; ``self_shadow`` where it can shade itself."""

    point: Triple
    normal: Triple
    albedo: F64
    self_shadow: Bool


def shade(
    scene: PackedScene, ray: Ray, t: F64, index: I64, face: I64, lamp_rectangles: F64, sample_angle: float,
    sample: I64, samples: int,
) -> F64:  # fmt: skip
    """Radiance [N, 3] leaving the hits towards the camera."""
    colour = np.zeros((len(t), 3))
    for i in np.unique(index[index >= 0]):
        rows = np.flatnonzero(index == i)
        part = ray.take(rows)
        surface = _surface(scene, scene.primitives[i], part, t[rows], face[rows], sample_angle)
        colour[rows] = _lit(scene, int(i), surface, part, lamp_rectangles, sample[rows], samples)
    return colour


def _lit(
    scene: PackedScene, i: int, surface: _Surface, ray: Ray, lamp_rectangles: F64, sample: I64, samples: int
) -> F64:
    lamp, record, n = scene.lamp, scene.primitives[i], surface.normal
    raised = tuple(p + m * 1e-5 for p, m in zip(surface.point, n, strict=True))
    v = tuple(lamp.position[k] - raised[k] for k in range(3))
    distance2 = dot(v, v)
    inverse = 1.0 / np.sqrt(distance2)
    light = tuple(c * inverse for c in v)
    cosine = dot(n, light)
    seen = np.zeros(len(cosine))
    lit = np.flatnonzero(cosine > 0)
    seen[lit] = visibility(
        scene, (raised[0][lit], raised[1][lit], raised[2][lit]), i, surface.self_shadow[lit], lamp_rectangles,
        sample[lit], samples,
    )  # fmt: skip
    arriving = lamp.power / distance2 * seen
    diffuse = np.where(cosine > 0, arriving * cosine, 0.0)
    highlight = np.zeros(len(cosine))
    if record[27] > 0:
        h = tuple(a - b for a, b in zip(light, ray.direction, strict=True))
        along = np.maximum(dot(n, h) / np.sqrt(dot(h, h)), 0.0)
        highlight = np.where(cosine > 0, arriving * record[27] * along ** record[28], 0.0)
    light_in = diffuse + lamp.ambient + lamp.ambient_slope * n[2]
    return np.asarray(surface.albedo * record[24:27] * light_in[:, None] + highlight[:, None])


def _surface(scene: PackedScene, record: F64, ray: Ray, t: F64, face: I64, angle: float) -> _Surface:
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
    return _Surface(point, n, albedo, self_shadow)
