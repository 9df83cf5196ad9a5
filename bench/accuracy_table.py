"""Rows, checks and tables of the accuracy benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lfrig.bench.cases import Case
from lfrig.bench.document import Column, Table
from lfrig.bench.inputs import TITLES, Input
from lfrig.bench.stages import Stage
from lfrig.contracts.progress import Monitor
from lfrig.contracts.score import LightFieldScore, ScoreDocument
from lfrig.processing.geometry import relative_pose, rotation_angle_deg
from lfrig.processing.metrics import light_field_score
from lfrig.processing.pipeline import ProcessResult
from lfrig.processing.synthesis import fill_nan, render_views
from lfrig.rig.candidate import score_oracles
from lfrig.sim.rig import Poses

SHIPPED = "snap"
"""Key of the stage that preset fast is."""


@dataclass(frozen=True)
class Setup:
    """One configuration: how many sources, and where the poses come from."""

    sources: int
    poses: Poses

    @property
    def name(self) -> str:
        """As shown in tables."""
        return f"{self.sources} sources, {'poses given' if self.poses == 'given' else 'turntable prior'}"


SETUPS = (Setup(2, "given"), Setup(2, "prior"), Setup(4, "given"), Setup(4, "prior"))


def case_oracles(case: Case, threads: int, monitor: Monitor) -> dict[str, LightFieldScore]:
    """The oracles of a case: they depend on its photo and its truth, not on sources, poses or methods. ``shipped`` is
    what the pipeline's own synthesis makes of exact geometry; the others are the fixed yardsticks.
    """
    truth, request = case.truth, case.request
    assert truth.views is not None
    disparity = truth.disparity(request.baseline_m, request.focus_distance_m)
    photo = case.target.image8
    views = render_views(photo, fill_nan(disparity), request.rows, request.cols, threads=threads, monitor=monitor)
    return {
        **score_oracles(photo, truth, disparity, truth.views, threads=threads, monitor=monitor),
        "shipped": light_field_score(np.asarray(views, np.uint8), truth.views),
    }


def score_fields(score: ScoreDocument) -> dict[str, Any]:
    """The numbers of a score, flat: those of all pixels by their names, of the others with their class."""
    fields: dict[str, Any] = {"bf_px_m": score.bf_px_m, **score.disparity["all"].model_dump()}
    for name, part in score.disparity.items():
        if name != "all":
            fields |= {f"mse_{name}": part.mse, f"ppe_010_{name}": part.ppe_010}
    views = score.views_clean or score.views
    if views is not None:
        fields |= {"psnr": views.psnr, "ssim": views.ssim, "psnr_corners": views.psnr_corners}
        fields |= {f"psnr_{name}": oracle.psnr for name, oracle in score.oracles.items()}
        fields["below_z_buffer_db"] = score.psnr_below_z_buffer_db
    if score.views is not None and score.views_clean is None and "shipped" in score.oracles:
        fields["below_shipped_db"] = score.oracles["shipped"].psnr - score.views.psnr
    return fields


def pose_errors(result: ProcessResult, case: Case) -> dict[str, float]:
    """Worst error over the sources of the pose relative to the target, and the target's focal length."""
    true_camera, true_target = case.cameras[case.target.id]
    degrees, metres = [], []
    for source in (found.source for found in result.sources):
        rotation, translation = relative_pose(result.target_pose, source.pose)
        true_rotation, true_translation = relative_pose(true_target, case.cameras[source.light_field.id][1])
        degrees.append(rotation_angle_deg(rotation, true_rotation))
        metres.append(float(np.linalg.norm(translation - true_translation)))
    return {
        "pose_error_deg": max(degrees),
        "pose_error_mm": 1000 * max(metres),
        "focal_error_pct": 100 * (result.target_camera.focal_px / true_camera.focal_px - 1),
    }


