"""What costs say: softmax of aggregated ones with the windowed mean around its peak, and a summary per pixel.

C++ forms: ``softmax.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.sgm import Penalties, aggregate_numpy
from lfrig.processing.model import F32

I16 = NDArray[np.int16]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]

TILE = 8
NO_SPAN = np.zeros((0, 0, 0), np.int16)


def sgm_softmax(
    cost: U16,
    penalties: Penalties,
    inverse_temperature: float,
    window: int,
    *,
    span: I16 | None = None,
    threads: int = 0,
) -> tuple[U16, F32, F32]:
    """Softmax of minus semi-global matching's sums (`sgm.aggregate`) along the last axis, and the peak's windowed mean.

    The sums are never written down. The mean is taken over ±``window`` planes around the peak, the first of the
    lowest sums: over all planes, a uniform floor of 20 % would pull it by 4 planes.

    Parameters
    ----------
    cost : uint16 [H, W, D]
    penalties : Penalties
        Of changes of label.
    inverse_temperature : float
        Sharpness per unit of the sums.
    span : int16 [ceil(H/8), ceil(W/8), 2], optional
        First and one-past-last active plane of each tile of 8×8 pixels; the rest has probability 0 and is not read.
        A tile without any is certain of one.

    Returns
    -------
    probability uint16 [H, W, D] (65535 = 1), peak index float32 [H, W], confidence float32 [H, W] (mass at the peak).
        The same bits for any thread count; C++ and NumPy differ by rounding.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return sgm_softmax_numpy(cost, penalties, inverse_temperature, window, span)
    out = np.empty(cost.shape, np.uint16)
    index, confidence = (np.empty(cost.shape[:2], np.float32) for _ in range(2))
    active = NO_SPAN if span is None else np.ascontiguousarray(span, np.int16)
    native.sgm_softmax(
        np.ascontiguousarray(cost), penalties.jump, active, penalties.step, penalties.cap, inverse_temperature, window,
        out, index, confidence, threads,
    )  # fmt: skip
    return out, index, confidence


@dataclass(frozen=True)
class Summary:
    """Per pixel of a cost volume [h, w]: uint16 ``lowest`` and ``mean`` cost; int16 ``best`` plane (the first), and
    ``first`` and one-past-last (``past``) plane that is within the margin of the lowest.
    """

    lowest: U16
    mean: U16
    best: I16
    first: I16
    past: I16


def summarise(cost: U16, *, span: I16 | None = None, margin: int = 0, every: int = 1, threads: int = 0) -> Summary:
    """Summary of a cost volume, of every ``every``-th row and column.

    Parameters
    ----------
    cost : uint16 [H, W, D]
    span : int16 [ceil(H/8), ceil(W/8), 2], optional
        First and one-past-last active plane of each tile of 8×8 pixels; at least one counts, the rest is not read.
    margin : int
        In units of the cost.
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return summarise_numpy(cost, span, margin, every)
    shape = -(-cost.shape[0] // every), -(-cost.shape[1] // every)
    lowest, mean = (np.empty(shape, np.uint16) for _ in range(2))
    best, first, past = (np.empty(shape, np.int16) for _ in range(3))
    native.summarise(
        np.ascontiguousarray(cost, np.uint16), NO_SPAN if span is None else np.ascontiguousarray(span, np.int16),
        every, margin, lowest, mean, best, first, past, threads,
    )  # fmt: skip
    return Summary(lowest, mean, best, first, past)


def in_span(span: I16 | None, shape: tuple[int, ...]) -> Mask:
    """Which planes are active, bool [H, W, D]; at least one everywhere."""
    height, width, planes = shape
    if span is None:
        return np.ones(shape, bool)
    first = np.clip(span[..., 0], 0, planes - 1)
    past = np.clip(span[..., 1], first + 1, planes)
    first, past = (np.repeat(np.repeat(a, TILE, 0), TILE, 1)[:height, :width, None] for a in (first, past))
    k = np.arange(planes)
    return np.asarray((k >= first) & (k < past))


def sgm_softmax_numpy(
    cost: U16, penalties: Penalties, inverse_temperature: float, window: int, span: I16 | None
) -> tuple[U16, F32, F32]:
    """NumPy twin of `sgm_softmax`."""
    total = aggregate_numpy(cost, penalties, span, None)
    index, confidence = _to_probabilities(total, inverse_temperature, window, in_span(span, cost.shape))
    return total, index, confidence


def _to_probabilities(cost: U16, inverse_temperature: float, window: int, active: Mask) -> tuple[F32, F32]:
    """Softmax of −cost along the last axis, in place; returns the index of the peak and the mass there."""
    height, width, planes = cost.shape
    index = np.empty((height, width), np.float32)
    confidence = np.empty((height, width), np.float32)
    labels = np.arange(planes, dtype=np.float32)
    rows = max(1, 2_000_000 // (width * planes))
    for y in range(0, height, rows):
        block = np.where(active[y : y + rows], cost[y : y + rows], np.inf).astype(np.float32)
        p = np.exp((block.min(2, keepdims=True) - block) * np.float32(inverse_temperature))
        p /= p.sum(2, keepdims=True)
        cost[y : y + rows] = (p * np.float32(65535) + np.float32(0.5)).astype(np.uint16)
        near = np.abs(labels - block.argmin(2)[..., None]) <= window
        p *= near
        mass = p.sum(2)
        confidence[y : y + rows] = np.minimum(mass, 1)
        index[y : y + rows] = (p @ labels) / mass
    return index, confidence


def summarise_numpy(cost: U16, span: I16 | None, margin: int, every: int) -> Summary:
    """NumPy twin of `summarise`: the same bits."""
    active = in_span(span, cost.shape)[::every, ::every]
    part = np.where(active, cost[::every, ::every].astype(np.int64), 1 << 20)
    lowest = part.min(2)
    count = active.sum(2)
    mean = (np.where(active, part, 0).sum(2) + count // 2) // count
    near = part <= lowest[..., None] + margin
    past = part.shape[2] - near[:, :, ::-1].argmax(2)
    return Summary(
        lowest.astype(np.uint16), mean.astype(np.uint16), part.argmin(2).astype(np.int16),
        near.argmax(2).astype(np.int16), past.astype(np.int16),
    )  # fmt: skip
