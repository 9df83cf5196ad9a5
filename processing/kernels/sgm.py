"""Semi-global matching along 8 paths (Hirschmüller, PAMI 2008, eq. 13) on a float cost volume.

``L(p, k) = C(p, k) + min(L(q, k), L(q, k±1) + P1, min_j L(q, j) + P2(p, q)) − min_j L(q, j)``; the result is the mean
over the paths, in the units of the cost. P2 is lowered where the guide image has an edge. C++ form: ``sgm.cpp``.
"""

from __future__ import annotations

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import F32, U8


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
    cost: F32, guide: U8, p1: float, p2: float, edge_grey: float, *, threads: int = 0, monitor: Monitor | None = None
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

    Returns
    -------
    float32 [H, W, D], mean over 8 paths.
    """
    if cost.shape[:2] != guide.shape[:2]:
        raise ValueError(f"shapes do not match: cost {cost.shape}, guide {guide.shape}")
    penalties = edge_penalties(guide, p1, p2, edge_grey)
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return aggregate_numpy(cost, penalties, p1, monitor)
    out = np.empty_like(cost)
    native.sgm(np.ascontiguousarray(cost), penalties, p1, out, threads)
    return out


def aggregate_numpy(cost: F32, penalties: F32, p1: float, monitor: Monitor | None = None) -> F32:
    """NumPy twin; ``penalties`` from `edge_penalties`."""
    total = np.zeros_like(cost)
    right, down, diagonal, anti = penalties
    # A path is a sweep over lines; flipping and transposing views turns all eight into three kinds of sweep.
    flip = (slice(None, None, -1), slice(None, None, -1))
    sweeps = [(cost, total, down, diagonal, anti)]
    sweeps.append((cost[flip], total[flip], _towards(down, 1, 0), _towards(diagonal, 1, 1), _towards(anti, 1, -1)))
    for c, s, p_down, p_diagonal, p_anti in sweeps:
        _sweep(c, s, p_down, 0, p1, monitor)
        _sweep(c, s, p_diagonal, 1, p1, monitor)
        _sweep(c, s, p_anti, -1, p1, monitor)
    swapped = (1, 0, 2)
    _sweep(cost.transpose(swapped), total.transpose(swapped), right.T, 0, p1, monitor)
    back = _towards(right, 0, 1).T
    _sweep(cost[flip].transpose(swapped), total[flip].transpose(swapped), back, 0, p1, monitor)
    total *= np.float32(0.125)
    return total


def _towards(penalty: F32, dy: int, dx: int) -> F32:
    """Penalties between p and p + (dy, dx), re-indexed for the image turned by 180°: still from line to line."""
    moved = np.roll(penalty, (dy, dx), (0, 1))
    return moved[::-1, ::-1]


def _sweep(cost: F32, total: F32, penalty: F32, shift: int, p1: float, monitor: Monitor | None) -> None:
    """Add the paths that run from line i − 1, position x − shift, to line i, position x, to ``total`` in place.

    ``penalty[i − 1, x − shift]`` is P2 of that step.
    """
    lines, width, planes = cost.shape
    wall = np.float32(1e30)
    previous = cost[0].copy()
    total[0] += previous
    padded = np.full((width, planes + 2), wall, np.float32)
    for i in range(1, lines):
        lowest = previous.min(1, keepdims=True)
        padded[:, 1:-1] = previous
        best = np.minimum(padded[:, :-2], padded[:, 2:])
        best += np.float32(p1)
        np.minimum(best, previous, out=best)
        np.minimum(best, lowest + penalty[i - 1][:, None], out=best)
        best -= lowest
        current = cost[i].copy()
        if shift == 0:
            current += best
        elif shift > 0:
            current[shift:] += best[:-shift]
        else:
            current[:shift] += best[-shift:]
        total[i] += current
        previous = current
        if monitor and i % 64 == 0:
            monitor.advance(0)
