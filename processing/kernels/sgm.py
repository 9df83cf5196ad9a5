"""Semi-global matching along 8 paths (Hirschmüller, PAMI 2008, eq. 13) on a float cost volume.

``L(p, k) = C(p, k) + min(L(q, k), L(q, k±1) + P1, min_j L(q, j) + P2(p, q)) − min_j L(q, j)``; the result is the mean
over the paths, in the units of the cost. P2 is lowered where the guide image has an edge. Where labels are relative to
a surface of their own at each pixel, ``shift`` says which labels of neighbours lie on one plane (SGM-P: Scharstein,
Taniai & Sinha, 3DV 2017). C++ form: ``sgm.cpp``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F32, U8

I16 = NDArray[np.int16]


def edge_penalties(guide: U8, p1: float, p2: float, edge_grey: float) -> F32:
    """P2 between neighbours, ``p2 / (1 + Σ_rgb|ΔI| / edge_grey)``, never below 1.5·P1.

    Returns
    -------
    float32 [4, H, W] : to the right, down, down-right and down-left neighbour; last rows/columns unused.
    """
    image = guide.astype(np.float32)
    out = np.full((4, *guide.shape[:2]), p2, np.float32)

    def penalty(a: F32, b: F32) -> F32:
        step = np.abs(a - b).sum(-1)
        lowered = np.float32(p2) / (1 + step / np.float32(edge_grey))
        return np.asarray(np.maximum(np.float32(1.5 * p1), lowered), np.float32)

    out[0, :, :-1] = penalty(image[:, :-1], image[:, 1:])
    out[1, :-1] = penalty(image[:-1], image[1:])
    out[2, :-1, :-1] = penalty(image[:-1, :-1], image[1:, 1:])
    out[3, :-1, 1:] = penalty(image[:-1, 1:], image[1:, :-1])
    return out


def aggregate(
    cost: F32,
    guide: U8,
    p1: float,
    p2: float,
    edge_grey: float,
    *,
    shift: I16 | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> F32:
    """Aggregate a cost volume.

    Parameters
    ----------
    cost : float32 [H, W, D]
    guide : uint8 [H, W, 3]
        Image whose edges lower P2.
    p1, p2 : float
        Penalties for a change of one label and of more, in units of the cost.
    edge_grey : float
        Sum of the absolute RGB differences that halves P2.
    shift : int16 [4, H, W], optional
        Label k of a pixel continues as label k + shift of its right, down, down-right and down-left neighbour;
        beyond ±D nothing continues. None = labels mean the same everywhere.

    Returns
    -------
    float32 [H, W, D], mean over 8 paths.
    """
    if cost.shape[:2] != guide.shape[:2]:
        raise ValueError(f"shapes do not match: cost {cost.shape}, guide {guide.shape}")
    if shift is not None and shift.shape != (4, *guide.shape[:2]):
        raise ValueError(f"shapes do not match: cost {cost.shape}, shift {shift.shape}")
    penalties = edge_penalties(guide, p1, p2, edge_grey)
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return aggregate_numpy(cost, penalties, p1, shift, monitor)
    out = np.empty_like(cost)
    moved = np.zeros((0, 0, 0), np.int16) if shift is None else np.ascontiguousarray(shift, np.int16)
    native.sgm(np.ascontiguousarray(cost), penalties, moved, p1, out, threads)
    return out


def aggregate_numpy(
    cost: F32, penalties: F32, p1: float, shift: I16 | None = None, monitor: Monitor | None = None
) -> F32:
    """NumPy twin; ``penalties`` from `edge_penalties`."""
    total = np.zeros_like(cost)
    held = np.zeros(penalties.shape, np.int64)
    if shift is not None:
        held = np.clip(shift.astype(np.int64), -cost.shape[2] - 1, cost.shape[2] + 1)
    right, down, diagonal, anti = zip(penalties, held, strict=True)
    # A path is a sweep over lines; flipping and transposing views turns all eight into three kinds of sweep.
    flip = (slice(None, None, -1), slice(None, None, -1))
    sweeps = [(cost, total, down, diagonal, anti)]
    sweeps.append((cost[flip], total[flip], _towards(down, 1, 0), _towards(diagonal, 1, 1), _towards(anti, 1, -1)))
    for c, s, s_down, s_diagonal, s_anti in sweeps:
        _sweep(c, s, s_down, 0, p1, monitor)
        _sweep(c, s, s_diagonal, 1, p1, monitor)
        _sweep(c, s, s_anti, -1, p1, monitor)
    swapped = (1, 0, 2)
    _sweep(cost.transpose(swapped), total.transpose(swapped), _transposed(right), 0, p1, monitor)
    back = _transposed(_towards(right, 0, 1))
    _sweep(cost[flip].transpose(swapped), total[flip].transpose(swapped), back, 0, p1, monitor)
    total *= np.float32(0.125)
    return total


Step = tuple[F32, NDArray[np.int64]]
"""Penalty and label shift of the step from each pixel to one of its neighbours, [H, W] each."""


def _towards(step: Step, dy: int, dx: int) -> Step:
    """The step between p and p + (dy, dx), re-indexed for the image turned by 180°: still from line to line."""
    penalty, shift = step
    turn = (slice(None, None, -1), slice(None, None, -1))
    return np.roll(penalty, (dy, dx), (0, 1))[turn], -np.roll(shift, (dy, dx), (0, 1))[turn]


def _transposed(step: Step) -> Step:
    return step[0].T, step[1].T


def _sweep(cost: F32, total: F32, step: Step, slant: int, p1: float, monitor: Monitor | None) -> None:
    """Add the paths that run from line i − 1, position x − slant, to line i, position x, to ``total`` in place.

    ``step[…][i − 1, x − slant]`` belongs to that step.
    """
    penalty, shift = step
    lines, width, planes = cost.shape
    labels = np.arange(planes)
    wall = np.float32(1e30)
    previous = cost[0].copy()
    total[0] += previous
    padded = np.full((width, planes + 2), wall, np.float32)
    for i in range(1, lines):
        lowest = previous.min(1, keepdims=True)
        padded[:, 1:-1] = previous
        near = padded
        if shift[i - 1].any():
            near = _shifted(previous, labels - shift[i - 1][:, None], wall)
        best = np.minimum(near[:, :-2], near[:, 2:])
        best += np.float32(p1)
        np.minimum(best, near[:, 1:-1], out=best)
        np.minimum(best, lowest + penalty[i - 1][:, None], out=best)
        best -= lowest
        current = cost[i].copy()
        if slant == 0:
            current += best
        elif slant > 0:
            current[slant:] += best[:-slant]
        else:
            current[:slant] += best[-slant:]
        total[i] += current
        previous = current
        if monitor and i % 64 == 0:
            monitor.advance(0)


def _shifted(values: F32, wanted: NDArray[np.int64], wall: np.float32) -> F32:
    """Labels −1 … planes of every row, read where ``wanted`` [W, planes] says; walls beyond its ends."""
    planes = values.shape[1]
    everywhere = np.concatenate([wanted[:, :1] - 1, wanted, wanted[:, -1:] + 1], axis=1)
    inside = (everywhere >= 0) & (everywhere < planes)
    read = np.take_along_axis(values, np.clip(everywhere, 0, planes - 1), axis=1)
    return np.where(inside, read, wall)
