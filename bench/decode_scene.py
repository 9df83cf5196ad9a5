"""The scene on which the decode is judged, rendered onto the lenslets analytically; shares no code with the decoder.

A textured plane, fronto-parallel or slanted, whose disparity is linear in the view coordinates, so that what a sensor
point sees has a closed form. The texture is noise blurred to σ 2.5 view px: a hexagonal lattice of one lens per view
pixel can carry it, so that what is lost was lost by the decoder. Geometry and radiometry as in docs/lenslet.md.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U16 = NDArray[np.uint16]

OVERSAMPLING = 8
"""Texture samples per view pixel; at σ 2.5 px linear interpolation between them errs by less than 1e-3."""
MARGIN_PX = 24
"""Texture beyond the view's border [view px]: the outer views look past it."""
ROW_HALF = np.sqrt(3) / 2
STRIPE_ROWS = 256


@dataclass(frozen=True)
class SensorModel:
    """A plenoptic sensor by its true figures.

    Lengths in sensor px, angles in radians. ``colours`` names the colours of the upper left 2×2 pixels, row by row.
    ``origin`` is the centre of a lens. ``electrons`` fill a pixel at the white level; noise is shot and read noise.
    """

    width: int
    height: int
    pitch: float = 14.2857
    rotation: float = 1.1e-3
    origin: tuple[float, float] = (7.31, 5.87)
    vertical: float = 1.0
    colours: str = "GRBG"
    response: tuple[float, float, float] = (0.55, 1.0, 0.62)
    black: int = 64
    white: int = 1023
    electrons: float = 4000.0
    read_electrons: float = 3.0
    corner_shading: float = 0.35
    """What the main lens loses towards the sensor's corners."""

    @property
    def view_size(self) -> tuple[int, int]:
        """(W, H) of a view."""
        return round(self.width / self.pitch), round(self.height / self.pitch)

    def lens_of(self, x: F64, y: F64) -> tuple[F64, F64, F64, F64]:
        """The lens above sensor points: view position (X, Y) [view px] and offset (du, dv) from its centre [px]."""
        cos, sin = np.cos(self.rotation), np.sin(self.rotation)
        gx = cos * (x - self.origin[0]) + sin * (y - self.origin[1])
        gy = -sin * (x - self.origin[0]) + cos * (y - self.origin[1])
        rise = self.pitch * ROW_HALF * self.vertical
        lower = np.floor(gy / rise)
        best = _Nearest(gx, gy)
        for row in (lower, lower + 1):
            shift = 0.5 * np.mod(row, 2)
            best.offer((np.round(gx / self.pitch - shift) + shift) * self.pitch, row * rise)
        middle_x, middle_y = (self.width - 1) / 2 - self.origin[0], (self.height - 1) / 2 - self.origin[1]
        width, height = self.view_size
        view_x = (best.x - (cos * middle_x + sin * middle_y)) / self.pitch + (width - 1) / 2
        view_y = (best.y - (-sin * middle_x + cos * middle_y)) / self.pitch + (height - 1) / 2
        return view_x, view_y, gx - best.x, gy - best.y

    def modulation(self, x: F64, y: F64, du: F64, dv: F64) -> F32:
        """Vignetting of lens and microlens at sensor points, peak 1."""
        radius = np.hypot(du, dv) / (self.pitch / 2)
        lens = (1 - 0.35 * radius**2) / (1 + np.exp((radius - 1.02) * 25))
        half = (self.width**2 + self.height**2) / 4
        field = ((x - (self.width - 1) / 2) ** 2 + (y - (self.height - 1) / 2) ** 2) / half
        return np.asarray(np.maximum(lens, 0) * (1 - self.corner_shading * field), np.float32)


class _Nearest:
    """Keeps the nearest of the lens centres offered for every point."""

    def __init__(self, gx: F64, gy: F64) -> None:
        self.gx, self.gy = gx, gy
        self.distance = np.full(gx.shape, np.inf)
        self.x, self.y = np.zeros_like(gx), np.zeros_like(gy)

    def offer(self, x: F64, y: F64) -> None:
        distance = (self.gx - x) ** 2 + (self.gy - y) ** 2
        nearer = distance < self.distance
        for kept, new in ((self.distance, distance), (self.x, x), (self.y, y)):
            np.copyto(kept, new, where=nearer)


