from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.bench import accuracy
from lfrig.bench.acceptance import BOUNDS, OTHER_SETUPS, STATED, acceptance, bounds_of
from lfrig.bench.accuracy_table import SETUPS, SHIPPED, Setup, mean_fields, stage_rows, tables
from lfrig.bench.cases import NEAR_DEG, scene_names, shoot_case
from lfrig.bench.decode_cost import decode_cost_rows, decode_cost_tables
from lfrig.bench.document import markdown_table
from lfrig.bench.inputs import Input
from lfrig.bench.stages import stage_table
from lfrig.contracts.bench import BenchDocument
from lfrig.processing.options import Settings
from lfrig.sim.scenes import REPORTING, TUNING

TINY = (96, 64)
GOOD = {"mse": 0.001, "ppe_005": 95.0, "ppe_010": 98.0, "below_z_buffer_db": 0.3, "ause_of_random": 0.2}
VIEWS: Input = "views"
GIVEN = Setup(2, "given")


def scene_row(setup: Setup, stage: str, scene: str, **numbers: float) -> dict[str, Any]:
    return {"setup": setup.name, "input": VIEWS, "stage": stage, "scene": scene, **GOOD, **numbers}


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
    paper, shipped = stage_rows(scenes, stages, [(setup, VIEWS)])
    assert paper["mse"] == pytest.approx(0.03) and paper["mse_ratio"] == 1
    assert shipped["mse"] == pytest.approx(0.003) and shipped["mse_ratio"] == pytest.approx(0.1)
    assert (shipped["worst"], shipped["worst_mse"]) == ("fence", 0.005)
    assert shipped["scenes"] == 2 and shipped["refused"] == ["studio"] and shipped["peak_rss_mb"] == 400


def test_means_leave_out_what_some_rows_lack() -> None:
    assert mean_fields([{"a": 1, "b": 2.0, "c": "x", "d": True}, {"a": 3, "c": "y", "d": False}]) == {"a": 2.0}


EVERY_BOUND = [
    (setup, kind, *bound[:3])
    for setup, kind in [*((setup, VIEWS) for setup in SETUPS), (STATED, "noisy"), (STATED, "raw")]
    for bound in bounds_of(setup.name, kind)
]


@pytest.mark.parametrize(("setup", "kind", "name", "bound", "way"), EVERY_BOUND)
def test_every_bound_can_fail(setup: Setup, kind: Input, name: str, bound: float, way: str) -> None:
    def failed(**numbers: float) -> list[str]:
        scene = scene_row(setup, SHIPPED, "desk", **numbers) | {"input": kind}
        rows = stage_rows([scene], stage_table()[-1:], [(setup, kind)])
        return [check.name for check in acceptance(rows) if not check.ok]

    assert failed() == []
    assert failed(**{name: bound}) == []
    worse = bound * (1.01 if way == "<=" else 0.99)
    assert failed(**{name: worse}) == [f"{setup.name}, {kind}: {name}"]


def test_bounds_are_what_was_promised() -> None:
    stated = {kind: {name: bound for name, bound, *_ in bounds} for kind, bounds in BOUNDS.items()}
    assert stated == {
        "views": {"mse": 0.0015, "ppe_005": 95, "ppe_010": 98, "below_z_buffer_db": 0.8, "ause_of_random": 0.3},
        "noisy": {"mse": 0.003, "ppe_005": 90, "ppe_010": 96},
        "raw": {"mse": 0.004, "ppe_005": 88, "ppe_010": 95},
    }
    assert bounds_of(Setup(4, "prior").name, "views") == OTHER_SETUPS
    assert bounds_of(STATED.name, "equal") == () and bounds_of(SETUPS[0].name, "raw") == ()


def test_a_refused_scene_fails_the_acceptance() -> None:
    setup = SETUPS[0]
    scenes = [scene_row(setup, SHIPPED, "desk"), scene_row(setup, SHIPPED, "fence") | {"refused": "too-few-anchors"}]
    failed = [
        check.name for check in acceptance(stage_rows(scenes, stage_table()[-1:], [(setup, VIEWS)])) if not check.ok
    ]
    assert failed == [f"{setup.name}, views: scenes refused"]


def test_a_setup_that_was_refused_everywhere_fails() -> None:
    scene = {"setup": STATED.name, "input": "raw", "stage": SHIPPED, "scene": "desk", "refused": "no-overlap"}
    checks = acceptance(stage_rows([scene], stage_table()[-1:], [(STATED, "raw")]))
    assert [check.ok for check in checks] == [False]


