from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfrig.bench import stress
from lfrig.bench.stress import Trial, attempt, check_of
from lfrig.bench.stress_inputs import exact_anchors, one_plane, rigid, transformed
from lfrig.bench.stress_trials import scale_fit_trials
from lfrig.contracts.bench import BenchDocument
from lfrig.contracts.errors import BadInput, GeometryRefused, Interrupted
from lfrig.processing.geometry import project_points, relative_pose
from lfrig.processing.model import Pose


def trial(run, **known):  # type: ignore[no-untyped-def]
    return Trial("group", "name", run, "why", **known)


def raising(error: Exception):  # type: ignore[no-untyped-def]
    def run() -> float:
        raise error

    return run


def test_values_are_held_against_their_bound() -> None:
    inside, outside = attempt(trial(lambda: 0.5)), attempt(trial(lambda: 1.5))
    assert inside["ok"] and not outside["ok"]
    assert check_of(inside).ok and not check_of(outside).ok
    assert check_of(outside).value == 1.5 and check_of(outside).bound == 1.0
    assert attempt(trial(lambda: 1.5, direction=">="))["ok"]
    assert not attempt(trial(lambda: float("nan")))["ok"]


def test_a_refusal_counts_only_with_its_code() -> None:
    refusal = GeometryRefused("no", code="too-few-anchors")
    assert attempt(trial(raising(refusal), refusal=("too-few-anchors",)))["ok"]
    assert not attempt(trial(raising(refusal), refusal=("no-overlap",)))["ok"]
    assert not attempt(trial(raising(refusal)))["ok"]


def test_wrongly_accepted_input_fails() -> None:
    row = attempt(trial(lambda: 0.0, refusal=("no-source",)))
    assert not row["ok"] and not check_of(row).ok


def test_a_crash_is_a_failed_row_and_a_cancel_passes_through() -> None:
    row = attempt(trial(raising(ZeroDivisionError("oops")), refusal=("no-source",)))
    assert row["outcome"] == "crashed: ZeroDivisionError" and not row["ok"] and not check_of(row).ok
    with pytest.raises(Interrupted):
        attempt(trial(raising(Interrupted())))


def test_the_scale_fit_holds() -> None:
    rows = [attempt(each) for each in scale_fit_trials()]
    assert [row["name"] for row in rows if not row["ok"]] == []
    assert {"0 anchors", "1 anchors", "2 anchors", "3 anchors", "8 anchors"} <= {row["name"] for row in rows}


def test_anchors_are_as_exact_as_they_say() -> None:
    _, _, anchors, evidence, truth = exact_anchors(200)
    x, y = anchors.xy.astype(int).T
    error = evidence.disparity[y, x] - truth.disparity((1 / anchors.depth_m).astype(np.float32))
    assert 0.015 < error.std() < 0.025
    assert evidence.disparity[y, x].min() < -0.3 and evidence.disparity[y, x].max() > 0.3
    _, _, wrong, evidence, truth = exact_anchors(200, outliers=0.3)
    error = evidence.disparity[y, x] - truth.disparity((1 / wrong.depth_m).astype(np.float32))
    assert 0.2 < np.mean(np.abs(error) > 0.1) < 0.3


def test_the_plane_is_where_it_says() -> None:
    sources, photo, _, depth_m = one_plane()
    views, optics, camera = sources[0].views, sources[0].optics, sources[0].camera
    assert camera is not None and optics.baseline_m is not None and optics.focus_distance_m is not None
    delta = optics.baseline_m * camera.focal_px * (1 / depth_m - 1 / optics.focus_distance_m)
    # Two views to the right, every point is 2δ further left.
    x = np.arange(20, 140)
    centre, right = (views[2, c, 60, :, 0].astype(float) for c in (2, 4))
    moved = np.interp(x - 2 * delta, np.arange(camera.width), right)
    assert np.abs(moved - centre[x]).max() < 6
    assert photo.image.std() > 10


def test_a_change_of_gauge_keeps_what_cameras_see() -> None:
    from lfrig.bench.cases import Case
    from lfrig.rig.truth import CaptureTruth

    sources, photo, prior, depth_m = one_plane()
    truth = CaptureTruth("002", np.full((4, 4), 1 / depth_m, np.float32), 300.0, 0.0036, 0.5, None, 0.0)
    # A target that is turned a little, so that rotation and translation mix.
    photo = replace(photo, pose=Pose(rigid(5.0, 0.0)[0], np.array([0.01, 0.02, 0.03])))
    case = Case("plane", sources, photo, prior, truth, {})
    rotation, offset = rigid(137.0, 40.0)
    moved = transformed(case, 7.0, rotation, offset)
    point = np.array([[0.02, -0.01, depth_m]])
    for before, after in zip([*case.sources, case.target], [*moved.sources, moved.target], strict=True):
        assert before.camera and before.pose and after.pose
        seen, depth = project_points(before.camera, before.pose, point)
        seen_after, depth_after = project_points(before.camera, after.pose, 7.0 * point @ rotation.T + offset)
        assert seen_after == pytest.approx(seen, abs=1e-8) and depth_after == pytest.approx(7 * depth)
    assert case.target.pose and moved.target.pose and case.sources[0].pose and moved.sources[0].pose
    assert relative_pose(moved.target.pose, moved.sources[0].pose)[1] == pytest.approx(
        7 * relative_pose(case.target.pose, case.sources[0].pose)[1]
    )
    assert moved.sources[0].optics.baseline_m == pytest.approx(7 * 0.0036)
    assert moved.request.focus_distance_m == pytest.approx(3.5)


def test_a_pose_with_nan_is_no_pose() -> None:
    with pytest.raises(BadInput):
        Pose(np.eye(3), np.array([0, np.nan, 0.0]))


def test_the_benchmark_end_to_end(tmp_path: Path) -> None:
    groups = ["scale fit", "identity", "geometry"]
    document = stress.run(tmp_path / "out", size=(96, 64), groups=groups, cache_dir=tmp_path / "cache")
    assert BenchDocument.load(tmp_path / "out" / "stress.json") == document
    assert list(dict.fromkeys(row["group"] for row in document.rows)) == groups
    assert len(document.checks) == len(document.rows)
    # At this size accuracy is nobody's concern; crashes and wrong refusals are.
    assert [row for row in document.rows if row["outcome"].startswith("crashed")] == []
    by_name = {row["name"]: row for row in document.rows}
    for name in ("NaN in a pose", "two identical poses", "no source at all", "the same again", "on one thread"):
        assert by_name[name]["ok"], by_name[name]
    assert "no-source" in (tmp_path / "out" / "stress.md").read_text()
