"""Fusion of the sources' evidence in the target's frustum into a cost volume, in one pass.

Target planes are uniform in inverse depth: ``w_k = w0 + dw·k``, nearer last. A target voxel (x, y, k) lies in a source
at ``p = A (x, y, 1) + b w_k``, pixel ``(p0/p2, p1/p2)``, inverse depth ``w_k / p2``, disparity
``δ = (w_k/p2 − c) / a``: one projective map. Per voxel and source, with the probability p there (trilinear) and ε the
floor share:

- evidence: ``log((1 − ε) p·stretch + ε/N)``; towards neutral (``log 1/N``) where the source's own surface hides the
  voxel; neutral outside its frame. ``stretch`` is the source's planes per target plane.
- colour: ``weight · seen · (unknown − min(difference / sigma, cap))``, at voxels whose evidence comes within ``reach``
  of their ray's best: a voxel that a source sees in another colour than the photo's is refuted. The disparities leave
  a ray that passes behind an object, or where no source sees anything, to chance; colours know that a ray cannot end
  in empty space.

Then planes behind strong nearer evidence are lowered (first-surface rule): a wall behind an object can be supported by
two sources while the object is out of frame in one of them, yet a ray ends at its first surface.

C++ form: ``fusion.cpp``, blocks of 8 × 8 pixels that stay in the cache. It samples only bricks (a block at one plane)
that can meet mass or the rim of a source's surface (`occupancy`); others have one value. Twin: ``fusion_twin.py``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.native import load_native
from lfrig.processing.kernels.occupancy import Occupancy
from lfrig.processing.model import F32, F64, U8, Evidence, ScaleFit

U16 = NDArray[np.uint16]


@dataclass(frozen=True)
class SourceVolume:
    """One source: its evidence and scale, the `geometry.projection` from target to source, the tables of its volume,
    and its centre view, uint8 [Hs, Ws, 4]: blurred as the photo, in the photo's tone, and the share of saturated pixels
    in the blur (/255).
    """

    evidence: Evidence
    scale: ScaleFit
    projection: tuple[F64, F64]
    occupancy: Occupancy
    colour: U8 | None = None


@dataclass(frozen=True)
class Pool:
    """How evidence is pooled: the sum above (``log_pool``), or the mean of p over the sources that see the voxel.

    ``literal`` takes the target's plane for the source's (the paper's printed form); ``margin_px`` is the slack of the
    visibility test [px per view step of the source], None leaves it out.
    """

    log_pool: bool = True
    literal: bool = False
    floor_share: float = 0.05
    margin_px: float | None = 0.06


@dataclass(frozen=True)
class ColourTerm:
    """``weight``, ``sigma_grey``, ``cap``, ``unknown`` and ``reach`` of the term above; log pool only."""

    weight: float
    sigma_grey: float
    cap: float
    unknown: float
    reach: float = float("inf")


@dataclass(frozen=True)
class SurfaceRule:
    """Plane k pays ``min(cap, β·max(0, V[j] − neutral − τ))`` for the strongest plane j ≥ k + ``gap`` before it."""

    gap: int
    tau: float
    beta: float
    cap: float


@dataclass(frozen=True)
class CostScale:
    """Fixed point: ``unit`` of log evidence per count, and the greatest cost there is [log evidence]."""

    unit: float = 1 / 64
    cap: float = 20.0


@dataclass(frozen=True)
class FusedCost:
    """``cost`` uint16 [H, W, N]: counts below the ray's best plane; ``best`` float32 [H, W]: log evidence of that.

    ``inside`` counts (voxel, source) pairs in the sources' frames; of the (brick, source) pairs, ``sampled``, ``empty``
    (inside, of one value) and ``unseen`` (outside).
    """

    cost: U16
    best: F32
    inside: int
    sampled: int
    empty: int
    unseen: int


def fuse_volume(
    sources: Sequence[SourceVolume],
    shape: tuple[int, int, int],
    planes: tuple[float, float],
    pool: Pool,
    *,
    photo: U8 | None = None,
    colour: ColourTerm | None = None,
    surface: SurfaceRule | None = None,
    scale: CostScale = CostScale(),
    skip_bricks: bool = True,
    skip_sources: bool = True,
    threads: int = 0,
) -> FusedCost:
    """Fuse into a volume of ``shape`` (H, W, N) with target planes ``planes`` (w0, dw) [1/m].

    Parameters
    ----------
    photo : uint8 [H, W, 4], optional
        What the target shows, blurred, and the share of saturated pixels (`tone.marked`); with ``colour`` it is
        compared with the sources.
    skip_bricks, skip_sources : bool
        Leave out bricks that no mass can reach, and sources where they do not see the brick.
    """
    compared = photo if colour is not None and pool.log_pool else None
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        from lfrig.processing.kernels.fusion_twin import fuse_numpy

        return fuse_numpy(sources, shape, planes, pool, compared, colour, surface, scale)
    cost, best = np.empty(shape, np.uint16), np.empty(shape[:2], np.float32)
    no_colour = np.empty((0, 0, 0), np.uint8)
    neutral = -len(sources) * float(np.log(shape[2]))
    rule = [] if surface is None else [neutral + surface.tau, surface.gap, surface.beta, surface.cap]
    term = colour or ColourTerm(0, 1, 0, 0)
    counts = native.fuse_volume(
        [s.evidence.probability for s in sources],
        [s.evidence.disparity for s in sources],
        [no_colour if s.colour is None else s.colour for s in sources],
        [s.occupancy.sums for s in sources],
        [s.occupancy.least for s in sources],
        [s.occupancy.greatest for s in sources],
        np.stack([_numbers(s) for s in sources]),
        *planes,
        np.array([pool.floor_share, NEVER_HIDDEN_PX if pool.margin_px is None else pool.margin_px], np.float32),
        no_colour if compared is None else compared,
        np.array([term.weight, term.sigma_grey, term.cap, term.unknown, term.reach], np.float32),
        np.array(rule, np.float32),
        not pool.log_pool,
        pool.literal,
        skip_bricks,
        skip_sources,
        scale.unit,
        round(scale.cap / scale.unit),
        cost,
        best,
        threads,
    )
    return FusedCost(cost, best, *counts)


NEVER_HIDDEN_PX = 1e9


def _numbers(source: SourceVolume) -> F32:
    matrix, offset = source.projection
    line = [source.scale.a, source.scale.c, *source.evidence.planes_px]
    return np.concatenate([matrix.ravel(), offset, line]).astype(np.float32)
