"""Depth against closed forms, for each primitive."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.sim.optics import SimCamera
from lfrig.sim.renderer import render_depth
from lfrig.sim.scene import (
    F64,
    Primitive,
    backdrop,
    board,
    box,
    cylinder,
    ground,
    pack,
    rod,
    sphere,
    torus,
    turned,
)
from tests.sim.small import CENTRE, H, W, camera, flat, head_on, scene

GREY = flat(0.5)
FAR = backdrop(2.0, GREY)


def depth_of(primitive: Primitive, k: SimCamera) -> F64:
    return render_depth(pack(scene(primitive, FAR)), k, CENTRE)[0].astype(float)


def tangents(k: SimCamera) -> tuple[F64, F64]:
    ys, xs = np.mgrid[: k.height, : k.width]
    return (xs - k.cx) / k.focal_px, (ys - k.cy) / k.focal_px


def test_sphere() -> None:
    k, radius, away = head_on(), 0.05, 0.5
    u, v = tangents(k)
    # |z (u, v, 1) − (0, 0, away)| = radius
    a, discriminant = u * u + v * v + 1, away**2 - (u * u + v * v + 1) * (away**2 - radius**2)
    hit = discriminant > 1e-6
    expected = (away - np.sqrt(np.maximum(discriminant, 0))) / a
    np.testing.assert_allclose(depth_of(sphere((0, away, 0), radius, GREY), k)[hit], expected[hit], rtol=1e-6)
    assert hit.sum() > 50


def test_box_faces_the_camera_with_one_depth() -> None:
    k = head_on()
    depth = depth_of(box((0, 0.5, 0), (0.05, 0.1, 0.05), GREY), k)
    u, v = tangents(k)
    inside = (np.abs(u) < 0.12) & (np.abs(v) < 0.12)
    np.testing.assert_allclose(depth[inside], 0.4, rtol=1e-6)


@given(st.floats(-50, 50))
def test_turned_board_is_a_plane(yaw_deg: float) -> None:
    k, away = head_on(), 0.5
    u, _ = tangents(k)
    slope = np.tan(np.deg2rad(yaw_deg))
    # World: y = away + slope * x, with x = u y.
    expected = away / (1 - slope * u)
    near = (expected > 0) & (np.abs(u * expected) < 0.3 * np.cos(np.deg2rad(yaw_deg)))
    depth = depth_of(board((0, away, 0), 0.3, 0.3, GREY, yaw_deg), k)
    np.testing.assert_allclose(depth[near], expected[near], rtol=1e-6)


def test_ground_below_a_tilted_camera() -> None:
    k = camera()
    u, v = tangents(k)
    rays = np.stack([u, v, np.ones_like(u)], -1) @ k.rotation
    expected = -k.centre[2] / rays[..., 2]
    packed = pack(scene(ground(5.0, GREY), FAR))
    depth = render_depth(packed, k, CENTRE)[0]
    down = (rays[..., 2] < 0) & (expected < 1.5)
    np.testing.assert_allclose(depth[down], expected[down], rtol=1e-6)
    assert down.sum() > W * H / 2


def test_backdrop_is_met_from_inside_only() -> None:
    k = camera(elevation_deg=0.0)  # stands outside of it
    packed = pack(scene(backdrop(0.2, GREY)))
    depth = render_depth(packed, k, CENTRE)[0].astype(float)
    u, v = tangents(k)
    points = np.stack([u, v, np.ones_like(u)], -1) * depth[..., None] @ k.rotation + k.centre
    hit = np.isfinite(depth)
    np.testing.assert_allclose(np.hypot(points[hit][:, 0], points[hit][:, 1]), 0.2, rtol=1e-5)
    assert (points[hit][:, 1] > 0).mean() > 0.8  # the far side


def test_cylinder_side_and_cap() -> None:
    k = camera()
    depth = depth_of(cylinder((0, 0, 0.03), 0.05, 0.03, GREY), k)
    u, v = tangents(k)
    points = np.stack([u, v, np.ones_like(u)], -1) * depth[..., None] @ k.rotation + k.centre
    hit = depth < 1
    radius, z = np.hypot(points[..., 0], points[..., 1])[hit], points[..., 2][hit]
    on_side, on_cap = np.abs(radius - 0.05) < 1e-6, np.abs(z - 0.06) < 1e-6
    assert (on_side | on_cap).all()
    assert on_side.sum() > 20
    assert on_cap.sum() > 20
    assert (points[..., 1][hit & (np.abs(points[..., 2] - 0.06) > 1e-6)] < 0).all()  # the side that faces us


@given(st.floats(-180, 180), st.floats(-90, 90), st.floats(0.004, 0.03))
def test_torus_points_lie_on_it(yaw_deg: float, roll_deg: float, minor: float) -> None:
    k, rotation, major = camera(), turned(yaw_deg, 0, roll_deg), 0.05
    depth = depth_of(torus((0, 0, 0.03), major, minor, GREY, rotation), k)
    u, v = tangents(k)
    points = np.stack([u, v, np.ones_like(u)], -1) * depth[..., None] @ k.rotation + k.centre
    local = (points[depth < 1] - [0, 0, 0.03]) @ rotation.T
    distance = np.hypot(np.hypot(local[:, 0], local[:, 1]) - major, local[:, 2])
    np.testing.assert_allclose(distance, minor, atol=1e-6)
    assert len(local) > 10


def test_torus_misses_no_ray_that_a_fine_march_finds() -> None:
    k, major, minor = camera(), 0.05, 0.006
    hit = depth_of(torus((0, 0, 0.03), major, minor, GREY, turned(0, 0, 70)), k) < 1
    u, v = tangents(k)
    rays = np.stack([u, v, np.ones_like(u)], -1) @ k.rotation
    nearest = np.full(u.shape, np.inf)
    for z in np.linspace(0.3, 0.6, 1500):
        local = (rays * z + k.centre - [0, 0, 0.03]) @ turned(0, 0, 70).T
        nearest = np.minimum(nearest, np.hypot(np.hypot(local[..., 0], local[..., 1]) - major, local[..., 2]) - minor)
    assert not (hit & (nearest > 2e-4)).any()
    assert not (~hit & (nearest < -2e-4)).any()


def test_rod_runs_between_its_ends() -> None:
    k = head_on(200, 20)
    depth = depth_of(rod((-0.05, 0.4, 0.0), (0.05, 0.5, 0.0), 0.004, GREY), k)
    middle = depth[10]
    u, _ = tangents(k)
    axis = 0.45 / (1 - u[10])  # y = 0.45 + x
    hit = middle < 1
    assert hit.sum() == pytest.approx(k.focal_px * (0.05 / 0.4 + 0.05 / 0.5), abs=6)
    assert np.abs(middle[hit] - axis[hit]).max() < 0.004 * np.sqrt(2) + 1e-3
