"""Light fields and photos at a fraction of their size, for geometry at lower resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from lfrig.processing.model import Image, LightField, Photo


def scale_light_field(light_field: LightField, factor: float) -> LightField:
    """Every view resampled by area to ``factor`` of its size; disparities shrink with it."""
    size = _size(light_field.width, light_field.height, factor)
    rows, cols = light_field.angular
    views = np.empty((rows, cols, size[1], size[0], 3), np.uint8)
    for r in range(rows):
        for c in range(cols):
            views[r, c] = _shrink(light_field.views[r, c], size)
    camera = light_field.camera.resized(*size) if light_field.camera else None
    return replace(light_field, views=views, camera=camera)


def scale_photo(photo: Photo, factor: float) -> Photo:
    """The photo resampled by area to ``factor`` of its size."""
    height, width = photo.image.shape[:2]
    size = _size(width, height, factor)
    camera = photo.camera.resized(*size) if photo.camera else None
    return replace(photo, image=_shrink(photo.image, size), camera=camera)


def _size(width: int, height: int, factor: float) -> tuple[int, int]:
    return max(16, round(width * factor)), max(16, round(height * factor))


def _shrink(image: Image, size: tuple[int, int]) -> Image:
    import cv2

    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))
