"""Semi-global matching along 8 paths (Hirschmüller, PAMI 2008, eq. 13) in 16-bit fixed point.

``L(p, k) = C(p, k) + min(L(q, k), L(q, k±1) + P1, min_j L(q, j) + P2(p, q)) − min_j L(q, j)``; the result is the sum
over the paths. P2 is lowered where the guide image has an edge. Where labels are relative to
a surface of their own at each pixel, ``shift`` says which labels of neighbours lie on one plane (SGM-P: Scharstein,
Taniai & Sinha, 3DV 2017). C++ form: ``sgm.cpp``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.model import U8

I16 = NDArray[np.int16]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]

SPAN_TILE = 8
"""Pixels; one range of active labels for each tile of so many by so many."""
PATHS = 8
"""The result is a sum over so many."""
PATH_LIMIT = 65535 // PATHS
"""What the cost of one path may reach in fixed point: all of them together fit 16 bits."""
WALL = 32767
"""The cost of a label that no path comes from, in the NumPy twin."""
INACTIVE = 65535
"""The aggregated cost of a label outside its tile's span."""


def _sum_of_paths(
    cost: NDArray[Any],
    penalties: NDArray[Any],
    p1: np.generic,
    shift: I16 | None,
    active: Mask | None,
) -> NDArray[Any]:
    """Sum over the 8 paths in the cost's type, [H, W, D]; 0 where a label is not ``active``."""
    total = np.zeros_like(cost)
    held = np.zeros(penalties.shape, np.int64)
    if shift is not None:
        held = np.clip(shift.astype(np.int64), -cost.shape[2] - 1, cost.shape[2] + 1)
    if active is None:
        active = np.ones(cost.shape, bool)
    right, down, diagonal, anti = zip(penalties, held, strict=True)
    # A path is a sweep over lines; flipping and transposing views turns all eight into three kinds of sweep.
    flip = (slice(None, None, -1), slice(None, None, -1))
    volume = (cost, active, total)
    turned = (cost[flip], active[flip], total[flip])
    sweeps = [(volume, down, diagonal, anti)]
    sweeps.append((turned, _towards(down, 1, 0), _towards(diagonal, 1, 1), _towards(anti, 1, -1)))
    for v, s_down, s_diagonal, s_anti in sweeps:
        _sweep(v, s_down, 0, p1)
        _sweep(v, s_diagonal, 1, p1)
        _sweep(v, s_anti, -1, p1)
    for (c, a, t), step in ((volume, right), (turned, _towards(right, 0, 1))):
        _sweep((c.swapaxes(0, 1), a.swapaxes(0, 1), t.swapaxes(0, 1)), _transposed(step), 0, p1)
    return total


Step = tuple[NDArray[Any], NDArray[np.int64]]
"""Penalty and label shift of the step from each pixel to one of its neighbours, [H, W] each."""
Volume = tuple[NDArray[Any], Mask, NDArray[Any]]
"""Costs, which labels are active, and the sum of the paths, [H, W, D] each."""


def _towards(step: Step, dy: int, dx: int) -> Step:
    """The step between p and p + (dy, dx), re-indexed for the image turned by 180°: still from line to line."""
    penalty, shift = step
    turn = (slice(None, None, -1), slice(None, None, -1))
    return np.roll(penalty, (dy, dx), (0, 1))[turn], -np.roll(shift, (dy, dx), (0, 1))[turn]


def _transposed(step: Step) -> Step:
    return step[0].T, step[1].T


def _sweep(volume: Volume, step: Step, slant: int, p1: np.generic) -> None:
    """Add the paths that run from line i − 1, position x − slant, to line i, position x, to the sum in place.

    ``step[…][i − 1, x − slant]`` belongs to that step.
    """
    cost, active, total = volume
    penalty, shift = step
    previous = np.where(active[0], cost[0], WALL)
    total[0] += np.where(active[0], cost[0], 0)
    for i in range(1, cost.shape[0]):
        gained = _best_step(previous, penalty[i - 1], shift[i - 1], p1)
        current = cost[i].copy()
        if slant == 0:
            current += gained
        elif slant > 0:
            current[slant:] += gained[:-slant]
        else:
            current[:slant] += gained[-slant:]
        total[i] += np.where(active[i], current, 0)
        previous = np.where(active[i], current, WALL)


