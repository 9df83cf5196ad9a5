"""Light field → disparity evidence (the DPV): how likely each disparity is at each pixel of the centre view.

A photo-consistency sweep over all views with truncated absolute differences, semi-global aggregation, and a softmax
whose temperature and penalties follow the measured noise. The paper reads the DPV from EPI slopes (after Chen et al.
2018); this sweep replaces it at the same module boundary.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.plane_cost import Halves, PlaneGrid, plane_cost
from lfrig.processing.kernels.softmax import softmax_peak, summarise
from lfrig.processing.matching_views import LIMIT_PX, MatchingViews, matching_views
from lfrig.processing.model import F32, U8, Evidence, LightField
from lfrig.processing.noise_floor import NOISE_PER_HALF, noise_of_cost
from lfrig.processing.plain_areas import DEFAULT_PLAIN, PlainAreas, PlainSettings, blend_plain_cost, find_plain_areas
from lfrig.processing.plane_search import (
    DEFAULT_SEARCH,
    CoarseCosts,
    Matching,
    SearchSettings,
    coarse_costs,
    coarse_match,
    found_range,
)
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally
from lfrig.processing.tone import NO_TEXTURE_GREY

I16 = NDArray[np.int16]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class DpvSettings:
    """Knobs of the sweep; grey levels are of 0..255. Chosen on the tuning scenes (docs/benchmarks.md)."""

    plane_step_px: float = 0.022
    min_planes: int = 16
    max_planes: int = 160
    truncation_grey: float = 23.0
    p1_grey: float = 0.15
    p2_grey: float = 3.0
    edge_grey: float = 12.0
    inverse_temperature: float = 4.0
    """Softmax sharpness per grey level of aggregated cost, on clean views."""
    window: int = 3
    """Half width, in planes, of the regression around the peak."""
    occlusion_aware: bool = True
    occlusion_gap_px: float = 0.3
    """A disparity step of this size within ``occlusion_radius`` pixels asks for the half-aperture test."""
    occlusion_radius: int = 4
    occlusion_bias_grey: float = 0.25
    """What a half of the aperture must be better than all of it: keeps noise from choosing halves."""
    plain: PlainSettings = DEFAULT_PLAIN
    clipped_blur_px: float = 1.0
    """Blur of the views where they clip; 0 = none (see `matching_views`). 1.5 is a little better in large
    clipped areas and worse beside small ones."""
    noise_share: float = 0.8
    """How fast penalties grow, and the temperature rises, per grey level of noise."""
    search: SearchSettings = DEFAULT_SEARCH

    def matching(self, step_px: float) -> Matching:
        """How costs of planes ``step_px`` apart are matched."""
        return Matching(
            self.truncation_grey, self.p1_grey, self.p2_grey, self.edge_grey, step_px, self.inverse_temperature,
            self.noise_share,
        )  # fmt: skip


DEFAULT_DPV = DpvSettings()


def light_field_evidence(
    light_field: LightField,
    disparity_range: tuple[float, float],
    settings: DpvSettings = DEFAULT_DPV,
    *,
    views: MatchingViews | None = None,
    skips: Skips = SKIP_ALL,
    tally: Tally | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> Evidence:
    """Disparity evidence of one light field.

    Parameters
    ----------
    disparity_range : (lo, hi)
        Disparities to consider [px per view step]; see `auto_range`.
    views : MatchingViews, optional
        Those of the light field, when at hand.
    skips : Skips
        With ``planes``, a coarse search says which planes each tile needs and where disparity has steps; without, all
        planes are swept everywhere, and steps are found in a match of their own. With ``views``, the coarse search
        compares the cross of views only.

    Returns
    -------
    Evidence
        On the grid of the centre view.

    Raises
    ------
    BadInput
        The views are constant: there is nothing to match.
    """
    refuse_constant(light_field)
    grid = plane_grid(disparity_range, settings)
    if views is None or views.limit_px < grid.furthest:
        limit = max(LIMIT_PX, grid.furthest)
        views = matching_views(light_field, settings.clipped_blur_px, limit_px=limit, threads=threads)
    matching = settings.matching(grid.step)
    task = _Task(light_field.centre_view, views, grid, settings, matching, threads, monitor)
    match = _match_after_search(task, skips, tally) if skips.planes else _match_everywhere(task)
    probability, index, confidence = softmax_peak(
        match.total, matching.sharpness(match.noise), settings.window, span=match.span, threads=threads
    )
    disparity = np.asarray(grid.first + grid.step * index, np.float32)
    used, tested = len(views.full.padded), float(match.edges.mean())
    return Evidence(probability, (grid.first, grid.step), disparity, confidence, match.noise, used, tested)


@dataclass(frozen=True)
class _Task:
    picture: U8
    views: MatchingViews
    grid: PlaneGrid
    settings: DpvSettings
    matching: Matching
    threads: int
    monitor: Monitor | None

    def steps(self, disparity: F32, *, scale: int = 1) -> Mask:
        """Where halves of the aperture are to be tested."""
        if not self.settings.occlusion_aware:
            return np.zeros(disparity.shape, bool)
        return disparity_steps(disparity, self.settings, scale=scale)

    def sweep(self, edges: Mask | None = None, *, span: I16 | None = None, out: U16 | None = None) -> U16:
        """Matching costs, with the half-aperture test at ``edges``."""
        tested = edges is not None and bool(edges.any())
        halves = Halves(edges, self.settings.occlusion_bias_grey) if edges is not None and tested else None
        return plane_cost(
            self.views.full, self.grid, self.settings.truncation_grey, span=span, halves=halves, out=out,
            threads=self.threads, monitor=self.monitor,
        )  # fmt: skip

    def plain_areas(self, noise: float) -> PlainAreas | None:
        """Where shading alone carries the disparity."""
        plain = self.settings.plain
        if not plain.enabled:
            return None
        return find_plain_areas(self.views.full, self.views.half, noise, plain, threads=self.threads)

    def constrain(
        self, cost: U16, grid: PlaneGrid, areas: PlainAreas | None, noise: float, span: I16 | None = None
    ) -> None:
        """Give plain pixels the cost of their shading's disparity, in place."""
        if areas is not None:
            temperature = self.matching.inverse_temperature / self.matching.swell(noise)
            cap = self.settings.plain.cap_grey
            blend_plain_cost(cost, grid, areas, temperature, cap, span=span, threads=self.threads)

    def aggregate(self, cost: U16, noise: float, span: I16 | None = None) -> U16:
        return self.matching.aggregate(
            cost, self.picture, noise, step_px=self.grid.step, span=span, threads=self.threads
        )


