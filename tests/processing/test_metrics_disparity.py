from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.contracts.errors import BadInput
from lfrig.processing.metrics import (
    BORDER_PX,
    depth_edges,
    disparity_scores,
    inner_region,
    linear_alignment,
    textureless,
)

SHAPE = (64, 96)


def noise(seed: int, sigma: float = 0.1) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, sigma, SHAPE).astype(np.float32)


def smooth_truth() -> np.ndarray:
    y, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float32)
    return (0.6 * np.sin(x / 17) + 0.01 * y).astype(np.float32)


def test_the_truth_itself_is_perfect() -> None:
    truth = smooth_truth()
    scores = disparity_scores(truth, truth)
    for name in ("all", "aligned"):
        s = scores[name]
        assert s.mse < 1e-12 and s.q25 < 1e-6 and s.unknown == 0
        assert (s.ppe_005, s.ppe_010) == (100.0, 100.0)
        assert (s.badpix_007, s.badpix_003, s.badpix_001) == (0.0, 0.0, 0.0)
    assert scores["all"].pixels == (SHAPE[0] - 2 * BORDER_PX) * (SHAPE[1] - 2 * BORDER_PX)


@pytest.mark.parametrize(
    ("shift", "ppe_005", "ppe_010", "badpix_007", "badpix_003", "badpix_001"),
    [
        (0.02, 100, 100, 0, 0, 100),
        (0.06, 0, 100, 0, 100, 100),
        (-0.09, 0, 100, 100, 100, 100),
        (0.2, 0, 0, 100, 100, 100),
    ],
)
def test_a_constant_error_by_hand(
    shift: float, ppe_005: float, ppe_010: float, badpix_007: float, badpix_003: float, badpix_001: float
) -> None:
    truth = smooth_truth()
    scores = disparity_scores(truth + np.float32(shift), truth)
    s = scores["all"]
    assert s.mse == pytest.approx(shift**2, rel=1e-4)
    assert s.rmse == pytest.approx(abs(shift), rel=1e-4)
    assert s.q25 == pytest.approx(abs(shift), rel=1e-4)
    inner = truth[inner_region(SHAPE)]
    assert s.rmse_over_range == pytest.approx(abs(shift) / (inner.max() - inner.min()), rel=1e-4)
    assert (s.ppe_005, s.ppe_010) == (ppe_005, ppe_010)
    assert (s.badpix_007, s.badpix_003, s.badpix_001) == (badpix_007, badpix_003, badpix_001)
    assert scores["aligned"].mse < 1e-10


def test_the_border_is_not_scored() -> None:
    truth = smooth_truth()
    estimate = np.full(SHAPE, 99, np.float32)
    estimate[inner_region(SHAPE)] = truth[inner_region(SHAPE)]
    assert disparity_scores(estimate, truth)["all"].mse < 1e-12


def test_unknown_pixels_are_bad_and_stand_for_the_median() -> None:
    truth = np.zeros(SHAPE, np.float32)
    estimate = np.full(SHAPE, 0.02, np.float32)
    rows, cols = inner_region(SHAPE)
    estimate[rows.start : rows.start + 2, cols] = np.nan
    s = disparity_scores(estimate, truth)["all"]
    part = 100 * s.unknown / s.pixels
    assert s.unknown == 2 * (cols.stop - cols.start)
    # The median, .02 px, is a small error; the pixel is bad all the same.
    assert s.mse == pytest.approx(0.02**2, rel=1e-4)
    assert s.ppe_005 == pytest.approx(100 - part) and s.ppe_010 == pytest.approx(100 - part)
    assert s.badpix_007 == pytest.approx(part) and s.badpix_003 == pytest.approx(part)


def test_nothing_known_still_gives_a_finite_score() -> None:
    s = disparity_scores(np.full(SHAPE, np.nan, np.float32), smooth_truth())["all"]
    assert np.isfinite(s.mse) and s.ppe_010 == 0 and s.badpix_007 == 100 and s.unknown == s.pixels


def test_pixels_without_truth_are_not_scored() -> None:
    truth = smooth_truth()
    truth[20:30, 20:40] = np.nan
    estimate = np.where(np.isnan(truth), np.float32(7), truth)
    s = disparity_scores(estimate, truth)["all"]
    assert s.mse < 1e-12 and s.pixels == (SHAPE[0] - 30) * (SHAPE[1] - 30) - 200


def test_no_truth_at_all_is_refused() -> None:
    with pytest.raises(BadInput, match="no pixel"):
        disparity_scores(smooth_truth(), np.full(SHAPE, np.nan, np.float32))


def test_other_sizes_are_refused() -> None:
    with pytest.raises(BadInput, match="the truth"):
        disparity_scores(smooth_truth()[:-1], smooth_truth())
    with pytest.raises(BadInput, match="border"):
        inner_region((30, 96))


