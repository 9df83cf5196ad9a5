"""Linear radiance on a plenoptic sensor, lens by lens. Native where it is built, else NumPy."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.sim import culling
from lfrig.sim.optics import SimCamera
from lfrig.sim.plenoptic import render_numpy
from lfrig.sim.plenoptic.lattice import Lattice
from lfrig.sim.renderer import lamp_record, samples_side
from lfrig.sim.scene import F32, PackedScene
from lfrig.sim.tone import U8

VERSION = 2
"""Part of the key of cached renders: raise it when lenslet.cpp or the headers that it includes change a picture."""
ROWS_AT_ONCE = 128  # between reports of progress


def render_lenslets(
    scene: PackedScene,
    camera: SimCamera,
    lattice: Lattice,
    colours: U8,
    shape: tuple[int, int],
    *,
    samples: int = 4,
    seed: int = 0,
    threads: int = 0,
    on_band: Callable[[], None] | None = None,
) -> F32:
    """What each pixel of the sensor receives of its own colour, float32 [Hs, Ws] linear radiance.

    A pixel sees the scene through the lens that its centre lies under: the lens's place is its place in the views,
    its own place under the lens the place in the pupil (docs/lenslet.md). Rays are spread over the hexagon of the lens
    and over the pixel, which is one view step of the pupil wide.

    Parameters
    ----------
    colours : uint8 [2, 2]
        Which of R, G, B (0, 1, 2) pixel (x, y) sees, at ``[y % 2, x % 2]``.
    shape : (int, int)
        Height and width of the sensor [px].
    samples : int
        Rays per pixel: 1, 4, 9, 16 or 25.
    threads : int
        0 = all cores. The picture does not depend on it.
    on_band : callable, optional
        Called after every `ROWS_AT_ONCE` rows; may raise to cancel.

    Raises
    ------
    ValueError
        ``samples`` is not the square of 1..5.
    """
    side = samples_side(samples)
    height = shape[0]
    # The pupil that a lens's pixels see: to the corner of its hexagon, and half a pixel's diagonal more.
    aperture = 2 * (lattice.pitch_px * max(1.0, lattice.stretch) / np.sqrt(3) + np.sqrt(0.5))
    rectangles, near = culling.view_rectangles(scene, camera, np.zeros((1, 2)), aperture)
    lamp_rectangles, record = culling.lamp_rectangles(scene), lattice.record()
    colours = np.ascontiguousarray(colours, np.uint8)
    out = np.zeros(shape, np.float32)
    native = load_native("lfrig.sim._render")
    for row in range(0, height, ROWS_AT_ONCE):
        part = out[row : row + ROWS_AT_ONCE]
        if native is None:
            render_numpy.lenslets(
                scene, camera, record, rectangles, lamp_rectangles, colours, seed, side, row, height, part
            )
        else:
            native.lenslets(
                scene.primitives, scene.texels, scene.table, scene.lamp_points, lamp_record(scene), lamp_rectangles,
                camera.record(), record, rectangles[0], near[0], colours, seed, side, row, height, part, threads,
            )  # fmt: skip
        if on_band is not None:
            on_band()
    return out