def _best_step(previous: NDArray[Any], penalty: NDArray[Any], shift: NDArray[np.int64], p1: np.generic) -> NDArray[Any]:
    """What a path adds to the costs of its next line, [W, D]; nothing behind a pixel without any label."""
    lowest = previous.min(1, keepdims=True)
    labels = np.arange(previous.shape[1])
    near = np.pad(previous, ((0, 0), (1, 1)), constant_values=WALL)
    if shift.any():
        near = _shifted(previous, labels - shift[:, None])
    best = np.minimum(near[:, :-2], near[:, 2:])
    best += p1
    np.minimum(best, near[:, 1:-1], out=best)
    np.minimum(best, lowest + penalty[:, None], out=best)
    return np.where(lowest < WALL, best - lowest, 0)


def _shifted(values: NDArray[Any], wanted: NDArray[np.int64]) -> NDArray[Any]:
    """Labels −1 … planes of every row, read where ``wanted`` [W, planes] says; walls beyond its ends."""
    planes = values.shape[1]
    everywhere = np.concatenate([wanted[:, :1] - 1, wanted, wanted[:, -1:] + 1], axis=1)
    inside = (everywhere >= 0) & (everywhere < planes)
    read = np.take_along_axis(values, np.clip(everywhere, 0, planes - 1), axis=1)
    return np.where(inside, read, WALL)


