"""Small scenes and cameras, quick to build and to render, and the library's scenes without their textures."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from lfrig.sim import textures
from lfrig.sim.optics import SimCamera, look_at
from lfrig.sim.scene import (
    F32,
    Lamp,
    Material,
    Primitive,
    Scene,
    Texture,
    backdrop,
    board,
    box,
    cylinder,
    ground,
    rod,
    sphere,
    torus,
    turned,
)

W, H = 48, 32
BASELINE_M, FOCUS_M = 0.0067, 0.46  # ten times a real baseline, so that a small picture shows disparity


def grain(seed: int, size: int = 32, width_m: float = 0.05) -> Texture:
    """Random colours."""
    return Texture(np.random.default_rng(seed).random((size, size, 3), dtype=np.float32), width_m)


def flat(level: float) -> Material:
    """One grey."""
    return Material(Texture(np.full((1, 1, 3), level, np.float32), 0.1))


def one_of_each() -> list[Primitive]:
    """Every kind of primitive, some turned, some glossy, some shading others and themselves."""
    return [
        ground(0.9, Material(grain(1))),
        backdrop(0.25, Material(grain(2), shift=(0.3, 0.7))),
        sphere((-0.05, 0.0, 0.03), 0.03, Material(grain(3), specular=0.5), turned(20, 10, 30)),
        box((0.045, 0.03, 0.03), (0.02, 0.03, 0.03), Material(grain(4), tint=(1.1, 0.8, 0.5)), turned(25, 5)),
        cylinder((0.05, -0.05, 0.02), 0.015, 0.02, Material(grain(5))),
        torus((-0.02, -0.07, 0.02), 0.025, 0.012, Material(grain(6), specular=0.3), turned(0, 0, 40)),
        rod((0.0, 0.05, 0.0), (0.02, 0.08, 0.14), 0.0015, flat(0.7)),
        board((-0.05, 0.1, 0.06), 0.04, 0.05, Material(grain(7)), 10),
    ]


def scene(*primitives: Primitive, lamp: Lamp | None = None) -> Scene:
    """A scene of these primitives."""
    return Scene("test", list(primitives), lamp or Lamp())


def camera(width: int = W, height: int = H, *, elevation_deg: float = 25.0, focal_px: float | None = None) -> SimCamera:
    """A camera that looks at the plate from −y."""
    e = np.deg2rad(elevation_deg)
    rotation, translation = look_at(0.45 * np.array([0, -np.cos(e), np.sin(e)]), np.array([0, 0, 0.03]))
    return SimCamera(width, height, focal_px or 2.0 * width, BASELINE_M, FOCUS_M, rotation, translation)


def head_on(width: int = W, height: int = H) -> SimCamera:
    """A camera at the origin that looks along +y, z up: depth is the world's y."""
    rotation, translation = look_at(np.zeros(3), np.array([0.0, 1.0, 0.0]))
    return SimCamera(width, height, 2.0 * width, BASELINE_M, FOCUS_M, rotation, translation)


CENTRE = np.zeros((1, 2))


def centroid(image: F32) -> tuple[float, float]:
    """(x, y) of the light in a picture [H, W]."""
    ys, xs = np.mgrid[: image.shape[0], : image.shape[1]]
    return float((xs * image).sum() / image.sum()), float((ys * image).sum() / image.sum())


def without_textures(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, tuple[object, ...]]]:
    """Make all procedural textures one grey texel, and list which ones were asked for: geometry tests need no more."""
    asked: list[tuple[str, tuple[object, ...]]] = []

    def stub(name: str) -> Callable[..., Texture]:
        def make(*arguments: object, width_m: float = 0.1, **options: object) -> Texture:
            asked.append((name, (*arguments, width_m, *sorted(options.items()))))
            return Texture(np.full((1, 1, 3), 0.5, np.float32), width_m)

        return make

    for name in MAKERS:
        monkeypatch.setattr(textures, name, stub(name))
    return asked


MAKERS = (
    "noise", "weak", "dead_leaves", "wood", "bricks", "checker", "stripes", "printed", "gradient", "patches", "fabric",
)  # fmt: skip
