"""Rendering a light field from a photo and its disparity."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.processing.synthesis import fill_nan, render_views, view_field, view_offsets
from tests.processing import scenes


@pytest.fixture(scope="module")
def exact() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centre view, its exact disparity, and the true 5×5 views."""
    photo, depth = scenes.photo()
    disparity = (scenes.BASELINE_M * scenes.FOCAL * (1 / depth - 1 / scenes.FOCUS_M)).astype(np.float32)
    return photo.image, disparity, scenes.light_field("t", 0.0).views


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / np.mean((a.astype(float) - b) ** 2)))


def test_exact_geometry_gives_the_true_views(exact) -> None:
    image, disparity, truth = exact
    z_buffer = render_views(image, disparity, 5, 5)
    fixed = render_views(image, disparity, 5, 5, method="fixed_point")
    inner = np.s_[:, :, 4:-4, 4:-4]
    assert psnr(z_buffer[inner], truth[inner]) > 31
    assert psnr(fixed[inner], truth[inner]) > 31
    flipped = render_views(image, -disparity, 5, 5)
    assert psnr(z_buffer[inner], truth[inner]) > psnr(flipped[inner], truth[inner]) + 6, "the sign matters"


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_the_centre_view_is_the_photo_bit_for_bit(exact, dtype) -> None:
    image, disparity, _ = exact
    image = (image.astype(dtype) * (1 if dtype == np.uint8 else 257)).astype(dtype)
    views = render_views(image, disparity, 3, 3)
    assert views.dtype == dtype and np.array_equal(views[1, 1], image)


def test_even_grids_have_no_centre_view(exact) -> None:
    image, disparity, _ = exact
    assert (0.0, 0.0) not in view_offsets(2, 2)
    assert render_views(image, disparity, 2, 2).shape == (2, 2, *image.shape)


def test_flat_scene_moves_by_its_disparity() -> None:
    image = np.random.default_rng(0).integers(0, 256, (20, 24, 3)).astype(np.uint8)
    views = render_views(image, np.full((20, 24), 2.0, np.float32), 3, 3)
    # the point at (x, y) is at (x − δ, y) in the view one step to the right
    assert np.array_equal(views[1, 2][:, :-3], image[:, 2:-1])
    assert np.array_equal(views[2, 1][:-3], image[2:-1])


def test_hidden_pixels_lie_behind_the_near_surface(exact) -> None:
    _, disparity, _ = exact
    field, hidden = view_field(disparity, 0.0, 2.0)
    assert hidden.any() and np.isfinite(field).all()
    assert np.median(field[hidden]) < disparity.mean()


def test_nan_is_filled_from_the_far_side() -> None:
    disparity = np.full((9, 12), 1.0, np.float32)
    disparity[:, :6] = -1.0
    disparity[3:5, 6] = np.nan  # beside the far surface
    filled = fill_nan(disparity)
    assert (filled[3:5, 6] == -1.0).all() and np.isfinite(filled).all()
    assert (fill_nan(np.full((3, 3), np.nan, np.float32)) == 0).all()