def test_what_the_decode_costs_is_told_from_the_noise() -> None:
    def rows(kind: str, *mse: float | None) -> list[dict[str, Any]]:
        scored = [scene_row(STATED, SHIPPED, f"s{i}", mse=m or 0.0) | {"input": kind} for i, m in enumerate(mse)]
        for row, m in zip(scored, mse, strict=True):
            if m is None:
                del row["mse"]
                row["refused"] = "no-overlap"
        return scored

    scenes = [*rows("views", 0.001, 0.003, 0.5), *rows("equal", 0.002, 0.006, 0.7), *rows("raw", 0.002, 0.007, None)]
    clean, noise, decode = decode_cost_rows(scenes)
    assert [row["scenes"] for row in (clean, noise, decode)] == [2, 2, 2], "what was refused once counts nowhere"
    assert "added_mse" not in clean and clean["mse"] == pytest.approx(0.002)
    assert noise["added_mse"] == pytest.approx(0.002) and decode["added_mse"] == pytest.approx(0.0005)
    assert decode["added_ppe_005"] == 0 and decode["cause"] == "the decode"
    [table] = decode_cost_tables([clean, noise, decode])
    assert "+0.00050" in markdown_table(table.rows, table.columns)
    assert decode_cost_rows(rows("views", 0.001)) == [] and decode_cost_tables([]) == []


def test_tables_show_stages_and_scenes() -> None:
    setup = SETUPS[0]
    scenes = [scene_row(setup, SHIPPED, "desk"), scene_row(setup, "paper", "desk")]
    stages, each = tables(stage_rows(scenes, stage_table(), [(setup, VIEWS)]), scenes)
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


def test_the_accuracy_benchmark_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "STATED", GIVEN)  # a scene this small does not tell poses
    document = accuracy.run(
        tmp_path / "out", half="tuning", scenes=["tabletop"], size=TINY, setups=[GIVEN],
        stages=["log-pool"], inputs=["views", "noisy"], measure_memory=False, cache_dir=tmp_path / "cache",
    )  # fmt: skip
    assert BenchDocument.load(tmp_path / "out" / "accuracy.json") == document
    means = [row for row in document.rows if row["kind"] == "mean"]
    assert [(row["input"], row["stage"]) for row in means] == [
        ("views", "log-pool"), ("views", SHIPPED), ("noisy", "log-pool"), ("noisy", SHIPPED)
    ]  # fmt: skip
    assert all(np.isfinite(row["mse"]) and row["psnr_z_buffer"] > 20 for row in means)
    assert all(0 < row["ause_of_random"] < 2 for row in means)
    assert all(row["below_shipped_db"] == pytest.approx(row["psnr_shipped"] - row["psnr"]) for row in means)
    assert means[1]["psnr_shipped"] != means[1]["psnr_z_buffer"]
    assert means[3]["noise_grey"] > means[1]["noise_grey"] + 2
    assert document.checks == [], "the bounds hold at full size on the reporting half"
    # In proportion to the photo's width, which is a little less than that of the light-field views.
    assert means[0]["bf_px_m"] == pytest.approx(0.70 * TINY[0] / 541, rel=0.1)
    written = (tmp_path / "out" / "accuracy.md").read_text(encoding="utf-8")
    assert "Stages, clean views" in written and "Stages, views with noise of 5 grey levels" in written
    for name in (accuracy.STAGES_PICTURE, accuracy.WORST_PICTURE):
        assert (tmp_path / "out" / name).stat().st_size > 500


def test_a_setup_is_named_by_what_it_has() -> None:
    assert Setup(4, "prior").name == "4 sources, turntable prior"
    assert replace(Setup(4, "prior"), poses="given").name == "4 sources, poses given"


@pytest.mark.slow
def test_raw_files_and_views_of_equal_noise_are_run_together(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(accuracy, "STATED", GIVEN)  # scenes this small do not tell poses
    document = accuracy.run(
        tmp_path / "out", half="tuning", scenes=["plaster"], size=(135, 94), stages=[], inputs=["views", "raw"],
        setups=[GIVEN], measure_memory=False, cache_dir=tmp_path / "cache",
    )  # fmt: skip
    assert {row["input"] for row in document.rows if row["kind"] == "mean"} == {"views", "equal", "raw"}
    cost = [row for row in document.rows if row["kind"] == "decode cost"]
    assert [row["input"] for row in cost] == ["views", "equal", "raw"]
    assert cost[1]["noise_grey"] > cost[0]["noise_grey"]
