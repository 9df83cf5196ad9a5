"""Which of two depths the sources' colours speak for, at chosen pixels.

C++ form: ``edge_cost.cpp``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.landing import Mask, Way, land_points, packed
from lfrig.processing.model import F32


@dataclass(frozen=True)
class EdgeView:
    """A source: the ``way`` into it and its ``picture`` float32 [Hs, Ws, 3], grey levels in the photo's tone, at least
    2×2 px and of the size of its disparity map.
    """

    way: Way
    picture: F32


@dataclass(frozen=True)
class EdgeRules:
    """A colour difference counts up to ``cap`` [grey levels]; a point is charged ``contradiction`` for floating, half
    of it at 1.25 ``contradiction_px``, before what the source sees; it is seen up to ``margin_px`` behind that, and no
    more from 1.5 of it [px per view step of the source].
    """

    cap: float
    contradiction: float
    contradiction_px: float
    margin_px: float


def edge_cost(
    near: F32, far: F32, at: Mask, photo: F32, views: Sequence[EdgeView], rules: EdgeRules, *, threads: int = 0
) -> F32:
    """How much more the far hypothesis costs than the near one.

    Parameters
    ----------
    near, far : float32 [H, W]
        Inverse depths [1/m].
    at : bool [H, W]
        Where to look; others cost nothing.
    photo : float32 [H, W, 3]
        Grey levels.

    Returns
    -------
    float32 [H, W], difference of the mean costs over the sources that see the points [grey levels]; 0 elsewhere. Where
    no source sees a hypothesis its cost is half the cap.
    """
    if far.shape != near.shape or at.shape != near.shape or photo.shape != (*near.shape, 3):
        raise ValueError(f"shapes do not match: near {near.shape}, far {far.shape}, photo {photo.shape}")
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return edge_cost_numpy(near, far, at, photo, views, rules)
    out = np.empty(near.shape, np.float32)
    native.edge_cost(
        *(np.ascontiguousarray(part, np.float32) for part in (near, far)), np.ascontiguousarray(at).view(np.uint8),
        np.ascontiguousarray(photo, np.float32), [np.ascontiguousarray(v.picture, np.float32) for v in views],
        *packed([v.way for v in views]), rules.cap, rules.contradiction, rules.contradiction_px, rules.margin_px, out,
        threads,
    )  # fmt: skip
    return out


def edge_cost_numpy(near: F32, far: F32, at: Mask, photo: F32, views: Sequence[EdgeView], rules: EdgeRules) -> F32:
    """NumPy twin."""
    ys, xs = np.nonzero(at)
    costs = []
    for hypothesis in (near, far):
        total, mass = np.zeros(len(ys), np.float32), np.zeros(len(ys), np.float32)
        for view in views:
            cost, seen = _look(view, rules, photo[ys, xs], xs.astype(np.float32), ys.astype(np.float32), hypothesis[at])
            total += seen * cost
            mass += seen
        costs.append(np.where(mass > 0.05, total / np.maximum(mass, np.float32(0.05)), np.float32(0.5 * rules.cap)))
    out = np.zeros(near.shape, np.float32)
    out[at] = costs[1] - costs[0]
    return out


def _look(view: EdgeView, rules: EdgeRules, photo: F32, xs: F32, ys: F32, inverse_depth: F32) -> tuple[F32, F32]:
    """Cost [M] of points in one source, and how far it sees them, 0..1 [M]."""
    u, v, inside, ahead = land_points(view.way, xs, ys, inverse_depth)
    height, width = view.way.disparity.shape
    u, v = np.clip(u, 0, np.float32(width - 1.001)), np.clip(v, 0, np.float32(height - 1.001))
    iu, iv = u.astype(np.int64), v.astype(np.int64)
    fu, fv = (u - iu)[:, None], (v - iv)[:, None]
    upper, lower = (view.picture[iv + k, iu] + fu * (view.picture[iv + k, iu + 1] - view.picture[iv + k, iu])
                    for k in (0, 1))  # fmt: skip
    difference = np.abs(photo - (upper + fv * (lower - upper))).sum(1) * np.float32(1 / 3)
    floats = np.clip((-ahead - np.float32(rules.contradiction_px)) / np.float32(0.5 * rules.contradiction_px), 0, 1)
    seen = np.clip(1 - (ahead - np.float32(rules.margin_px)) / np.float32(0.5 * rules.margin_px), 0, 1) * inside
    cost = np.minimum(difference + np.float32(rules.contradiction) * floats, np.float32(rules.cap))
    return np.asarray(cost, np.float32), np.asarray(seen, np.float32)
