"""Scoring against a truth that is known in closed form: a card in front of a wall, both textured
analytically."""

from __future__ import annotations

import functools
import json
from pathlib import Path

import numpy as np
import pytest

from lfrig.contracts.capture import CameraSpec, OpticsSpec, PoseSpec, ViewsSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.result import ReportDocument, TargetReport
from lfrig.contracts.score import ScoreDocument
from lfrig.contracts.truth import TruthCapture, TruthDocument
from lfrig.processing.export.pfm import write_pfm
from lfrig.processing.export.result import write_views
from lfrig.processing.model import LightFieldRequest
from lfrig.rig.candidate import Candidate, score_candidate
from lfrig.rig.scoring import find_truth, score_result
from lfrig.rig.truth import CaptureTruth, load_capture_truth

H, W = 56, 80
FOCAL_PX, BASELINE_M, FOCUS_M = 150.0, 0.008, 0.5
VIEWS, SUPERSAMPLING = 5, 3
WALL_M, CARD_M = 0.6, 0.42
IDENTITY = PoseSpec(R=((1, 0, 0), (0, 1, 0), (0, 0, 1)), t=(0, 0, 0))


def texture(x: np.ndarray, y: np.ndarray, phase: float) -> np.ndarray:
    waves = [np.sin(0.31 * x + 0.2 * y + phase + k) * 30 + np.cos(0.17 * x - 0.37 * y + 2 * k) * 30 for k in range(3)]
    return 128 + np.stack(waves, -1)


