"""Square pixels and no lens distortion: one resampling, and none where the camera is fine as it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.capture import CameraSpec
from lfrig.processing.model import F32, Camera
from lfrig.rig.session.images import Pixels

SQUARE_TOLERANCE = 1e-4
"""Relative difference of fx and fy that moves no pixel by more than 0.05 px in a picture 1000 px wide."""


@dataclass(frozen=True)
class Rectification:
    """Where each pixel of the rectified picture comes from: ``map_x``, ``map_y`` float32 [H', W'] px."""

    camera: Camera
    map_x: F32
    map_y: F32

    def apply(self, image: Pixels) -> Pixels:
        """Resample [H, W, 3] bicubically to [H', W', 3]; the border is repeated outwards."""
        import cv2

        rectified: Pixels = cv2.remap(image, self.map_x, self.map_y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
        return rectified


def rectification(spec: CameraSpec | None) -> Rectification | None:
    """How to make a camera an ideal one with fx = fy = max(fx, fy); None when it is one, or too little is known.

    Distortion is Brown–Conrady with OpenCV's coefficients. The principal point keeps its place in the scene.
    """
    if spec is None or spec.fx is None:
        return None
    fy = spec.fy or spec.fx
    distorted = any(spec.distortion or ())
    if not distorted and abs(spec.fx / fy - 1.0) <= SQUARE_TOLERANCE:
        return None
    import cv2

    cx, cy = principal_point(spec)
    focal = max(spec.fx, fy)
    sx, sy = focal / spec.fx, focal / fy
    width, height = round(spec.width * sx), round(spec.height * sy)
    camera = Camera(width, height, focal, (cx + 0.5) * sx - 0.5, (cy + 0.5) * sy - 0.5, spec.sigma_f or 0.0)
    stored = np.array([[spec.fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    distortion = np.array(spec.distortion if distorted else (0.0, 0.0, 0.0, 0.0), np.float64)
    map_x, map_y = cv2.initUndistortRectifyMap(stored, distortion, None, camera.matrix, (width, height), cv2.CV_32FC1)
    return Rectification(camera, map_x, map_y)


def principal_point(spec: CameraSpec) -> tuple[float, float]:
    """(cx, cy) [px]; the middle of the picture where it is not known."""
    cx = (spec.width - 1) / 2 if spec.cx is None else spec.cx
    cy = (spec.height - 1) / 2 if spec.cy is None else spec.cy
    return cx, cy
