"""Rendering of a scene by a camera: linear radiance and exact depth. Native where it is built, else NumPy; both give
the same picture to one grey level and the same depth.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.sim import culling, render_numpy
from lfrig.sim.optics import SimCamera
from lfrig.sim.scene import F32, F64, PackedScene

VERSION = 2
"""Part of the key of cached renders: raise it when render.cpp or its headers change a picture."""
LAMP_GRID = 96
LAMP_HALF_TANGENT = 0.9


def render_radiance(
    scene: PackedScene,
    camera: SimCamera,
    offsets: F64,
    *,
    samples: int = 4,
    aperture: float = 0.0,
    seed: int = 0,
    threads: int = 0,
) -> F32:
    """Linear radiance of views, float32 [V, H, W, 3].

    Parameters
    ----------
    offsets : float64 [V, 2]
        (row, col) of each view in view steps from the axis.
    samples : int
        Rays per pixel, a square (1, 4, 9, 16), multi-jittered by a hash of seed, view, pixel and sample.
    aperture : float
        Width of each view's square pupil in view steps; 0 = pinhole.
    threads : int
        0 = all cores. The picture does not depend on it.

    Raises
    ------
    ValueError
        ``samples`` is not the square of 1..5.
    """
    side = samples_side(samples)
    offsets = np.ascontiguousarray(offsets, np.float64)
    rectangles, near = culling.view_rectangles(scene, camera, offsets, aperture)
    lamp_rectangles = culling.lamp_rectangles(scene)
    seeds = _view_seeds(seed, offsets)
    out = np.zeros((len(offsets), camera.height, camera.width, 3), np.float32)
    native = _native()
    if native is None:
        render_numpy.radiance(scene, camera, offsets, rectangles, lamp_rectangles, seeds, side, aperture, out)
        return out
    native.radiance(
        scene.primitives, scene.texels, scene.table, scene.lamp_points, lamp_record(scene), lamp_rectangles,
        camera.record(), offsets, rectangles, near, seeds, side, aperture, out, threads,
    )  # fmt: skip
    return out


def samples_side(samples: int) -> int:
    """Root of the number of rays per pixel; raises `ValueError` when it is not the square of 1..5."""
    side: int = round(samples**0.5)
    if side * side != samples or not 1 <= side <= 5:
        raise ValueError(f"samples must be 1, 4, 9, 16 or 25, got {samples}")
    return side


def render_depth(scene: PackedScene, camera: SimCamera, offsets: F64, *, threads: int = 0) -> F32:
    """Exact depth along the optical axis at pixel centres, float32 [V, H, W] m; inf where a ray meets nothing."""
    offsets = np.ascontiguousarray(offsets, np.float64)
    rectangles, near = culling.view_rectangles(scene, camera, offsets, 0.0)
    out = np.zeros((len(offsets), camera.height, camera.width), np.float32)
    native = _native()
    if native is None:
        render_numpy.depth(scene, camera, offsets, rectangles, out)
    else:
        native.depth(scene.primitives, camera.record(), offsets, rectangles, near, out, threads)
    return out


def _native() -> Any:
    return load_native("lfrig.sim._render")


def _view_seeds(seed: int, offsets: F64) -> render_numpy.U32:
    """One seed per view from its position, so that a view looks the same whichever others are rendered with it."""
    row, col = np.round(offsets * 64).astype(np.int64).T
    base = render_numpy.hash32(np.array([seed & 0xFFFFFFFF], np.uint32))
    return render_numpy.hash32((base + (row * 4099 + col).astype(np.uint32)).astype(np.uint32))


def lamp_record(scene: PackedScene) -> F64:
    """The lamp as the native renderers take it, float64 [17]."""
    lamp = scene.lamp
    return np.array(
        [*lamp.position, *scene.lamp_frame.ravel(), lamp.power, LAMP_HALF_TANGENT, LAMP_GRID, lamp.ambient,
         lamp.ambient_slope]
    )  # fmt: skip
