"""A tiny analytic scene for tests of the processing stages: textured fronto-parallel planes, no simulator involved."""

from __future__ import annotations

from functools import cache

import numpy as np

from lfrig.processing.model import Anchors, Camera, LightField, Optics, Photo, Pose

WIDTH, HEIGHT, FOCAL = 96, 72, 190.0
FAR_M, NEAR_M, FOCUS_M = 0.62, 0.45, 0.52
BASELINE_M = 0.6 / FOCAL
CAMERA = Camera.centred(WIDTH, HEIGHT, FOCAL)


@cache
def texture(seed: int) -> np.ndarray:
    """Band-limited noise, float32 [400, 400, 3], 20..235."""
    import cv2

    rng = np.random.default_rng(seed)
    t = cv2.GaussianBlur(rng.normal(0, 1, (400, 400, 3)).astype(np.float32), (0, 0), 1.6)
    return np.clip(128 + 62 * t / t.std(), 20, 235).astype(np.float32)


def look(centre_x: float, centre_y: float, shear: tuple[float, float] = (0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """Image uint8 [H, W, 3] and depth float32 [H, W] of a camera at (x, y, 0) looking along +z.

    ``shear`` moves the principal point [px], as the views of a light field do.
    """
    import cv2

    ys, xs = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    image = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    depth = np.zeros((HEIGHT, WIDTH), np.float32)
    for i, z in enumerate((FAR_M, NEAR_M)):
        x = (xs - CAMERA.cx + shear[0]) / FOCAL * z + centre_x
        y = (ys - CAMERA.cy + shear[1]) / FOCAL * z + centre_y
        pixels = cv2.remap(
            texture(i), (200 + x * 330).astype(np.float32), (200 + y * 330).astype(np.float32), cv2.INTER_CUBIC,
            borderMode=cv2.BORDER_REFLECT,
        )  # fmt: skip
        inside = np.ones_like(depth, bool) if i == 0 else (np.abs(x) < 0.03) & (np.abs(y) < 0.025)
        image[inside] = pixels[inside]
        depth[inside] = z
    return np.clip(image + 0.5, 0, 255).astype(np.uint8), depth


def light_field(name: str, centre_x: float, size: int = 5) -> LightField:
    """A size×size light field of the camera at (centre_x, 0, 0)."""
    half = (size - 1) / 2
    views = np.stack(
        [
            np.stack(
                [
                    look(
                        centre_x + (c - half) * BASELINE_M,
                        (r - half) * BASELINE_M,
                        (
                            (c - half) * BASELINE_M * FOCAL / FOCUS_M * -1,
                            (r - half) * BASELINE_M * FOCAL / FOCUS_M * -1,
                        ),
                    )[0]
                    for c in range(size)
                ]
            )
            for r in range(size)
        ]
    )
    pose = Pose(np.eye(3), np.array([-centre_x, 0.0, 0.0]))
    return LightField(name, views, CAMERA, Optics(BASELINE_M, FOCUS_M), pose, depth_range_m=(0.35, 0.8))


def photo(centre_x: float = 0.0) -> tuple[Photo, np.ndarray]:
    """The target photo and its true depth."""
    image, depth = look(centre_x, 0.0)
    return Photo("target", image, CAMERA, Pose(np.eye(3), np.array([-centre_x, 0.0, 0.0]))), depth


def anchors(centre_x: float, count: int = 200, seed: int = 0) -> Anchors:
    """Exact anchors of the camera at (centre_x, 0, 0), away from depth steps."""
    import cv2

    depth = look(centre_x, 0.0)[1]
    rng = np.random.default_rng(seed)
    window = np.ones((9, 9), np.uint8)
    flat = np.argwhere(cv2.dilate(depth, window) == cv2.erode(depth, window))
    flat = flat[(flat.min(1) > 6) & (flat[:, 0] < HEIGHT - 7) & (flat[:, 1] < WIDTH - 7)]
    picked = flat[rng.choice(len(flat), count)]
    xy = picked[:, ::-1].astype(np.float64)
    z = depth[picked[:, 0], picked[:, 1]].astype(np.float64)
    world = np.c_[(xy - [CAMERA.cx, CAMERA.cy]) / FOCAL * z[:, None], z] + [centre_x, 0, 0]
    return Anchors(xy, z, world)
