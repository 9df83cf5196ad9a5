"""What the metadata say about the decoded views before any of them is looked at: intrinsics, baseline, focus.

With f the focal length, N the f-number, p the lens pitch [px], λ∞ the defocus of infinity in lens pitches per f-number
(the lens array is λ∞·N·pitch behind the image of infinity), as in docs/lenslet.md: one view step is one sensor pixel,
``b = f / (N p)``; the image distance is ``v = f + λ∞·N·p·pixel pitch``; the focal length of a view is v over the pitch.
"""

from __future__ import annotations

from lfrig.processing.lenslet.metadata import RawMetadata
from lfrig.processing.model import Camera, Optics

SIGMA_FOCAL = 0.02
"""Relative standard deviation of the focal length from metadata."""
SIGMA_BASELINE = 0.03
MAX_FOCUS_M = 1e4
"""What is focused farther than that is focused at infinity."""


def view_size(metadata: RawMetadata) -> tuple[int, int]:
    """(width, height) [px] of a decoded view: square pixels as wide as a lens. Illum 541×376, F01 328×328."""
    pitch = metadata.lens_pitch_px
    return round(metadata.width / pitch), round(metadata.height / pitch)


def camera_and_optics(metadata: RawMetadata) -> tuple[Camera | None, Optics]:
    """Centre view's camera (None without a focal length) and (b, z_f), with their sigmas.

    The focus distance is None when it is not recorded, and when the camera was focused at infinity or beyond.
    """
    focal, number, infinity = metadata.focal_length_m, metadata.f_number, metadata.infinity_lambda
    if focal is None:
        return None, Optics(sigma_baseline=SIGMA_BASELINE)
    pitch_px, pixel = metadata.lens_pitch_px, metadata.pixel_pitch_m
    baseline = focal / (number * pitch_px) if number is not None else None
    behind_infinity = 0.0
    if number is not None and infinity is not None:
        behind_infinity = max(0.0, infinity * number * pitch_px * pixel)
    focus = focal + focal * focal / behind_infinity if behind_infinity > focal * focal / MAX_FOCUS_M else None
    image_distance = focal + behind_infinity
    camera = Camera.centred(*view_size(metadata), image_distance / (pitch_px * pixel), SIGMA_FOCAL)
    return camera, Optics(baseline, focus, SIGMA_BASELINE)