@dataclass(frozen=True)
class _Match:
    """``total`` uint16 [H, W, D], aggregated costs within ``span``; ``edges`` bool [H, W], where halves of the aperture
    were tested.
    """

    total: U16
    span: I16 | None
    noise: float
    edges: Mask


def _match_everywhere(task: _Task) -> _Match:
    cost = task.sweep()
    noise = noise_of_cost(cost, threads=task.threads)
    task.constrain(cost, task.grid, task.plain_areas(noise), noise)
    total = task.aggregate(cost, noise)
    best = summarise(total, threads=task.threads).best
    edges = task.steps(best * np.float32(task.grid.step))
    if not edges.any():
        return _Match(total, None, noise, edges)
    del total
    task.sweep(edges, out=cost)
    return _Match(task.aggregate(cost, noise), None, noise, edges)


def _match_after_search(task: _Task, skips: Skips, tally: Tally | None) -> _Match:
    settings, half, grid = task.settings, task.views.half, task.grid
    chosen = half.cross() if skips.views else half.others()
    coarse = coarse_costs(
        half, grid, settings.truncation_grey, settings.search, chosen=chosen, threads=task.threads,
        monitor=task.monitor,
    )  # fmt: skip
    areas = task.plain_areas(NOISE_PER_HALF * coarse.noise)
    if areas is not None:
        task.constrain(coarse.cost, coarse.grid, areas.halved(), coarse.noise)
    found = coarse_match(coarse, task.picture, task.matching, settings.search, threads=task.threads)
    shape = task.picture.shape[:2]
    span = found.span(grid, shape, settings.search)
    edges = _at_full_size(task.steps(found.disparity, scale=2), shape)
    start = time.process_time()
    cost = task.sweep(edges, span=span)
    if tally is not None:
        _count(tally, task, span, time.process_time() - start, coarse, len(chosen))
    noise = noise_of_cost(cost, span=span, edges=edges, threads=task.threads)
    task.constrain(cost, grid, areas, noise, span)
    return _Match(task.aggregate(cost, noise, span), span, noise, edges)


