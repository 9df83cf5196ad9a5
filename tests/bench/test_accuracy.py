from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.bench import accuracy
from lfrig.bench.accuracy_table import BOUNDS, SETUPS, SHIPPED, Setup, acceptance, mean_fields, stage_rows, tables
from lfrig.bench.cases import NEAR_DEG, scene_names, shoot_case
from lfrig.bench.document import markdown_table
from lfrig.bench.stages import stage_table
from lfrig.contracts.bench import BenchDocument
from lfrig.processing.pipeline import Settings
from lfrig.sim.scenes import REPORTING, TUNING

TINY = (96, 64)
GOOD = {"mse": 0.001, "ppe_005": 95.0, "ppe_010": 98.0, "below_z_buffer_db": 0.3}


def scene_row(setup: Setup, stage: str, scene: str, **numbers: float) -> dict[str, Any]:
    return {"setup": setup.name, "stage": stage, "scene": scene, **GOOD, **numbers}


def changed(a: object, b: object) -> set[str]:
    """The fields in which two frozen settings differ."""
    return {f.name for f in fields(a) if getattr(a, f.name) != getattr(b, f.name)}  # type: ignore[arg-type]


def test_the_stages_lead_from_the_paper_to_what_is_shipped() -> None:
    stages = stage_table()
    assert stages[-1].key == SHIPPED and stages[-1].settings == Settings()
    assert len({stage.key for stage in stages}) == len(stages)
    paper = stages[0].settings
    assert (paper.fusion.mapping, paper.fusion.pool, paper.scale_fit.form) == ("literal", "mean", "paper")
    assert paper.regularise.regression == "soft-argmax" and paper.regularise.method == "none"
    for before, after in pairwise(stages):
        assert changed(before.settings, after.settings), after.key


def test_both_halves_are_there_and_share_nothing() -> None:
    assert scene_names("reporting") == list(REPORTING) and scene_names("tuning") == list(TUNING)
    assert not set(REPORTING) & set(TUNING)
    assert scene_names("reporting", ["desk"]) == ["desk"]


def test_rows_hold_means_the_worst_scene_and_the_gain() -> None:
    stages, setup = [stage_table()[0], stage_table()[-1]], SETUPS[0]
    scenes = [
        scene_row(setup, "paper", "desk", mse=0.02), scene_row(setup, "paper", "fence", mse=0.04),
        scene_row(setup, SHIPPED, "desk", mse=0.001, peak_rss_mb=300.0),
        scene_row(setup, SHIPPED, "fence", mse=0.005, peak_rss_mb=400.0),
        scene_row(setup, SHIPPED, "studio") | {"refused": "too-few-anchors"},
    ]  # fmt: skip
    paper, shipped = stage_rows(scenes, stages, [setup])
    assert paper["mse"] == pytest.approx(0.03) and paper["mse_ratio"] == 1
    assert shipped["mse"] == pytest.approx(0.003) and shipped["mse_ratio"] == pytest.approx(0.1)
    assert (shipped["worst"], shipped["worst_mse"]) == ("fence", 0.005)
    assert shipped["scenes"] == 2 and shipped["refused"] == ["studio"] and shipped["peak_rss_mb"] == 400


def test_means_leave_out_what_some_rows_lack() -> None:
    assert mean_fields([{"a": 1, "b": 2.0, "c": "x", "d": True}, {"a": 3, "c": "y", "d": False}]) == {"a": 2.0}


@pytest.mark.parametrize("name", [bound[0] for bound in BOUNDS])
def test_every_bound_can_fail(name: str) -> None:
    setup = SETUPS[1]
    rows = stage_rows([scene_row(setup, SHIPPED, "desk")], stage_table()[-1:], [setup])
    assert all(check.ok for check in acceptance(rows))
    worse = {"mse": 0.0041, "ppe_005": 87.9, "ppe_010": 93.9, "below_z_buffer_db": 1.01}[name]
    rows = stage_rows([scene_row(setup, SHIPPED, "desk", **{name: worse})], stage_table()[-1:], [setup])
    assert [check.name for check in acceptance(rows) if not check.ok] == [f"{setup.name}: {name}"]


def test_a_refused_scene_fails_the_acceptance() -> None:
    setup = SETUPS[0]
    scenes = [scene_row(setup, SHIPPED, "desk"), scene_row(setup, SHIPPED, "fence") | {"refused": "too-few-anchors"}]
    failed = [check.name for check in acceptance(stage_rows(scenes, stage_table()[-1:], [setup])) if not check.ok]
    assert failed == [f"{setup.name}: scenes refused"]


def test_tables_show_stages_and_scenes() -> None:
    setup = SETUPS[0]
    scenes = [scene_row(setup, SHIPPED, "desk"), scene_row(setup, "paper", "desk")]
    stages, each = tables(stage_rows(scenes, stage_table(), [setup]), scenes)
    assert "preset fast" in markdown_table(stages.rows, stages.columns)
    assert [row["scene"] for row in each.rows] == ["desk"]


def test_pixels_do_not_depend_on_what_is_known_of_the_poses(tmp_path: Path) -> None:
    given, prior = (
        shoot_case("tabletop", (48, 32), poses=poses, angles_deg=NEAR_DEG, cache_dir=tmp_path, truth_views=False)
        for poses in ("given", "prior")
    )
    assert (given.sources[0].views == prior.sources[0].views).all()
    assert given.sources[0].pose is not None and prior.sources[0].pose is None
    assert given.truth.disparity(1, 1) == pytest.approx(prior.truth.disparity(1, 1))
    camera, pose = given.cameras["000"]
    assert given.sources[0].camera is not None and camera.focal_px == given.sources[0].camera.focal_px
    assert pose.rotation == pytest.approx(given.sources[0].pose.rotation)
    options = given.options(threads=3)
    assert (options.target_baseline_m, options.threads, options.rows) == (given.request.baseline_m, 3, 7)


def test_the_accuracy_benchmark_end_to_end(tmp_path: Path) -> None:
    document = accuracy.run(
        tmp_path / "out", half="tuning", scenes=["tabletop"], size=TINY, setups=[Setup(2, "given")],
        stages=["log-pool"], measure_memory=False, cache_dir=tmp_path / "cache",
    )  # fmt: skip
    assert BenchDocument.load(tmp_path / "out" / "accuracy.json") == document
    means = [row for row in document.rows if row["kind"] == "mean"]
    assert [row["stage"] for row in means] == ["log-pool", SHIPPED]
    assert all(np.isfinite(row["mse"]) and row["psnr_z_buffer"] > 20 for row in means)
    assert document.checks == [], "the bounds hold at full size on the reporting half"
    # In proportion to the photo's width, which is a little less than that of the light-field views.
    assert means[0]["bf_px_m"] == pytest.approx(0.70 * TINY[0] / 541, rel=0.1)
    for name in ("accuracy.md", accuracy.STAGES_PICTURE, accuracy.WORST_PICTURE):
        assert (tmp_path / "out" / name).stat().st_size > 500


def test_a_setup_is_named_by_what_it_has() -> None:
    assert Setup(4, "prior").name == "4 sources, turntable prior"
    assert replace(Setup(4, "prior"), poses="given").name == "4 sources, poses given"
