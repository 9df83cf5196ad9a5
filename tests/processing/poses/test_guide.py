"""The light field's disparity as a guide, and the anchors it contradicts."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.processing.model import ScaleFit
from lfrig.processing.poses.anchors import contradicted
from lfrig.processing.poses.guide import inverse_depth_interval, scale_line
from lfrig.processing.poses.priors import depth_limits, neighbours, prior_band_px, turntable_arrangement

SLOPE, OFFSET = 1 / 0.7, 1 / 0.46


@pytest.fixture
def keypoints(still):
    """Pixels of the first source that hit something, and their true depths."""
    depth = still.depths[0]
    ys, xs = np.mgrid[10 : depth.shape[0] - 10 : 12, 10 : depth.shape[1] - 10 : 12]
    hit = np.isfinite(depth[ys, xs])
    return np.c_[xs[hit], ys[hit]].astype(float), depth[ys[hit], xs[hit]]


def test_line_through_solved_points(still, keypoints):
    xy, depth = keypoints
    line = scale_line(xy, depth, still.evidence[0])
    assert line.a == pytest.approx(SLOPE, rel=0.02) and line.c == pytest.approx(OFFSET, rel=0.01)
    assert scale_line(xy[:20], depth[:20], still.evidence[0]) is None


def test_false_depths_do_not_make_a_line(still, keypoints):
    xy, depth = keypoints
    line = scale_line(xy, np.random.default_rng(0).permutation(depth), still.evidence[0])
    assert line is None or line.residual > 5 * scale_line(xy, depth, still.evidence[0]).residual


def test_interval_holds_the_true_depth_and_little_else(still, keypoints):
    xy, depth = keypoints
    low, high = inverse_depth_interval(xy, still.evidence[0], ScaleFit(SLOPE, OFFSET, 0.015))
    inside = (low < 1 / depth) & (1 / depth < high)
    assert inside.mean() > 0.99
    assert np.median(high - low) < 0.15 * np.median(1 / depth)


def test_unconfident_pixels_admit_everything(still, keypoints):
    from dataclasses import replace

    xy, _ = keypoints
    blind = replace(still.evidence[0], confidence=np.zeros_like(still.evidence[0].confidence))
    low, high = inverse_depth_interval(xy, blind, ScaleFit(SLOPE, OFFSET))
    assert np.isneginf(low).all() and np.isposinf(high).all()


def test_false_points_along_the_ray_are_contradicted(still, keypoints):
    xy, depth = keypoints
    wrong = depth.copy()
    wrong[::5] *= 1.12
    flagged = contradicted(xy, wrong, still.evidence[0])
    assert flagged[::5].mean() > 0.85
    assert np.delete(flagged, np.s_[::5]).mean() < 0.02


def test_neighbours_are_sorted_and_leave_nobody_alone(studio):
    from lfrig.processing import geometry

    poses = [geometry.turntable_pose(studio.mount(), a) for a in (0.0, 10.0, 30.0, 80.0)]
    assert neighbours(poses) == [(0, 1), (1, 2), (0, 2), (2, 3)]
    assert neighbours(poses[:1]) == []


def test_a_shared_mount_widens_the_band_less_than_separate_ones(still, studio):
    from dataclasses import replace

    arrangement = turntable_arrangement(still.sources, still.prior)
    shared = prior_band_px(arrangement, 0, 1)
    mounts = arrangement.mounts * 3
    separate = replace(
        arrangement, mounts=mounts, views=tuple(replace(v, mount=k) for k, v in enumerate(arrangement.views))
    )
    assert 2.0 <= shared < prior_band_px(separate, 0, 1)


def test_depth_limits_come_from_the_rig_then_from_the_captures(still):
    from dataclasses import replace

    ranged = [replace(s, depth_range_m=(0.3, 0.8)) for s in still.sources]
    assert depth_limits(ranged, replace(still.prior, depth_range_m=(0.2, 0.5))) == (0.8 * 0.2, 1.25 * 0.5)
    assert depth_limits(ranged, still.prior) == (0.8 * 0.3, 1.25 * 0.8)
    near, far = depth_limits([*ranged[:2], still.sources[2]], still.prior)
    assert near < 0.05 and far > 10
