"""Light-field-aware poses: what they find, what they fall back to, and what they say."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput, GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing import geometry
from lfrig.processing.model import Camera, Optics, RigPrior
from lfrig.processing.poses import gate, solve_poses
from lfrig.processing.poses.arrangement import Arrangement, Viewpoint
from lfrig.processing.poses.structure import Structure
from lfrig.processing.poses.tracks import Observations


def solve(shoot, method="auto", threads=1, monitor=None):
    return solve_poses(*shoot.arguments(), method, threads=threads, monitor=monitor or Monitor())


def with_angles(shoot, *angles_deg):
    sources = [replace(s, turntable_deg=a) for s, a in zip(shoot.sources, angles_deg, strict=True)]
    return replace(shoot, sources=sources)


@pytest.fixture(scope="module")
def solved(light_still):
    monitor = Monitor()
    return solve(light_still, monitor=monitor), monitor.notices


def test_turntable_prior(light_still, solved):
    solution, notices = solved
    assert solution.method == "lf" and solution.metric and not notices
    assert light_still.rotation_error_deg(solution) < 0.08
    assert light_still.target_error_px(solution) < 0.2
    assert min(len(a) for a in solution.anchors) >= 100


def test_anchors_lie_where_the_scene_is(light_still, solved):
    solution, _ = solved
    ratios = np.concatenate([light_still.depth_ratios(solution, v) for v in range(3)])
    scale = np.median(ratios)
    assert abs(scale - 1) < 0.02
    assert np.median(np.abs(ratios / scale - 1)) < 0.002
    for anchors, camera, pose in zip(solution.anchors, solution.cameras, solution.poses, strict=True):
        xy, depth = geometry.project_points(camera, pose, anchors.world)
        np.testing.assert_allclose(depth, anchors.depth_m, rtol=1e-9)
        assert np.median(np.linalg.norm(xy - anchors.xy, axis=1)) < 0.3


def test_scales_come_out_with_the_poses(light_still, studio, solved):
    solution, _ = solved
    common = np.median([np.median(light_still.depth_ratios(solution, v)) for v in range(3)])
    for scale, depth in zip(solution.scales, light_still.depths, strict=True):
        hit = np.isfinite(depth)
        found = 1 / scale.inverse_depth(studio.disparity_of(depth[hit]))
        assert np.median(np.abs(found / (common * depth[hit]) - 1)) < 0.006
        assert scale.anchors > 60 and scale.inliers > 0.7 and 0 < scale.residual < 0.1


def test_focal_lengths_are_found(light_still, solved):
    solution, _ = solved
    true = light_still.true_cameras
    said = [s.camera.focal_px / t.focal_px - 1 for s, t in zip(light_still.sources, true, strict=True)]
    found = [c.focal_px / t.focal_px - 1 for c, t in zip(solution.cameras, true, strict=True)]
    assert np.ptp(found) < 0.003 < np.ptp(said)


def test_unrecorded_optics_are_found_too(light_still):
    sources = [replace(s, optics=Optics()) for s in light_still.sources]
    shoot = replace(light_still, sources=sources)
    solution = solve(shoot)
    assert solution.method == "lf" and all(s is not None for s in solution.scales)
    assert shoot.rotation_error_deg(solution) < 0.1


def test_photo_without_a_prior_is_found(light_still):
    shoot = replace(light_still, target=replace(light_still.target, turntable_deg=None))
    solution = solve(shoot)
    assert solution.method == "lf"
    assert shoot.target_error_px(solution) < 0.3


def test_photo_far_from_its_prior_is_found_and_reported(light_still):
    shoot = replace(light_still, target=replace(light_still.target, turntable_deg=30.0))
    monitor = Monitor()
    solution = solve(shoot, monitor=monitor)
    assert [n.code for n in monitor.notices] == ["photo-pose-corrected"]
    assert shoot.target_error_px(solution) < 0.3


def test_two_sources_bridged_by_the_photo(studio):
    shoot = studio.shoot((-16.0, 16.0), 2.0, light_fields=True, sigma_focal=0.02, seed=2)
    solution = solve(shoot)
    assert solution.method == "lf"
    assert shoot.rotation_error_deg(solution) < 0.15 and shoot.target_error_px(solution) < 0.4


def test_one_wrong_angle_is_corrected_and_reported(light_still):
    said = [s.turntable_deg for s in light_still.sources]
    monitor = Monitor()
    solution = solve(with_angles(light_still, said[0], said[1], said[2] + 7), monitor=monitor)
    assert [n.code for n in monitor.notices] == ["angle-corrected"] and "002" in monitor.notices[0].message
    assert solution.method == "lf" and light_still.rotation_error_deg(solution) < 0.1
    assert said[2] + 7 + solution.angle_residual_deg[2] - said[2] == pytest.approx(0, abs=1.5)


def test_angles_that_count_the_other_way_are_refused(light_still):
    with pytest.raises(GeometryRefused) as refusal:
        solve(with_angles(light_still, *(-s.turntable_deg for s in light_still.sources)))
    assert refusal.value.code in {"turntable-direction", "turntable-angles"} and refusal.value.remedy


def test_the_same_light_field_twice_is_refused(light_still):
    sources, evidence = list(light_still.sources), list(light_still.evidence)
    sources[2], evidence[2] = replace(sources[2], views=sources[1].views), evidence[1]
    with pytest.raises(GeometryRefused) as refusal:
        solve(replace(light_still, sources=sources, evidence=evidence))
    assert refusal.value.code == "duplicate-capture" and "002" in refusal.value.message


def test_same_bytes_for_any_thread_count(light_still, solved):
    one, two = solved[0], solve(light_still, threads=2)
    for a, b in zip((*one.poses, one.target_pose), (*two.poses, two.target_pose), strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.translation, b.translation)
    for a, b in zip(one.anchors, two.anchors, strict=True):
        np.testing.assert_array_equal(a.world, b.world)


@pytest.mark.parametrize("missing", ["mount", "angle"])
def test_lf_without_a_prior_says_what_is_missing(light_still, missing):
    shoot = light_still
    if missing == "mount":
        shoot = replace(shoot, prior=RigPrior())
    else:
        shoot = replace(shoot, sources=[shoot.sources[0], replace(shoot.sources[1], turntable_deg=None)])
    with pytest.raises(BadInput) as refusal:
        solve(shoot, "lf")
    assert refusal.value.code == "no-turntable-prior" and refusal.value.remedy
    assert ("001" in str(refusal.value)) == (missing == "angle")


def test_views_that_share_no_points_are_told(studio):
    mounts = (studio.mount(),) * 3
    arrangement = Arrangement(mounts, tuple(Viewpoint(Camera.centred(300, 200, 500.0), g) for g in range(3)))
    # 60 points in views 0 and 1, 10 in 1 and 2: the last view hangs on too few.
    point = np.repeat(np.arange(70), 2)
    view = np.r_[np.tile([0, 1], 60), np.tile([1, 2], 10)]
    seen = Observations(point, view, point, np.zeros((140, 2)), np.ones(140))
    size = arrangement.size
    structure = Structure(arrangement, np.zeros(size), seen, np.zeros((70, 3)), 0.1, np.zeros((size, size)))
    assert gate.unlinked(structure) == [2]
