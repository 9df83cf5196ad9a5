"""A textured wall that stands still while the plate turns: what a rig without a plain backdrop sees.

In the library's scenes the round wall turns with the plate. Here its pixels are painted over, in every view at its true
depth, with a texture that is fixed to the room: only its motion is wrong, nothing else.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfrig.bench.poses_scene import PLATE_DEG, PhotoShot, SceneShots, Shot
from lfrig.sim.optics import SimCamera, view_offsets
from lfrig.sim.renderer import render_depth
from lfrig.sim.rig import COLS, ROWS
from lfrig.sim.scene import F32, F64, Kind, Texture
from lfrig.sim.textures import dead_leaves
from lfrig.sim.tone import U8, Exposure, develop

ON_WALL = 0.999
"""Points further from the axis than this fraction of the wall's radius belong to it."""

IRRADIANCE = 0.45
WIDTH_M = 0.30
KIND_COLUMN, RADIUS_COLUMN = 0, 13


def with_still_wall(shots: SceneShots, plate_deg: float, texture: Texture) -> Shot:
    """The light field at an angle of `PLATE_DEG` before the still wall, with evidence of its own."""
    shot, rig = shots.light_field(plate_deg), shots.rig
    index = PLATE_DEG.index(plate_deg)
    camera = rig.light_field_camera(index, plate_deg)
    views = painted(shots, shot.views, camera, view_offsets(ROWS, COLS), shot.angle_deg, rig.exposure(index), texture)
    return shot.reseen(views, shots.threads)


def photo_with_still_wall(shots: SceneShots, plate_deg: float, texture: Texture) -> PhotoShot:
    """The photo before the still wall."""
    photo, rig = shots.photo(plate_deg), shots.rig
    camera, exposure = rig.target_camera(plate_deg), rig.exposure(0, target=True)
    image = painted(shots, photo.image[None, None], camera, np.zeros((1, 2)), photo.angle_deg, exposure, texture)
    return replace(photo, image=image[0, 0])


def wall_texture(seed: int) -> Texture:
    """Full of detail: the worst case."""
    return dead_leaves(seed + 900, "toy", WIDTH_M)


def wall_share(shots: SceneShots, plate_deg: float) -> float:
    """Share of the centre view's pixels that show the wall."""
    camera = shots.rig.light_field_camera(PLATE_DEG.index(plate_deg), plate_deg)
    depth = render_depth(shots.rig.packed(), camera, np.zeros((1, 2)), threads=shots.threads)[0]
    return float(wall_points(camera, depth, np.zeros(2), _radius_m(shots))[1].mean())


def painted(
    shots: SceneShots, views: U8, camera: SimCamera, offsets: F64, angle_deg: float, exposure: Exposure,
    texture: Texture,
) -> U8:  # fmt: skip
    """Views uint8 [rows, cols, H, W, 3] with the wall's pixels replaced."""
    radius_m = _radius_m(shots)
    depth = render_depth(shots.rig.packed(), camera, offsets, threads=shots.threads)
    flat = views.reshape(-1, *views.shape[2:]).copy()
    for view, own, offset in zip(flat, depth, offsets, strict=True):
        points, mask = wall_points(camera, own, offset, radius_m)
        # The plate's frame turns with the plate; the room's angle is the plate's plus how far that has turned.
        turn = np.arctan2(points[:, 1], points[:, 0]) + np.deg2rad(angle_deg)
        view[mask] = develop(IRRADIANCE * _colour(texture, turn * radius_m, points[:, 2]), exposure)
        shots.monitor.advance(0)
    return flat.reshape(views.shape)


def wall_points(camera: SimCamera, depth: F32, offset: F64, radius_m: float) -> tuple[F64, np.ndarray]:
    """Points [N, 3] of a view's wall pixels in the plate's frame, and the mask [H, W] of those pixels."""
    ys, xs = np.mgrid[0 : camera.height, 0 : camera.width]
    step = offset[::-1] * camera.baseline_m
    z = depth.astype(np.float64)
    with np.errstate(invalid="ignore"):
        x = (xs - camera.cx) / camera.focal_px * z + step[0] * (1 - z / camera.focus_m)
        y = (ys - camera.cy) / camera.focal_px * z + step[1] * (1 - z / camera.focus_m)
        points = (np.stack([x, y, z], -1) - camera.translation) @ camera.rotation
        mask = np.hypot(points[..., 0], points[..., 1]) > ON_WALL * radius_m
    mask &= np.isfinite(z) & (points[..., 2] > 1e-4)  # the table reaches below the wall, and beyond it
    return points[mask], mask


def _colour(texture: Texture, along_m: F64, up_m: F64) -> F32:
    """Linear colour [N, 3] of the repeating texture, bilinear; all coordinates in metres."""
    height, width = texture.image.shape[:2]
    u, v = along_m / texture.width_m * width, up_m / texture.height_m * height
    column, row = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    a, b = (u - column)[:, None], (v - row)[:, None]
    image = texture.image
    left, right, low, high = column % width, (column + 1) % width, row % height, (row + 1) % height
    top = (1 - a) * image[low, left] + a * image[low, right]
    bottom = (1 - a) * image[high, left] + a * image[high, right]
    return np.asarray((1 - b) * top + b * bottom, np.float32)


def _radius_m(shots: SceneShots) -> float:
    primitives = shots.rig.packed().primitives
    walls = primitives[primitives[:, KIND_COLUMN] == Kind.BACKDROP]
    return float(walls[0, RADIUS_COLUMN])
