"""Which disparities can occur, found at half resolution before the sweep at full resolution.

Each level of a semi-global match narrows the search of the next one (tSGM: Rothermel et al., SURE, LC3D 2012). Here one
coarse level suffices: its aggregated costs say which planes each tile of 8×8 pixels has to look at, which disparities
the light field has at all, and where it has steps. The coarse sweep compares the cross of views only.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.grey import GreyViews
from lfrig.processing.kernels.plane_cost import COST_UNIT, TILE, PlaneGrid, plane_cost
from lfrig.processing.kernels.sgm import PATH_LIMIT, PATHS, Penalties, aggregate
from lfrig.processing.kernels.softmax import Summary, sgm_softmax, summarise
from lfrig.processing.model import F32, U8
from lfrig.processing.noise_floor import noise_of_cost

I16 = NDArray[np.int16]
I32 = NDArray[np.int32]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]

RANGE_STEP_PX = 0.24
"""Between the planes by which the range of disparities is found [px per view step]."""
RANGE_SLACK_PX = 0.36
"""What that range may be wrong by, and what too few pixels vote for."""


@dataclass(frozen=True)
class SearchSettings:
    """Knobs of the coarse sweep; disparities in px per view step of the full size."""

    plane_step_px: float = 0.12
    least_probability: float = 0.01
    """Planes less likely than this share of the best one, at the coarse level, are ruled out (on clean views; noise
    leaves much of the probability on many planes, and lowers it)."""
    reach_px: int = 4
    """How far a tile also looks at its surroundings' planes."""
    slack_px: float = 0.09
    """Disparity added on both sides of what the coarse level allows: about what it may be wrong by."""
    worth: float = 0.8
    """Share of active planes above which tiles are not told apart: nothing much would be saved."""


DEFAULT_SEARCH = SearchSettings()


@dataclass(frozen=True)
class Matching:
    """How costs are matched: grey levels of cost on clean views, ``p1_grey`` for a change of ``step_px``; penalties and
    temperature grow by ``noise_share`` per grey level of noise.
    """

    truncation_grey: float
    p1_grey: float
    p2_grey: float
    edge_grey: float
    step_px: float
    inverse_temperature: float
    noise_share: float

    def swell(self, noise: float) -> float:
        """By how much penalties and temperature grow at a noise [grey levels]."""
        return 1.0 + self.noise_share * noise

    def sharpness(self, noise: float) -> float:
        """Inverse temperature per unit of aggregated cost."""
        return self.inverse_temperature / self.swell(noise) / (PATHS * COST_UNIT)

    def aggregate(
        self, cost: U16, picture: U8, noise: float, *, step_px: float, span: I16 | None = None, threads: int = 0
    ) -> U16:
        """Semi-global matching: the sum over `PATHS` paths, uint16 [H, W, D]."""
        small, large = self._penalties(noise, step_px)
        return aggregate(cost, picture, small, large, self.edge_grey, span=span, threads=threads)

    def probability(
        self, cost: U16, picture: U8, noise: float, window: int, *, span: I16 | None = None, threads: int = 0
    ) -> tuple[U16, F32, F32]:
        """The same on planes ``step_px`` apart, and what its sums say: see `sgm_softmax`."""
        penalties = Penalties.of(picture, *self._penalties(noise, self.step_px), self.edge_grey, threads=threads)
        return sgm_softmax(cost, penalties, self.sharpness(noise), window, span=span, threads=threads)

    def _penalties(self, noise: float, step_px: float) -> tuple[float, float]:
        """P1 and P2 in units of cost."""
        unit = COST_UNIT * self.swell(noise)
        most = PATH_LIMIT - round(self.truncation_grey * COST_UNIT) - 1
        large = min(self.p2_grey * unit, most)
        return min(self.p1_grey * unit * step_px / self.step_px, large / 1.5), large


