"""Scoring against a truth that is known in closed form."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput
from lfrig.contracts.score import ScoreDocument
from lfrig.processing.model import LightFieldRequest
from lfrig.processing.synthesis import render_views
from lfrig.rig.candidate import Candidate, score_candidate
from lfrig.rig.scoring import find_truth, score_result
from lfrig.rig.truth import load_capture_truth
from tests.rig.card_scene import (
    BASELINE_M,
    FOCAL_PX,
    FOCUS_M,
    VIEWS,
    H,
    W,
    capture_truth,
    request,
    write_result_folder,
    write_truth,
)


def test_exact_geometry_scores_as_the_oracle() -> None:
    truth = capture_truth()
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    views = render_views(truth.photo, disparity, VIEWS, VIEWS, method="z_buffer")
    score, error_px = score_candidate(Candidate(disparity, views, request()), truth)
    assert score.disparity["all"].mse < 1e-12 and np.abs(error_px).max() < 1e-6
    assert score.psnr_below_z_buffer_db == pytest.approx(0, abs=1e-9)
    assert score.views == score.oracles["z_buffer"]
    assert score.oracles["z_buffer"].psnr > score.oracles["fixed_point"].psnr > 25
    assert score.views_clean is None and score.bf_px_m == pytest.approx(BASELINE_M * FOCAL_PX)


def test_wrong_geometry_falls_below_the_oracle() -> None:
    truth = capture_truth()
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    flat = np.full_like(disparity, np.median(disparity))
    views = render_views(truth.photo, flat, VIEWS, VIEWS, method="z_buffer")
    score, error_px = score_candidate(Candidate(flat, views, request()), truth)
    assert score.psnr_below_z_buffer_db is not None and score.psnr_below_z_buffer_db > 1
    assert score.disparity["all"].mse == pytest.approx(np.mean(error_px[15:-15, 15:-15] ** 2), rel=1e-5)
    # The aligned estimate of a constant is the mean of the truth.
    assert score.disparity["aligned"].mse <= score.disparity["all"].mse
    assert score.disparity["edge"].mse > 0 and "textureless" not in score.disparity


def test_a_wrong_focal_length_counts_as_the_error_that_it_causes() -> None:
    truth = capture_truth()
    right = truth.disparity(BASELINE_M, FOCUS_M)
    score, _ = score_candidate(Candidate(right * np.float32(1.02), None, request()), truth)
    inner = right[15:-15, 15:-15]
    assert score.disparity["all"].mse == pytest.approx(np.mean((0.02 * inner) ** 2), rel=1e-3)
    assert score.disparity["aligned"].mse < 1e-10


def test_views_of_another_request_are_not_scored_and_say_why() -> None:
    truth = capture_truth()
    for other, why in (
        (LightFieldRequest(BASELINE_M * 1.01, FOCUS_M, VIEWS, VIEWS), "baseline"),
        (LightFieldRequest(BASELINE_M, FOCUS_M * 1.01, VIEWS, VIEWS), "focus distance"),
        (LightFieldRequest(BASELINE_M, FOCUS_M, 3, 5), "3×5"),
    ):
        disparity = truth.disparity(other.baseline_m, other.focus_distance_m)
        views = np.repeat(truth.photo[None], other.rows * other.cols, 0)
        views = views.reshape(other.rows, other.cols, *truth.photo.shape)
        score, _ = score_candidate(Candidate(disparity, views, other), truth)
        assert score.views is None and score.oracles == {} and score.disparity["all"].mse < 1e-12
        assert any(why in note for note in score.notes), score.notes


def test_a_noisy_photo_is_also_scored_without_its_noise() -> None:
    truth = capture_truth(noise_sigma=9.0)
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    rough = disparity + np.random.default_rng(0).normal(0, 0.04, disparity.shape).astype(np.float32)
    noisy = np.clip(truth.photo + np.random.default_rng(1).normal(0, 9, truth.photo.shape), 0, 255).astype(np.uint8)
    views = render_views(noisy, rough, VIEWS, VIEWS, method="z_buffer")
    score, _ = score_candidate(Candidate(rough, views, request()), truth)
    assert score.views is not None and score.views_clean is not None
    assert score.views_clean.psnr > score.views.psnr + 3
    hidden = score.oracles["z_buffer"].psnr - score.views.psnr
    assert score.psnr_below_z_buffer_db == pytest.approx(score.oracles["z_buffer_clean"].psnr - score.views_clean.psnr)
    assert score.psnr_below_z_buffer_db > hidden


def test_a_result_without_metric_scale_takes_its_unit_from_the_truth() -> None:
    truth = capture_truth()
    unit = 0.037
    gauge = LightFieldRequest(BASELINE_M / unit, FOCUS_M / unit, VIEWS, VIEWS)
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    score, _ = score_candidate(Candidate(disparity, None, gauge, metric=False), truth)
    assert score.disparity["all"].mse < 1e-9
    assert score.bf_px_m == pytest.approx(BASELINE_M * FOCAL_PX, rel=1e-5)
    assert any("0.037" in note for note in score.notes)


def test_a_truth_of_another_picture_is_refused() -> None:
    truth = capture_truth()
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    with pytest.raises(BadInput, match="not the picture"):
        score_candidate(Candidate(disparity, np.ascontiguousarray(truth.views[:, :, :, ::-1]), request()), truth)
    with pytest.raises(BadInput, match="truth of capture 007"):
        score_candidate(Candidate(disparity[1:], None, request()), truth)


def test_score_result_writes_the_score_and_nothing_else(tmp_path: Path) -> None:
    result = tmp_path / "session" / "results" / "007-fast"
    write_truth(tmp_path / "session.truth")
    truth = load_capture_truth(tmp_path / "session.truth", "007")
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    assert truth.views is not None
    write_result_folder(result, disparity, truth.views, session="session")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    score, error_px = score_result(result)
    assert ScoreDocument.load(result / "score.json") == score
    assert error_px.shape == (H, W)
    # The exact views beat the oracle, which cannot know what the photo does not show.
    assert score.psnr_below_z_buffer_db is not None and score.psnr_below_z_buffer_db < 0
    after = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file() and p.name != "score.json"}
    assert after == before


def test_the_truth_is_found_beside_the_session(tmp_path: Path) -> None:
    inside = tmp_path / "shoot" / "results" / "a-fast"
    inside.mkdir(parents=True)
    elsewhere = tmp_path / "out"
    elsewhere.mkdir()
    with pytest.raises(BadInput, match="no truth") as error:
        find_truth(inside, "shoot")
    assert "--truth" in error.value.remedy
    write_truth(tmp_path / "shoot.truth")
    assert find_truth(inside, None) == tmp_path / "shoot.truth"
    assert find_truth(elsewhere, "shoot") == tmp_path / "shoot.truth"
    with pytest.raises(BadInput, match="no truth"):
        find_truth(elsewhere, None)


def test_damaged_truth_is_named(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=r"truth\.json"):
        load_capture_truth(tmp_path, "007")
    write_truth(tmp_path)
    with pytest.raises(BadInput, match="'008'"):
        load_capture_truth(tmp_path, "008")
    depth = tmp_path / "captures" / "007" / "depth.npy"
    np.save(depth, np.ones((4, 4), np.float32))
    with pytest.raises(BadInput, match=r"depth\.npy"):
        load_capture_truth(tmp_path, "007")
    depth.write_bytes(b"nonsense")
    with pytest.raises(BadInput, match=r"depth\.npy"):
        load_capture_truth(tmp_path, "007")
    write_truth(tmp_path)
    (tmp_path / "captures" / "007" / "views" / "01_02.png").unlink()
    with pytest.raises(BadInput, match=r"01_02\.png"):
        load_capture_truth(tmp_path, "007")
    document = json.loads((tmp_path / "truth.json").read_text())
    document["schema"] = "lfrig.truth/2"
    (tmp_path / "truth.json").write_text(json.dumps(document))
    with pytest.raises(BadInput, match="newer"):
        load_capture_truth(tmp_path, "007")
