"""From light fields and poses to sources that can be fused: their evidence, and its scale."""

from __future__ import annotations

from collections.abc import Sequence

from lfrig.contracts.progress import Monitor
from lfrig.processing.dpv import auto_range, light_field_evidence, plane_grid
from lfrig.processing.matching_views import LIMIT_PX, matching_views
from lfrig.processing.model import Evidence, LightField, RigPrior, Source
from lfrig.processing.options import Settings
from lfrig.processing.poses import PoseSolution
from lfrig.processing.reuse import EvidenceStore, evidence_key
from lfrig.processing.scale_fit import fit_scale
from lfrig.processing.skipping import Tally


def find_evidence(
    light_fields: Sequence[LightField],
    prior: RigPrior,
    settings: Settings,
    *,
    store: EvidenceStore | None = None,
    threads: int = 0,
    monitor: Monitor,
    tally: Tally,
) -> list[Evidence]:
    """Evidence of every light field; what the store holds is not computed again (switch ``unchanged``)."""
    found = []
    with tally.timed("unchanged", "light fields") as count:
        for light_field in light_fields:
            expected = expected_range(light_field, prior)
            key = None
            if store is not None and settings.skips.unchanged:
                key = evidence_key(light_field, expected, settings.dpv, settings.skips)
            evidence = None if key is None or store is None else store.load(key)
            if evidence is None:
                count.done += 1
                evidence = _compute(light_field, expected, settings, threads, monitor, tally)
                if key is not None and store is not None:
                    store.save(key, evidence)
            else:
                count.skipped += 1
            found.append(evidence)
            monitor.advance()
    return found


def _compute(
    light_field: LightField,
    expected: tuple[float, float] | None,
    settings: Settings,
    threads: int,
    monitor: Monitor,
    tally: Tally,
) -> Evidence:
    knobs, skips = settings.dpv, settings.skips
    views = matching_views(light_field, knobs.clipped_blur_px, threads=threads)
    possible = expected or (-LIMIT_PX, LIMIT_PX)
    found = possible
    if skips.depth_range:
        occurring = auto_range(light_field, views=views, skips=skips, threads=threads)
        lo, hi = max(occurring[0], possible[0]), min(occurring[1], possible[1])
        found = (lo, hi) if hi - lo > 0.1 * (occurring[1] - occurring[0]) else occurring
    with tally.timed("depth_range", "planes") as count:
        count.done = plane_grid(found, knobs).count
        count.skipped = max(0, plane_grid(possible, knobs).count - count.done)
        return light_field_evidence(
            light_field, found, knobs, views=views, skips=skips, tally=tally, threads=threads, monitor=monitor
        )


def expected_range(light_field: LightField, prior: RigPrior) -> tuple[float, float] | None:
    """Disparities [px per view step] that the recorded optics and depth range allow, with room for their errors."""
    depth = light_field.depth_range_m or prior.depth_range_m
    optics, camera = light_field.optics, light_field.camera
    if depth is None or camera is None or optics.baseline_m is None or optics.focus_distance_m is None:
        return None
    scale = optics.baseline_m * camera.focal_px
    lo, hi = (scale * (1 / z - 1 / optics.focus_distance_m) for z in (depth[1], depth[0]))
    slack = 0.15 * (hi - lo) + 0.1 * scale / optics.focus_distance_m
    return lo - slack, hi + slack


def fit_sources(
    light_fields: Sequence[LightField],
    evidence: Sequence[Evidence],
    solution: PoseSolution,
    settings: Settings,
    monitor: Monitor,
) -> list[Source]:
    """Sources with their poses and fitted scales.

    Raises
    ------
    GeometryRefused
        A scale cannot be trusted (see `fit_scale`).
    """
    ready = []
    for light_field, e, camera, pose, anchors in zip(
        light_fields, evidence, solution.cameras, solution.poses, solution.anchors, strict=True
    ):
        scale = fit_scale(light_field, camera, anchors, e, settings.scale_fit, monitor, metric=solution.metric)
        ready.append(Source(light_field, camera, pose, e, scale))
        monitor.advance()
    return ready


def metric_depth_range(
    light_fields: Sequence[LightField], prior: RigPrior, solution: PoseSolution
) -> tuple[float, float] | None:
    """The rig's depth range [m], only when the result is metric."""
    if not solution.metric:
        return None
    if prior.depth_range_m is not None:
        return prior.depth_range_m
    own = [lf.depth_range_m for lf in light_fields if lf.depth_range_m is not None]
    return (min(r[0] for r in own), max(r[1] for r in own)) if len(own) == len(light_fields) else None