def stage_rows(
    scenes: Sequence[dict[str, Any]], stages: Sequence[Stage], runs: Sequence[tuple[Setup, Input]]
) -> list[dict[str, Any]]:
    """Means over the scenes per run and stage, the worst scene named, and the gain over the first stage."""
    rows: list[dict[str, Any]] = []
    for setup, kind in runs:
        reference: float | None = None
        for stage in stages:
            mine = [r for r in scenes if (r["setup"], r["input"], r["stage"]) == (setup.name, kind, stage.key)]
            if not mine:
                continue
            row: dict[str, Any] = {
                "kind": "mean", "setup": setup.name, "sources": setup.sources, "poses": setup.poses, "input": kind,
                "stage": stage.key, "title": stage.title, **means_and_worst(mine),
            }  # fmt: skip
            rows.append(row)
            if not row["scenes"]:
                continue
            peaks = [r["peak_rss_mb"] for r in mine if r.get("peak_rss_mb") is not None]
            if peaks:
                row["peak_rss_mb"] = max(peaks)
            reference = row["mse"] if reference is None else reference
            row["mse_ratio"] = row["mse"] / reference
    return rows


def means_and_worst(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """How many scenes were scored and which were refused; of the scored ones the means, and the worst by MSE."""
    scored = [row for row in rows if "refused" not in row]
    found: dict[str, Any] = {"scenes": len(scored), "refused": [row["scene"] for row in rows if "refused" in row]}
    if scored:
        worst = max(scored, key=lambda row: float(row["mse"]))
        found |= {**mean_fields(scored), "worst": worst["scene"], "worst_mse": worst["mse"]}
    return found


def mean_fields(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Mean of every numeric field that all rows have."""
    names = [name for name, value in rows[0].items() if isinstance(value, (int, float)) and not isinstance(value, bool)]
    return {
        name: float(np.mean([row[name] for row in rows]))
        for name in names
        if all(isinstance(row.get(name), (int, float)) for row in rows)
    }


SCORES = (
    Column("mse", "MSE px²", ".5f"), Column("ppe_005", "PPE .05 %", ".1f"), Column("ppe_010", "PPE .1 %", ".1f"),
    Column("rmse_over_range", "RMSE / range", ".4f"), Column("mse_edge", "MSE edge", ".5f"),
    Column("mse_textureless", "MSE textureless", ".5f"), Column("psnr", "PSNR dB", ".2f"),
    Column("ssim", "SSIM", ".4f"),
    Column("psnr_z_buffer", "z-buffer oracle", ".2f"), Column("psnr_fixed_point", "fixed-point oracle", ".2f"),
    Column("below_z_buffer_db", "below oracle dB", ".2f"),
    Column("below_shipped_db", "below own synthesis of the truth dB", ".2f"),
    Column("ause_of_random", "AUSE / random", ".3f"),
)  # fmt: skip
COSTS = (
    Column("cpu_s", "CPU s", ".1f"), Column("wall_s", "wall s", ".1f"), Column("peak_rss_mb", "peak MB", ".0f"),
)  # fmt: skip
STAGE_COLUMNS = (
    Column("setup", "setup"), Column("title", "stage"), *SCORES, Column("mse_ratio", "MSE / A", ".3f"),
    Column("worst", "worst scene"), Column("worst_mse", "its MSE", ".5f"), *COSTS, Column("refused", "refused"),
)  # fmt: skip
SCENE_COLUMNS = (
    Column("scene", "scene"), Column("setup", "setup"), Column("input", "sources"), *SCORES,
    Column("mse_aligned", "MSE aligned", ".5f"), Column("ece", "ECE", ".3f"),
    Column("noise_grey", "noise found", ".1f"), Column("pose_error_deg", "pose °", ".3f"),
    Column("pose_error_mm", "pose mm", ".2f"), Column("focal_error_pct", "focal %", ".2f"), *COSTS,
    Column("refused", "refused"), Column("warnings", "warnings"),
)  # fmt: skip


def tables(rows: Sequence[dict[str, Any]], scenes: Sequence[dict[str, Any]]) -> list[Table]:
    """A stage table for every input that more than the shipped preset was run on, and the preset scene by scene."""
    found = []
    for kind, title in TITLES.items():
        mine = [row for row in rows if row["input"] == kind]
        if any(row["stage"] != SHIPPED for row in mine):
            found.append(Table(f"Stages, {title}: means over the scenes", mine, STAGE_COLUMNS))
    shipped = sorted((row for row in scenes if row["stage"] == SHIPPED), key=lambda row: str(row["scene"]))
    return [*found, Table("Preset fast, scene by scene", shipped, SCENE_COLUMNS)]