@dataclass(frozen=True)
class PlaneScene:
    """A textured plane of disparity ``d0 + gx·x + gy·y`` at the pixel (x, y) of the centre view [px per view step]."""

    size: tuple[int, int]
    disparity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    sigma_px: float = 2.5
    contrast: float = 0.16
    """Standard deviation of the sRGB-encoded texture, which lies in 0..1 around one half."""
    seed: int = 1

    def disparity_map(self) -> F32:
        """Of the centre view, float32 [H, W]."""
        width, height = self.size
        d0, gx, gy = self.disparity
        return np.asarray(d0 + gx * np.arange(width) + gy * np.arange(height)[:, None], np.float32)

    def encoded(self, view_x: F64, view_y: F64, du: F64 | float, dv: F64 | float, channel: int) -> F32:
        """sRGB-encoded value 0..1 seen at the view position (X, Y) from the aperture offset (du, dv)."""
        import cv2

        d0, gx, gy = self.disparity
        # The point at (x, y) of the centre view is at (x − du δ, y − dv δ): solve for δ with δ linear in (x, y).
        delta = (d0 + gx * view_x + gy * view_y) / (1 - gx * du - gy * dv)
        x = (view_x + du * delta + MARGIN_PX) * OVERSAMPLING
        y = (view_y + dv * delta + MARGIN_PX) * OVERSAMPLING
        return np.asarray(
            cv2.remap(self._texture[channel], x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR,
                      borderMode=cv2.BORDER_REFLECT), np.float32,
        )  # fmt: skip

    @cached_property
    def _texture(self) -> list[F32]:
        """Three float32 images, mostly grey, as natural scenes are."""
        import cv2

        rng = np.random.default_rng(self.seed)
        shape = [(n + 2 * MARGIN_PX) * OVERSAMPLING for n in reversed(self.size)]

        def blurred() -> F32:
            # Noise per view pixel, then a Gaussian on the fine grid: the coarse noise is part of the definition.
            fine = rng.standard_normal(shape, dtype=np.float32)
            fine = cv2.GaussianBlur(fine, (0, 0), self.sigma_px * OVERSAMPLING)
            return np.asarray(fine / fine.std(), np.float32)

        common = blurred()
        return [self._bounded(0.85 * common + 0.53 * blurred()) for _ in range(3)]

    def _bounded(self, texture: F32) -> F32:
        # tanh keeps the values inside 0.05..0.95 and is smooth, so the band limit all but holds.
        return np.asarray(0.5 + 0.45 * np.tanh(self.contrast / 0.45 * texture), np.float32)


def true_view(sensor: SensorModel, scene: PlaneScene, du: int, dv: int) -> F32:
    """The noise-free view from the aperture offset (du, dv), sRGB-encoded float32 [H, W, 3]."""
    width, height = sensor.view_size
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    return np.stack([scene.encoded(x, y, float(du), float(dv), channel) for channel in range(3)], -1)


def shoot(sensor: SensorModel, scene: PlaneScene | None, seed: int, *, noise: bool = True, subpixels: int = 3) -> U16:
    """Sensor values of the scene, or a white image when there is none; uint16 [Hs, Ws].

    Each pixel integrates ``subpixels``² points of its area: over the aperture and over the edge between lenses.
    """
    rng = np.random.default_rng(seed)
    values = np.empty((sensor.height, sensor.width), np.uint16)
    for rows in _stripes(sensor.height):
        exposed = _exposed(sensor, scene, rows, subpixels).astype(np.float64)
        if noise:
            collected = rng.poisson(exposed * sensor.electrons) + rng.normal(0, sensor.read_electrons, exposed.shape)
            exposed = collected / sensor.electrons
        scaled = np.round(sensor.black + (sensor.white - sensor.black) * exposed)
        values[rows] = np.clip(scaled, 0, sensor.white)
    return values


WHITE_EXPOSURE = 0.9
"""What a white image is exposed to at its peak."""


def _exposed(sensor: SensorModel, scene: PlaneScene | None, rows: slice, subpixels: int) -> F32:
    """Share of the white level that a stripe of pixels collects."""
    y, x = np.mgrid[rows, 0 : sensor.width].astype(np.float64)
    total = np.zeros(x.shape, np.float32)
    steps = (np.arange(subpixels) + 0.5) / subpixels - 0.5
    for sx in steps:
        for sy in steps:
            view_x, view_y, du, dv = sensor.lens_of(x + sx, y + sy)
            light = sensor.modulation(x + sx, y + sy, du, dv)
            for corner, colour in enumerate(sensor.colours):
                cell = np.s_[(corner // 2 - rows.start) % 2 :: 2, corner % 2 :: 2]
                channel = "RGB".index(colour)
                seen: F32 | float = WHITE_EXPOSURE
                if scene is not None:
                    seen = to_linear(scene.encoded(view_x[cell], view_y[cell], du[cell], dv[cell], channel))
                total[cell] += light[cell] * seen * np.float32(sensor.response[channel])
    return np.asarray(total / np.float32(subpixels**2))


def _stripes(height: int) -> Iterator[slice]:
    return (slice(start, min(start + STRIPE_ROWS, height)) for start in range(0, height, STRIPE_ROWS))


def to_linear(encoded: F32) -> F32:
    """Linear light of sRGB values 0..1 (IEC 61966-2-1)."""
    return np.asarray(np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4), np.float32)
