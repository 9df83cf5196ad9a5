"""The lenses of a plenoptic sensor by their definition in docs/lenslet.md, slowly."""

from __future__ import annotations

import numpy as np

from lfrig.sim.plenoptic.lattice import Lattice
from lfrig.sim.scene import F64


def all_lenses(lattice: Lattice, shape: tuple[int, int]) -> F64:
    """Centres (x, y) of all lenses of a sensor by the definition, one by one; float64 [N, 2]."""
    p, t, (x0, y0) = lattice.pitch_px, lattice.rotation_rad, lattice.origin_px
    found = []
    reach = int(max(shape) / p) + 4
    for j in range(-reach, reach + 1):
        for i in range(-reach, reach + 1):
            gx, gy = (i + 0.5 * (j % 2)) * p, j * np.sqrt(3) / 2 * p * lattice.stretch
            x, y = x0 + np.cos(t) * gx - np.sin(t) * gy, y0 + np.sin(t) * gx + np.cos(t) * gy
            if -p < x < shape[1] + p and -p < y < shape[0] + p:
                found.append((x, y))
    return np.array(found)


def pixels_by_lens(lattice: Lattice, shape: tuple[int, int]) -> tuple[F64, F64, F64, F64]:
    """Of every pixel: its nearest lens relative to the sensor's middle [pitch] and its offset from it [px], x and y,
    in the lattice's axes; each float64 [Hs, Ws].
    """
    lenses = all_lenses(lattice, shape)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    nearest = np.argmin((x[..., None] - lenses[:, 0]) ** 2 + (y[..., None] - lenses[:, 1]) ** 2, -1)
    lens = lenses[nearest]
    c, s = np.cos(lattice.rotation_rad), np.sin(lattice.rotation_rad)

    def turned(dx: F64, dy: F64) -> tuple[F64, F64]:
        return c * dx + s * dy, c * dy - s * dx

    place = turned(lens[..., 0] - (shape[1] - 1) / 2, lens[..., 1] - (shape[0] - 1) / 2)
    du, dv = turned(x - lens[..., 0], y - lens[..., 1])
    return place[0] / lattice.pitch_px, place[1] / lattice.pitch_px, du, dv
