"""Leave-one-out on sessions whose results are made here: what is scored against what, and what stays untouched."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfrig.contracts.bench import BenchDocument
from lfrig.contracts.capture import CaptureDocument, OpticsSpec, ViewsSpec
from lfrig.contracts.errors import BadInput, GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.contracts.score import ScoreDocument
from lfrig.processing.depth import estimate_disparity
from lfrig.processing.export.result import load_result
from lfrig.processing.model import LightField, LightFieldRequest
from lfrig.processing.synthesis import render_views
from lfrig.rig import leave_one_out
from lfrig.rig.leave_one_out import evaluate_session, fitted_request
from lfrig.rig.session.store import SessionStore
from tests.rig.card_scene import (
    BASELINE_M,
    CAMERA,
    FOCAL_PX,
    FOCUS_M,
    VIEWS,
    capture_truth,
    scene,
    write_result_folder,
    write_truth,
)

RECORDED = LightFieldRequest(BASELINE_M * 1.03, FOCUS_M * 0.98, VIEWS, VIEWS)
"""Optics as a rig records them: near the truth, not the truth."""


def make_session(folder: Path, *, sigma_baseline: float | None = 0.03, optics: bool = True) -> SessionStore:
    store = SessionStore.create(folder)
    for phase in (0.0, 1.0, 2.0):
        known = OpticsSpec(
            baseline_m=RECORDED.baseline_m, focus_distance_m=RECORDED.focus_distance_m, sigma_baseline=sigma_baseline
        )
        document = CaptureDocument(
            kind="light_field", views=ViewsSpec(rows=VIEWS, cols=VIEWS), camera=CAMERA, optics=known if optics else None
        )
        store.add_light_field(scene(phase)[1], document)
    return store


def targets(store: SessionStore) -> list[str]:
    return list(store.captures())


@pytest.fixture
def pipeline(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A pipeline that finds the geometry up to .02 px of noise, for the optics that it is asked for; the targets."""
    asked: list[str] = []

    def process_session(session, target, sources, options, out, overwrite, monitor):  # type: ignore[no-untyped-def]
        asked.append(target)
        assert (options.rows, options.cols) == (VIEWS, VIEWS)
        light_field = SessionStore.open(session).load_light_field(target)
        known = light_field.optics.baseline_m is not None
        optics = RECORDED if known else replace(RECORDED, baseline_m=0.011, focus_distance_m=0.47)
        depth_m = scene()[0]
        disparity = optics.disparity((1 / depth_m).astype(np.float32), FOCAL_PX)
        disparity += np.random.default_rng(len(asked)).normal(0, 0.02, disparity.shape).astype(np.float32)
        views = render_views(light_field.centre_view, disparity, VIEWS, VIEWS)
        write_result_folder(out, disparity, views, name=target, session=session.name, optics=optics)
        return out

    monkeypatch.setattr(leave_one_out, "process_session", process_session)
    return asked


def files(folder: Path, *, without: tuple[str, ...] = ()) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name not in without
    }


SCORES = ("score.json", "report.html", "evaluate.json", "evaluate.md")


def test_every_light_field_is_left_out_once(tmp_path: Path, pipeline: list[str]) -> None:
    store = make_session(tmp_path / "session")
    phases = dict(zip(targets(store), (0.0, 1.0, 2.0), strict=True))
    write_truth(tmp_path / "session.truth", phases)
    before = files(tmp_path / "session")
    [evaluation] = evaluate_session(store.path)
    assert pipeline == targets(store)
    assert evaluation.folder == store.path / "results" / "evaluate-fast"
    assert BenchDocument.load(evaluation.folder / "evaluate.json") == evaluation.document
    *rows, mean = evaluation.document.rows
    assert [row["target"] for row in rows] == targets(store) and mean["target"] == "mean"
    assert mean["mse"] == pytest.approx(np.mean([row["mse"] for row in rows]))
    for row in rows:
        assert row["reference"] == "truth"
        # Scored as the light field that was left out: with its true optics, whatever was recorded.
        assert row["bf_px_m"] == pytest.approx(BASELINE_M * FOCAL_PX)
        assert row["mse"] == pytest.approx((0.02 / 1.03) ** 2, rel=0.1)
        assert row["psnr_z_buffer"] >= row["psnr"] > 25
    assert "fixed-point oracle" in (evaluation.folder / "evaluate.md").read_text()
    after = files(tmp_path / "session")
    assert {name: after[name] for name in before} == before


