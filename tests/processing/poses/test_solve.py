"""The pose stage as a whole, on a ray-cast still life with imperfect priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.errors import GeometryRefused, Interrupted
from lfrig.contracts.progress import Monitor
from lfrig.processing import geometry
from lfrig.processing.model import Camera, Optics, Pose, RigPrior
from lfrig.processing.poses import PoseSolution, solve_poses

BASELINE_TIMES_FOCAL = 0.7
FOCUS_M = 0.46


def solve(shoot, method=None, threads=1, monitor=None) -> PoseSolution:
    # These light fields are copies of their centre views: nothing for the way that looks into them.
    method = method or ("auto" if all(s.pose is not None for s in shoot.sources) else "colmap")
    return solve_poses(*shoot.arguments(), method, threads=threads, monitor=monitor or Monitor())


def check_accuracy(solution, shoot, *, rotation_deg, depth, target_px) -> float:
    """Assert the bounds beyond a common scale; returns the scale."""
    ratios = [shoot.depth_ratios(solution, k) for k in range(len(shoot.sources))]
    scale = float(np.median(np.concatenate(ratios)))
    assert shoot.rotation_error_deg(solution) < rotation_deg
    for r in ratios:
        assert np.median(np.abs(r / scale - 1)) < depth
        assert (np.abs(r / scale - 1) > 0.02).mean() < 0.1
    assert shoot.target_error_px(solution) < target_px
    return scale


def test_turntable_prior(still):
    monitor = Monitor()
    solution = solve(still, monitor=monitor)
    assert solution.method == "colmap-turntable" and solution.metric and not monitor.notices
    scale = check_accuracy(solution, still, rotation_deg=0.2, depth=0.003, target_px=0.4)
    assert abs(scale - 1) < 0.03
    assert min(len(a) for a in solution.anchors) >= 100
    residuals = [s.turntable_deg + r for s, r in zip(still.sources, solution.angle_residual_deg, strict=True)]
    assert np.ptp(np.array(residuals) - [-15, 0, 15]) < 0.2


def test_anchors_are_consistent_with_the_poses(still):
    solution = solve(still)
    for anchors, camera, pose in zip(solution.anchors, solution.cameras, solution.poses, strict=True):
        xy, depth = geometry.project_points(camera, pose, anchors.world)
        np.testing.assert_allclose(depth, anchors.depth_m, rtol=1e-9)
        assert np.linalg.norm(xy - anchors.xy, axis=1).max() < 4.0


def test_given_poses_are_kept_and_used(studio):
    shoot = studio.shoot(given=True)
    solution = solve(shoot)
    assert solution.method == "given" and solution.metric
    assert solution.angle_residual_deg == (None, None, None)
    for pose, true in zip(
        (*solution.poses, solution.target_pose), (*shoot.true_poses, shoot.true_target_pose), strict=True
    ):
        np.testing.assert_array_equal(pose.rotation, true.rotation)
        np.testing.assert_allclose(pose.translation, true.translation, atol=1e-12)
    scale = check_accuracy(solution, shoot, rotation_deg=1e-6, depth=0.003, target_px=0.3)
    assert abs(scale - 1) < 0.001


def test_given_sources_and_a_photo_without_a_pose(studio):
    shoot = studio.shoot(given=True)
    shoot.target = replace(shoot.target, pose=None)
    solution = solve(shoot)
    assert solution.method == "given"
    assert geometry.rotation_angle_deg(solution.target_pose.rotation, shoot.true_target_pose.rotation) < 0.1
    assert np.linalg.norm(solution.target_pose.centre - shoot.true_target_pose.centre) < 0.001


def test_photo_with_an_unknown_focal_length(studio):
    shoot = studio.shoot(given=True)
    shoot.target = replace(shoot.target, pose=None, camera=None)
    solution = solve(shoot)
    assert solution.target_camera.focal_px == pytest.approx(shoot.true_target_camera.focal_px, rel=0.01)
    assert shoot.target_error_px(solution) < 0.5


def moved_world(shoot, rotation, offset, scale):
    """The same shoot in another world: X' = scale (rotation X) + offset."""

    def moved(pose):
        turned = pose.rotation @ rotation.T
        return Pose(turned, scale * pose.translation - turned @ offset)

    sources = [replace(s, pose=moved(s.pose)) for s in shoot.sources]
    return replace(shoot, sources=sources, target=replace(shoot.target, pose=moved(shoot.target.pose)))


@pytest.mark.parametrize(("offset", "scale"), [(0.0, 1.0), (1e5, 1.0), (1e3, 40.0)])
def test_gauge_invariance_with_given_poses(studio, offset, scale):
    shoot = studio.shoot(angles_deg=(-10.0, 10.0), given=True)
    rotation = geometry.rotation_z(0.7)[[2, 0, 1]]
    before = solve(shoot)
    after = solve(moved_world(shoot, rotation, np.array([offset, -offset, offset]), scale))
    for a, b in zip(before.anchors, after.anchors, strict=True):
        np.testing.assert_array_equal(a.xy, b.xy)
        np.testing.assert_allclose(b.depth_m, scale * a.depth_m, rtol=1e-5)


