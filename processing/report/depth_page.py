"""What `lfrig depth` leaves behind: the arrays, previews of them, and a small page."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lfrig.contracts.files import atomic_write_text, disk_errors
from lfrig.processing.export.pfm import write_pfm
from lfrig.processing.export.png import write_png
from lfrig.processing.model import F32, U8, LightField
from lfrig.processing.report import charts, pictures, sections, slices, words
from lfrig.processing.report.html import Html, el, figure, page, section
from lfrig.processing.report.sources import volume
from lfrig.processing.report.viewer import viewer

if TYPE_CHECKING:
    from lfrig.processing.depth import DepthMap

CONFIDENCE = pictures.Scale(0.0, 1.0, "cividis")


def write_depth_result(folder: Path, light_field: LightField, depth_map: DepthMap) -> None:
    """Write disparity.pfm, confidence.npy, the previews disparity.png, confidence.png and centre.png, and report.html.

    The caller makes the whole atomic (`lfrig.contracts.files.atomic_folder`).

    Raises
    ------
    DiskError
        Writing failed.
    """
    disparity, confidence = depth_map.disparity, depth_map.confidence
    scale = pictures.robust_scale(disparity)
    write_pfm(folder / "disparity.pfm", disparity)
    stream = io.BytesIO()
    np.save(stream, np.ascontiguousarray(confidence, np.float32), allow_pickle=False)
    with disk_errors(folder):
        (folder / "confidence.npy").write_bytes(stream.getvalue())
    write_png(folder / "disparity.png", preview(disparity, scale))
    write_png(folder / "confidence.png", preview(confidence, CONFIDENCE))
    write_png(folder / "centre.png", light_field.centre_view)
    atomic_write_text(folder / "report.html", _page(light_field, depth_map, scale))


def preview(values: F32, scale: pictures.Scale) -> U8:
    """A map, float32 [H, W], in the colours of ``scale``: uint8 [H, W, 3], unknown pixels black."""
    known = np.isfinite(values)
    unit = (np.where(known, values, scale.low) - scale.low) / (scale.high - scale.low)
    colours = pictures.lookup_table(scale.name)[np.rint(np.clip(unit, 0, 1) * 255).astype(np.uint8)]
    return np.where(known[..., None], colours, 0).astype(np.uint8)


def _page(light_field: LightField, depth_map: DepthMap, scale: pictures.Scale) -> str:
    disparity, confidence, evidence = depth_map.disparity, depth_map.confidence, depth_map.evidence
    optics, camera = light_field.optics, light_field.camera
    bf = optics.baseline_m * camera.focal_px if optics.baseline_m and camera else None
    focus = optics.focus_distance_m
    row = slices.lively_row(disparity, confidence)
    return page(
        f"{light_field.id} · lfrig depth",
        el(
            "main",
            _header(light_field, depth_map),
            section(
                "The light field",
                viewer(light_field.views, disparity, bf_px_m=bf, focus_distance_m=focus),
                id="light-field-section",
            ),
            section("Disparity", _maps(disparity, confidence, scale, bf, focus), id="geometry",
                    lead="Of the centre view, px per view step; positive is nearer than the focal plane."),
            section("Disparity probability volume", volume(evidence, row), id="volume",
                    lead="How likely each disparity is, plane by plane, and along the row that shows most."),
            sections.epis(light_field.views, disparity, confidence),
        ),
    )  # fmt: skip


def _header(light_field: LightField, depth_map: DepthMap) -> Html:
    rows, cols = light_field.angular
    disparity, confidence, evidence = depth_map.disparity, depth_map.confidence, depth_map.evidence
    known = np.isfinite(disparity)
    low, high = np.percentile(disparity[known], [1, 99]) if known.any() else (np.nan, np.nan)
    figures = [
        ("views", f"{rows} × {cols}"),
        ("size", f"{light_field.width} × {light_field.height}"),
        ("disparity", f"{words.fixed(float(low), 2)} … {words.fixed(float(high), 2)} px"),
        ("median confidence", words.fixed(float(np.median(confidence[known])) if known.any() else None, 2)),
        ("planes", str(evidence.planes)),
        ("noise", f"{words.number(evidence.noise_sigma, 2)} of 255"),
    ]
    return el(
        "header",
        el("p", "lfrig · disparity of one light field", class_="eyebrow"),
        el("h1", light_field.id),
        el(
            "p",
            "How far a point moves from one view to the next is its disparity: the nearer, the more. Found from "
            f"{evidence.views_used or rows * cols} views of this light field alone.",
            class_="summary",
        ),
        sections.tiles(figures),
    )


def _maps(disparity: F32, confidence: F32, scale: pictures.Scale, bf: float | None, focus: float | None) -> Html:
    def depth(value: float) -> float:
        inverse = value / bf + 1 / focus if bf and focus else 0.0
        return 1 / inverse if inverse > 0 else float("inf")

    metres = depth if bf and focus else None
    return el(
        "div",
        figure(
            pictures.coloured(disparity, scale).element("disparity map", "map"),
            "Disparity.",
            charts.colour_bar(scale, "px", metres, "m" if metres else ""),
        ),
        figure(
            pictures.coloured(confidence, CONFIDENCE).element("confidence map", "map"),
            "Confidence: the probability mass at the peak.",
            charts.colour_bar(CONFIDENCE),
        ),
        class_="pair",
    )
