"""What a plenoptic sensor makes of the light: vignetting, colour response, noise, clipping, quantisation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.lytro import CameraFigures
from lfrig.sim.plenoptic.body import Body
from lfrig.sim.plenoptic.lattice import Lattice, from_nearest_lens, in_lattice
from lfrig.sim.scene import F32
from lfrig.sim.tone import Exposure

U16 = NDArray[np.uint16]

FULL_WELL_E = 4000.0
READ_NOISE_E = 3.0
WHITE_LEVEL = 0.85
"""Of the full scale: what a white image's brightest green pixels reach."""
EDGE_PX = 0.4  # a lens's image ends over 4.4 times this: diffraction and the pixel's own size
LENS_FALLOFF = 0.12  # from the middle of a lens's image to its rim
MAIN_FALLOFF = 0.30  # from the middle of the sensor to its corner
ROWS_AT_ONCE = 256


def modulation(lattice: Lattice, shape: tuple[int, int]) -> F32:
    """How much of uniform light reaches each pixel, float32 [Hs, Ws], 1 under the middle lens's middle.

    The image of the round pupil fills the lens to the middle of its sides: ``f / N`` is ``pitch`` view steps wide.
    """
    height, width = shape
    record, radius = lattice.record(), lattice.pitch_px / 2
    middle = (width - 1) / 2, (height - 1) / 2
    corner = middle[0] ** 2 + middle[1] ** 2
    x = np.arange(width, dtype=np.float64)[None]
    out = np.empty(shape, np.float32)
    for row in range(0, height, ROWS_AT_ONCE):
        y = np.arange(row, min(row + ROWS_AT_ONCE, height), dtype=np.float64)[:, None]
        dx, dy = from_nearest_lens(*in_lattice(record, x, y), record[0], record[1])
        d = np.sqrt(dx * dx + dy * dy).astype(np.float32)
        lens = (1 - LENS_FALLOFF * (d / radius) ** 2) / (1 + np.exp((d - radius) / EDGE_PX))
        main = 1 - MAIN_FALLOFF * ((x - middle[0]) ** 2 + (y - middle[1]) ** 2) / corner
        out[row : row + len(y)] = lens * main
    return out


def exposed(radiance: F32, transmitted: F32, body: Body, exposure: Exposure) -> F32:
    """Signal of a shot, float32 [Hs, Ws] with 1 the white level; ``radiance`` of each pixel's own colour.

    The exposure's white balance is no part of it: it is applied by whoever reads the file (`recorded_gains`).
    """
    return _respond(radiance * transmitted * np.float32(exposure.gain), body)


def white_signal(transmitted: F32, body: Body) -> F32:
    """Signal of a uniform white light, float32 [Hs, Ws]."""
    return _respond(transmitted * np.float32(WHITE_LEVEL), body)


def recorded_gains(body: Body, exposure: Exposure) -> tuple[float, float, float]:
    """White-balance gains R, G, B that make the file's colours those of `tone.develop`, green 1."""
    red, green, blue = (w / q for w, q in zip(exposure.white_balance, body.responses, strict=True))
    return red / green, 1.0, blue / green


def _respond(signal: F32, body: Body) -> F32:
    responses = np.asarray(body.responses, np.float32)[body.colours]
    for y in range(2):
        for x in range(2):
            signal[y::2, x::2] *= responses[y, x]
    return signal


def read_out(signal: F32, body: Body, rng: np.random.Generator | None) -> U16:
    """Sensor values uint16 [Hs, Ws]; ``rng`` None is a sensor without noise and hot pixels.

    Poisson shot noise of the electrons (`FULL_WELL_E` at the white level) and Gaussian read noise, clipped at the
    white level and at zero.
    """
    figures = body.figures
    values = np.empty(signal.shape, np.uint16)
    # In bands, one after the other: the noise of a whole sensor would take a gigabyte of scratch.
    for row in range(0, signal.shape[0], ROWS_AT_ONCE):
        part = signal[row : row + ROWS_AT_ONCE].astype(np.float64)
        if rng is not None:
            inside = (body.hot_pixels[:, 1] >= row) & (body.hot_pixels[:, 1] < row + len(part))
            xs, ys = body.hot_pixels[inside].T
            part[ys - row, xs] += body.hot_level[inside]
            part = rng.poisson(np.maximum(part, 0) * FULL_WELL_E) + READ_NOISE_E * rng.standard_normal(part.shape)
            part /= FULL_WELL_E
        values[row : row + len(part)] = _quantise(part, figures)
    return values


def _quantise(signal: NDArray[np.float64], figures: CameraFigures) -> U16:
    levels = figures.black + (figures.white - figures.black) * np.minimum(signal, 1.0)
    return np.asarray(np.clip(np.rint(levels), 0, 2**figures.bits - 1), np.uint16)