def aggregate(
    cost: U16,
    guide: U8,
    p1: float,
    p2: float,
    edge_grey: float,
    *,
    span: I16 | None = None,
    shift: I16 | None = None,
    threads: int = 0,
    out: U16 | None = None,
) -> U16:
    """Aggregate a cost volume in 16-bit fixed point; the same bits natively and in NumPy, for any thread count.

    Parameters
    ----------
    cost : uint16 [H, W, D]
        In any unit. A path's value is at most a cost and P2, and eight paths must fit 16 bits: costs above
        8191 − P2 count as that.
    guide : uint8 [H, W, 3]
        Image whose edges lower P2.
    p1, p2 : float
        Penalties for a change of one label and of more, in units of the cost; rounded to whole ones.
    edge_grey : float
        Sum of the absolute RGB differences that halves P2.
    span : int16 [ceil(H / 8), ceil(W / 8), 2], optional
        First and one-past-last label that is active in each tile of 8×8 pixels. The others are neither read nor
        written and are walls to the paths; a path starts anew behind a tile without any. None = all are active.
    shift : int16 [4, H, W], optional
        As for `aggregate`.
    out : uint16 [H, W, D], optional
        Where to put the result; not the cost itself.

    Returns
    -------
    uint16 [H, W, D], sum over 8 paths; 65535 outside the spans.

    Raises
    ------
    ValueError
        The shapes do not match, or the penalties leave no room for costs.
    """
    height, width = cost.shape[:2]
    tiles = (-(-height // SPAN_TILE), -(-width // SPAN_TILE), 2)
    fits = guide.shape[:2] == (height, width) and (shift is None or shift.shape == (4, height, width))
    if not fits or (span is not None and span.shape != tiles) or (out is not None and out.shape != cost.shape):
        raise ValueError(f"shapes do not match the cost's {cost.shape}")
    penalties = Penalties.of(guide, p1, p2, edge_grey, threads=threads)
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        total = aggregate_numpy(cost, penalties, span, shift)
        if out is None:
            return total
        out[:] = total
        return out
    result = np.empty_like(cost, order="C") if out is None else out
    native.sgm(
        np.ascontiguousarray(cost), penalties.jump, optional_i16(shift), optional_i16(span), penalties.step,
        penalties.cap, result, threads,
    )  # fmt: skip
    return result


def finest_unit(cap: float, p1: float, p2: float) -> int:
    """Fixed-point steps per unit of cost for `aggregate`: as many as let costs up to ``cap`` and the penalties fit.

    Raises
    ------
    ValueError
        Not even one does.
    """
    unit = int(PATH_LIMIT / (cap + max(p2, 1.5 * p1)))
    if unit < 1:
        raise ValueError(f"costs up to {cap:g} and penalties {p1:g} and {p2:g} do not fit below {PATH_LIMIT}")
    return unit


@dataclass(frozen=True)
class Penalties:
    """Of changes of label, in fixed point: ``step`` (P1) and ``jump`` uint16 [4, H, W], P2 to the right, down,
    down-right and down-left neighbour (last rows and columns unused); and ``cap``, the most that a cost may be.
    """

    step: int
    jump: U16
    cap: int

    @classmethod
    def of(cls, guide: U8, p1: float, p2: float, edge_grey: float, *, threads: int = 0) -> Penalties:
        """Lowered at the edges of the guide, as by `edge_penalties`.

        Raises
        ------
        ValueError
            They leave no room for costs.
        """
        # By the sum of the absolute RGB differences, 0..765.
        lowered = p2 / (1 + np.arange(766) / edge_grey)
        table = np.rint(np.clip(np.maximum(1.5 * p1, lowered), 0, PATH_LIMIT)).astype(np.uint16)
        step, cap = round(p1), PATH_LIMIT - int(table.max())
        if not 0 <= step <= PATH_LIMIT or cap < 1:
            raise ValueError(f"penalties {p1:g} and {p2:g} leave no room below {PATH_LIMIT}: take a coarser unit")
        native = load_native("lfrig.processing.kernels._native")
        if native is None:
            return cls(step, _penalties_numpy(guide, table), cap)
        jump = np.empty((4, *guide.shape[:2]), np.uint16)
        native.edge_penalties(np.ascontiguousarray(guide), table, jump, threads)
        return cls(step, jump, cap)


def optional_i16(values: I16 | None) -> I16:
    """As the kernels take it: empty where there is none."""
    return np.zeros((0, 0, 0), np.int16) if values is None else np.ascontiguousarray(values, np.int16)


def _penalties_numpy(guide: U8, table: U16) -> U16:
    """P2 to the right, down, down-right and down-left neighbour, uint16 [4, H, W]; last rows/columns unused."""
    image = guide.astype(np.int16)
    out = np.full((4, *guide.shape[:2]), table[0], np.uint16)
    out[0, :, :-1] = table[np.abs(image[:, :-1] - image[:, 1:]).sum(-1)]
    out[1, :-1] = table[np.abs(image[:-1] - image[1:]).sum(-1)]
    out[2, :-1, :-1] = table[np.abs(image[:-1, :-1] - image[1:, 1:]).sum(-1)]
    out[3, :-1, 1:] = table[np.abs(image[:-1, 1:] - image[1:, :-1]).sum(-1)]
    return out


def aggregate_numpy(cost: U16, penalties: Penalties, span: I16 | None, shift: I16 | None) -> U16:
    """NumPy twin of `aggregate`."""
    active = None if span is None else active_labels(span, cost.shape)
    capped = np.minimum(cost, penalties.cap).astype(np.int32)
    total = _sum_of_paths(capped, penalties.jump.astype(np.int32), np.int32(penalties.step), shift, active)
    if active is not None:
        total[~active] = INACTIVE
    return np.asarray(total, np.uint16)


def active_labels(span: I16, shape: tuple[int, ...]) -> Mask:
    """Which labels of which pixels are inside their tile's span, bool [H, W, D]."""
    each = span.repeat(SPAN_TILE, 0).repeat(SPAN_TILE, 1)[: shape[0], : shape[1], None, :]
    labels = np.arange(shape[2])
    return (each[..., 0] <= labels) & (labels < each[..., 1])
