"""From the hexagonal lattice to square view pixels: the one interpolation between sensor and view.

A view pixel is a weighted sum over the lenses nearest to it. The weights are those of least squared error for a
texture of a given smoothness seen through noise (ordinary kriging; Matheron, "Principles of geostatistics", 1963):
sharper than linear interpolation between three lenses and less noisy than cubic interpolation (docs/lenslet.md).
"""

from __future__ import annotations

import numpy as np

from lfrig.processing.kernels.lenslet import LensSampling
from lfrig.processing.lenslet.covariance import matern
from lfrig.processing.lenslet.lattice import ROW_RISE, HexLattice
from lfrig.processing.lenslet.reading import reading_weights
from lfrig.processing.model import F32, F64

TAPS = 14
"""Lenses that a view pixel is made of."""
RANGE_PITCHES = 4.0
"""Range of the Matérn covariance that textures are taken to have."""
NOISE_SHARE = 0.003
"""Variance of the noise of one lens sample relative to that of the texture."""


def lens_sampling(
    lattice: HexLattice,
    sensor: tuple[int, int],
    view_size: tuple[int, int],
    steps: list[tuple[int, int]],
    colours: tuple[int, int, int, int],
) -> LensSampling:
    """Where the views are on the sensor.

    Parameters
    ----------
    sensor : (height, width)
        Of the sensor [px].
    view_size : (width, height)
        Of a view [px].
    steps : list of (row, column)
        Offsets of the views from the centre view, in view steps.
    colours : 4 ints
        0 red, 1 green, 2 blue of the 2×2 Bayer cell, row by row.
    """
    width, height = view_size
    along, up = lattice.axes.T
    # The sensor's centre is the view's centre; a view pixel is as wide as a lens.
    middle = lattice.axes.T @ (np.array([(sensor[1] - 1) / 2, (sensor[0] - 1) / 2]) - lattice.origin)
    row = (middle[1] + lattice.pitch_px * (np.arange(height) - (height - 1) / 2)) / lattice.row_rise_px
    column = middle[0] / lattice.pitch_px - (width - 1) / 2 - row / 2  # of the pixel x = 0, in steps along the row
    whole = np.floor(np.stack([column, row], -1)).astype(np.int64)
    lenses, weights = kernel_weights(np.stack([column, row], -1) - whole, lattice.vertical)
    lenses = lenses + whole[:, None]
    lenses[..., 0] += lenses[..., 1] // 2  # from steps along the two basis vectors to row j with its half shift
    offsets = np.array([c * along + r * up for r, c in steps], np.float32)
    return LensSampling(
        lattice.origin, _pair(along * lattice.pitch_px), _pair(up * lattice.row_rise_px), offsets,
        reading_weights(colours, offsets, lattice.pitch_px / 2), lenses.astype(np.int32), weights, width,
    )  # fmt: skip


def kernel_weights(
    fractions: F64, vertical: float = 1.0, *, range_pitches: float = RANGE_PITCHES, noise: float = NOISE_SHARE,
    taps: int = TAPS,
) -> tuple[np.ndarray, F32]:  # fmt: skip
    """Weights of the lenses around points between them.

    Parameters
    ----------
    fractions : float64 [N, 2]
        Position in the lattice's basis (right, lower right neighbour), 0..1.

    Returns
    -------
    int64 [N, taps, 2], float32 [N, taps]
        Lenses as steps along the basis vectors, and their weights, which sum to one.
    """
    candidates = np.array([(a, b) for b in range(-2, 4) for a in range(-3, 5)])
    to_plane = np.array([[1.0, 0.5], [0.0, ROW_RISE * vertical]]).T
    places = candidates @ to_plane
    distance = np.hypot(*np.moveaxis(places[None] - (fractions @ to_plane)[:, None], -1, 0))
    nearest = np.argsort(distance, axis=1, kind="stable")[:, :taps]
    chosen = places[nearest]
    between = np.hypot(*np.moveaxis(chosen[:, :, None] - chosen[:, None], -1, 0))
    system = np.ones((len(fractions), taps + 1, taps + 1))
    system[:, :taps, :taps] = matern(between, range_pitches) + noise * np.eye(taps)
    system[:, taps, taps] = 0  # Lagrange multiplier: the weights sum to one
    right = np.ones((len(fractions), taps + 1, 1))
    right[:, :taps, 0] = matern(np.take_along_axis(distance, nearest, 1), range_pitches)
    weights = np.linalg.solve(system, right)[:, :taps, 0]
    return candidates[nearest], weights.astype(np.float32)


def _pair(vector: F64) -> tuple[float, float]:
    return float(vector[0]), float(vector[1])
