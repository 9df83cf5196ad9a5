"""Where the lenses of a plenoptic camera are on its sensor (docs/lenslet.md)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.sim.scene import F64

ROW_STEP = np.sqrt(3) / 2


@dataclass(frozen=True)
class Lattice:
    """Lens (i, j) is imaged to ``origin + R(rotation) ((i + (j mod 2)/2) pitch, j ROW_STEP pitch stretch)`` [px].

    ``rotation_rad`` from the sensor's +x towards its +y; ``stretch`` is 1 for regular hexagons; sensor pixel centres
    are integers.
    """

    pitch_px: float
    rotation_rad: float
    origin_px: tuple[float, float]
    stretch: float = 1.0

    @property
    def row_pitch_px(self) -> float:
        """Distance between rows of lenses [px]."""
        return float(self.pitch_px * ROW_STEP * self.stretch)

    def record(self) -> F64:
        """The lattice as the renderers take it, float64 [6]: pitch, row pitch, cosine, sine, origin."""
        turn = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        return np.array([self.pitch_px, self.row_pitch_px, *turn, *self.origin_px])

    def centres(self, i: F64, j: F64) -> tuple[F64, F64]:
        """Sensor position (x, y) [px] of the images of lenses (i, j)."""
        gx, gy = (i + 0.5 * np.mod(j, 2)) * self.pitch_px, j * self.row_pitch_px
        c, s = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        return self.origin_px[0] + c * gx - s * gy, self.origin_px[1] + s * gx + c * gy


def in_lattice(record: F64, x: F64, y: F64) -> tuple[F64, F64]:
    """Sensor positions in the lattice's axes, from its origin [px]; ``record`` as `Lattice.record` gives it."""
    _, _, cosine, sine, x0, y0 = record
    dx, dy = x - x0, y - y0
    return cosine * dx + sine * dy, cosine * dy - sine * dx


def from_nearest_lens(gx: F64, gy: F64, pitch: float, row_pitch: float) -> tuple[F64, F64]:
    """Offset of points from the nearest lens, both in the lattice's axes.

    The two rows around a point are enough: one within them is never further away than 0.58 pitch.
    """
    below = np.floor(gy / row_pitch)
    best: tuple[F64, F64] | None = None
    nearest = np.empty(0)
    for row in (below, below + 1.0):
        shift = 0.5 * (row - 2.0 * np.floor(0.5 * row))
        column = np.floor(gx / pitch - shift + 0.5)
        dx, dy = gx - (column + shift) * pitch, gy - row * row_pitch
        d = dx * dx + dy * dy
        if best is None:
            best, nearest = (dx, dy), d
        else:
            closer = d < nearest
            best = np.where(closer, dx, best[0]), np.where(closer, dy, best[1])
    assert best is not None
    return best
