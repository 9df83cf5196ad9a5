"""Rigid transforms and projections: round trips, conventions, and worlds far from their origin."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.contracts.errors import BadInput
from lfrig.processing import geometry
from lfrig.processing.model import Camera, Pose

CAMERA = Camera.centred(320, 240, 500.0)
angles = st.floats(-170, 170)
lengths = st.floats(-2, 2)
points = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(0.3, 3.0))


def rotation(x_deg: float, z_deg: float) -> np.ndarray:
    """Two turns about different axes."""
    swap = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
    return swap @ geometry.rotation_z(np.deg2rad(x_deg)) @ swap.T @ geometry.rotation_z(np.deg2rad(z_deg))


def pose(x_deg: float, z_deg: float, *centre: float) -> Pose:
    r = rotation(x_deg, z_deg)
    return Pose(r, -r @ np.array(centre))


@given(angles, angles, lengths, lengths, lengths, points)
def test_project_undoes_back_project(x, z, a, b, c, point):
    p = pose(x, z, a, b, c)
    xy, depth = np.array([[point[0] * 500 + 160, point[1] * 500 + 120]]), np.array([point[2]])
    world = geometry.world_points(CAMERA, p, xy, depth)
    back, distance = geometry.project_points(CAMERA, p, world)
    np.testing.assert_allclose(back, xy, atol=1e-7)
    np.testing.assert_allclose(distance, depth, rtol=1e-9)


@given(angles, angles, lengths, lengths, lengths)
def test_centre_and_direction(x, z, a, b, c):
    p = pose(x, z, a, b, c)
    np.testing.assert_allclose(p.centre, [a, b, c], atol=1e-12)
    ahead = p.centre + 2.0 * p.direction
    xy, depth = geometry.project_points(CAMERA, p, ahead[None])
    np.testing.assert_allclose(xy, [[CAMERA.cx, CAMERA.cy]], atol=1e-7)
    assert depth[0] == pytest.approx(2.0)


@given(angles, angles, angles, angles, lengths, lengths)
def test_relative_pose_carries_points(x1, z1, x2, z2, a, b):
    target, source = pose(x1, z1, a, b, 0.3), pose(x2, z2, b, -a, 0.1)
    r, t = geometry.relative_pose(target, source)
    world = np.array([0.2, -0.5, 0.7])
    in_target = target.rotation @ world + target.translation
    np.testing.assert_allclose(r @ in_target + t, source.rotation @ world + source.translation, atol=1e-12)
    identity, zero = geometry.relative_pose(target, target)
    np.testing.assert_allclose(identity, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(zero, 0, atol=1e-12)


@pytest.mark.parametrize("offset", [0.0, 1e3, 1e5, 1e7])
def test_a_far_origin_costs_no_pixels(offset):
    shift = np.array([offset, -offset, offset / 2])
    target, source = pose(3, 10, 0.0, -0.4, 0.2), pose(-2, 25, 0.1, -0.4, 0.25)
    far = [Pose(p.rotation, p.translation - p.rotation @ shift) for p in (target, source)]
    grid = np.mgrid[0:240:40, 0:320:40].reshape(2, -1).astype(np.float32)
    w = np.full(grid.shape[1], 2.0, np.float32)
    near_maps = geometry.project(*geometry.projection(CAMERA, target, CAMERA, source), grid[1], grid[0], w)
    far_maps = geometry.project(*geometry.projection(CAMERA, far[0], CAMERA, far[1]), grid[1], grid[0], w)
    # What is left comes from t = −R C itself, which loses 1e-9 m at 1e7.
    np.testing.assert_allclose(far_maps[0], near_maps[0], atol=1e-3)
    np.testing.assert_allclose(far_maps[1], near_maps[1], atol=1e-3)


@given(angles, angles, points)
def test_projection_agrees_with_going_through_the_world(x, z, point):
    target, source = pose(5, 0, 0, -0.5, 0.2), pose(5 + x / 20, z / 10, 0.05, -0.5, 0.2)
    xy, depth = np.array([[point[0] * 500 + 160, point[1] * 500 + 120]]), np.array([point[2]])
    expected, z_source = geometry.project_points(CAMERA, source, geometry.world_points(CAMERA, target, xy, depth))
    u, v, w = geometry.project(
        *geometry.projection(CAMERA, target, CAMERA, source),
        xy[:, 0].astype(np.float32), xy[:, 1].astype(np.float32), (1 / depth).astype(np.float32),
    )  # fmt: skip
    if z_source[0] > 0.05:
        np.testing.assert_allclose(np.c_[u, v], expected, rtol=1e-4, atol=2e-2)
        np.testing.assert_allclose(w, 1 / z_source, rtol=1e-4)
    elif z_source[0] < -0.05:
        assert np.isnan(u).all() and np.isnan(v).all()


def test_the_plate_turns_counter_clockwise_seen_from_above():
    # A still camera south of the plate, looking north; a mark on the plate's south side moves east (to the right in
    # the image) when the plate turns counter-clockwise seen from above.
    camera_from_plate = Pose(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), np.array([0.0, 0.0, 0.5]))
    mark = np.array([[0.0, -0.1, 0.0]])
    before, _ = geometry.project_points(CAMERA, geometry.turntable_pose(camera_from_plate, 0.0), mark)
    after, _ = geometry.project_points(CAMERA, geometry.turntable_pose(camera_from_plate, 10.0), mark)
    assert after[0, 0] > before[0, 0] + 5


@given(angles, angles)
def test_turntable_poses_compose(first, second):
    camera_from_plate = pose(20, 0, 0.0, -0.4, 0.2)
    both = geometry.turntable_pose(camera_from_plate, first + second)
    turned = geometry.turntable_pose(geometry.turntable_pose(camera_from_plate, first), second)
    np.testing.assert_allclose(both.rotation, turned.rotation, atol=1e-12)
    np.testing.assert_allclose(both.translation, camera_from_plate.translation)


@given(st.floats(1e-7, 179.0), angles, angles)
def test_rotation_angle(angle, x, z):
    base = rotation(x, z)
    turned = base @ geometry.rotation_z(np.deg2rad(angle))
    assert geometry.rotation_angle_deg(base, turned) == pytest.approx(angle, rel=1e-6, abs=1e-12)
    assert geometry.rotation_angle_deg(base, base) == pytest.approx(0, abs=1e-7)


@given(st.floats(0.25, 4.0))
def test_resized_camera_sees_the_same_rays(scale):
    width = max(8, round(320 * scale))
    small = CAMERA.resized(width, round(240 * width / 320))
    s = width / 320
    for x in (0.0, 10.5, 319.0):
        there = (x + 0.5) * s - 0.5
        assert (there - small.cx) / small.focal_px == pytest.approx((x - CAMERA.cx) / CAMERA.focal_px, abs=1e-12)


@pytest.mark.parametrize(
    ("field", "value"), [("focal_px", np.nan), ("focal_px", 0.0), ("focal_px", -5.0), ("cx", np.inf), ("cy", np.nan)]
)
def test_a_camera_with_no_focal_length_or_centre_is_refused_by_name(field: str, value: float) -> None:
    with pytest.raises(BadInput, match=field):
        Camera(**{"width": 40, "height": 30, "focal_px": 50.0, "cx": 19.5, "cy": 14.5, field: value})
