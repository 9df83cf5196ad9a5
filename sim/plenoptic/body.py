"""The body of the simulated plenoptic camera: sensor, lenslet array, and what is peculiar to one specimen."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.lytro import F01, ILLUM, CameraFigures
from lfrig.sim.plenoptic.lattice import Lattice
from lfrig.sim.scene import F32
from lfrig.sim.tone import U8

Model = Literal["ILLUM", "F01"]
I32 = NDArray[np.int32]

FIGURES: dict[Model, CameraFigures] = {"ILLUM": ILLUM, "F01": F01}
RESPONSES: dict[Model, tuple[float, float, float]] = {"ILLUM": (0.763, 1.0, 0.745), "F01": (0.88, 1.0, 0.795)}
"""What the sensor makes of white light, R, G, B relative to green."""
SMALL_PITCH_PX = 9.15
"""Of all sensors that are not a real camera's: the smallest whose lenses hold 7×7 views up to the corners."""
ROTATION_DEG = (0.06, 0.14)
STRETCH_SIGMA = 2e-4
SCALE_SPREAD = 3e-4  # of the pitch, by zoom and focus: the exit pupil moves
SHIFT_SPREAD_PX = 0.3  # of the lattice, by zoom and focus
HOT_SHARE = 2e-5
COLOUR_INDEX = {"R": 0, "G": 1, "B": 2}


@dataclass(frozen=True, eq=False)
class Body:
    """One specimen.

    ``figures`` are those of its sensor, ``rotation_rad``, ``stretch`` and ``origin_px`` of its lenslet array;
    ``hot_pixels`` int32 [N, 2] (x, y) and ``hot_level`` float32 [N], what they show in the dark [1 = white level].
    """

    model: Model
    serial: str
    figures: CameraFigures
    rotation_rad: float
    stretch: float
    origin_px: tuple[float, float]
    hot_pixels: I32
    hot_level: F32

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of the sensor [px]."""
        return self.figures.height, self.figures.width

    @property
    def nominal_pitch_px(self) -> float:
        """Pitch of the lenses on paper [px]."""
        return self.figures.lens_pitch_m / self.figures.pixel_pitch_m

    @property
    def responses(self) -> tuple[float, float, float]:
        """Response of R, G, B to white light."""
        return RESPONSES[self.model]

    @property
    def colours(self) -> U8:
        """Which of R, G, B (0, 1, 2) a pixel sees, uint8 [2, 2] by the parities of y and x."""
        return np.array([COLOUR_INDEX[c] for c in self.figures.bayer], np.uint8).reshape(2, 2)

    def lattice(self, rng: np.random.Generator) -> Lattice:
        """The lattice at one zoom and focus, which ``rng`` stands for."""
        pitch = self.nominal_pitch_px * (1 + SCALE_SPREAD * rng.uniform(-1, 1))
        shift = SHIFT_SPREAD_PX * rng.uniform(-1, 1, 2)
        origin = self.origin_px[0] + float(shift[0]), self.origin_px[1] + float(shift[1])
        return Lattice(float(pitch), self.rotation_rad, origin, self.stretch)


def make_body(model: Model, width: int, height: int, view_pixel_m: float, rng: np.random.Generator) -> Body:
    """A specimen whose views have ``width`` × ``height`` pixels of ``view_pixel_m`` on the sensor."""
    figures = _figures(model, width, height, view_pixel_m)
    pitch = figures.lens_pitch_m / figures.pixel_pitch_m
    turn = np.deg2rad(rng.uniform(*ROTATION_DEG)) * rng.choice([-1.0, 1.0])
    origin = np.array([figures.width - 1, figures.height - 1]) / 2 + pitch * rng.uniform(-0.5, 0.5, 2)
    count = max(3, round(HOT_SHARE * figures.width * figures.height))
    places = np.sort(rng.choice(figures.width * figures.height, count, replace=False))
    hot = np.stack([places % figures.width, places // figures.width], -1).astype(np.int32)
    return Body(
        model, f"B514{rng.integers(10_000_000):07d}", figures, float(turn),
        float(1 + STRETCH_SIGMA * rng.standard_normal()), (float(origin[0]), float(origin[1])), hot,
        rng.uniform(0.3, 1.2, count).astype(np.float32),
    )  # fmt: skip


def _figures(model: Model, width: int, height: int, view_pixel_m: float) -> CameraFigures:
    """Those of the real sensor where the views have its size; else of a smaller one with coarser lenses."""
    real = FIGURES[model]
    pitch = real.lens_pitch_m / real.pixel_pitch_m
    size = real.width, real.height
    if (round(real.width / pitch), round(real.height / pitch)) != (width, height):
        pitch = SMALL_PITCH_PX
        # Whole groups of the 10-bit packing and whole Bayer cells; never so far off that a view gains a pixel.
        size = 4 * round(width * pitch / 4), 2 * round(height * pitch / 2)
    return replace(
        real, width=size[0], height=size[1], lens_pitch_m=view_pixel_m, pixel_pitch_m=view_pixel_m / pitch
    )  # fmt: skip
