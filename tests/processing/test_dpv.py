"""Disparity evidence of one light field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.errors import BadInput
from lfrig.processing.depth import estimate_disparity
from lfrig.processing.dpv import DpvSettings, auto_range, light_field_evidence, plane_grid
from lfrig.processing.kernels.sgm import PATHS, Penalties
from lfrig.processing.kernels.softmax import sgm_softmax
from lfrig.processing.model import LightField
from lfrig.processing.noise_floor import noise_of_cost
from tests.processing import scenes


@pytest.fixture(scope="module")
def light_field() -> LightField:
    return scenes.light_field("a", 0.0)


def true_disparity(centre_x: float = 0.0) -> np.ndarray:
    depth = scenes.look(centre_x, 0.0)[1]
    return scenes.BASELINE_M * scenes.FOCAL * (1 / depth - 1 / scenes.FOCUS_M)


def test_disparity_is_right_in_sign_and_size(light_field: LightField) -> None:
    found = estimate_disparity(light_field)
    error = np.abs(found.disparity - true_disparity())[5:-5, 5:-5]
    assert np.median(error) < 0.02 and (error < 0.07).mean() > 0.93
    assert found.disparity.dtype == np.float32 and 0 <= found.confidence.min() <= found.confidence.max() <= 1


def test_evidence_is_a_distribution(light_field: LightField) -> None:
    evidence = light_field_evidence(light_field, (-0.5, 0.5))
    sums = evidence.probability.astype(int).sum(2)
    assert (np.abs(sums - 65535) < evidence.planes).all()
    assert evidence.planes_px[0] == -0.5 and evidence.views_used == 25


def test_auto_range_holds_the_scene(light_field: LightField) -> None:
    lo, hi = auto_range(light_field)
    truth = true_disparity()
    assert -1.2 < lo < truth.min() and truth.max() < hi < 1.2


def occluding_square() -> tuple[LightField, np.ndarray]:
    """A near square with weak texture before a far wall with weaker texture, whole-pixel disparities 0 and 2."""
    rng = np.random.default_rng(1)
    wall = rng.normal(100, 3.0, (60, 80)).astype(np.float32)
    square = rng.normal(160, 8.0, (60, 80)).astype(np.float32)
    views = np.empty((5, 5, 60, 80, 3), np.uint8)
    for r in range(5):
        for c in range(5):
            view, moved = wall.copy(), np.roll(square, (-2 * (r - 2), -2 * (c - 2)), (0, 1))
            box = np.zeros((60, 80), bool)
            box[20 - 2 * (r - 2) : 40 - 2 * (r - 2), 25 - 2 * (c - 2) : 55 - 2 * (c - 2)] = True
            view[box] = moved[box]
            views[r, c] = np.clip(view, 0, 255)[..., None]
    truth = np.zeros((60, 80), np.float32)
    truth[20:40, 25:55] = 2.0
    return LightField("square", views), truth


def test_half_apertures_sharpen_depth_edges() -> None:
    square, truth = occluding_square()
    errors = [
        np.mean(
            (light_field_evidence(square, (-0.5, 2.5), replace(DpvSettings(), occlusion_aware=on)).disparity - truth)
            ** 2
        )
        for on in (True, False)
    ]
    assert errors[0] < 0.7 * errors[1]


def test_noise_is_measured_and_survived(light_field: LightField) -> None:
    rng = np.random.default_rng(0)
    noisy = np.clip(light_field.views + rng.normal(0, 8, light_field.views.shape) + 0.5, 0, 255).astype(np.uint8)
    evidence = light_field_evidence(replace(light_field, views=noisy), (-0.5, 0.5))
    # luma of three independent channels: 8 · sqrt(.299² + .587² + .114²) = 5.4
    assert 4.0 < evidence.noise_sigma < 7.5
    assert np.median(np.abs(evidence.disparity - true_disparity())) < 0.04


def test_constant_views_are_refused() -> None:
    with pytest.raises(BadInput) as refusal:
        estimate_disparity(LightField("dark", np.full((3, 3, 20, 30, 3), 7, np.uint8)))
    assert refusal.value.code == "constant-image" and "dark" in refusal.value.message


@pytest.mark.parametrize("bad", [(1.0, 1.0), (1.0, -1.0), (np.nan, 1.0), (-np.inf, 1.0)])
def test_empty_range_is_refused(light_field: LightField, bad: tuple[float, float]) -> None:
    with pytest.raises(BadInput, match="range"):
        light_field_evidence(light_field, bad)


def test_plane_grid_covers_the_range() -> None:
    grid = plane_grid((-1.0, 1.2), DpvSettings())
    assert grid.first == -1.0 and grid.values()[-1] == pytest.approx(1.2) and grid.step <= 0.0221
    assert plane_grid((-50, 50), DpvSettings()).count == DpvSettings().max_planes


def test_the_peak_is_not_pulled_by_a_uniform_floor() -> None:
    """A 50 % floor pulls a mean over all planes by ten planes, the windowed one not at all."""
    planes = np.arange(100)
    p = np.exp(-0.5 * ((planes - 30.3) / 1.2) ** 2)
    p = 0.5 * p / p.sum() + 0.5 / 100
    cost = np.rint(-1000 * np.log(p)).astype(np.uint16)
    penalties = Penalties.of(np.zeros((1, 1, 3), np.uint8), 1.0, 2.0, 30.0)
    _, index, _ = sgm_softmax(cost[None, None], penalties, 1e-3 / PATHS, 3)  # a lone pixel's paths all cost the same
    assert index[0, 0] == pytest.approx(30.3, abs=0.1)


def test_noise_of_a_perfect_match_is_zero() -> None:
    assert noise_of_cost(np.zeros((8, 8, 4), np.uint16)) == 0


def test_same_bytes_for_any_thread_count(light_field: LightField) -> None:
    one, three = (light_field_evidence(light_field, (-0.5, 0.5), threads=n) for n in (1, 3))
    assert one.probability.tobytes() == three.probability.tobytes()
    assert one.disparity.tobytes() == three.disparity.tobytes()


def overexposed_print(disparity: float) -> LightField:
    """Thin dark strokes on paper that clips, uint8 views 7×7 of 96×64 px; pixels are means of 8×8 samples."""
    rng = np.random.default_rng(5)
    fine, margin = 8, 4
    height, width = (64 + 2 * margin) * fine, (96 + 2 * margin) * fine
    paper = np.full((height, width), 1.0, np.float32)
    for _ in range(420):
        y, x = rng.integers(0, height - 40), rng.integers(0, width - 40)
        tall, wide = ((6, 36), (36, 6))[rng.integers(2)]
        paper[y : y + tall, x : x + wide] = 0.05
    views = np.empty((7, 7, 64, 96, 3), np.uint8)
    for r in range(7):
        for c in range(7):
            dy, dx = (margin * fine + round(fine * disparity * (i - 3)) for i in (r, c))
            part = paper[dy : dy + 64 * fine, dx : dx + 96 * fine].reshape(64, fine, 96, fine).mean((1, 3))
            views[r, c] = np.clip(np.rint(330 * part), 0, 255)[..., None]
    return LightField("print", views)


def test_clipped_strokes_do_not_draw_disparity_to_zero() -> None:
    light_field = overexposed_print(0.25)
    softened, sharp = (
        light_field_evidence(light_field, (-0.6, 0.7), DpvSettings(clipped_blur_px=blur)).disparity[6:-6, 6:-6]
        for blur in (1.0, 0.0)
    )
    assert abs(np.median(sharp)) < 0.05 and (np.abs(sharp - 0.25) < 0.08).mean() < 0.1
    assert abs(np.median(softened) - 0.25) < 0.05 and (np.abs(softened - 0.25) < 0.08).mean() > 0.6


def test_views_that_do_not_clip_are_left_alone() -> None:
    light_field = scenes.light_field("a", 0.0)
    softened, sharp = (
        light_field_evidence(light_field, (-0.5, 0.5), DpvSettings(clipped_blur_px=blur)).probability
        for blur in (1.0, 0.0)
    )
    assert np.array_equal(softened, sharp)
