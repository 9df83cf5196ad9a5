"""Two results side by side: what differs in how they were made, what they cost, how good they are, what they say."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.contracts.result import ReportDocument
from lfrig.contracts.score import ScoreDocument
from lfrig.processing.export.result import LoadedResult, load_result
from lfrig.processing.model import F32

SAME_REQUEST = 1e-9
"""Relative difference of baseline and focus below which two disparities are in the same unit."""


@dataclass(frozen=True)
class MapDifference:
    """How far two maps lie apart, over the pixels known in both; ``only_one`` counts those known in one alone."""

    unit: str
    pixels: int
    only_one: int
    mean: float
    median: float
    p95: float
    max: float


@dataclass(frozen=True)
class Comparison:
    """What `compare_results` found; ``rows`` hold (what, value of the first, value of the second)."""

    first: Path
    second: Path
    parameters: list[tuple[str, Any, Any]]
    costs: list[tuple[str, Any, Any]]
    scores: list[tuple[str, Any, Any]]
    disparity: MapDifference | None
    inverse_depth: MapDifference | None
    views_identical: bool
    note: str = ""

    def as_document(self) -> dict[str, Any]:
        """For --json."""
        rows = {
            name: [{"name": row[0], "first": row[1], "second": row[2]} for row in getattr(self, name)]
            for name in ("parameters", "costs", "scores")
        }
        return {
            "first": self.first, "second": self.second, **rows,
            "disparity": asdict(self.disparity) if self.disparity else None,
            "inverse_depth": asdict(self.inverse_depth) if self.inverse_depth else None,
            "views_identical": self.views_identical, "note": self.note,
        }  # fmt: skip


def compare_results(first: Path, second: Path) -> Comparison:
    """Compare two result folders.

    Disparities are compared as they are when both were requested with the same optics; otherwise the second one is
    expressed in the first one's, which needs nothing but its inverse depth.

    Raises
    ------
    BadInput
        One of the folders is no result.
    """
    a, b = load_result(first), load_result(second)
    disparity = inverse_depth = None
    notes = []
    if a.disparity.shape != b.disparity.shape:
        notes.append("the sizes differ: the maps are not compared")
    else:
        other = b.disparity
        if not _same_request(a, b):
            other = a.request.disparity(b.inverse_depth, a.report.target.fx)
            notes.append("the requests differ: the second disparity is expressed in the first one's optics")
        disparity = map_difference(a.disparity, other, "px")
        inverse_depth = map_difference(a.inverse_depth, b.inverse_depth, "1/m")
    return Comparison(
        first, second,
        parameters=_rows(_parameters(a.report), _parameters(b.report)),
        costs=_rows(_costs(a.report), _costs(b.report)),
        scores=_rows(_scores(first), _scores(second)),
        disparity=disparity, inverse_depth=inverse_depth, views_identical=_same_views(a, b), note="; ".join(notes),
    )  # fmt: skip


def map_difference(first: F32, second: F32, unit: str) -> MapDifference:
    """Absolute differences of two float32 [H, W] maps of one shape; NaN = unknown."""
    known_first, known_second = np.isfinite(first), np.isfinite(second)
    both = known_first & known_second
    gap = np.abs(first[both].astype(np.float64) - second[both])
    if gap.size == 0:
        gap = np.full(1, np.nan)
    median, p95 = np.percentile(gap, (50, 95))
    return MapDifference(
        unit, int(both.sum()), int((known_first ^ known_second).sum()),
        float(gap.mean()), float(median), float(p95), float(gap.max()),
    )  # fmt: skip


def _same_request(a: LoadedResult, b: LoadedResult) -> bool:
    first, second = a.request, b.request
    pairs = (
        (first.baseline_m * a.report.target.fx, second.baseline_m * b.report.target.fx),
        (first.focus_distance_m, second.focus_distance_m),
    )
    return all(abs(x - y) <= SAME_REQUEST * abs(x) for x, y in pairs)


def _same_views(a: LoadedResult, b: LoadedResult) -> bool:
    return a.views.dtype == b.views.dtype and np.array_equal(a.views, b.views)


def _parameters(report: ReportDocument) -> dict[str, Any]:
    target = report.target
    return {
        "session": report.session, "target": target.id, "sources": ", ".join(s.id for s in report.sources),
        "preset": report.preset, "backend": report.backend, "native core": report.native,
        "version": report.version, "poses": report.poses, "size [px]": f"{target.width}×{target.height}",
        "views": f"{target.rows}×{target.cols}", "fx [px]": target.fx, "baseline [m]": target.baseline_m,
        "b·F [px·m]": target.baseline_m * target.fx, "focus [m]": target.focus_distance_m,
        "metric": target.metric, **{f"option {name}": value for name, value in report.options.items()},
        "warnings": ", ".join(warning.code for warning in report.warnings),
    }  # fmt: skip


def _costs(report: ReportDocument) -> dict[str, Any]:
    total = {
        "wall [s]": sum(stage.wall_s for stage in report.stages),
        "CPU [s]": sum(stage.cpu_s for stage in report.stages),
        "peak RSS [MB]": max((stage.peak_rss_mb for stage in report.stages), default=0.0),
    }
    return total | {f"{stage.name}, CPU [s]": stage.cpu_s for stage in report.stages}


def _scores(folder: Path) -> dict[str, Any]:
    path = folder / "score.json"
    if not path.is_file():
        return {}
    score = ScoreDocument.load(path)
    found: dict[str, Any] = {}
    if "all" in score.disparity:
        everywhere = score.disparity["all"]
        found |= {"MSE [px²]": everywhere.mse, "PPE .05 [%]": everywhere.ppe_005, "PPE .1 [%]": everywhere.ppe_010}
    if score.views is not None:
        found |= {"PSNR [dB]": score.views.psnr, "SSIM": score.views.ssim}
    return found | {f"PSNR, {name} oracle [dB]": oracle.psnr for name, oracle in score.oracles.items()}


def _rows(first: dict[str, Any], second: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    return [(name, first.get(name), second.get(name)) for name in first | second]
