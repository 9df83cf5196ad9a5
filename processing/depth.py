"""Disparity and confidence of one light field alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.dpv import DEFAULT_DPV, DpvSettings, auto_range, light_field_evidence
from lfrig.processing.matching_views import matching_views
from lfrig.processing.model import F32, Evidence, LightField
from lfrig.processing.refine import DEFAULT_REFINE, RefineSettings, smooth, snap_to_edges
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally
from lfrig.processing.threads import opencv_threads


@dataclass(frozen=True)
class DepthMap:
    """``disparity`` float32 [H, W] px per view step and ``confidence`` float32 [H, W] on the centre view.

    The disparity of ``evidence`` is that before local planes were fitted and edges were snapped to the picture's.
    """

    disparity: F32
    confidence: F32
    evidence: Evidence
    disparity_range: tuple[float, float]


def estimate_disparity(
    light_field: LightField,
    disparity_range: tuple[float, float] | None = None,
    settings: DpvSettings = DEFAULT_DPV,
    *,
    refine: RefineSettings = DEFAULT_REFINE,
    skips: Skips = SKIP_ALL,
    tally: Tally | None = None,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> DepthMap:
    """Disparity of a light field's centre view, refined as the pipeline refines its surface.

    ``disparity_range`` (lo, hi) in px per view step; None finds it (`dpv.auto_range`).

    Raises
    ------
    BadInput
        Constant views, or an empty range.
    """
    monitor = monitor or Monitor()
    with opencv_threads(threads), monitor.task("disparity", 3):
        views = matching_views(light_field, settings.clipped_blur_px, threads=threads)
        found = disparity_range or auto_range(light_field, views=views, skips=skips, threads=threads)
        monitor.advance()
        evidence = light_field_evidence(
            light_field, found, settings, views=views, skips=skips, tally=tally, threads=threads, monitor=monitor
        )
        monitor.advance()
        disparity, picture = evidence.disparity, np.ascontiguousarray(light_field.centre_view)
        if refine.smooth:
            disparity = smooth(disparity, evidence.confidence, picture, 1.0, refine, threads=threads).value
        if refine.snap:
            disparity = snap_to_edges(disparity, picture, 1.0, refine, skips=skips, tally=tally, threads=threads)
        monitor.advance()
    return DepthMap(disparity, evidence.confidence, evidence, found)
