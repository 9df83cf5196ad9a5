"""Bundle adjustment: derivatives against differences, recovery of known geometry, and what priors hold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.processing import geometry
from lfrig.processing.kernels.rig_chain import adjoint, motion_derivative, rotation_matrix
from lfrig.processing.model import Camera, Pose
from lfrig.processing.poses.adjust import Disparity, Reprojection, adjust
from lfrig.processing.poses.arrangement import Arrangement, Line, Viewpoint, moved, rotation_vector
from lfrig.processing.poses.tracks import Observations

CAMERA = Camera.centred(320, 240, 600.0)
ANGLES_DEG = (-15.0, 0.0, 14.0)

vectors = st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).map(np.array)
motions = st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6).map(np.array)


def observed(cameras, poses, points, noise=0.0, seed=0) -> Observations:
    """Every point seen by every view."""
    rng = np.random.default_rng(seed)
    n, views = len(points), len(poses)
    xy = np.stack([geometry.project_points(c, p, points)[0] for c, p in zip(cameras, poses, strict=True)], 1)
    xy = xy.reshape(-1, 2) + rng.normal(0, noise, (n * views, 2))
    view = np.tile(np.arange(views), n)
    return Observations(np.repeat(np.arange(n), views), view, np.repeat(np.arange(n), views), xy, np.ones(n * views))


def turntable(studio, **sigmas) -> Arrangement:
    views = tuple(Viewpoint(replace(CAMERA, sigma_focal=0.02), 0, a, 0.3, 0.02, 0.0002) for a in ANGLES_DEG)
    return Arrangement((studio.mount(sigma_deg=1.0, sigma_m=0.005, **sigmas),), views)


@pytest.fixture
def points():
    return np.random.default_rng(1).uniform([-0.06, -0.06, 0], [0.06, 0.06, 0.09], (150, 3))


@given(vectors)
def test_rotation_vector_inverts_rotation_matrix(v):
    rotation = rotation_matrix(v)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation_vector(rotation), v, atol=1e-7)


@given(motions, motions)
def test_motion_derivative_and_adjoint_against_differences(motion, direction):
    pose, step = Pose(rotation_matrix(np.array([0.3, -0.2, 0.5])), np.array([0.1, 0.2, 0.4])), 1e-6
    point = np.array([0.3, -0.4, 0.2])

    def image(p):
        return p.rotation @ point + p.translation

    def difference(at):
        return (image(at(step)) - image(at(-step))) / (2 * step)

    here = image(moved(motion, pose))
    left = motion_derivative(motion) @ direction
    changed = difference(lambda h: moved(motion + h * direction, pose))
    np.testing.assert_allclose(np.cross(left[:3], here) + left[3:], changed, atol=1e-7)
    carried = adjoint(motion) @ direction
    before = difference(lambda h: moved(motion, moved(h * direction, pose)))
    np.testing.assert_allclose(np.cross(carried[:3], here) + carried[3:], before, atol=1e-7)


def test_chain_of_parameters_against_differences(studio, points):
    arrangement = turntable(studio)
    x = np.random.default_rng(2).normal(0, 0.05, arrangement.size)
    chain = arrangement.local_derivative(x)
    step = 1e-6
    for column in range(arrangement.size):
        e = np.zeros(arrangement.size)
        e[column] = step
        for view in range(len(ANGLES_DEG)):
            images = []
            for at in (x - e, x, x + e):
                pose, camera = arrangement.poses(at)[view], arrangement.cameras(at)[view]
                images.append((points[0] @ pose.rotation.T + pose.translation, np.log(camera.focal_px)))
            local = chain[view, :, column]
            motion = np.cross(local[:3], images[1][0]) + local[3:6]
            np.testing.assert_allclose(motion, (images[2][0] - images[0][0]) / (2 * step), atol=1e-7)
            assert local[6] == pytest.approx((images[2][1] - images[0][1]) / (2 * step), abs=1e-7)


def test_exact_sightings_recover_exact_geometry(studio, points):
    arrangement = turntable(studio)
    truth = np.random.default_rng(3).normal(0, 1, arrangement.size) * arrangement.sigmas()
    seen = observed(arrangement.cameras(truth), arrangement.poses(truth), points)
    start = points + np.random.default_rng(4).normal(0, 0.002, points.shape)
    # A tiny pixel sigma makes the data outweigh the prior wherever they say anything.
    block = Reprojection(seen, np.full(len(seen), 1e-3))
    result = adjust(arrangement, np.zeros(arrangement.size), start, [block], max_iterations=60, tolerance=1e-12)
    found, true = arrangement.poses(result.parameters), arrangement.poses(truth)
    for a, b in zip(found, true, strict=True):
        relative = a.rotation @ found[0].rotation.T, b.rotation @ true[0].rotation.T
        assert geometry.rotation_angle_deg(*relative) < 0.002
    residual = block.linearise(arrangement.cameras(result.parameters), found, result.points).residual * 1e-3
    assert np.abs(residual).max() < 1e-3


def test_outliers_hardly_matter(studio, points):
    arrangement = turntable(studio)
    truth = np.random.default_rng(5).normal(0, 1, arrangement.size) * arrangement.sigmas()
    seen = observed(arrangement.cameras(truth), arrangement.poses(truth), points, noise=0.1)
    block = Reprojection(seen, np.full(len(seen), 0.1))
    clean = adjust(arrangement, np.zeros(arrangement.size), points, [block])
    seen.xy[::11] += 25.0
    spoilt = adjust(arrangement, np.zeros(arrangement.size), points, [block])
    deviation = np.sqrt(np.diag(clean.covariance))
    assert (np.abs(spoilt.parameters - clean.parameters) <= 2 * deviation).all()


def test_covariance_tells_how_far_off_the_parameters_are(studio, points):
    arrangement = turntable(studio)
    ratios = []
    for seed in range(8):
        truth = np.random.default_rng(seed).normal(0, 1, arrangement.size) * arrangement.sigmas()
        seen = observed(arrangement.cameras(truth), arrangement.poses(truth), points[:80], noise=0.3, seed=seed)
        block = Reprojection(seen, np.full(len(seen), 0.3))
        result = adjust(arrangement, np.zeros(arrangement.size), points[:80], [block])
        error = result.parameters - truth
        free = np.flatnonzero(arrangement.sigmas())
        covariance = result.covariance[np.ix_(free, free)]
        ratios.append(error[free] @ np.linalg.solve(covariance, error[free]) / len(free))
    # Expected 1; the Cauchy weights of honest noise make the covariance a little too wide.
    assert 0.6 < np.mean(ratios) < 1.3


def test_a_held_parameter_does_not_move(studio, points):
    views = tuple(Viewpoint(CAMERA, 0, a, 0.3) for a in ANGLES_DEG)
    arrangement = Arrangement((studio.mount(),), views)
    truth = np.random.default_rng(6).normal(0, 1, arrangement.size) * arrangement.sigmas()
    seen = observed(arrangement.cameras(truth), arrangement.poses(truth), points, noise=0.1)
    result = adjust(arrangement, np.zeros(arrangement.size), points, [Reprojection(seen, np.full(len(seen), 0.1))])
    held = arrangement.sigmas() == 0
    assert (result.parameters[held] == 0).all() and (result.parameters[~held] != 0).all()
    # The turns are all that is free; what they share is the world's own turn, which only the prior holds.
    error = (result.parameters - truth)[arrangement.turns]
    np.testing.assert_allclose(error - error.mean(), 0, atol=3e-4)


def test_a_blunder_in_one_angle_loses_its_pull(studio, points):
    arrangement = turntable(studio)
    truth = np.zeros(arrangement.size)
    truth[arrangement.turns.start + 2] = np.deg2rad(8.0)
    seen = observed(arrangement.cameras(truth), arrangement.poses(truth), points, noise=0.2)
    x = np.zeros(arrangement.size)
    for sigma_px in (16.0, 4.0, 1.0, 0.2):
        result = adjust(arrangement, x, points, [Reprojection(seen, np.full(len(seen), sigma_px))])
        x, points = result.parameters, result.points
    turns = np.rad2deg(result.parameters[arrangement.turns])
    assert turns[2] - turns[0] == pytest.approx(8.0, abs=0.5)
    assert abs(turns[0]) < 0.3 and abs(turns[1]) < 0.3


def test_start_at_puts_a_lone_view_where_it_should_be(studio):
    base = turntable(studio)
    joint = Arrangement((*base.mounts, studio.mount(30.0)), (*base.views, Viewpoint(CAMERA, 1, 7.0, 0.3)))
    wanted = geometry.turntable_pose(studio.mount(31.0, 0.5), 8.0)
    x = joint.start_at(np.zeros(joint.size), 3, wanted)
    np.testing.assert_allclose(joint.poses(x)[3].rotation, wanted.rotation, atol=1e-9)
    np.testing.assert_allclose(joint.poses(x)[3].translation, wanted.translation, atol=1e-9)
    with pytest.raises(ValueError, match="shared"):
        joint.start_at(x, 0, wanted)


LINE = Line(0.0011, 2.2, 0.03)


def light_fields(studio) -> Arrangement:
    """The turntable with a line for every view."""
    arrangement = turntable(studio)
    return replace(arrangement, views=tuple(replace(v, line=LINE) for v in arrangement.views))


def disparities(arrangement, x, points, noise=0.0) -> Disparity:
    """Disparity of every point in every view."""
    views, rng = len(arrangement.views), np.random.default_rng(0)
    told = []
    for camera, pose, line in zip(arrangement.cameras(x), arrangement.poses(x), arrangement.lines(x), strict=True):
        depth = geometry.project_points(camera, pose, points)[1]
        told.append(line.scale(camera).disparity(1 / depth) + rng.normal(0, noise, len(points)))
    index = np.repeat(np.arange(len(points)), views)
    return Disparity(
        index, np.tile(np.arange(views), len(points)), np.stack(told, 1).ravel(), np.full(len(index), 0.004)
    )


def test_disparity_derivatives_against_differences(studio, points):
    arrangement = light_fields(studio)
    x = np.random.default_rng(2).normal(0, 1, arrangement.size) * arrangement.sigmas()
    block = disparities(arrangement, x, points[:5], noise=0.1)

    def linear(at, where=points[:5]):
        return block.linearise(arrangement.cameras(at), arrangement.poses(at), where, arrangement.lines(at))

    here, chain, step = linear(x), arrangement.local_derivative(x), 1e-6
    for column in np.flatnonzero(arrangement.sigmas()):
        e = np.zeros(arrangement.size)
        e[column] = step
        changed = (linear(x + e).residual - linear(x - e).residual)[:, 0] / (2 * step)
        for m in range(len(changed)):
            pose = arrangement.poses(x)[block.view[m]]
            local = pose.rotation @ points[block.point[m]] + pose.translation
            move = chain[block.view[m], :, column]
            motion = np.cross(move[:3], local) + move[3:6]
            expected = here.d_local[m, 0] @ motion + here.d_inner[m, 0] @ move[6:]
            assert expected == pytest.approx(changed[m], rel=1e-4, abs=1e-4)


def test_lines_and_focal_lengths_come_out_of_exact_disparities(studio, points):
    arrangement = light_fields(studio)
    truth = np.random.default_rng(3).normal(0, 1, arrangement.size) * arrangement.sigmas()
    seen = observed(arrangement.cameras(truth), arrangement.poses(truth), points)
    blocks = [Reprojection(seen, np.full(len(seen), 0.01)), disparities(arrangement, truth, points)]
    result = adjust(arrangement, np.zeros(arrangement.size), points, blocks, max_iterations=60, tolerance=1e-12)
    depths = [
        geometry.project_points(c, p, result.points)[1]
        for c, p in zip(arrangement.cameras(result.parameters), arrangement.poses(result.parameters), strict=True)
    ]
    found, true = (
        [line.scale(c) for line, c in zip(arrangement.lines(x), arrangement.cameras(x), strict=True)]
        for x in (result.parameters, truth)
    )
    for a, b, pose, depth in zip(found, true, arrangement.poses(truth), depths, strict=True):
        told = b.disparity(1 / (points @ pose.rotation[2] + pose.translation[2]))
        np.testing.assert_allclose(a.inverse_depth(told), 1 / depth, rtol=1e-3)


def test_wobble_along_the_axis_may_be_wider(studio):
    view = Viewpoint(CAMERA, 0, 0.0, 0.3, 0.02, 0.0002, 0.002)
    sigma = Arrangement((studio.mount(),), (view,)).sigmas()
    np.testing.assert_allclose(sigma[Arrangement((studio.mount(),), (view,)).wobble(0)][3:], [0.0002, 0.0002, 0.002])
