"""The part of a picture where the turntable's load can be: what lies outside need not be computed (switch ``plate``).

A rig that knows how far its load reaches (a cylinder about the plate's axis) does not look at the backdrop: neither is
matched there, which saves the work, nor does a backdrop that stands still draw the poses towards no motion at all.
Pictures are cropped to the cylinder's bounding box, with the principal point moved along; everything after that is as
for any smaller picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from lfrig.processing.geometry import project_points
from lfrig.processing.model import F32, F64, Camera, Image, LightField, Photo, Plate, Pose, RigPrior, Surface
from lfrig.processing.skipping import Tally

SIGMAS = 3.0
"""Standard deviations of the pose by which the box is widened."""
SLACK_PX = 16
"""And by how much more: the outermost views of a light field see the load displaced by up to 12 px."""
WORTHWHILE = 0.95
"""A box larger than this share of the picture is not cropped to."""
CIRCLE = 64


@dataclass(frozen=True)
class Box:
    """Columns ``x0`` to ``x1`` and rows ``y0`` to ``y1`` (excluded) of a picture [px]."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def width(self) -> int:
        """Columns."""
        return self.x1 - self.x0

    @property
    def height(self) -> int:
        """Rows."""
        return self.y1 - self.y0

    @property
    def pixels(self) -> int:
        """Pixels inside."""
        return self.width * self.height


def light_field_box(light_field: LightField, prior: RigPrior) -> Box | None:
    """Where a light field can show the load; None = everywhere, or it cannot be told."""
    return _box(light_field.camera, light_field.pose or prior.light_field_from_plate, prior.plate)


def photo_box(photo: Photo, prior: RigPrior) -> Box | None:
    """Where the photo can show the load; None = everywhere, or it cannot be told."""
    return _box(photo.camera, photo.pose or prior.target_from_plate, prior.plate)


def _box(camera: Camera | None, pose: Pose | None, plate: Plate | None) -> Box | None:
    if camera is None or pose is None or plate is None:
        return None
    points = _rims(plate)
    xy, depth_m = project_points(camera, pose, points)
    if depth_m.min() <= 1e-3 * depth_m.max():
        return None  # the camera stands among the load
    reach = SIGMAS * (np.deg2rad(pose.sigma_deg) + pose.sigma_m / depth_m.min()) * camera.focal_px
    reach += SIGMAS * camera.sigma_focal * float(np.abs(xy - [camera.cx, camera.cy]).max()) + SLACK_PX
    x0, y0 = (max(0, int(np.floor(v - reach))) for v in xy.min(0))
    x1 = min(camera.width, int(np.ceil(xy[:, 0].max() + reach)) + 1)
    y1 = min(camera.height, int(np.ceil(xy[:, 1].max() + reach)) + 1)
    box = Box(x0, y0, x1, y1)
    if box.width < 16 or box.height < 16 or box.pixels > WORTHWHILE * camera.width * camera.height:
        return None
    return box


def _rims(plate: Plate) -> F64:
    """Points of the cylinder's two rims, float64 [2·CIRCLE, 3]; it lies in their convex hull."""
    angles = np.arange(CIRCLE) * (2 * np.pi / CIRCLE)
    radius = plate.radius_m / np.cos(np.pi / CIRCLE)  # the polygon goes round the circle, not inside it
    circle = np.c_[radius * np.cos(angles), radius * np.sin(angles)]
    return np.concatenate([np.c_[circle, np.full(CIRCLE, z)] for z in (0.0, plate.height_m)])


def crop_to_plate(light_fields: Sequence[LightField], prior: RigPrior, tally: Tally) -> list[LightField]:
    """Light fields without what is certainly no part of the load; counts pixels of all views."""
    cropped = []
    for light_field in light_fields:
        inner = crop_light_field(light_field, light_field_box(light_field, prior))
        cropped.append(inner)
        if prior.plate is not None:
            done, whole = inner.views[..., 0].size, light_field.views[..., 0].size
            tally.add("plate", done, whole - done, "pixels of views")
    return cropped


def crop_light_field(light_field: LightField, box: Box | None) -> LightField:
    """The light field inside a box."""
    if box is None:
        return light_field
    views = np.ascontiguousarray(light_field.views[:, :, box.y0 : box.y1, box.x0 : box.x1])
    return replace(light_field, views=views, camera=_crop_camera(light_field.camera, box))


def crop_photo(photo: Photo, box: Box | None) -> Photo:
    """The photo inside a box."""
    if box is None:
        return photo
    image = np.ascontiguousarray(photo.image[box.y0 : box.y1, box.x0 : box.x1])
    return replace(photo, image=cast(Image, image), camera=_crop_camera(photo.camera, box))


def uncrop_camera(camera: Camera, box: Box | None, width: int, height: int) -> Camera:
    """The camera of the whole picture, of which ``camera`` took the part inside the box."""
    if box is None:
        return camera
    return replace(camera, width=width, height=height, cx=camera.cx + box.x0, cy=camera.cy + box.y0)


def paste_surface(surface: Surface, box: Box | None, width: int, height: int) -> Surface:
    """A surface of the whole picture [height, width]: outside the box as far as the farthest inside, with no
    confidence, seen by no source, and uncertain by all the depth there is.
    """
    if box is None:
        return surface
    far, near = float(surface.inverse_depth.min()), float(surface.inverse_depth.max())

    def pasted(part: F32, outside: float) -> F32:
        whole = np.full((height, width), outside, np.float32)
        whole[box.y0 : box.y1, box.x0 : box.x1] = part
        return whole

    return Surface(
        pasted(surface.inverse_depth, far), pasted(surface.confidence, 0), pasted(surface.sigma, near - far),
        pasted(surface.seen, 0),
    )  # fmt: skip


def _crop_camera(camera: Camera | None, box: Box) -> Camera | None:
    if camera is None:
        return None
    return replace(camera, width=box.width, height=box.height, cx=camera.cx - box.x0, cy=camera.cy - box.y0)