@given(seed=st.integers(0, 99), scale=st.floats(0.1, 10) | st.floats(-10, -0.1), offset=st.floats(-5, 5))
def test_alignment_undoes_any_affine_change(seed: int, scale: float, offset: float) -> None:
    truth = smooth_truth()
    estimate = truth + noise(seed)
    changed = (scale * estimate + offset).astype(np.float32)
    before, after = disparity_scores(estimate, truth)["aligned"], disparity_scores(changed, truth)["aligned"]
    assert after.mse == pytest.approx(before.mse, rel=1e-3)
    assert after.ppe_005 == pytest.approx(before.ppe_005, abs=0.2)


@given(seed=st.integers(0, 99), sigma=st.floats(0.001, 1))
def test_alignment_never_raises_the_mse(seed: int, sigma: float) -> None:
    truth = smooth_truth()
    scores = disparity_scores(truth + noise(seed, sigma), truth)
    assert scores["aligned"].mse <= scores["all"].mse * (1 + 1e-5)


@given(seed=st.integers(0, 99))
def test_scores_do_not_depend_on_where_the_pixels_are(seed: int) -> None:
    truth, estimate = smooth_truth(), smooth_truth() + noise(seed)
    order = np.random.default_rng(seed).permutation(truth.size)
    moved = disparity_scores(estimate.ravel()[order].reshape(SHAPE), truth.ravel()[order].reshape(SHAPE), border_px=0)
    kept = disparity_scores(estimate, truth, border_px=0)
    assert moved["all"].model_dump() == pytest.approx(kept["all"].model_dump(), rel=1e-5)


def test_thresholds_are_ordered() -> None:
    s = disparity_scores(smooth_truth() + noise(3, 0.05), smooth_truth())["all"]
    assert s.ppe_005 < s.ppe_010
    assert s.badpix_007 < s.badpix_003 < s.badpix_001
    assert s.ppe_005 < 100 - s.badpix_007 < s.ppe_010


def test_constant_estimates_align_to_the_mean() -> None:
    truth = smooth_truth()
    scale, offset = linear_alignment(np.full(SHAPE, 3, np.float32), truth)
    assert scale == 0 and offset == pytest.approx(truth.mean(dtype=np.float64))
    assert linear_alignment(np.full(SHAPE, np.nan, np.float32), truth) == (1.0, 0.0)


def test_edges_are_where_depth_jumps_not_where_it_slants() -> None:
    depth = np.full(SHAPE, 0.6, np.float32)
    depth[:, 50:] = 0.45
    edges = depth_edges(1 / depth)
    assert edges[:, 46:54].all() and edges.sum() == 8 * SHAPE[0]
    _, x = np.mgrid[0 : SHAPE[0], 0 : SHAPE[1]].astype(np.float32)
    # A plane at 60° to the axis: X = x z / F, z = z0 + tan(60°) X.
    slanted = 1 / 0.5 * (1 - np.tan(np.pi / 3) * (x - 48) / 190)
    assert not depth_edges(slanted.astype(np.float32)).any()


def test_edges_do_not_depend_on_the_unit() -> None:
    w = 2 + smooth_truth() + (smooth_truth() > 0.3) * np.float32(0.5)
    assert (depth_edges(w) == depth_edges(w * np.float32(1000))).all() and depth_edges(w).any()


def test_textureless_tells_flat_from_textured_and_ramps_by_their_slope() -> None:
    image = np.full((*SHAPE, 3), 120, np.uint8)
    image[:, 48:] = np.random.default_rng(0).integers(60, 180, (SHAPE[0], 48, 3))
    flat = textureless(image)
    assert flat[:, :40].all() and not flat[:, 56:].any()
    x = np.arange(SHAPE[1])
    for slope, expected in ((1, True), (2.6, False)):
        ramp = np.broadcast_to((x * slope).clip(0, 255)[None, :, None], (*SHAPE, 3)).astype(np.uint8)
        assert (textureless(ramp)[:, 10:86] == expected).all()


def test_classes_follow_their_masks() -> None:
    truth = np.zeros(SHAPE, np.float32)
    truth[:, 48:] = 0.5
    estimate = truth.copy()
    w = 2 + truth
    estimate[depth_edges(w)] += 0.3
    image = np.full((*SHAPE, 3), 120, np.uint8)
    scores = disparity_scores(estimate, truth, inverse_depth=w, photo=image)
    assert scores["edge"].mse == pytest.approx(0.09, rel=1e-4)
    assert scores["edge"].pixels == int(depth_edges(w)[inner_region(SHAPE)].sum())
    assert scores["textureless"] == scores["all"]
    assert scores["all"].mse == pytest.approx(0.09 * scores["edge"].pixels / scores["all"].pixels, rel=1e-4)
    without = disparity_scores(estimate, truth, inverse_depth=np.ones(SHAPE, np.float32))
    assert "edge" not in without and "textureless" not in without
