"""The parts of a result's page that tell of the result itself: summary, maps, EPIs, cameras, cost, warnings."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lfrig.contracts.result import ReportDocument
from lfrig.processing.export.png import to_8_bit
from lfrig.processing.model import F32, Image
from lfrig.processing.report import charts, overview, pictures, slices, words
from lfrig.processing.report.html import Html, el, figure, section, table

if TYPE_CHECKING:
    from lfrig.processing.pipeline import ProcessResult

EPI_LINE_PX = 9
"""Height of one view's line in an EPI picture [px]."""


def header(result: ProcessResult, report: ReportDocument) -> Html:
    """What was made, of what, and how well known it is, in words and in a few numbers."""
    target = report.target
    name = f"{report.session} · {target.id}" if report.session else target.id
    return el(
        "header",
        el("p", "lfrig · synthesized light field", class_="eyebrow"),
        el("h1", name),
        el("p", summary(result, report), class_="summary"),
        tiles(_key_figures(result, report)),
        _warnings(report),
    )


def summary(result: ProcessResult, report: ReportDocument) -> str:
    """Three sentences: what it is, where it came from, what it cost."""
    target, metric = report.target, report.target.metric
    sources = len(result.sources)
    angles = _angles(result)
    made = (
        f"The photo {target.id} ({target.width} × {target.height}) was raised into a light field of "
        f"{target.rows} × {target.cols} views, {words.length(target.baseline_m, metric=metric)} apart and focused at "
        f"{words.length(target.focus_distance_m, metric=metric)}."
    )
    came = f"Its geometry comes from {words.count(sources, 'light field')}{angles}; {words.poses(report.poses)}."
    wall, cpu = sum(s.wall_s for s in report.stages), sum(s.cpu_s for s in report.stages)
    core = "native core" if report.native else "NumPy only"
    cost = f"Preset “{report.preset}” took {words.seconds(wall)} ({words.seconds(cpu)} CPU, {core})."
    scale = "" if metric else " Nothing gave the metric scale: lengths are in gauge units."
    return f"{made} {came} {cost}{scale}"


def tiles(figures: list[tuple[str, str]]) -> Html:
    """A row of numbers with their names."""
    return el("dl", *(el("div", el("dt", name), el("dd", value)) for name, value in figures), class_="tiles")


def maps(result: ProcessResult, report: ReportDocument) -> Html:
    """The photo beside disparity, confidence and uncertainty."""
    light_field, surface = result.light_field, result.light_field.surface
    scale = pictures.robust_scale(light_field.disparity)
    to_px = light_field.request.baseline_m * light_field.camera.focal_px
    sigma = np.asarray(surface.sigma * to_px, np.float32)
    sigma_scale = pictures.Scale(0.0, max(1e-3, pictures.robust_scale(sigma, tail_percent=2).high), "magma")
    unit = "m" if report.target.metric else "gauge units"

    def depth(disparity: float) -> float:
        inverse = disparity / to_px + 1 / light_field.request.focus_distance_m
        return 1 / inverse if inverse > 0 else float("inf")

    photo = pictures.photograph(result.target.image8)
    return section(
        "The photo and its geometry",
        el(
            "div",
            figure(photo.element("the target photo"), "The photo: the light field's centre view, bit for bit."),
            figure(
                pictures.coloured(light_field.disparity, scale).element("disparity map of the photo", "map"),
                "Disparity of the synthesized light field, px per view step, and the distance that it stands for.",
                charts.colour_bar(scale, "px", depth, unit),
            ),
            figure(
                pictures.coloured(surface.confidence, pictures.Scale(0, 1, "cividis")).element("confidence map", "map"),
                "Confidence: the probability that the disparity is right within 0.1 px.",
                charts.colour_bar(pictures.Scale(0, 1, "cividis")),
            ),
            figure(
                pictures.coloured(sigma, sigma_scale).element("map of the expected error", "map"),
                "Expected error of the disparity: two thirds of such pixels are closer; dark is good.",
                charts.colour_bar(sigma_scale, "px"),
            ),
            class_="pair",
        ),
        id="geometry",
        lead="What the camera saw, how far away it is, and how sure that is. Chequered pixels are unknown.",
    )


