"""The scale fit: exact on exact data, robust, affine-equivariant, and refusing by name what it cannot trust."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing import scale_fit
from lfrig.processing.dpv import light_field_evidence
from lfrig.processing.export.pfm import read_pfm
from lfrig.processing.model import Anchors, Evidence, Optics
from lfrig.processing.scale_fit import ScaleFitSettings, ScalePrior, fit_affine, fit_paper, fit_scale
from tests.processing import scenes


@given(
    slope=st.floats(0.05, 50), offset=st.floats(-20, 20), shift=st.floats(-5, 5), scale=st.floats(0.01, 100),
    seed=st.integers(0, 99),
)  # fmt: skip
def test_the_fit_follows_a_change_of_units(slope: float, offset: float, shift: float, scale: float, seed: int) -> None:
    """Measuring disparity from elsewhere or depth in other units changes (a, c) as algebra says."""
    rng = np.random.default_rng(seed)
    delta = rng.uniform(-1, 1, 60)
    inverse_depth = slope * delta + offset + rng.normal(0, 0.01 * slope, 60)
    plain = fit_affine(delta, inverse_depth)
    moved = fit_affine(delta + shift, scale * inverse_depth)
    assert moved.a == pytest.approx(scale * plain.a, rel=1e-5)
    assert moved.c == pytest.approx(scale * (plain.c - plain.a * shift), rel=1e-5, abs=1e-5 * scale * slope)


def test_thirty_percent_outliers_and_a_zero_crossing() -> None:
    errors, paper = [], []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        delta = rng.uniform(-0.6, 0.8, 800)
        inverse_depth = 1.43 * delta + 2.17
        noisy = delta + rng.normal(0, 0.02, 800)
        bad = rng.random(800) < 0.3
        observed = np.where(bad, rng.uniform(1.2, 3.4, 800), inverse_depth)
        fit = fit_affine(noisy, observed)
        errors.append(np.median(np.abs((fit.a * delta + fit.c) / inverse_depth - 1)))
        alpha, beta = fit_paper(noisy, 1 / observed)
        paper.append(np.median(np.abs((alpha / delta + beta) * inverse_depth - 1)))
        assert 0.6 < fit.inliers < 0.8
    assert max(errors) < 0.005
    assert np.median(paper) > 20 * max(errors), "the depth form has its pole inside this scene"


def test_cotton_scale(shared_data: Path) -> None:
    """On cotton's ground truth 1/a = 36.57 (f·b of its parameters.cfg), also with 30 % outliers."""
    disparity = read_pfm(shared_data / "hci_cotton/gt_disp_lowres.pfm").astype(float).ravel()
    depth = read_pfm(shared_data / "hci_cotton/gt_depth_lowres.pfm").astype(float).ravel()
    fit = fit_affine(disparity, 1 / depth)
    assert 1 / fit.a == pytest.approx(36.57, abs=0.05)
    rng = np.random.default_rng(0)
    pick = rng.integers(0, depth.size, 2000)
    observed = 1 / depth[pick]
    bad = rng.random(2000) < 0.3
    observed[bad] = rng.uniform(observed.min(), observed.max(), int(bad.sum()))
    fit = fit_affine(disparity[pick] + rng.normal(0, 0.02, 2000), observed)
    assert disparity.min() < 0 < disparity.max()
    assert np.median(np.abs((fit.a * disparity + fit.c) * depth - 1)) < 0.005


@pytest.fixture(scope="module")
def capture():  # type: ignore[no-untyped-def]
    """A light field without recorded optics, its evidence and exact anchors."""
    from dataclasses import replace

    lf = replace(scenes.light_field("a", -0.05), optics=Optics())
    return lf, light_field_evidence(lf, (-0.5, 0.5)), scenes.anchors(-0.05)


def fit(capture, anchors: Anchors, monitor: Monitor | None = None, **changes):  # type: ignore[no-untyped-def]
    from dataclasses import replace

    lf, evidence, _ = capture
    return fit_scale(replace(lf, **changes), scenes.CAMERA, anchors, evidence, ScaleFitSettings(), monitor or Monitor())


def some(anchors: Anchors, keep) -> Anchors:  # type: ignore[no-untyped-def]
    return Anchors(anchors.xy[keep], anchors.depth_m[keep], anchors.world[keep])


def both_planes(anchors: Anchors) -> Anchors:
    """Half of the anchors on each plane, so that their disparities spread."""
    near, far = np.flatnonzero(anchors.depth_m < 0.5), np.flatnonzero(anchors.depth_m > 0.5)
    n = min(len(near), len(far))
    return some(anchors, np.r_[near[:n], far[:n]])


def test_anchors_give_the_scale(capture) -> None:
    found = fit(capture, both_planes(capture[2]))
    assert found.a == pytest.approx(1 / (scenes.BASELINE_M * scenes.FOCAL), rel=0.1)
    assert found.c == pytest.approx(1 / scenes.FOCUS_M, rel=0.02)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7])
