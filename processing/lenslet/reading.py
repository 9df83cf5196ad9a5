"""How a lens is read at an offset from its centre: colours and position at once, from the pixels of that lens alone.

Around each point that a view asks for, the weights of the 5×5 nearest pixels for red, green and blue are those of
least squared error for a scene that is smooth across the aperture, similar in its colours, and seen through noise
(ordinary cokriging; Wackernagel, "Multivariate Geostatistics", 2003). Demosaic and shift by a fraction of a pixel are
one step, and pixels of the neighbouring lens, which see another part of the scene from the other side of the aperture,
take no part: with small lenses a demosaic of the whole sensor spoils the outer views.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.kernels.lenslet import REACH
from lfrig.processing.lenslet.covariance import matern
from lfrig.processing.model import F32, F64

BINS = 8
"""Positions within a pixel, per axis, for which there are weights."""
RANGE_PX = 5.0
"""Range of the Matérn covariance across the aperture [px]."""
COLOUR_CORRELATION = 0.9
NOISE_SHARE = 0.002
"""Variance of a green pixel's noise relative to that of the scene; of red and blue it is twice that."""
RIM_PX = 0.25
"""Pixels nearer than this to a lens's rim, or beyond it, hold light of the next lens too and are not used."""
CHUNK = 2048

_SPAN = np.arange(-REACH, REACH + 1)
TAPS: NDArray[np.int64] = np.stack(np.meshgrid(_SPAN, _SPAN), -1).reshape(-1, 2)
"""Pixels (dx, dy) from the nearest one, in the order of the weights."""


def reading_weights(
    colours: tuple[int, int, int, int],
    offsets: F32,
    radius_px: float,
    *,
    reach_px: float = RANGE_PX,
    correlation: float = COLOUR_CORRELATION,
    noise: float = NOISE_SHARE,
) -> F32:
    """Weights of the pixels around a point of a lens.

    Parameters
    ----------
    colours : 4 ints
        0 red, 1 green, 2 blue of the 2×2 Bayer cell, row by row.
    offsets : float32 [V, 2]
        Points (x, y) from the lens's centre [px].
    radius_px : float
        Of the lens's image.

    Returns
    -------
    float32 [4, BINS, BINS, V, len(TAPS), 4]
        By the cell position ``2 (y mod 2) + (x mod 2)`` of the nearest pixel, by the bins in y and x of the point's
        position within it, by view and pixel: weights for red, green, blue, which sum to one, and of the pixel's own
        weight, which sum to the share of the surroundings that lies in the lens.
    """
    within = (np.arange(BINS) + 0.5) / BINS - 0.5
    point = np.stack(np.meshgrid(within, within), -1).reshape(-1, 2)  # of the bins, y first
    used = _own_pixels(offsets, point, radius_px, colours)  # [4, bins, V, taps]
    keys = np.concatenate(
        [np.broadcast_to(np.arange(n).reshape(shape), used.shape[:3])[..., None] for n, shape in
         ((4, (4, 1, 1)), (len(point), (1, -1, 1)))] + [used.astype(np.int64) @ (1 << np.arange(len(TAPS)))[:, None]],
        axis=-1,
    ).reshape(-1, 3)  # fmt: skip
    unique, inverse = np.unique(keys, axis=0, return_inverse=True)
    solved = np.empty((len(unique), len(TAPS), 4), np.float32)
    for start in range(0, len(unique), CHUNK):
        part = unique[start : start + CHUNK]
        mask = (part[:, 2:] >> np.arange(len(TAPS))) & 1
        tap_colours = _tap_colours(colours)[part[:, 0]]
        solved[start : start + CHUNK] = _solve(
            point[part[:, 1]], mask.astype(bool), tap_colours, reach_px, correlation, noise
        )
    return solved[inverse.reshape(-1)].reshape(4, BINS, BINS, len(offsets), len(TAPS), 4)


def _tap_colours(colours: tuple[int, int, int, int]) -> NDArray[np.int64]:
    """Colour of each tap by the cell position of the nearest pixel, int64 [4, taps]."""
    cell = np.array(colours).reshape(2, 2)
    at = np.arange(4)
    return np.asarray(cell[(at[:, None] // 2 + TAPS[:, 1]) % 2, (at[:, None] % 2 + TAPS[:, 0]) % 2], np.int64)


def _own_pixels(offsets: F32, point: F64, radius_px: float, colours: tuple[int, int, int, int]) -> NDArray[np.bool_]:
    """Which pixels lie in the lens, bool [4, bins, V, taps]; always one of each colour at least."""
    place = offsets[None, :, None].astype(np.float64) - point[:, None, None] + TAPS  # from the lens's centre
    distance = np.hypot(place[..., 0], place[..., 1])
    tap_colours = _tap_colours(colours)
    used = np.empty((4, *distance.shape), bool)
    for phase in range(4):
        # Where the rim leaves nothing of a colour, its pixel nearest the centre stands in.
        least = np.full(distance.shape[:2], radius_px - RIM_PX)
        for colour in range(3):
            least = np.maximum(least, distance[..., tap_colours[phase] == colour].min(-1))
        used[phase] = distance <= least[..., None] + 1e-9
    return used


def _solve(
    point: F64, used: NDArray[np.bool_], colours: NDArray[np.int64], reach_px: float, correlation: float, noise: float
) -> NDArray[np.float64]:
    """Weights [M, taps, 4] of M readings: the taps used, their colours, and where the points are among them."""
    count, taps = used.shape
    between = matern(np.hypot(*np.moveaxis(TAPS[:, None] - TAPS[None], -1, 0).astype(np.float64)), reach_px)
    alike = np.where(colours[:, :, None] == colours[:, None], 1.0, correlation)
    system = np.zeros((count, taps + 3, taps + 3))
    pair = used[:, :, None] & used[:, None]
    system[:, :taps, :taps] = np.where(pair, between * alike, 0)
    diagonal = np.arange(taps)
    system[:, diagonal, diagonal] += np.where(used, np.where(colours == 1, noise, 2 * noise), 1)
    right = np.zeros((count, taps + 3, 3))
    to_point = matern(np.hypot(*np.moveaxis(TAPS - point[:, None], -1, 0)), reach_px)
    for colour in range(3):
        same = colours == colour
        # The weights of a reading's own colour sum to one, those of the others to nothing.
        system[:, taps + colour, :taps] = system[:, :taps, taps + colour] = used & same
        right[:, :taps, colour] = np.where(used, to_point * np.where(same, 1.0, correlation), 0)
        right[:, taps + colour, colour] = 1
    weights = np.empty((count, taps, 4))
    weights[..., :3] = np.linalg.solve(system, right)[:, :taps]
    # Less than one in all where part of the surroundings is beyond the rim.
    near = np.exp(-((TAPS - point[:, None]) ** 2).sum(-1))
    weights[..., 3] = used * near / near.sum(1, keepdims=True)
    return weights
