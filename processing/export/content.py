"""What can be exported: the synthesized light field of a result, or a captured light field, seen the same way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.processing.export.result import VIEWS, LoadedResult
from lfrig.processing.model import F32, F64, Image, LightField


@dataclass(frozen=True)
class Content:
    """One light field on its way out.

    Maps are float32 [H, W] or None when unknown: ``disparity`` and ``sigma`` px per view step, ``inverse_depth`` 1/m,
    ``confidence`` 0..1. ``rotation``, ``translation`` are the centre view's pose, X_c = R X + t. ``folder`` holds
    ``views/RR_CC.png`` already when the content is a result; ``raw`` is the camera's own file of a capture.
    """

    name: str
    load_views: Callable[[], Image]
    disparity: F32 | None = None
    sigma: F32 | None = None
    inverse_depth: F32 | None = None
    confidence: F32 | None = None
    focal_px: float | None = None
    baseline_m: float | None = None
    focus_distance_m: float | None = None
    rotation: F64 | None = None
    translation: F64 | None = None
    folder: Path | None = None
    raw: Path | None = None

    @cached_property
    def views(self) -> Image:
        """uint8 or uint16 [rows, cols, H, W, 3]."""
        return self.load_views()

    @property
    def angular(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.views.shape[0], self.views.shape[1]

    @property
    def views_folder(self) -> Path | None:
        """Where the views are on disk already, or None."""
        return self.folder / VIEWS if self.folder else None

    def depth_m(self) -> F32 | None:
        """float32 [H, W] along the optical axis; NaN where unknown or at infinity."""
        if self.inverse_depth is None:
            return None
        known = self.inverse_depth > 0  # false for NaN
        return np.where(known, 1.0 / np.where(known, self.inverse_depth, 1.0), np.nan).astype(np.float32)

    def require_disparity(self) -> F32:
        """The disparity map, or `BadInput` that says how to get one."""
        if self.disparity is None:
            raise BadInput("has no disparity map", path=self.name, code="no-disparity",
                           remedy="process the session first and export its result")  # fmt: skip
        return self.disparity

    def require_raw(self) -> Path:
        """The camera's own file, or `BadInput` that says where to find one."""
        if self.raw is None:
            raise BadInput("has no raw file of a plenoptic camera", path=self.name, code="no-raw-file",
                           remedy="give the .lfr or .lfp file, or a capture that was ingested from one")  # fmt: skip
        return self.raw


def content_of_result(result: LoadedResult) -> Content:
    """The synthesized light field of a result folder."""
    target = result.report.target
    pose = target.pose
    return Content(
        name=result.folder.resolve().name, load_views=lambda: result.views, disparity=result.disparity,
        sigma=result.disparity_sigma, inverse_depth=result.inverse_depth, confidence=result.confidence,
        focal_px=target.fx, baseline_m=target.baseline_m, focus_distance_m=target.focus_distance_m,
        rotation=np.array(pose.R) if pose else None, translation=np.array(pose.t) if pose else None,
        folder=result.folder,
    )  # fmt: skip


def content_of_light_field(light_field: LightField) -> Content:
    """A captured light field; it has no maps."""
    camera, optics, pose = light_field.camera, light_field.optics, light_field.pose
    return Content(
        name=light_field.id, load_views=lambda: light_field.views, focal_px=camera.focal_px if camera else None,
        baseline_m=optics.baseline_m, focus_distance_m=optics.focus_distance_m,
        rotation=pose.rotation if pose else None, translation=pose.translation if pose else None,
    )  # fmt: skip


def content_of_raw(name: str, path: Path) -> Content:
    """A camera's own file, not decoded: for formats that take the sensor's values, and no others."""

    def refuse() -> Image:
        raise BadInput("is raw and has no views", path=path, code="no-views",
                       remedy="decode it first (lfrig decode FILE --out DIR) and export what that makes")  # fmt: skip

    return Content(name=name, load_views=refuse, raw=path)