def test_uncertain_focal_lengths_are_refined(studio):
    shoot = studio.shoot(sigma_focal=0.02, seed=3)
    said = [s.camera.focal_px / t.focal_px - 1 for s, t in zip(shoot.sources, shoot.true_cameras, strict=True)]
    solution = solve(shoot)
    found = [c.focal_px / t.focal_px - 1 for c, t in zip(solution.cameras, shoot.true_cameras, strict=True)]
    assert max(map(abs, said)) > 0.02
    assert max(map(abs, found)) < 0.015 and np.ptp(found) < 0.006
    check_accuracy(solution, shoot, rotation_deg=0.4, depth=0.003, target_px=0.7)


def test_two_sources_far_apart_are_bridged_by_the_photo(studio):
    shoot = studio.shoot(angles_deg=(-20.0, 20.0), target_deg=2.0)
    solution = solve(shoot)
    check_accuracy(solution, shoot, rotation_deg=0.3, depth=0.004, target_px=0.6)
    assert min(len(a) for a in solution.anchors) >= 60


def test_one_source_and_a_photo(studio):
    shoot = studio.shoot(angles_deg=(-8.0,))
    solution = solve(shoot)
    scale = check_accuracy(solution, shoot, rotation_deg=1e-6, depth=0.005, target_px=0.6)
    assert abs(scale - 1) < 0.15 and len(solution.anchors[0]) >= 60


def without_rig(shoot, optics):
    """The captures alone."""
    sources = [replace(s, turntable_deg=None, optics=optics) for s in shoot.sources]
    target = replace(shoot.target, turntable_deg=None)
    return replace(shoot, sources=sources, target=target, prior=RigPrior())


def test_no_prior_gives_a_gauge_of_its_own(still):
    monitor = Monitor()
    solution = solve(without_rig(still, Optics()), monitor=monitor)
    assert solution.method == "colmap" and not solution.metric and solution.scale_source == "gauge"
    assert [n.code for n in monitor.notices] == ["no-scale"]
    check_accuracy(solution, still, rotation_deg=0.3, depth=0.004, target_px=0.6)


def test_recorded_optics_make_it_metric(still):
    shoot = without_rig(still, Optics(focus_distance_m=FOCUS_M))
    solution = solve(shoot)
    assert solution.metric and solution.scale_source == "recorded optics"
    ratios = np.concatenate([shoot.depth_ratios(solution, k) for k in range(3)])
    assert np.median(ratios) == pytest.approx(1, abs=0.02)


@pytest.mark.parametrize("strip", [False, True])
def test_same_bytes_for_any_thread_count(still, strip):
    shoot = without_rig(still, Optics()) if strip else still
    one, two = solve(shoot, threads=1), solve(shoot, threads=2)
    for a, b in zip((*one.poses, one.target_pose), (*two.poses, two.target_pose), strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.translation, b.translation)
    for a, b in zip(one.anchors, two.anchors, strict=True):
        np.testing.assert_array_equal(a.world, b.world)


def test_uncertainty_is_reported(still):
    solution = solve(still)
    for pose in (*solution.poses, solution.target_pose):
        assert 0 < pose.sigma_deg < 1.5 and 0 < pose.sigma_m < 0.01


def test_cancel(still):
    monitor = Monitor()
    monitor.cancel()
    with pytest.raises(Interrupted):
        solve(still, monitor=monitor)


def test_one_source_with_given_poses_demanded_explains(studio):
    shoot = studio.shoot(angles_deg=(-8.0,), given=True)
    shoot.target = replace(shoot.target, pose=None)
    with pytest.raises(GeometryRefused, match="photo has no pose") as refusal:
        solve(shoot, "given")
    assert refusal.value.code == "one-source-no-photo-pose" and "000" in refusal.value.message


def test_one_source_and_nothing_known_of_the_photo(studio):
    shoot = studio.shoot(angles_deg=(-8.0,), given=True)
    shoot.target = replace(shoot.target, pose=None)
    solution = solve(shoot)
    assert solution.method == "colmap" and not solution.metric and solution.scale_source == "gauge"
    check_accuracy(solution, shoot, rotation_deg=1e-6, depth=0.006, target_px=0.8)


def test_cameras_keep_their_size(still):
    solution = solve(still)
    photo = still.target.image
    assert (solution.target_camera.height, solution.target_camera.width) == photo.shape[:2]
    assert all(isinstance(c, Camera) and c.width == still.sources[0].width for c in solution.cameras)
