"""Sensor values to views: flat field, lenses read, lens kernel, colour. C++ form: ``lenslet.cpp``.

A view pixel is a weighted sum over the lenses around it, and each lens is read at the view's offset from its centre: a
weighted sum over the 5×5 pixels there, which gives red, green, blue and a weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F32, F64, U8

I32 = NDArray[np.int32]
U16 = NDArray[np.uint16]

REACH = 2
"""Pixels to each side of the nearest one that a reading uses."""
SIDE = 2 * REACH + 1
ROWS_AT_ONCE = 48
"""View rows per call of the native form: between calls progress is told and a cancel is noticed."""


@dataclass(frozen=True, eq=False)
class SensorPlanes:
    """What the sensor recorded and how to make light of it.

    ``values`` uint16 [Hs, Ws]; ``modulation`` uint16 [Hs, Ws], times ``unit`` it is 1 at the peak. By position in the
    2×2 Bayer cell, row by row: ``colours`` (0 red, 1 green, 2 blue), ``black``, ``scale`` (white-balance gain over
    white minus black), ``saturated`` (the least value that is clipped). Modulation is not divided by below ``floor``
    and weighs nothing below ``dark``. ``hot`` int32 [N, 2] (x, y) of pixels to replace.
    """

    values: U16
    modulation: U16
    unit: float
    colours: tuple[int, int, int, int]
    black: tuple[float, float, float, float]
    scale: tuple[float, float, float, float]
    saturated: tuple[float, float, float, float]
    hot: I32
    floor: float = 0.02
    dark: float = 0.1


@dataclass(frozen=True, eq=False)
class LensSampling:
    """Where the views are on the sensor.

    Lens (i, j) is centred at ``origin + (i + ½ (j mod 2)) along + j up`` [px]; view v is read at ``offsets[v]``,
    float32 [V, 2] (x, y) sensor px, from it, with the weights ``reading``, float32 [4, B, B, V, 25, 4]: by the place in
    the Bayer cell of the nearest pixel, by the point's y and x within that pixel, and per pixel around it for red,
    green, blue and weight. View pixel (x, y) sums ``weights[y, t]`` times lens ``(lenses[y, t, 0] + x,
    lenses[y, t, 1])``: float32 and int32 [H, T(, 2)]; all pixels of a view row lie alike between the lenses.
    """

    origin: tuple[float, float]
    along: tuple[float, float]
    up: tuple[float, float]
    offsets: F32
    reading: F32
    lenses: I32
    weights: F32
    width: int


@dataclass(frozen=True, eq=False)
class Colours:
    """``matrix`` float32 [3, 3] to linear sRGB; ``lut`` uint8 [N]: the display value of linear 0..1."""

    matrix: F32
    lut: U8


def decode_views(
    sensor: SensorPlanes,
    lenses: LensSampling,
    colours: Colours,
    *,
    linear: bool = False,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> tuple[U8, U8, F32 | None]:
    """Decode all views.

    Returns
    -------
    views : uint8 [V, H, W, 3]
        RGB as displayed, clipped.
    weight : uint8 [V, H, W]
        255 = full modulation, nothing saturated.
    linear : float32 [V, H, W, 3] or None
        Linear sRGB, nothing clipped.
    """
    monitor = monitor or Monitor()
    height, count = lenses.lenses.shape[0], len(lenses.offsets)
    _check(sensor, lenses)
    views = np.empty((count, height, lenses.width, 3), np.uint8)
    weight = np.empty((count, height, lenses.width), np.uint8)
    light = np.empty((count, height, lenses.width, 3), np.float32) if linear else None
    native = load_native("lfrig.processing.kernels._native")
    with monitor.task("decode", height if native else count):
        if native is None:
            developed = develop_numpy(sensor)
            for v in range(count):
                found = view_numpy(developed, lenses, v)
                views[v], weight[v], linear_view = displayed_numpy(found, colours)
                if light is not None:
                    light[v] = linear_view
                monitor.advance()
            return views, weight, light
        arguments = _native_arguments(sensor, lenses, colours)
        for row in range(0, height, ROWS_AT_ONCE):
            end = min(row + ROWS_AT_ONCE, height)
            native.decode_rows(*arguments, views, weight, light, row, end, threads)
            monitor.advance(end - row)
    return views, weight, light


def _check(sensor: SensorPlanes, lenses: LensSampling) -> None:
    if sensor.values.shape != sensor.modulation.shape or min(sensor.values.shape) < 8:
        raise ValueError(f"sensor {sensor.values.shape} and modulation {sensor.modulation.shape} do not match")
    if lenses.lenses.shape != (*lenses.weights.shape, 2):
        raise ValueError(f"lenses {lenses.lenses.shape} and weights {lenses.weights.shape} do not match")


def _native_arguments(sensor: SensorPlanes, lenses: LensSampling, colours: Colours) -> tuple[object, ...]:
    cells = np.array([sensor.colours, sensor.black, sensor.scale, sensor.saturated], np.float32).T
    return (
        np.ascontiguousarray(sensor.values, np.uint16), np.ascontiguousarray(sensor.modulation, np.uint16),
        np.ascontiguousarray(cells), np.array([sensor.unit, sensor.floor, sensor.dark], np.float32),
        _in_reading_order(sensor.hot), np.array([*lenses.origin, *lenses.along, *lenses.up], np.float64),
        np.ascontiguousarray(lenses.offsets, np.float32), np.ascontiguousarray(lenses.reading, np.float32),
        np.ascontiguousarray(lenses.lenses, np.int32),
        np.ascontiguousarray(lenses.weights, np.float32), np.ascontiguousarray(colours.matrix, np.float32),
        np.ascontiguousarray(colours.lut, np.uint8),
    )  # fmt: skip


def _in_reading_order(hot: I32) -> I32:
    return np.ascontiguousarray(hot[np.lexsort((hot[:, 0], hot[:, 1]))], np.int32)


def develop_numpy(sensor: SensorPlanes) -> F32:
    """NumPy twin, first half: the sensor as float32 [Hs + 4, Ws + 4, 2], its borders mirrored.

    White-balanced linear light of each pixel's own colour, and its weight.
    """
    shape = sensor.values.shape
    mosaic, weight = np.empty(shape, np.float32), np.empty(shape, np.float32)
    for k in range(4):
        site = np.s_[k // 2 :: 2, k % 2 :: 2]
        value = sensor.values[site].astype(np.float32)
        m = sensor.modulation[site].astype(np.float32) * np.float32(sensor.unit)
        mosaic[site] = (value - np.float32(sensor.black[k])) * np.float32(sensor.scale[k])
        mosaic[site] /= np.maximum(m, np.float32(sensor.floor))
        weight[site] = np.where((value < sensor.saturated[k]) & (m >= np.float32(sensor.dark)), np.minimum(m, 1), 0)
    _replace_hot(mosaic, weight, sensor.hot)
    return np.pad(np.stack([mosaic, weight], -1), ((REACH, REACH), (REACH, REACH), (0, 0)), mode="reflect")


def _replace_hot(mosaic: F32, weight: F32, hot: I32) -> None:
    """The mean of the nearest pixels of the same colour that are not hot themselves, in place."""
    height, width = mosaic.shape
    known = {(int(x), int(y)) for x, y in hot}
    for x, y in sorted(known):
        weight[y, x] = 0
        beside = [(x - 2, y), (x + 2, y), (x, y - 2), (x, y + 2)]
        mirrored = [(_mirror(px, width), _mirror(py, height)) for px, py in beside]
        good = [mosaic[py, px] for px, py in mirrored if (px, py) not in known]
        if good:
            mosaic[y, x] = np.mean(good)


def _mirror(i: int, n: int) -> int:
    return -i if i < 0 else (2 * n - 2 - i if i >= n else i)


def view_numpy(developed: F32, lenses: LensSampling, view: int) -> F32:
    """NumPy twin, second half: one view, float32 [H, W, 4] linear red, green, blue and weight."""
    used = lenses.lenses
    i = np.arange(used[..., 0].min(), used[..., 0].max() + lenses.width)
    j = np.arange(used[..., 1].min(), used[..., 1].max() + 1)
    samples = _read_lenses(developed, lenses, i[None], j[:, None], view)
    out = np.zeros((used.shape[0], lenses.width, 4), np.float32)
    x = np.arange(lenses.width)
    for t in range(used.shape[1]):
        read = samples[(used[:, t, 1] - j[0])[:, None], used[:, t, :1] - i[0] + x]
        out += lenses.weights[:, t, None, None] * read
    return out


def _read_lenses(developed: F32, lenses: LensSampling, i: NDArray[np.int64], j: NDArray[np.int64], view: int) -> F32:
    """Every lens at one view's offset, float32 [..., 4]; for one beyond the sensor another further in, at weight 0."""
    height, width = (n - 2 * REACH for n in developed.shape[:2])
    x, y, outside = _points(lenses, i, j, lenses.offsets[view], width, height)
    ix, iy = (x + 0.5).astype(int), (y + 0.5).astype(int)
    bins = lenses.reading.shape[1]
    bx, by = (np.minimum(((p + 0.5 - n) * bins).astype(int), bins - 1) for p, n in ((x, ix), (y, iy)))
    weights = lenses.reading[2 * (iy % 2) + ix % 2, by, bx, view]
    out = np.zeros((*x.shape, 4), np.float32)
    for tap in range(weights.shape[-2]):
        value = developed[iy + tap // SIDE, ix + tap % SIDE]
        out[..., :3] += weights[..., tap, :3] * value[..., :1]
        out[..., 3] += weights[..., tap, 3] * value[..., 1]
    out[outside, 3] = 0
    return out


def _points(
    lenses: LensSampling, i: NDArray[np.int64], j: NDArray[np.int64], offset: F32, width: int, height: int
) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Where lenses are read; points beyond the sensor move inwards by whole lenses, and which those are."""
    across = i + 0.5 * np.mod(j, 2)
    x: F64 = lenses.origin[0] + across * lenses.along[0] + j * lenses.up[0] + float(offset[0])
    y: F64 = lenses.origin[1] + across * lenses.along[1] + j * lenses.up[1] + float(offset[1])
    outside = np.zeros(x.shape, bool)
    for _ in range(16):
        left, right, above, below = x < 0, x > width - 1, y < 0, y > height - 1
        above, below = above & ~(left | right), below & ~(left | right)
        if not (left | right | above | below).any():
            break
        outside |= left | right | above | below
        sideways, upwards = left.astype(int) - right, 2 * (above.astype(int) - below)
        x = x + sideways * lenses.along[0] + upwards * lenses.up[0]
        y = y + sideways * lenses.along[1] + upwards * lenses.up[1]
    return np.clip(x, 0, width - 1), np.clip(y, 0, height - 1), outside


def displayed_numpy(found: F32, colours: Colours) -> tuple[U8, U8, F32]:
    """NumPy twin, last step: uint8 [H, W, 3], weight uint8 [H, W], linear float32 [H, W, 3]."""
    matrix = colours.matrix.T.astype(np.float32)
    # Clipped before the matrix: a channel that the sensor clipped would tint the others.
    clipped = np.minimum(found[..., :3], 1) @ matrix
    index = (np.clip(clipped, 0, 1) * np.float32(len(colours.lut) - 1) + np.float32(0.5)).astype(np.intp)
    weight = (np.clip(found[..., 3], 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8)
    return colours.lut[index], weight, found[..., :3] @ matrix
