"""Rendering a light field from a photo and its disparity."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.processing.kernels.rims import grow, peel
from lfrig.processing.skipping import SKIP_ALL, Tally
from lfrig.processing.synthesis import SynthesisSettings, fill_nan, render_views, view_field, view_offsets
from lfrig.processing.synthesis.matte import split_layers
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
    layered = render_views(image, disparity, 5, 5)
    z_buffer = render_views(image, disparity, 5, 5, method="z_buffer")
    fixed = render_views(image, disparity, 5, 5, method="fixed_point")
    inner = np.s_[:, :, 4:-4, 4:-4]
    assert psnr(z_buffer[inner], truth[inner]) > 31
    assert psnr(fixed[inner], truth[inner]) > 31
    assert psnr(layered[inner], truth[inner]) > 31
    flipped = render_views(image, -disparity, 5, 5)
    assert psnr(layered[inner], truth[inner]) > psnr(flipped[inner], truth[inner]) + 6, "the sign matters"


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


NEAR_GREY, FAR_GREY = np.array([220.0, 200, 40]), np.array([30.0, 60, 120])
NEAR_PX, FAR_PX = 1.0, -0.5


def card(edge_x: float) -> np.ndarray:
    """A plain card over a plain wall, [40, 60, 3]: right of ``edge_x``, which cuts a pixel unless it is k + ½."""
    share = np.clip(np.arange(60) + 0.5 - edge_x, 0, 1)[None, :, None]
    return np.broadcast_to(share * NEAR_GREY + (1 - share) * FAR_GREY, (40, 60, 3)).astype(np.float32)


def card_disparity(edge_x: float) -> np.ndarray:
    row = np.where(np.arange(60) > edge_x, NEAR_PX, FAR_PX).astype(np.float32)
    return np.tile(row, (40, 1))


@pytest.mark.parametrize("edge_x", [29.5, 29.8, 30.0, 30.3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_cut_pixel_leaves_no_fringe(edge_x, dtype) -> None:
    scale = 1 if dtype == np.uint8 else 257
    image = np.rint(card(edge_x) * scale).astype(dtype)
    views = render_views(image, card_disparity(edge_x), 1, 7) / scale
    single = render_views(image, card_disparity(edge_x), 1, 7, method="z_buffer") / scale
    for c in (0, 1, 5, 6):
        # Toward the right of the grid the card moves left and covers; toward the left it uncovers the wall.
        truth = card(edge_x - (c - 3) * NEAR_PX)
        error, before = (np.abs(v[0, c] - truth)[:, 6:-6].max() for v in (views, single))
        assert error < 24, "the spline rings a little at a step"
        if c < 3 and edge_x % 1 != 0.5:
            assert error < 0.5 * before


def test_layers_give_the_photo_again() -> None:
    photo = card(29.7) + np.random.default_rng(0).normal(0, 4, (40, 60, 3)).astype(np.float32)
    layers = split_layers(photo, card_disparity(29.7), 6, SynthesisSettings())
    share = layers.near_grey[..., 3:]
    again = share * layers.near_grey[..., :3] + (1 - share) * layers.far_grey
    rim = np.s_[:, 28:32]
    assert np.abs(again[rim] - photo[rim]).max() < 1e-3
    assert share[10, 30, 0] == pytest.approx(0.8, abs=0.1), "the share of the cut pixel is read off its colour"
    assert (share[:, :28] <= 1).all() and np.array_equal(layers.far_grey[:, :28], photo[:, :28])


def test_the_background_is_continued_as_a_plane() -> None:
    ys, xs = np.mgrid[0:40, 0:50].astype(np.float32)
    plane = 0.01 * xs - 0.02 * ys
    card_ = (xs > 20) & (xs < 40) & (ys > 10) & (ys < 30)
    found = peel(np.where(card_, np.float32(2), plane).astype(np.float32), 0.2, 5)
    rim = (xs >= 21) & (xs <= 25) & (ys > 16) & (ys < 24)
    assert found.peeled[rim].all() and not found.peeled[20, 26] and not found.peeled[~card_].any()
    assert np.abs(found.disparity - plane)[rim].max() < 0.002
    assert np.abs(found.disparity - plane)[found.peeled].max() < 0.06, "corners see less of the plane"
    assert np.array_equal(found.disparity[~found.peeled], np.where(card_, 2, plane).astype(np.float32)[~found.peeled])


def test_nothing_is_behind_the_frame_or_a_slant() -> None:
    ys, xs = np.mgrid[0:30, 0:30].astype(np.float32)
    assert not peel((0.1 * xs + 0.05 * ys).astype(np.float32), 0.2, 5).peeled.any()


def test_grow_takes_from_known_pixels_only() -> None:
    values = np.full((9, 9, 1), 5.0, np.float32)
    values[:, 6:] = 1000  # neither known nor wanted: the foreground
    known, wanted = np.zeros((9, 9), bool), np.zeros((9, 9), bool)
    known[:, :3], wanted[:, 3:6] = True, True
    values[:, 3:6] = -7
    found, now = grow(values, known, wanted, rounds=2)
    assert np.allclose(found[:, :5], 5) and (found[:, 5] == -7).all(), "two rounds, two pixels"
    assert now[:, :5].all() and not now[:, 5:].any()


def test_hidden_pixels_take_no_foreground_colour() -> None:
    xs = np.tile(np.arange(60), (40, 1))
    near = (xs >= 24) & (xs < 40)
    image = np.where(near[..., None], [255, 0, 0], [0, 0, 200]).astype(np.uint8)
    disparity = np.where(near, 1.5, -0.5).astype(np.float32)
    view = render_views(image, disparity, 1, 5)[0, 0].astype(int)  # two steps to the left: the card moves by +3
    moved = (xs >= 27) & (xs < 43)
    uncovered = ~moved & (xs >= 10) & (xs < 50)
    assert view[uncovered][:, 0].max() < 25 and view[moved][:, 0].min() > 230


def test_what_is_smooth_is_counted_as_left_out(exact) -> None:
    image, disparity, _ = exact
    tally, whole = Tally(), Tally()
    render_views(image, disparity, 3, 3, tally=tally)
    render_views(image, disparity, 3, 3, tally=whole, skips=SKIP_ALL.without("certain"))
    count = tally.counts["certain"]
    assert count.done + count.skipped == whole.counts["certain"].done + whole.counts["certain"].skipped
    assert count.done + count.skipped == 9 * disparity.size
    assert whole.counts["certain"].done >= 8 * disparity.size >= count.done


@pytest.mark.parametrize("method", ["layered", "z_buffer"])
def test_views_do_not_depend_on_threads(exact, method) -> None:
    image, disparity, _ = exact
    one, three = (render_views(image, disparity, 3, 3, method=method, threads=n) for n in (1, 3))
    assert np.array_equal(one, three)


def test_16_bits_hold_what_8_bits_hold(exact) -> None:
    image, disparity, _ = exact
    narrow = render_views(image, disparity, 3, 3).astype(int)
    wide = render_views(image.astype(np.uint16) * 257, disparity, 3, 3).astype(int)
    # Half a level is lost in rounding; 8 bits are sampled in fixed point, which moves a value by up to a tenth more.
    assert np.abs(wide - narrow * 257).max() <= 0.6 * 257


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (16, 2)])
def test_tiny_pictures_are_rendered(shape) -> None:
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    views = render_views(image, rng.normal(0, 3, shape).astype(np.float32), 3, 3)
    assert views.shape == (3, 3, *shape, 3)
