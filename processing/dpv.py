"""Light field → disparity evidence (the DPV): how likely each disparity is at each pixel of the centre view.

A photo-consistency sweep over all views with truncated absolute differences, semi-global aggregation, and a softmax
whose temperature and penalties follow the measured noise. The paper reads the DPV from EPI slopes (after Chen et al.
2018); this sweep replaces it at the same module boundary.
"""

from __future__ import annotations

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.dpv_match import MatchTask, match_after_search, match_everywhere
from lfrig.processing.dpv_settings import DEFAULT_DPV as DEFAULT_DPV
from lfrig.processing.dpv_settings import DpvSettings as DpvSettings
from lfrig.processing.dpv_settings import plane_grid as plane_grid
from lfrig.processing.matching_views import LIMIT_PX, MatchingViews, matching_views
from lfrig.processing.model import Evidence, LightField
from lfrig.processing.plane_search import found_range
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally


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
        planes are swept everywhere, and steps are found in a match of their own. With both ``planes`` and ``views``,
        the search compares the cross of views only, and the sweep the star (rows, columns and diagonals through the
        centre) where noise does not ask for all.

    Returns
    -------
    Evidence
        On the grid of the centre view.

    Raises
    ------
    BadInput
        The views are constant: there is nothing to match.
    """
    grid = plane_grid(disparity_range, settings)
    if views is None or views.limit_px < grid.furthest:
        limit = max(LIMIT_PX, grid.furthest)
        views = matching_views(light_field, settings.clipped_blur_px, limit_px=limit, threads=threads)
    matching = settings.matching(grid.step)
    task = MatchTask(light_field.centre_view, views, grid, settings, matching, threads, monitor)
    match = match_after_search(task, skips, tally) if skips.planes else match_everywhere(task)
    probability, index, confidence = matching.probability(
        match.cost, light_field.centre_view, match.noise, settings.window, span=match.span, threads=threads
    )
    disparity = np.asarray(grid.first + grid.step * index, np.float32)
    used, tested = len(views.full.padded), float(match.edges.mean())
    return Evidence(probability, (grid.first, grid.step), disparity, confidence, match.noise, used, tested)


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
    if views is None or views.limit_px < limit_px:
        views = matching_views(light_field, DEFAULT_DPV.clipped_blur_px, limit_px=limit_px, threads=threads)
    chosen = views.half.cross() if skips.views else views.half.others()
    found = found_range(views.half, limit_px, DEFAULT_DPV.truncation_grey, chosen=chosen, threads=threads)
    return found or (-limit_px / 4, limit_px / 4)