def on_card(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (np.abs(x - 40) < 13.5) & (np.abs(y - 28) < 8.5)


@functools.cache
def scene() -> tuple[np.ndarray, np.ndarray]:
    """Depth of the centre view, float32 [H, W] m, and exact views, uint8 [VIEWS, VIEWS, H, W, 3],
    antialiased."""
    bf = BASELINE_M * FOCAL_PX
    wall, card = (bf * (1 / z - 1 / FOCUS_M) for z in (WALL_M, CARD_M))
    views = np.zeros((VIEWS, VIEWS, H, W, 3))
    taps = (np.arange(SUPERSAMPLING) - (SUPERSAMPLING - 1) / 2) / SUPERSAMPLING
    for r, c in np.ndindex(VIEWS, VIEWS):
        dr, dc = r - VIEWS // 2, c - VIEWS // 2
        for dy in taps:
            for dx in taps:
                y, x = np.mgrid[0:H, 0:W] + np.array([dy, dx])[:, None, None]
                near = on_card(x + dc * card, y + dr * card)[..., None]
                front, back = texture(x + dc * card, y + dr * card, 2), texture(x + dc * wall, y + dr * wall, 0)
                views[r, c] += np.where(near, front, back) / SUPERSAMPLING**2
    y, x = np.mgrid[0:H, 0:W]
    return np.where(on_card(x, y), CARD_M, WALL_M).astype(np.float32), np.rint(views).astype(np.uint8)


def capture_truth(noise_sigma: float = 0.0) -> CaptureTruth:
    depth_m, views = scene()
    return CaptureTruth("007", 1 / depth_m, FOCAL_PX, BASELINE_M, FOCUS_M, views, noise_sigma)


def request(baseline_m: float = BASELINE_M) -> LightFieldRequest:
    return LightFieldRequest(baseline_m, FOCUS_M, VIEWS, VIEWS)


def write_truth(folder: Path) -> None:
    depth_m, views = scene()
    capture = TruthCapture(
        kind="photo", camera=CameraSpec(width=W, height=H, fx=FOCAL_PX, fy=FOCAL_PX, cx=39.5, cy=27.5),
        optics=OpticsSpec(baseline_m=BASELINE_M, focus_distance_m=FOCUS_M), pose=IDENTITY, turntable_deg=0.0,
        views=ViewsSpec(rows=VIEWS, cols=VIEWS),
    )  # fmt: skip
    TruthDocument(scene="card", seed=0, captures={"007": capture}).save(folder / "truth.json")
    place = folder / "captures" / "007"
    write_views(place / "views", views)
    np.save(place / "depth.npy", depth_m)


def write_result_folder(folder: Path, disparity: np.ndarray, views: np.ndarray, session: str | None = None) -> None:
    folder.mkdir(parents=True)
    write_pfm(folder / "disparity.pfm", disparity)
    for name in ("disparity_sigma", "confidence", "inverse_depth"):
        np.save(folder / f"{name}.npy", np.ones((H, W), np.float32))
    write_views(folder / "views", views)
    target = TargetReport(
        id="007",
        baseline_m=BASELINE_M,
        focus_distance_m=FOCUS_M,
        fx=FOCAL_PX,
        width=W,
        height=H,
        rows=VIEWS,
        cols=VIEWS,
    )
    ReportDocument(preset="fast", version="0", target=target, session=session).save(folder / "report.json")


@pytest.fixture
def no_page(monkeypatch: pytest.MonkeyPatch) -> list[ScoreDocument]:
    """The report page is tested where it is written; here it only has to be completed."""
    from lfrig.processing.report import page

    completed: list[ScoreDocument] = []
    monkeypatch.setattr(page, "add_score", lambda folder, score, error: completed.append(score))
    return completed


def test_exact_geometry_scores_as_the_oracle() -> None:
    truth = capture_truth()
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    from lfrig.processing.synthesis import render_views

    views = render_views(truth.photo, disparity, VIEWS, VIEWS)
    score, error_px = score_candidate(Candidate(disparity, views, request()), truth)
    assert score.disparity["all"].mse < 1e-12 and np.abs(error_px).max() < 1e-6
    assert score.psnr_below_z_buffer_db == pytest.approx(0, abs=1e-9)
    assert score.views == score.oracles["z_buffer"]
    assert score.oracles["z_buffer"].psnr > score.oracles["fixed_point"].psnr > 25
    assert score.views_clean is None and score.bf_px_m == pytest.approx(BASELINE_M * FOCAL_PX)


def test_wrong_geometry_falls_below_the_oracle() -> None:
    from lfrig.processing.synthesis import render_views

    truth = capture_truth()
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    flat = np.full_like(disparity, np.median(disparity))
    score, error_px = score_candidate(Candidate(flat, render_views(truth.photo, flat, VIEWS, VIEWS), request()), truth)
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
        (LightFieldRequest(BASELINE_M, FOCUS_M, 5, 3), "5×3"),
    ):
        disparity = truth.disparity(other.baseline_m, other.focus_distance_m)
        views = np.repeat(truth.photo[None], other.rows * other.cols, 0)
        views = views.reshape(other.rows, other.cols, *truth.photo.shape)
        score, _ = score_candidate(Candidate(disparity, views, other), truth)
        assert score.views is None and score.oracles == {} and score.disparity["all"].mse < 1e-12
        assert any(why in note for note in score.notes), score.notes


def test_a_noisy_photo_is_also_scored_without_its_noise() -> None:
    from lfrig.processing.synthesis import render_views

    truth = capture_truth(noise_sigma=9.0)
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    rough = disparity + np.random.default_rng(0).normal(0, 0.04, disparity.shape).astype(np.float32)
    noisy = np.clip(truth.photo + np.random.default_rng(1).normal(0, 9, truth.photo.shape), 0, 255).astype(np.uint8)
    score, _ = score_candidate(Candidate(rough, render_views(noisy, rough, VIEWS, VIEWS), request()), truth)
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


def test_score_result_writes_the_score_and_nothing_else(tmp_path: Path, no_page: list[ScoreDocument]) -> None:
    result = tmp_path / "session" / "results" / "007-fast"
    write_truth(tmp_path / "session.truth")
    truth = load_capture_truth(tmp_path / "session.truth", "007")
    disparity = truth.disparity(BASELINE_M, FOCUS_M)
    assert truth.views is not None
    write_result_folder(result, disparity, truth.views, session="session")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    score, error_px = score_result(result)
    assert ScoreDocument.load(result / "score.json") == score
    assert no_page == [score] and error_px.shape == (H, W)
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
