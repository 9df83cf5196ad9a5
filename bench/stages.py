"""The stage table: the pipeline from the paper's form to its full form, one step per row."""

from __future__ import annotations

from dataclasses import dataclass, replace

from lfrig.processing.options import Settings


@dataclass(frozen=True)
class Stage:
    """One row of the table: a key, what it says, and the settings of the whole pipeline at that step."""

    key: str
    title: str
    settings: Settings


def stage_table() -> tuple[Stage, ...]:
    """All steps in order, each with one thing changed."""
    shipped = Settings()
    continued = replace(shipped, refine=replace(shipped.refine, snap=False))
    refined = replace(continued, continuation=replace(shipped.continuation, enabled=False))
    tested = replace(refined, wide_baseline=replace(shipped.wide_baseline, enabled=False))
    regularised = replace(tested, edges=replace(shipped.edges, enabled=False))
    surface = replace(
        regularised,
        regularise=replace(regularised.regularise, method="none"),
        refine=replace(regularised.refine, smooth=False),
    )
    grey = replace(surface, fusion=replace(surface.fusion, colour=False))
    visible = replace(grey, fusion=replace(grey.fusion, first_surface=False))
    affine = replace(visible, fusion=replace(visible.fusion, pool="mean", visibility=False))
    paper = replace(
        affine,
        fusion=replace(affine.fusion, mapping="literal"),
        regularise=replace(affine.regularise, regression="soft-argmax"),
        scale_fit=replace(affine.scale_fit, form="paper"),
    )
    return (
        Stage("paper", "A: literal planes, mean fusion, full soft-argmax, fit in depth", paper),
        Stage("affine", "exact mapping, affine fit in inverse depth, windowed regression", affine),
        Stage("log-pool", "B: floored log-pool and visibility", visible),
        Stage("first-surface", "+ first-surface rule", grey),
        Stage("colour", "+ the photo's colours against the sources' in the fused volume", surface),
        Stage("sgm", "C: + SGM on the fused volume, plane fit", regularised),
        Stage("edges", "+ edge test in the photo's colours", tested),
        Stage("wide-baseline", "D: + narrow-band wide-baseline refinement", refined),
        Stage("continuation", "+ hidden areas continue the planes beside them", continued),
        Stage("snap", "preset fast: + snap to the photo's edges", shipped),
    )
