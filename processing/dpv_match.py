"""Sweep and semi-global match of one light field: everywhere, or where a coarse search has left something to decide."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.progress import Monitor
from lfrig.processing.dpv_settings import DpvSettings
from lfrig.processing.kernels.plane_cost import Halves, PlaneGrid, plane_cost
from lfrig.processing.kernels.softmax import summarise
from lfrig.processing.matching_views import MatchingViews
from lfrig.processing.model import F32, U8
from lfrig.processing.noise_floor import NOISE_PER_HALF, noise_of_cost
from lfrig.processing.plain_areas import PlainAreas, blend_plain_cost, find_plain_areas
from lfrig.processing.plane_search import Matching, coarse_costs, coarse_match
from lfrig.processing.skipping import Skips, Tally

I16 = NDArray[np.int16]
I32 = NDArray[np.int32]
U16 = NDArray[np.uint16]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class MatchTask:
    """The centre view uint8 [H, W, 3], what it is compared with, and how."""

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

    def sweep(
        self,
        edges: Mask | None = None,
        *,
        chosen: I32 | None = None,
        span: I16 | None = None,
        out: U16 | None = None,
    ) -> U16:
        """Matching costs, with the half-aperture test at ``edges``."""
        tested = edges is not None and bool(edges.any())
        halves = Halves(edges, self.settings.occlusion_bias_grey) if edges is not None and tested else None
        return plane_cost(
            self.views.full, self.grid, self.settings.truncation_grey, chosen=chosen, span=span, halves=halves,
            out=out, threads=self.threads, monitor=self.monitor,
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

    def aggregate(self, cost: U16, noise: float) -> U16:
        """Semi-global matching at full size."""
        return self.matching.aggregate(cost, self.picture, noise, step_px=self.grid.step, threads=self.threads)


@dataclass(frozen=True)
class Match:
    """``cost`` uint16 [H, W, D], still to be aggregated, within ``span``; ``edges`` bool [H, W], where halves of the
    aperture were tested.
    """

    cost: U16
    span: I16 | None
    noise: float
    edges: Mask


def match_everywhere(task: MatchTask) -> Match:
    """Sweep all planes with all views, match, and test halves of the aperture where disparity steps."""
    cost = task.sweep()
    noise = noise_of_cost(cost, threads=task.threads)
    task.constrain(cost, task.grid, task.plain_areas(noise), noise)
    best = summarise(task.aggregate(cost, noise), threads=task.threads).best
    edges = task.steps(best * np.float32(task.grid.step))
    if edges.any():
        task.sweep(edges, out=cost)
    return Match(cost, None, noise, edges)


def match_after_search(task: MatchTask, skips: Skips, tally: Tally | None) -> Match:
    """Search at half size for planes, steps and noise; sweep and match once what that leaves."""
    settings, full, half, grid = task.settings, task.views.full, task.views.half, task.grid
    coarse = coarse_costs(
        half, grid, settings.truncation_grey, settings.search, chosen=half.cross() if skips.views else half.others(),
        threads=task.threads, monitor=task.monitor,
    )  # fmt: skip
    about_noise = NOISE_PER_HALF * coarse.noise
    chosen = full.star() if skips.views and about_noise <= settings.quiet_grey else full.others()
    areas = task.plain_areas(about_noise)
    if areas is not None:
        task.constrain(coarse.cost, coarse.grid, areas.halved(), coarse.noise)
    found = coarse_match(coarse, task.picture, task.matching, settings.search, threads=task.threads)
    shape = task.picture.shape[:2]
    span = found.span(grid, shape, settings.search)
    edges = _at_full_size(task.steps(found.disparity, scale=2), shape)
    start = time.process_time()
    cost = task.sweep(edges, chosen=chosen, span=span)
    if tally is not None:
        _count(tally, task, span, len(chosen), time.process_time() - start)
    noise = noise_of_cost(cost, span=span, edges=edges, threads=task.threads)
    task.constrain(cost, grid, areas, noise, span)
    return Match(cost, span, noise, edges)


def _count(tally: Tally, task: MatchTask, span: I16 | None, compared: int, cpu_s: float) -> None:
    """What the sweep did and left out: planes of the views that it compared, and views at its planes."""
    views = task.views.full
    planes = task.grid.count if span is None else float((span[..., 1] - span[..., 0]).mean())
    pixels = float(views.height * views.width)
    tally.add("planes", pixels * planes * compared, pixels * (task.grid.count - planes) * compared, "samples", cpu_s)
    left_out = len(views.padded) - 1 - compared
    tally.add("views", pixels * planes * compared, pixels * planes * left_out, "samples", cpu_s)


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
