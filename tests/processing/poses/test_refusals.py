"""Bad input to the pose stage: what is refused, what is corrected, and how it is said."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput, ExitCode, GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Photo, Pose
from lfrig.processing.poses import solve_poses


def solve(shoot, method=None, monitor=None):
    # These light fields are copies of their centre views: nothing for the way that looks into them.
    method = method or ("auto" if all(s.pose is not None for s in shoot.sources) else "colmap")
    return solve_poses(*shoot.arguments(), method, threads=1, monitor=monitor or Monitor())


def refusal_of(shoot, **options) -> GeometryRefused:
    with pytest.raises(GeometryRefused) as caught:
        solve(shoot, **options)
    assert caught.value.exit_code == ExitCode.GEOMETRY and caught.value.remedy
    return caught.value


def with_angles(shoot, *angles_deg):
    sources = [replace(s, turntable_deg=a) for s, a in zip(shoot.sources, angles_deg, strict=True)]
    return replace(shoot, sources=sources)


def with_views(source, image):
    return replace(source, views=np.broadcast_to(image, (3, 3, *image.shape)))


def test_nan_in_a_pose():
    with pytest.raises(BadInput, match="NaN"):
        Pose(np.eye(3), np.array([0, np.nan, 0]))


def test_two_identical_poses(studio):
    shoot = studio.shoot(given=True)
    shoot.sources[2] = replace(shoot.sources[2], pose=shoot.sources[1].pose)
    refusal = refusal_of(shoot)
    assert refusal.code == "identical-poses" and "001" in refusal.message and "002" in refusal.message


def test_two_identical_angles(still):
    said = [s.turntable_deg for s in still.sources]
    assert refusal_of(with_angles(still, said[0], said[1], said[1])).code == "identical-poses"


def test_photo_of_another_scene(still, studio):
    other = studio.shoot(angles_deg=(), scene=50, seed=9)
    refusal = refusal_of(replace(still, target=other.target))
    assert refusal.code == "photo-no-overlap" and "photo" in refusal.message


def test_photo_of_another_scene_with_given_poses(studio):
    shoot = studio.shoot(given=True)
    other = studio.shoot(angles_deg=(), scene=50, seed=9, given=True)
    assert refusal_of(replace(shoot, target=other.target)).code == "photo-no-overlap"


def test_constant_photo(still):
    grey = Photo("photo", np.full_like(still.target.image, 90), still.target.camera)
    assert refusal_of(replace(still, target=grey)).code == "photo-no-overlap"


def test_the_same_picture_at_two_angles(still):
    sources = list(still.sources)
    sources[2] = with_views(sources[2], sources[1].centre_view)
    refusal = refusal_of(replace(still, sources=sources))
    assert refusal.code == "duplicate-capture" and "001" in refusal.message and "002" in refusal.message


def test_constant_capture_is_named(still):
    sources = list(still.sources)
    sources[1] = with_views(sources[1], np.full_like(sources[1].centre_view, 128))
    refusal = refusal_of(replace(still, sources=sources))
    assert refusal.code == "too-few-matches" and "001" in refusal.message


def test_capture_of_another_scene_is_named(still, studio):
    other = studio.shoot(angles_deg=(0.0,), scene=50, seed=9)
    sources = list(still.sources)
    sources[0] = with_views(sources[0], other.sources[0].centre_view)
    refusal = refusal_of(replace(still, sources=sources))
    assert refusal.code == "too-few-matches" and "000" in refusal.message


def test_one_wrong_angle_is_corrected_and_reported(still):
    monitor = Monitor()
    shoot = with_angles(still, still.sources[0].turntable_deg, still.sources[1].turntable_deg, 23.0)
    solution = solve(shoot, monitor=monitor)
    assert [n.code for n in monitor.notices] == ["angle-corrected"]
    assert "002" in monitor.notices[0].message and "23.00°" in monitor.notices[0].message
    assert solution.angle_residual_deg[2] == pytest.approx(-8.0, abs=1.0)


def test_all_angles_of_the_wrong_sign(still):
    refusal = refusal_of(with_angles(still, *(-s.turntable_deg for s in still.sources)))
    assert refusal.code in {"turntable-direction", "turntable-angles"}


def test_all_angles_too_large(studio):
    shoot = studio.shoot(angles_deg=(-18.0, -6.0, 6.0, 18.0), target_deg=2.0)
    wrong = with_angles(shoot, *(1.3 * s.turntable_deg for s in shoot.sources))
    refusal = refusal_of(wrong)
    assert refusal.code == "turntable-angles" and "0.7" in refusal.message


def test_photo_angle_off_is_corrected_and_reported(still):
    monitor = Monitor()
    shoot = replace(still, target=replace(still.target, turntable_deg=30.0))
    solution = solve(shoot, monitor=monitor)
    assert [n.code for n in monitor.notices] == ["photo-pose-corrected"]
    step = np.linalg.norm(solution.target_pose.centre - solution.poses[1].centre)
    assert step == pytest.approx(np.linalg.norm(still.true_target_pose.centre - still.true_poses[1].centre), rel=0.05)


def test_a_wrong_focal_length_is_reported(studio):
    shoot = studio.shoot(sigma_focal=0.02, seed=3)
    camera = shoot.sources[1].camera
    shoot.sources[1] = replace(shoot.sources[1], camera=replace(camera, focal_px=camera.focal_px * 1.2))
    monitor = Monitor()
    solution = solve(shoot, monitor=monitor)
    assert "focal-corrected" in [n.code for n in monitor.notices]
    assert solution.cameras[1].focal_px == pytest.approx(shoot.true_cameras[1].focal_px, rel=0.04)


def test_given_without_a_pose_names_the_capture(still):
    with pytest.raises(BadInput, match=r"000.*pose"):
        solve(still, "given")


def test_no_source(still):
    with pytest.raises(BadInput, match="no source"):
        solve(replace(still, sources=[], evidence=[]))


def test_nothing_known_and_nothing_to_see(studio):
    shoot = studio.shoot(angles_deg=(-10.0, 10.0))
    grey = np.full_like(shoot.sources[0].centre_view, 128)
    shoot.sources = [replace(with_views(s, grey), turntable_deg=None) for s in shoot.sources]
    assert refusal_of(shoot).code == "not-registered"
