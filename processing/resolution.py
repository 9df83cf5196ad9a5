"""Light fields and photos at a fraction of their size, for geometry at lower resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfrig.processing.model import F32, Image, LightField, Photo, Surface


def scale_light_field(light_field: LightField, factor: float) -> LightField:
    """Every view resampled by area to ``factor`` of its size; disparities shrink with it. 1 returns the same one."""
    if factor == 1.0:
        return light_field
    size = _size(light_field.width, light_field.height, factor)
    rows, cols = light_field.angular
    views = np.empty((rows, cols, size[1], size[0], 3), np.uint8)
    for r in range(rows):
        for c in range(cols):
            views[r, c] = _shrink(light_field.views[r, c], size)
    camera = light_field.camera.resized(*size) if light_field.camera else None
    return replace(light_field, views=views, camera=camera)


def scale_photo(photo: Photo, factor: float) -> Photo:
    """The photo resampled by area to ``factor`` of its size. 1 returns the same one."""
    if factor == 1.0:
        return photo
    height, width = photo.image.shape[:2]
    size = _size(width, height, factor)
    camera = photo.camera.resized(*size) if photo.camera else None
    return replace(photo, image=_shrink(photo.image, size), camera=camera)


def scale_surface(surface: Surface, width: int, height: int) -> Surface:
    """The surface resampled to another size of the same picture, float32 [height, width] each."""
    import cv2

    def resized(a: F32, mode: int) -> F32:
        return np.asarray(cv2.resize(a, (width, height), interpolation=mode))

    return Surface(
        inverse_depth=resized(surface.inverse_depth, cv2.INTER_LINEAR),
        confidence=resized(surface.confidence, cv2.INTER_LINEAR),
        sigma=resized(surface.sigma, cv2.INTER_LINEAR),
        seen=resized(surface.seen, cv2.INTER_NEAREST),
    )


def _size(width: int, height: int, factor: float) -> tuple[int, int]:
    return max(16, round(width * factor)), max(16, round(height * factor))


def _shrink(image: Image, size: tuple[int, int]) -> Image:
    import cv2

    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