def test_the_truth_changes_scores_only(tmp_path: Path, pipeline: list[str]) -> None:
    store = make_session(tmp_path / "session")
    write_truth(tmp_path / "session.truth", dict(zip(targets(store), (0.0, 1.0, 2.0), strict=True)))
    [with_truth] = evaluate_session(store.path)
    kept = files(with_truth.folder, without=SCORES)
    shutil.rmtree(tmp_path / "session.truth")
    pipeline.clear()
    [without_truth] = evaluate_session(store.path, overwrite=True)
    assert files(without_truth.folder, without=SCORES) == kept
    assert {row["reference"] for row in without_truth.document.rows} == {"own light field (estimated)"}
    score = ScoreDocument.load(without_truth.folder / targets(store)[0] / "score.json")
    assert score.oracles == {} and score.views is not None
    assert any("estimate" in note for note in score.notes)


def test_unknown_optics_are_found_from_the_light_field_itself(tmp_path: Path, pipeline: list[str]) -> None:
    store = make_session(tmp_path / "session", optics=False)
    [evaluation] = evaluate_session(store.path)
    row = evaluation.document.rows[0]
    assert row["bf_px_m"] == pytest.approx(BASELINE_M * FOCAL_PX, rel=0.03)
    assert row["psnr"] > 25
    # Made for other optics, the views as they lie in the folder would not have fitted.
    made = load_result(evaluation.folder / row["target"])
    assert made.request.baseline_m == 0.011


def test_optics_that_claim_to_be_exact_are_not_fitted(tmp_path: Path, pipeline: list[str]) -> None:
    store = make_session(tmp_path / "session", sigma_baseline=0.0)
    [evaluation] = evaluate_session(store.path)
    assert evaluation.document.rows[0]["bf_px_m"] == pytest.approx(RECORDED.baseline_m * FOCAL_PX)


def test_one_refusal_is_a_row_and_all_of_them_an_error(
    tmp_path: Path, pipeline: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    store = make_session(tmp_path / "session")
    first = targets(store)[0]
    working = leave_one_out.process_session
    refused = {first}

    def process_session(session, target, *rest):  # type: ignore[no-untyped-def]
        if target in refused:
            raise GeometryRefused("too few anchors", code="too-few-anchors", remedy="shoot more")
        return working(session, target, *rest)

    monkeypatch.setattr(leave_one_out, "process_session", process_session)
    monitor = Monitor()
    [evaluation] = evaluate_session(store.path, monitor=monitor)
    assert evaluation.document.rows[0]["refused"] == "too-few-anchors"
    assert [notice.code for notice in monitor.notices] == ["target-refused"]
    assert "refused: too few anchors" in (evaluation.folder / "evaluate.md").read_text()
    refused.update(targets(store))
    kept = files(evaluation.folder)
    with pytest.raises(GeometryRefused, match="too few anchors"):
        evaluate_session(store.path, overwrite=True)
    assert files(evaluation.folder) == kept


def test_what_cannot_be_evaluated(tmp_path: Path, pipeline: list[str]) -> None:
    store = SessionStore.create(tmp_path / "small")
    document = CaptureDocument(kind="light_field", views=ViewsSpec(rows=VIEWS, cols=VIEWS))
    store.add_light_field(scene()[1], document)
    with pytest.raises(BadInput, match="1 light field"):
        evaluate_session(store.path)
    with pytest.raises(BadInput):
        evaluate_session(tmp_path / "nowhere")
    store = make_session(tmp_path / "session")
    (store.path / "results" / "evaluate-fast").mkdir(parents=True)
    with pytest.raises(BadInput, match="exists"):
        evaluate_session(store.path)
    assert pipeline == []


def test_results_go_where_they_are_wanted(tmp_path: Path, pipeline: list[str]) -> None:
    store = make_session(tmp_path / "session")
    [evaluation] = evaluate_session(store.path, out=tmp_path / "elsewhere")
    assert evaluation.folder == tmp_path / "elsewhere" / "evaluate-fast"
    assert not (store.path / "results").exists()
    report = json.loads((evaluation.folder / targets(store)[0] / "report.json").read_text())
    assert report["session"] == "session"


def test_fitted_optics_need_a_relation(tmp_path: Path) -> None:
    truth = capture_truth()
    light_field = LightField("007", truth.views)
    own = estimate_disparity(light_field)
    noise = np.random.default_rng(0).normal(0, 0.3, own.disparity.shape).astype(np.float32)
    write_result_folder(tmp_path / "result", noise, truth.views)
    result = load_result(tmp_path / "result")
    against = replace(own, disparity=-result.inverse_depth)
    with pytest.raises(GeometryRefused, match="does not follow"):
        fitted_request(against, result, result.request, FOCAL_PX)
    flat = replace(own, confidence=np.zeros_like(own.confidence))
    with pytest.raises(GeometryRefused, match="does not follow"):
        fitted_request(flat, result, result.request, FOCAL_PX)
