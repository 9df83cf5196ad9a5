"""The part of a result's page that shows each source: what it saw, what it concluded, and how well its scale fits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lfrig.processing.model import Evidence
from lfrig.processing.report import charts, pictures, slices, words
from lfrig.processing.report.html import Html, el, figure, section

if TYPE_CHECKING:
    from lfrig.processing.pipeline import ProcessResult, SourceResult

THUMB_PX = 320
SLICE_PX = 180
SLICES = 5
ANCHOR_DOTS = 250


def sources(result: ProcessResult) -> Html:
    """One card per source."""
    metric = result.metric
    return section(
        "The sources",
        *(card(source, metric=metric) for source in result.sources),
        id="sources",
        lead="Each light field alone: its centre view with the anchors that tie it to the others, the disparity it "
        "sees, and slices through its disparity probability volume.",
    )


def card(source: SourceResult, *, metric: bool) -> Html:
    """Pictures and numbers of one source."""
    light_field, evidence = source.source.light_field, source.source.evidence
    scale = pictures.robust_scale(evidence.disparity)
    height = evidence.disparity.shape[0]
    row = slices.lively_row(evidence.disparity, evidence.confidence)
    view_row = slices.matched_row(light_field.height, height, row)
    angle = f" · plate at {words.number(light_field.turntable_deg)}°" if light_field.turntable_deg is not None else ""
    fit = source.source.scale
    return el(
        "article",
        el("h3", light_field.id, el("small", angle) if angle else None),
        el(
            "div",
            figure(_centre_view(source, view_row), f"Centre view; {words.count(len(source.anchors), 'anchor')}."),
            figure(
                pictures.coloured(evidence.disparity, scale, THUMB_PX).element(f"disparity of {light_field.id}", "map"),
                None,
                charts.colour_bar(
                    scale,
                    "px",
                    lambda disparity: _depth(fit.a * disparity + fit.c),
                    "m" if metric else "units",
                ),
            ),
            _numbers(source, metric=metric),
            class_="trio",
        ),
        volume(evidence, row),
        class_="card",
    )


def volume(evidence: Evidence, row: int) -> Html:
    """A few planes of the probability volume, and its x–δ slice along ``row``."""
    first, step = evidence.planes_px
    planes = slices.telling_planes(evidence, SLICES)
    stack = [slices.plane(evidence, index) for index in planes]
    top = float(np.percentile(np.stack(stack)[:, ::2, ::2], 99.5)) if stack else 1.0
    scale = pictures.Scale(0.0, max(top, 1e-3), "inferno")
    figures = [
        figure(
            pictures.coloured(image, scale, SLICE_PX).element(f"probability of δ = {first + index * step:.2f} px"),
            f"δ = {words.fixed(first + index * step, 2)} px",
        )
        for index, image in zip(planes, stack, strict=True)
    ]
    across = slices.along_row(evidence, row)
    sheet = pictures.coloured(across, pictures.Scale(0.0, _peak(across), "inferno"))
    last = first + (evidence.planes - 1) * step
    return el(
        "div",
        el("div", *figures, class_="planes"),
        figure(
            sheet.element("probability over x and disparity along one row", "slice"),
            f"x–δ slice of row {row}: δ from {words.fixed(first, 2)} px (bottom) to {words.fixed(last, 2)} px (top).",
        ),
        class_="volume",
    )


def _centre_view(source: SourceResult, row: int) -> Html:
    light_field = source.source.light_field
    picture = pictures.photograph(light_field.centre_view, THUMB_PX)
    every = max(1, -(-len(source.anchors) // ANCHOR_DOTS))
    radius = light_field.width / 180
    dots = [
        el("circle", cx=round(float(x), 1), cy=round(float(y), 1), r=round(radius, 2))
        for x, y in source.anchors.xy[::every]
    ]
    marks = el(
        "svg",
        el("line", x1=0, x2=light_field.width, y1=row, y2=row),
        *dots,
        viewBox=f"0 0 {light_field.width} {light_field.height}",
        preserveAspectRatio="none",
        aria_hidden="true",
    )
    return el("div", picture.element(f"centre view of {light_field.id}"), marks, class_="marked")


def _numbers(source: SourceResult, *, metric: bool) -> Html:
    fit, evidence, light_field = source.source.scale, source.source.evidence, source.source.light_field
    rows, cols = light_field.angular
    pairs = [
        ("scale fit", "1/z = a·δ + c" if fit.form == "affine" else fit.form),
        ("a", f"{words.number(fit.a)} 1/(px·{'m' if metric else 'unit'})"),
        ("c", f"{words.number(fit.c)} 1/{'m' if metric else 'unit'}"),
        ("b · F = 1/a", f"{words.number(1 / fit.a)} px·{'m' if metric else 'unit'}" if fit.a else "–"),
        ("focus 1/c", words.length(1 / fit.c, metric=metric) if fit.c > 0 else "beyond infinity"),
        ("residual", f"{words.number(abs(fit.residual / fit.a), 2)} px" if fit.a else "–"),
        ("inliers", f"{words.percent(fit.inliers)} of {fit.anchors} anchors"),
        ("angle off the prior", "–" if source.angle_residual_deg is None
         else f"{words.fixed(source.angle_residual_deg, 2)}°"),
        ("views", f"{rows} × {cols}, {light_field.width} × {light_field.height} px"),
        ("planes", f"{evidence.planes}, {words.number(evidence.planes_px[1], 2)} px apart"),
        ("noise", f"{words.number(evidence.noise_sigma, 2)} of 255"),
    ]  # fmt: skip
    return el("dl", *(el("div", el("dt", name), el("dd", value)) for name, value in pairs), class_="numbers")


def _depth(inverse_depth: float) -> float:
    return 1 / inverse_depth if inverse_depth > 0 else float("inf")


def _peak(values: np.ndarray) -> float:
    return max(1e-3, float(np.percentile(values, 99.5)))
