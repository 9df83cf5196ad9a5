"""Patches and corners: aligned to a fraction of a pixel, disparities against the truth."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.processing.kernels.patches import with_slopes
from lfrig.processing.model import LightField
from lfrig.processing.poses.corners import corner_disparities, find_corners, light_field_corners, rim_views
from lfrig.processing.poses.patches import align as align_pictures
from lfrig.processing.poses.patches import normalised
from lfrig.processing.poses.picture import picture_of


def align(first, second, *places):
    return align_pictures(with_slopes(first), with_slopes(second), *places)


def wavy(x, y):
    """A texture that can be evaluated anywhere: waves of many directions and lengths."""
    rng = np.random.default_rng(5)
    total = np.zeros(np.shape(x))
    for length in np.geomspace(7, 60, 40):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        total += np.sqrt(length) * np.sin(2 * np.pi / length * (x * np.cos(angle) + y * np.sin(angle)) + phase)
    return (128 + 2.0 * total).astype(np.float32)


@pytest.fixture(scope="module")
def picture():
    ys, xs = np.mgrid[0:200, 0:250]
    return wavy(xs, ys)


def warped(picture, affine, shift, about):
    """The picture under x → affine (x − about) + about + shift."""
    ys, xs = np.mgrid[0 : picture.shape[0], 0 : picture.shape[1]]
    back = (np.stack([xs, ys], -1) - about - shift) @ np.linalg.inv(affine).T + about
    return wavy(back[..., 0], back[..., 1])


GRID = np.stack(np.meshgrid(np.arange(40.0, 210, 17), np.arange(40.0, 160, 17)), -1).reshape(-1, 2)


@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.31, -0.64), (-1.8, 1.2)])
@pytest.mark.parametrize("affine", [np.eye(2), np.array([[1.1, 0.08], [-0.05, 0.93]])])
def test_alignment_finds_a_shift_whatever_the_exposure(picture, shift, affine):
    about, shift = np.array([125.0, 100.0]), np.array(shift)
    there = 0.7 * warped(picture, affine, shift, about) + 21
    true = (GRID - about) @ affine.T + about + shift
    along = np.tile([1.0, 0.0], (len(GRID), 1))
    found, likeness = align(picture, there, GRID, true - shift, np.tile(affine, (len(GRID), 1, 1)), along)
    assert np.median(np.linalg.norm(found - true, axis=1)) < 0.02
    assert np.median(likeness) > 0.99


def test_alignment_corrects_a_wrong_slant(picture):
    about, stretch = np.array([125.0, 100.0]), np.array([[1.12, -0.06], [0.0, 1.0]])
    there = warped(picture, stretch, np.array([0.4, 0.2]), about)
    true = (GRID - about) @ stretch.T + about + [0.4, 0.2]
    flat = np.tile(np.eye(2), (len(GRID), 1, 1))
    sideways, upright = (np.tile(d, (len(GRID), 1)) for d in ([1.0, 0.0], [0.0, 1.0]))
    errors = [
        np.linalg.norm(align(picture, there, GRID, true + 0.3, flat, d)[0] - true, axis=1) for d in (sideways, upright)
    ]
    assert np.median(errors[0]) < 0.02
    # Along another line than that of the slant it cannot be told.
    assert np.median(errors[1]) > 2 * np.median(errors[0])


def test_unlike_patches_are_unlike(picture):
    other = np.ascontiguousarray(picture[::-1, ::-1])
    flat, along = np.tile(np.eye(2), (len(GRID), 1, 1)), np.tile([1.0, 0.0], (len(GRID), 1))
    assert np.median(align(picture, other, GRID, GRID, flat, along)[1]) < 0.75


def test_normalised_pictures_forget_exposure(picture):
    a, b = normalised(picture), normalised(0.5 * picture + 60)
    assert np.abs(a.astype(int) - b).mean() < 3


def test_no_corners_in_a_constant_picture():
    assert find_corners(np.full((40, 50), 90, np.uint8)).shape == (0, 2)


@pytest.mark.parametrize(("rows", "cols"), [(3, 3), (5, 3), (4, 7), (15, 15)])
def test_rim_views_are_eight_around_the_centre(rows, cols):
    centre = ((rows - 1) // 2, (cols - 1) // 2)
    views = rim_views(rows, cols, centre)
    assert len(set(views)) == 8 and centre not in views
    assert all(0 <= r < rows and 0 <= c < cols for r, c in views)


@pytest.mark.parametrize(("rows", "cols"), [(3, 3), (4, 5)])
def test_corner_disparities_against_the_truth(light_still, studio, rows, cols):
    depth, centre = light_still.depths[1], light_still.sources[1].centre_view
    views = studio.views_of(centre, depth, np.random.default_rng(0), 1.0, rows, cols)
    # Vignetting: the rim is darker than the centre.
    views[0] = (views[0] * 0.9).astype(np.uint8)
    source = LightField("a", views, light_still.sources[1].camera)
    corners = light_field_corners(source, light_still.evidence[1], 200)
    at = corners.xy.astype(int)
    error = corners.disparity - studio.disparity_of(depth)[at[:, 1], at[:, 0]]
    assert np.isfinite(error).mean() > 0.8
    assert np.nanmedian(np.abs(error)) < 0.012


def test_disparities_far_from_the_depth_map_are_not_told(light_still):
    source, evidence = light_still.sources[0], light_still.evidence[1]
    wrong = type(evidence)(
        evidence.probability, evidence.planes_px, light_still.evidence[0].disparity + np.float32(0.5),
        evidence.confidence,
    )  # fmt: skip
    picture = picture_of(source.centre_view)
    xy = find_corners(picture.even, 100)
    assert np.isnan(corner_disparities(source, wrong, xy, picture)).mean() > 0.9
