"""The section of a report that scoring fills in later: error map, error curve, tables with both oracles."""

from __future__ import annotations

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.contracts.score import DisparityScore, LightFieldScore, ScoreDocument
from lfrig.processing.model import F32
from lfrig.processing.report import charts, pictures, words
from lfrig.processing.report.html import Html, comment, el, figure, join, section, table

BEGIN, END = comment("score: begin"), comment("score: end")
ERROR_SCALE_PX = 0.15
_CLASSES = {"all": "all pixels", "edge": "at depth edges", "textureless": "without texture",
            "aligned": "all, linearly aligned"}  # fmt: skip
_ORACLES = {"z_buffer": "exact geometry, z-buffered", "fixed_point": "exact geometry, fixed point"}


def placeholder() -> Html:
    """Where the section will go."""
    return join(BEGIN, END)


def insert(page: str, content: Html, path: str) -> str:
    """``page`` with ``content`` in the place of whatever score it held.

    Raises
    ------
    BadInput
        The page has no such place.
    """
    before, found, rest = page.partition(BEGIN)
    _, closed, after = rest.partition(END)
    if not (found and closed):
        raise BadInput("has no place for a score", path=path, code="no-score-place", remedy="process again")
    return f"{before}{BEGIN}{content}{END}{after}"


def score_section(score: ScoreDocument, error_px: F32) -> Html:
    """The section.

    Parameters
    ----------
    score : ScoreDocument
    error_px : float32 [H, W]
        Signed error of the disparity, px per view step (estimate − truth); NaN = unknown.
    """
    known = error_px[np.isfinite(error_px)]
    return section(
        "Against the truth",
        el("p", _verdict(score), class_="summary"),
        el(
            "div",
            figure(
                pictures.coloured(error_px, _error_scale()).element("map of the disparity error", "map"),
                "Error of the disparity: red lies too near, blue too far, chequered is unknown.",
                charts.colour_bar(_error_scale(), "px"),
            ),
            figure(charts.error_curve(error_px), "How many pixels are right within how much.") if known.size else None,
            class_="pair",
        ),
        _disparity_table(score),
        _views_table(score),
        el("ul", *(el("li", note) for note in score.notes), class_="notes") if score.notes else None,
        id="score",
        lead=f"A border of {score.border_px} px is left out of the numbers. px are those of a light field with "
        f"b · F = {words.number(score.bf_px_m)} px·m focused at {words.number(score.focus_distance_m)} m.",
    )


def _error_scale() -> pictures.Scale:
    return pictures.Scale(-ERROR_SCALE_PX, ERROR_SCALE_PX, "balance")


def _verdict(score: ScoreDocument) -> str:
    sentences: list[str] = []
    overall = score.disparity.get("all")
    if overall:
        sentences.append(
            f"{words.fixed(overall.ppe_010, 1)} % of the disparities are right within 0.1 px and "
            f"{words.fixed(overall.ppe_005, 1)} % within 0.05 px; the mean squared error is "
            f"{words.number(overall.mse)} px² (RMSE {words.percent(overall.rmse_over_range, 1)} of the true range)."
        )
    if score.views:
        sentences.append(f"The views reach {words.fixed(score.views.psnr, 1)} dB.")
    if score.psnr_below_z_buffer_db is not None:
        gap = score.psnr_below_z_buffer_db
        place = "below" if gap >= 0 else "above"
        sentences.append(f"That is {words.fixed(abs(gap), 2)} dB {place} what exact geometry would give.")
    return " ".join(sentences)


def _disparity_table(score: ScoreDocument) -> Html | None:
    if not score.disparity:
        return None
    head = ["disparity", "MSE px²", "RMSE px", "< 0.05 px", "< 0.1 px", "> 0.07 px", "> 0.03 px", "> 0.01 px", "Q25 px",
            "unknown", "pixels"]  # fmt: skip
    return table(head, [_disparity_row(name, value) for name, value in score.disparity.items()])


def _disparity_row(name: str, score: DisparityScore) -> list[str | Html]:
    shares = (score.ppe_005, score.ppe_010, score.badpix_007, score.badpix_003, score.badpix_001)
    return [
        _CLASSES.get(name, name), words.number(score.mse), words.number(score.rmse),
        *(f"{words.fixed(share, 1)} %" for share in shares),
        words.number(score.q25, 2), f"{score.unknown:,}", f"{score.pixels:,}",
    ]  # fmt: skip


def _views_table(score: ScoreDocument) -> Html | None:
    named: list[tuple[str, LightFieldScore | None]] = [("this result", score.views)]
    named += [(_ORACLES.get(name, name), oracle) for name, oracle in score.oracles.items()]
    named += [("this result, noise-free", score.views_clean)]
    rows: list[list[str | Html]] = [
        [
            name, f"{words.fixed(s.psnr, 2)} dB", words.fixed(s.ssim, 4), f"{words.fixed(s.psnr_corners, 2)} dB",
            words.fixed(s.ssim_corners, 4), f"{words.fixed(s.psnr_with_centre, 2)} dB",
            words.fixed(s.ssim_with_centre, 4), words.number(s.epi_mae),
        ]
        for name, s in named
        if s is not None
    ]  # fmt: skip
    head = ["views", "PSNR", "SSIM", "corners", "corners SSIM", "with centre", "with centre SSIM", "EPI error"]
    return table(head, rows) if rows else None