def _count(tally: Tally, task: _Task, span: I16 | None, cpu_s: float, coarse: CoarseCosts, compared: int) -> None:
    others = len(task.views.full.others())
    samples = float(task.views.full.height * task.views.full.width * task.grid.count * others)
    active = 1.0 if span is None else float((span[..., 1] - span[..., 0]).mean()) / task.grid.count
    tally.add("planes", samples * active, samples * (1 - active), "samples", cpu_s)
    tally.add("views", coarse.cost.size * compared, coarse.cost.size * (others - compared), "samples", coarse.cpu_s)


def _at_full_size(mask: Mask, shape: tuple[int, ...]) -> Mask:
    """A mask of half size at full size; an odd last row or column repeats its neighbour."""
    doubled = np.repeat(np.repeat(mask, 2, 0), 2, 1)
    missing = [(0, n - m) for n, m in zip(shape, doubled.shape, strict=True)]
    return np.pad(doubled, missing, mode="edge")


def disparity_steps(disparity: F32, settings: DpvSettings, *, scale: int = 1) -> Mask:
    """Pixels near a disparity step, bool [H, W].

    There a background pixel is hidden from the views of one side, and the mean over all views prefers the
    foreground's plane, which fattens edges; the best half of the aperture sees the pixel unhidden. Elsewhere halves
    only add noise (on weak texture they ruin the match), so the test is kept to these pixels. ``scale`` is by how much
    the map is smaller than the views.
    """
    import cv2

    slack = scale - 1  # a coarse map's steps are a pixel of its own less certain
    size = 2 * (round(settings.occlusion_radius / scale) + slack) + 1
    window = np.ones((size, size), np.uint8)
    spread = cv2.dilate(disparity, window) - cv2.erode(disparity, window)
    return np.asarray(spread > settings.occlusion_gap_px)


def plane_grid(disparity_range: tuple[float, float], settings: DpvSettings) -> PlaneGrid:
    """Planes that cover ``disparity_range`` at about ``plane_step_px``.

    Raises
    ------
    BadInput
        The range is empty, reversed or not finite.
    """
    lo, hi = map(float, disparity_range)
    if not (np.isfinite([lo, hi]).all() and lo < hi):
        raise BadInput(
            f"disparity range {lo:g}:{hi:g} is empty", field="disparity-range", remedy="give LO:HI with LO < HI"
        )
    count = int(np.clip(np.ceil((hi - lo) / settings.plane_step_px) + 1, settings.min_planes, settings.max_planes))
    return PlaneGrid(lo, (hi - lo) / (count - 1), count)


def auto_range(
    light_field: LightField,
    *,
    limit_px: float = LIMIT_PX,
    views: MatchingViews | None = None,
    skips: Skips = SKIP_ALL,
    threads: int = 0,
) -> tuple[float, float]:
    """The disparities that occur in a light field, found by a coarse sweep at half size.

    Pixels vote where the best plane is clearly better than the average; the range holds 99 % of the votes on
    each side and a margin.

    Returns
    -------
    (lo, hi) [px per view step]
    """
    refuse_constant(light_field)
    if views is None or views.limit_px < limit_px:
        views = matching_views(light_field, DEFAULT_DPV.clipped_blur_px, limit_px=limit_px, threads=threads)
    chosen = views.half.cross() if skips.views else views.half.others()
    found = found_range(views.half, limit_px, DEFAULT_DPV.truncation_grey, chosen=chosen, threads=threads)
    return found or (-limit_px / 4, limit_px / 4)


def refuse_constant(light_field: LightField) -> None:
    """Raise `BadInput` when no view has any structure (a lens cap, a uniform wall)."""
    import cv2

    if float(cv2.meanStdDev(light_field.centre_view)[1].max()) < NO_TEXTURE_GREY:
        raise BadInput(
            "the centre view is constant: nothing can be matched in it",
            path=light_field.id,
            field="views",
            code="constant-image",
            remedy="check the exposure and the lens cap, or leave this capture out",
        )