@dataclass(frozen=True)
class Search:
    """``disparity`` float32 [H/2, W/2], px per view step of the full size; ``first`` and ``last`` float32 [H/2, W/2],
    the range of disparities that may be right.
    """

    disparity: F32
    first: F32
    last: F32

    def span(self, grid: PlaneGrid, shape: tuple[int, int], settings: SearchSettings) -> I16 | None:
        """Planes of ``grid`` that each tile needs: int16 [ceil(H/8), ceil(W/8), 2], first and one past last.

        None when tiles need so many that nothing much would be saved.
        """
        import cv2

        size = 2 * (settings.reach_px // 2) + 1
        window = np.ones((size, size), np.uint8)
        low = _tiles(cv2.erode(self.first, window), shape, np.minimum) - settings.slack_px
        high = _tiles(cv2.dilate(self.last, window), shape, np.maximum) + settings.slack_px
        first = np.clip(np.floor((low - grid.first) / grid.step), 0, grid.count - 1)
        past = np.clip(np.ceil((high - grid.first) / grid.step) + 1, first + 1, grid.count)
        if float((past - first).mean()) > settings.worth * grid.count:
            return None
        return np.ascontiguousarray(np.stack([first, past], -1).astype(np.int16))


@dataclass(frozen=True)
class CoarseCosts:
    """``cost`` uint16 [H/2, W/2, D] on the planes of ``grid``, in pixels of the half size; ``noise`` of the views at
    half size [grey levels].
    """

    cost: U16
    grid: PlaneGrid
    noise: float


def coarse_costs(
    half: GreyViews,
    grid: PlaneGrid,
    truncation_grey: float,
    settings: SearchSettings,
    *,
    chosen: I32,
    threads: int,
    monitor: Monitor | None,
) -> CoarseCosts:
    """Sweep at half size.

    Parameters
    ----------
    half : GreyViews
        The views at half size.
    grid : PlaneGrid
        Planes of the full size: the range to search.
    chosen : int32 [n]
        Indices of the views to compare.
    """
    length = grid.step * (grid.count - 1)
    count = max(2, int(np.ceil(length / settings.plane_step_px)) + 1)
    coarse = PlaneGrid(grid.first / 2, length / 2 / (count - 1), count)
    cost = plane_cost(half, coarse, truncation_grey, chosen=chosen, threads=threads, monitor=monitor)
    return CoarseCosts(cost, coarse, noise_of_cost(cost, threads=threads))


def coarse_match(
    costs: CoarseCosts, picture: U8, matching: Matching, settings: SearchSettings, *, threads: int
) -> Search:
    """Match at half size; ``picture`` is the centre view at full size, uint8 [H, W, 3]."""
    import cv2

    height, width = costs.cost.shape[:2]
    even = np.ascontiguousarray(picture[: 2 * height, : 2 * width])
    guide = np.asarray(cv2.resize(even, (width, height), interpolation=cv2.INTER_AREA))
    step = 2 * costs.grid.step
    total = matching.aggregate(costs.cost, guide, costs.noise, step_px=step, threads=threads)
    least = settings.least_probability / matching.swell(costs.noise) ** 2
    margin = -np.log(least) / matching.sharpness(costs.noise)
    found = summarise(total, margin=int(margin), threads=threads)
    best, first, last = (
        np.asarray(2 * costs.grid.first + step * k, np.float32) for k in (found.best, found.first, found.past - 1)
    )
    return Search(best, first, last)


def found_range(
    half: GreyViews, limit_px: float, truncation_grey: float, *, chosen: I32, threads: int
) -> tuple[float, float] | None:
    """The disparities [px per view step of the full size] that occur, from a coarse sweep over ±``limit_px``.

    Pixels of every second band vote where the best plane is clearly better than the average; the range holds 99 % of
    the votes on each side and a margin. None when too few pixels show anything.
    """
    step = RANGE_STEP_PX / 2
    grid = PlaneGrid(-limit_px / 2, step, int(limit_px / step) + 1)
    span, asked = _bands(half.height, half.width, grid.count)
    cost = plane_cost(half, grid, truncation_grey, chosen=chosen, span=span, threads=threads)
    found: Summary = summarise(cost, span=span, threads=threads)
    margin = found.mean[asked].astype(np.float32) - found.lowest[asked]
    votes = margin > max(float(COST_UNIT), float(np.quantile(margin, 0.5)))
    if votes.sum() < 20:
        return None
    lo, hi = RANGE_STEP_PX * np.quantile(found.best[asked][votes], [0.005, 0.995]) - limit_px
    slack = RANGE_SLACK_PX + 0.05 * (hi - lo)
    return max(-limit_px, float(lo - slack)), min(limit_px, float(hi + slack))


def _bands(height: int, width: int, planes: int) -> tuple[I16, Mask]:
    """All planes of every second band of 16 rows, and none of the others, as a span of tiles; and the rows, bool [H].

    The sweep works on such bands: what is between costs it nothing.
    """
    tall = 2 * TILE
    asked = np.arange(height) // tall % 2 == 0
    span = np.zeros((-(-height // TILE), -(-width // TILE), 2), np.int16)
    span[asked[::TILE], :, 1] = planes
    return span, asked


def _tiles(half: F32, shape: tuple[int, int], least: np.ufunc) -> F32:
    """Least (or greatest) value in each tile of 8×8 pixels of the full size, from a map at half size."""
    tile = TILE // 2
    down, across = (-(-n // TILE) for n in shape)
    whole = np.pad(half, ((0, down * tile - half.shape[0]), (0, across * tile - half.shape[1])), mode="edge")
    rows = functools.reduce(least, (whole[k::tile] for k in range(tile)))
    return np.asarray(functools.reduce(least, (rows[:, k::tile] for k in range(tile))))