def epis(views: Image, disparity: F32, confidence: F32) -> Html:
    """The centre view with the EPI of a lively row below and that of a lively column beside it."""
    row, column = slices.lively_row(disparity, confidence), slices.lively_column(disparity, confidence)
    height, width = disparity.shape
    views8 = to_8_bit(views)
    centre = pictures.photograph(views8[(views.shape[0] - 1) // 2, (views.shape[1] - 1) // 2])
    across = pictures.strip(slices.horizontal_epi(views8, row), EPI_LINE_PX, axis=0)
    down = pictures.strip(slices.vertical_epi(views8, column), EPI_LINE_PX, axis=1)
    cross = el(
        "svg",
        el("line", x1=0, x2=width, y1=row, y2=row), el("line", x1=column, x2=column, y1=0, y2=height),
        viewBox=f"0 0 {width} {height}", preserveAspectRatio="none", aria_hidden="true",
    )  # fmt: skip
    return section(
        "Epipolar images",
        el(
            "div",
            el("div", centre.element("centre view with the two lines that the EPIs are taken along"), cross),
            down.element(f"vertical EPI of column {column}: one column of pixels per row of views", "down"),
            across.element(f"horizontal EPI of row {row}: one row of pixels per column of views", "across"),
            class_="epi",
        ),
        id="epi",
        lead="One line of pixels from each view, one under the other. Upright lines lie in the focal plane, nearer "
        f"points lean to the left, farther ones to the right. Row {row} below, column {column} beside.",
    )


def cameras(result: ProcessResult) -> Html:
    """Plan and side elevation of where everything stood."""
    light_field = result.light_field
    standpoints = [overview.Standpoint(s.source.light_field.id, s.source.camera, s.source.pose) for s in result.sources]
    target = overview.Standpoint(result.target.id, result.target_camera, result.target_pose, target=True)
    cloud = overview.point_cloud(
        result.target_camera, result.target_pose, light_field.surface.inverse_depth,
        light_field.surface.confidence, result.target.image8,
    )  # fmt: skip
    return section(
        "Where the cameras stood",
        overview.overview([*standpoints, target], cloud, metric=result.metric),
        id="cameras",
        lead="The plate's frame: as the object turns, a camera that stands still goes round it. "
        "Points: the surface that the target sees.",
    )


def cost(report: ReportDocument) -> Html:
    """What each stage took, what it did and what it could leave out."""
    worked = [stage for stage in report.stages if stage.work_done or stage.work_skipped]
    rows: list[list[str | Html]] = []
    for stage in worked:
        total = stage.work_done + stage.work_skipped
        skipped = words.percent(stage.work_skipped / total) if stage.work_skipped else "nothing"
        rows.append([stage.name, f"{stage.work_done:,.0f} {stage.unit}", f"{stage.work_skipped:,.0f}", skipped])
    threads = words.count(report.threads, "thread") if report.threads else "all cores"
    return section(
        "What it cost",
        el("p", el("span", "wall", class_="key wall"), el("span", "CPU of the whole process", class_="key cpu")),
        charts.stage_chart(report.stages),
        table(["stage", "work done", "left out", "share"], rows, "Work done and work left out") if rows else None,
        id="cost",
        lead=f"With {threads}; memory is the peak of the process up to the end of the stage.",
    )


def details(report: ReportDocument) -> Html:
    """Version and options, folded away."""
    pairs = {"version": report.version, "backend": report.backend, "poses": report.poses, **report.options}
    rows: list[list[str | Html]] = [[key, str(value)] for key, value in pairs.items()]
    return el("details", el("summary", "Version and options"), table(["option", "value"], rows))


def _key_figures(result: ProcessResult, report: ReportDocument) -> list[tuple[str, str]]:
    surface, metric = result.light_field.surface, report.target.metric
    known = np.isfinite(surface.inverse_depth) & (surface.inverse_depth > 0)
    figures = [("known", words.percent(float(np.isfinite(surface.inverse_depth).mean()), 1))]
    if known.any():
        far, near = 1 / np.percentile(surface.inverse_depth[known], [1, 99])
        unit = "m" if metric else "units"
        figures += [
            ("seen by a source", words.percent(float((surface.seen > 0).mean()), 1)),
            ("median confidence", words.fixed(float(np.median(surface.confidence[known])), 2)),
            ("distance", f"{words.number(float(near), 2)} – {words.number(float(far), 2)} {unit}"),
        ]
    bf = report.target.baseline_m * report.target.fx
    figures += [("b · F", f"{words.number(bf)} px·m"), ("peak memory", words.memory(_peak(report)))]
    return figures


def _peak(report: ReportDocument) -> float:
    return max([stage.peak_rss_mb for stage in report.stages], default=0.0)


def _angles(result: ProcessResult) -> str:
    """How far the sources' viewing directions are from the target's."""
    ahead = result.target_pose.direction
    cosines = [float(np.clip(s.source.pose.direction @ ahead, -1, 1)) for s in result.sources]
    degrees = sorted(float(np.degrees(np.arccos(c))) for c in cosines)
    if not degrees:
        return ""
    if round(degrees[0]) == round(degrees[-1]):
        return f", {degrees[0]:.0f}° away"
    return f", {degrees[0]:.0f}° to {degrees[-1]:.0f}° away"


def _warnings(report: ReportDocument) -> Html:
    if not report.warnings:
        return el("p", "No warnings.", class_="calm")
    items = (el("li", warning.message[:1].upper() + warning.message[1:], " ", el("code", warning.code))
             for warning in report.warnings)  # fmt: skip
    title = "One warning" if len(report.warnings) == 1 else f"{len(report.warnings)} warnings"
    return el("aside", el("h2", title), el("ul", *items), class_="warnings", aria_label="warnings")