def test_too_few_anchors_are_refused_by_name(capture, count: int) -> None:
    with pytest.raises(GeometryRefused, match="capture a: scale fit: only") as refusal:
        fit(capture, some(both_planes(capture[2]), slice(0, count)))
    assert refusal.value.code == "too-few-anchors" and refusal.value.exit_code == 4 and refusal.value.remedy


def test_recorded_optics_stand_in_with_a_warning(capture) -> None:
    monitor = Monitor()
    optics = Optics(scenes.BASELINE_M, scenes.FOCUS_M)
    found = fit(capture, some(capture[2], slice(0, 3)), monitor, optics=optics)
    assert found.form == "optics" and found.c == pytest.approx(1 / scenes.FOCUS_M)
    assert [n.code for n in monitor.notices] == ["scale-from-optics"]


def test_one_plane_is_refused_without_a_known_slope(capture) -> None:
    far = some(capture[2], capture[2].depth_m > 0.5)
    with pytest.raises(GeometryRefused) as refusal:
        fit(capture, far)
    assert refusal.value.code == "narrow-anchors"
    known = 1 / (scenes.BASELINE_M * scenes.FOCAL)
    found = fit(capture, far, optics=Optics(scenes.BASELINE_M, scenes.FOCUS_M))
    assert found.a == pytest.approx(known, rel=0.1), "the recorded optics hold the slope"


def test_anchors_that_contradict_the_recorded_optics_are_believed(capture) -> None:
    monitor = Monitor()
    a = both_planes(capture[2])
    many = Anchors(np.tile(a.xy, (8, 1)), np.tile(a.depth_m, 8), np.tile(a.world, (8, 1)))
    wrong = Optics(0.5 * scenes.BASELINE_M, 0.7 * scenes.FOCUS_M)
    found = fit(capture, many, monitor, optics=wrong)
    assert found.a == pytest.approx(1 / (scenes.BASELINE_M * scenes.FOCAL), rel=0.1)
    assert "optics-mismatch" in [n.code for n in monitor.notices]


def test_a_prior_carries_a_fit_that_outliers_would_ruin() -> None:
    rng = np.random.default_rng(3)
    delta = rng.uniform(0.0, 0.12, 20)
    observed = 1.43 * delta + 2.17 + rng.normal(0, 0.02, 20)
    observed[:8] = rng.uniform(2.1, 2.5, 8)
    prior = ScalePrior(1.40, 2.2, 0.05, 0.06)
    assert abs(fit_affine(delta, observed, prior).a - 1.43) < 0.1 < abs(fit_affine(delta, observed).a - 1.43)


def test_reversed_views_are_refused(capture) -> None:
    a = both_planes(capture[2])
    swapped = Anchors(a.xy, 1 / (2 * np.median(1 / a.depth_m) - 1 / a.depth_m), a.world)
    with pytest.raises(GeometryRefused) as refusal:
        fit(capture, swapped)
    assert refusal.value.code == "wrong-sign"


def test_anchors_at_steps_and_borders_are_left_out(capture) -> None:
    _, evidence, _ = capture
    edge = np.abs(np.diff(evidence.disparity, axis=1)).argmax()
    y, x = divmod(int(edge), evidence.disparity.shape[1] - 1)
    xy = np.array([[x + 0.5, y], [0.0, 0.0], [np.nan, 5.0], [30.0, 1e9]])
    _, usable = scale_fit.anchor_disparities(
        Anchors(xy, np.full(4, 0.5), np.zeros((4, 3))), evidence, ScaleFitSettings()
    )
    assert not usable.any()


def test_a_frontal_wall_behind_a_few_near_anchors_does_not_contradict_the_optics() -> None:
    """A line without slope explains the wall best: it must not outvote the recorded optics that explain all."""
    rng = np.random.default_rng(0)
    depth = np.r_[np.full(58, scenes.FAR_M), np.full(9, scenes.NEAR_M)]
    px = scenes.BASELINE_M * scenes.FOCAL
    disparity = np.zeros((scenes.HEIGHT, scenes.WIDTH), np.float32)
    xy = np.stack([10 + 4 * (np.arange(67) % 17), 10 + 8 * (np.arange(67) // 17)], 1).astype(np.float64)
    error = np.r_[0.055, -0.05, rng.normal(0, 0.009, 65)]  # two that a line through the wall alone starts from
    for (x, y), z, e in zip(xy.astype(int), depth, error, strict=True):
        disparity[y : y + 2, x : x + 2] = px * (1 / z - 1 / scenes.FOCUS_M) + e
    sure = np.ones_like(disparity)
    evidence = Evidence(np.zeros((*sure.shape, 4), np.uint16), (-0.5, 0.3), disparity, sure)
    scatter = np.r_[0.001, -0.001, rng.normal(0, 0.002, 65)]
    anchors = Anchors(xy, 1 / (1 / depth + scatter), np.zeros((67, 3)))
    monitor = Monitor()
    fit = fit_scale(scenes.light_field("a", 0.0, 3), scenes.CAMERA, anchors, evidence, ScaleFitSettings(), monitor)
    assert fit.a == pytest.approx(1 / px, rel=0.04) and monitor.notices == []
