"""Radiometry of raw light fields: the modulation from a white image, and levels and gains for the kernel.

Sensor values become light by ``(raw − black)/(white − black) / modulation · white-balance gain``, before demosaic and
without a clip (docs/lenslet.md, Radiometry).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import COLOURS, BayerPattern
from lfrig.processing.kernels.lenslet import SensorPlanes
from lfrig.processing.lenslet.lattice import HexLattice
from lfrig.processing.lenslet.metadata import ColourValues, RawMetadata

U16 = NDArray[np.uint16]

FULL_SCALE = 40000
"""Modulation as stored at the white image's white level, a margin left above."""
LENSES_PER_BLOCK = 6
STRIPE_ROWS = 32
SMOOTH_RADIUS = 0.85
"""The white image is smoothed where all pixels that the views use lie inside this part of a lens's radius."""


@dataclass(frozen=True, eq=False)
class Modulation:
    """How much of uniform light reaches each pixel.

    ``values`` uint16 [Hs, Ws], times ``unit`` it is 1 at the peak; the Bayer colours are brought to green's level.
    ``gains`` are what did that, in the order of `COLOURS`.
    """

    values: U16
    unit: float
    gains: ColourValues


def bayer_sites(bayer: BayerPattern) -> tuple[int, int, int, int]:
    """Index into `COLOURS` of each pixel of the 2×2 Bayer cell, row by row."""
    names = []
    for k, colour in enumerate(bayer):
        in_red_row = "R" in bayer[k // 2 * 2 : k // 2 * 2 + 2]
        names.append(("gr" if in_red_row else "gb") if colour == "G" else colour.lower())
    a, b, c, d = (COLOURS.index(name) for name in names)
    return a, b, c, d


def equalised(values: U16, metadata: RawMetadata, name: Path | str | None = None) -> tuple[U16, ColourValues]:
    """An image with black subtracted and every Bayer colour scaled to the mean of green.

    Parameters
    ----------
    values : uint16 [Hs, Ws]
    name : Path or str, optional
        Of the image, for messages.

    Returns
    -------
    uint16 [Hs, Ws], gains
        Full scale (white − black) at `FULL_SCALE`.

    Raises
    ------
    BadInput
        A colour is black throughout.
    """
    sites = bayer_sites(metadata.bayer)
    black, white = np.array(metadata.black)[list(sites)], np.array(metadata.white)[list(sites)]
    if (white <= black).any():
        raise BadInput(
            f"white level {min(white):g} is not above black {max(black):g}",
            path=name, field="pixelFormat", code="levels",
            remedy="the metadata are damaged",
        )  # fmt: skip
    level = (_site_means(values) - black) / (white - black)
    if (level <= 1e-4).any():
        raise BadInput("is black in at least one colour", path=name, code="black-image", remedy="use another image")
    green = np.mean([level[k] for k in range(4) if metadata.bayer[k] == "G"])
    gain = green / level
    out = np.empty(values.shape, np.uint16)
    for row in range(2):
        along = [2 * row, 2 * row + 1]
        factor, offset = (_tiled(part[along], values.shape[1]) for part in (FULL_SCALE * gain / (white - black), black))
        for start in range(row, values.shape[0], STRIPE_ROWS):  # in stripes: a float copy would take four bytes a pixel
            stripe = slice(start, start + STRIPE_ROWS, 2)
            part = (values[stripe].astype(np.float32) - offset) * factor
            out[stripe] = np.clip(part, 0, 65535, out=part)
    r, gr, gb, b = (float(gain[sites.index(n)]) for n in range(4))
    return out, (r, gr, gb, b)


def _site_means(values: U16) -> NDArray[np.float64]:
    """Mean of each position in the 2×2 cell, float64 [4]."""
    columns = [values[row::2].sum(0, dtype=np.uint64) for row in (0, 1)]  # whole rows at a time: several times faster
    sums = [columns[k // 2][k % 2 :: 2].sum() for k in range(4)]
    return np.array([total / values[k // 2 :: 2, k % 2 :: 2].size for k, total in enumerate(sums)])


def _tiled(pair: NDArray[np.float64], width: int) -> NDArray[np.float32]:
    return np.resize(pair, width).astype(np.float32)


def modulation_of(
    white: U16, metadata: RawMetadata, hot: NDArray[np.int32], *, smooth: bool, name: str | None = None
) -> Modulation:
    """The modulation that a white image shows, its unit still that of the white level (see `at_peak`).

    ``smooth`` averages its own noise over 3×3 pixels, by binomial weights. That bends the steep rim of the lenses, so
    it is for views that stay away from it (`may_smooth`).
    """
    import cv2

    values, gains = equalised(white, metadata, name)
    _mend(values, hot)
    if smooth:
        values = np.asarray(cv2.GaussianBlur(values, (3, 3), 0), np.uint16)
    return Modulation(values, 1 / FULL_SCALE, gains)


def no_modulation(shape: tuple[int, int]) -> Modulation:
    """Where there is no white image: nothing is known, nothing is divided."""
    return Modulation(np.full(shape, FULL_SCALE, np.uint16), 1 / FULL_SCALE, (1.0, 1.0, 1.0, 1.0))


def may_smooth(pitch_px: float, outermost: int) -> bool:
    """Whether the views up to ``outermost`` steps from the centre stay clear of the lenses' rims."""
    used = outermost * np.sqrt(2) + 1.5  # demosaic and sampling reach a pixel and a half further
    return bool(used <= SMOOTH_RADIUS * pitch_px / 2)


def _mend(values: U16, hot: NDArray[np.int32]) -> None:
    """Replace hot pixels of an equalised image by the mean of their four neighbours, in place."""
    height, width = values.shape
    x, y = hot[:, 0], hot[:, 1]
    total = np.zeros(len(hot))
    for dx, dy in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        # A neighbour beyond the border is the one on the other side.
        nx, ny = (
            np.where((x + dx < 0) | (x + dx >= width), x - dx, x + dx),
            np.where((y + dy < 0) | (y + dy >= height), y - dy, y + dy),
        )
        total += values[ny, nx]
    values[y, x] = np.rint(total / 4)


def at_peak(modulation: Modulation, lattice: HexLattice) -> Modulation:
    """The same with 1 at the peak: the brightest block of lenses, at their centres.

    A single brightest pixel would be a draw of the noise; the mean over a block of lenses is not.
    """
    height, width = modulation.values.shape
    reach = int(max(width, height) / min(lattice.pitch_px, lattice.row_rise_px)) // 2 + 2
    steps = np.arange(-reach, reach + 1)
    centres = np.rint(lattice.centres(steps[None], steps[:, None])).astype(np.int64)
    x, y = centres[..., 0], centres[..., 1]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    level = np.where(inside, modulation.values[np.where(inside, y, 0), np.where(inside, x, 0)], 0).astype(np.float64)
    n = LENSES_PER_BLOCK
    side = len(steps) // n * n
    sums, counts = (
        part[:side, :side].reshape(side // n, n, side // n, n).sum((1, 3)) for part in (level, inside.astype(float))
    )
    peak = float((sums / np.maximum(counts, 1))[counts >= n].max(initial=0))
    if peak <= 0:
        raise BadInput("is black at every lens", code="black-image", remedy="use another white image")
    return Modulation(modulation.values, 1 / peak, modulation.gains)


def sensor_planes(values: U16, metadata: RawMetadata, modulation: Modulation, hot: NDArray[np.int32]) -> SensorPlanes:
    """Levels and gains for the kernel; the white image's own gains where the shot records no white balance."""
    gains = metadata.white_balance or modulation.gains
    sites = bayer_sites(metadata.bayer)
    a, b, c, d = ((metadata.black[n], metadata.white[n], gains[n]) for n in sites)
    cells = (a, b, c, d)
    top = 2**metadata.bits - 1

    def each(number: list[float]) -> tuple[float, float, float, float]:
        p, q, r, s = (float(value) for value in number)
        return p, q, r, s

    colours = ["RGB".index(letter) for letter in metadata.bayer]
    return SensorPlanes(
        values, modulation.values, modulation.unit, (colours[0], colours[1], colours[2], colours[3]),
        each([black for black, _, _ in cells]),
        each([gain / (white - black) for black, white, gain in cells]),
        each([min(white, top) for _, white, _ in cells]),
        hot,
    )  # fmt: skip
