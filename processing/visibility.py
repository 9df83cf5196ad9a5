"""Who sees the surface: where its points lie in each source, and whether its own surface hides or confirms them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.geometry import project, projection
from lfrig.processing.kernels.landing import FAR_OUTSIDE, Way, landing
from lfrig.processing.model import F32, F64, Camera, Pose, Source

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Landing:
    """Where the points of a surface lie in a source.

    ``u``, ``v`` float32 [H, W] px, far outside where a point is behind the source; ``inside`` bool [H, W], within the
    source's frame; ``ahead`` float32 [H, W], how much nearer the source's own surface is there [px per view step]
    (0 where they agree, positive where it hides the point).
    """

    u: F32
    v: F32
    inside: Mask
    ahead: F32

    def visible(self, margin_px: float) -> F32:
        """How far the source sees each point, 0..1 float32 [H, W]: falls from 1 to 0 between 1 and 1.5 margins."""
        seen: F32 = self.ahead - np.float32(margin_px)
        seen /= np.float32(0.5 * margin_px)
        np.subtract(1, seen, out=seen)
        np.clip(seen, 0, 1, out=seen)
        seen *= self.inside
        return seen

    def contradicted(self, margin_px: float) -> F32:
        """How far each point floats before what the source sees there, 0..1 float32 [H, W]."""
        return contradiction(self.ahead, margin_px)

    def agrees(self, tolerance_px: float) -> Mask:
        """Where the source's own disparity is that of the point."""
        return np.asarray(self.inside & (np.abs(self.ahead) < tolerance_px))


def contradiction(ahead: F32, margin_px: float) -> F32:
    """How far points float before what a source sees, 0..1 float32, from `Landing.ahead` [px per view step]."""
    return np.asarray(np.clip((-ahead - np.float32(margin_px)) / np.float32(0.5 * margin_px), 0, 1), np.float32)


def half_contradicted(margin_px: float) -> float:
    """How far a point floats before what a source sees where `contradiction` is one half [px per view step]."""
    return 1.25 * margin_px


def way_into(source: Source, camera: Camera, pose: Pose) -> Way:
    """From the pixels of ``camera`` at ``pose`` into a source."""
    size = (source.camera.height, source.camera.width)
    return Way(projection(camera, pose, source.camera, source.pose), size, source.evidence.disparity, source.scale)


def land(inverse_depth: F32, source: Source, camera: Camera, pose: Pose, *, threads: int = 0) -> Landing:
    """Carry a surface float32 [H, W] (1/m, in the frame of ``camera`` at ``pose``) into a source."""
    return Landing(*landing(inverse_depth, way_into(source, camera, pose), threads=threads))


def carry(
    inverse_depth: F32, source: Source, camera: Camera, pose: Pose, stride: int = 1
) -> tuple[F32, F32, F32, Mask]:
    """Where points lie in a source: u, v [px], far outside for points behind it; inverse depth there [1/m]; in frame.

    ``inverse_depth`` is known at every ``stride``-th pixel of ``camera``.
    """
    height, width = inverse_depth.shape
    ys, xs = (stride * np.mgrid[0:height, 0:width]).astype(np.float32)
    return place(projection(camera, pose, source.camera, source.pose), source.camera, xs, ys, inverse_depth)


def place(way: tuple[F64, F64], camera: Camera, x: F32, y: F32, inverse_depth: F32) -> tuple[F32, F32, F32, Mask]:
    """The same for any points (x, y), by a `projection` into ``camera``; arrays of one shape."""
    u, v, w = project(*way, x, y, inverse_depth)
    u, v = np.nan_to_num(u, nan=FAR_OUTSIDE), np.nan_to_num(v, nan=FAR_OUTSIDE)
    inside = (u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1)
    return u, v, w, np.asarray(inside)


def count_agreeing(landings: Sequence[Landing], tolerance_px: float) -> F32:
    """How many sources agree with each point, float32 [H, W]."""
    return np.asarray(sum(landing.agrees(tolerance_px).astype(np.float32) for landing in landings), np.float32)
