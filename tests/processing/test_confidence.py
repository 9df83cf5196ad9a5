"""Clues, features and the model of the confidence."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.processing.confidence import Clues, ConfidenceModel, estimate, feature_maps, shipped_model
from lfrig.processing.confidence.model import Curve
from lfrig.processing.kernels.perceptron import Layer
from lfrig.processing.model import Camera, Evidence, LightField, Pose, ScaleFit, Source
from lfrig.processing.plane_fit import Planes
from lfrig.processing.visibility import land
from lfrig.processing.wide_baseline import WideMatch

HEIGHT, WIDTH = 40, 60
CAMERA = Camera(WIDTH, HEIGHT, 100.0, 29.5, 19.5)
HERE = Pose(np.eye(3), np.zeros(3))
SCALE = ScaleFit(a=1.5, c=2.0)


def plane(value: float = 2.2) -> np.ndarray:
    return np.full((HEIGHT, WIDTH), value, np.float32)


def source(inverse_depth: np.ndarray, shift_m: float = 0.0) -> Source:
    rng = np.random.default_rng(0)
    views = rng.integers(0, 255, (3, 3, HEIGHT, WIDTH, 3), np.uint8)
    evidence = Evidence(
        np.zeros((1, 1, 1), np.uint16), (-1.0, 0.1), SCALE.disparity(inverse_depth), 0.9 + 0 * inverse_depth
    )
    return Source(LightField("s", views), CAMERA, Pose(np.eye(3), np.array([shift_m, 0, 0])), evidence, SCALE)


def clues(surface: np.ndarray, seen_by: np.ndarray | None = None, peak: float = 0.999, accepted: bool = True) -> Clues:
    """Of a surface that nothing moved, seen by one source that stands where the camera stands."""
    flat = np.zeros_like(surface)
    one = flat + 1
    sources = [source(surface if seen_by is None else seen_by)]
    match = WideMatch(surface, 0.1 * one, one, np.full(surface.shape, accepted), 0.5 * one, one)
    photo = np.random.default_rng(1).integers(0, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    landings = [land(surface, s, CAMERA, HERE) for s in sources]
    return Clues(
        surface,
        peak * one,
        Planes(surface, flat, flat),
        match,
        surface,
        surface,
        photo,
        sources,
        landings,
        CAMERA,
        HERE,
    )


def model() -> ConfidenceModel:
    """log E|error| = that of the evidence beside the peak, which is itself log10."""
    up = Curve(np.array([-8.0, 0.0]), np.array([-8.0, 0.0]))
    return ConfidenceModel(
        ("rest",), np.array([-3.0], np.float32), np.array([1.0], np.float32),
        (Layer(np.ones((1, 1), np.float32), np.array([-3.0], np.float32)),), up, Curve(up.x, -up.y),
    )  # fmt: skip


def test_features_are_finite_and_in_the_order_of_the_model() -> None:
    surface = plane()
    surface[:, 30:] = 2.4
    maps = feature_maps(clues(surface))
    assert tuple(maps) == shipped_model().names
    for values in maps.values():
        assert values.dtype == np.float32 and values.shape == surface.shape and np.isfinite(values).all()


def test_features_tell_steps_and_sides() -> None:
    surface = plane()
    surface[:, 30:] = 2.4
    maps = feature_maps(clues(surface))
    distance, side = 10 ** maps["step_distance"][20], maps["step_side"][20]
    assert distance[29] < 1 and distance[30] < 1 and distance[20] == pytest.approx(9.5, abs=0.6)
    assert (side[24:30] < 0).all() and (side[30:36] > 0).all() and side[5] == 0
    height = 0.2 / SCALE.a
    assert 10 ** maps["step_height"][20, 25] == pytest.approx(height, rel=1e-3)
    assert 10 ** maps["relief_13"][20, 28] == pytest.approx(height, rel=1e-3)
    assert maps["relief_rank"][20, 25] < 0 < maps["relief_rank"][20, 35]
    flat = feature_maps(clues(plane()))
    assert (flat["step_side"] == 0).all() and flat["relief_25"] == pytest.approx(-3)


def test_features_tell_agreement_and_what_floats() -> None:
    agreeing = feature_maps(clues(plane()))
    assert (
        (agreeing["agreeing"] == 1).all()
        and agreeing["floats"] == pytest.approx(-2)
        and (agreeing["visible"] == 1).all()
    )
    # The source sees a wall half a pixel behind the surface: through it.
    floating = feature_maps(clues(plane(), seen_by=plane(2.2 - 0.5 * SCALE.a)))
    assert (floating["agreeing"] == 0).all() and 10 ** floating["floats"].mean() == pytest.approx(0.45, rel=1e-3)
    hidden = feature_maps(clues(plane(), seen_by=plane(2.2 + 0.5 * SCALE.a)))
    assert (hidden["visible"] == 0).all() and hidden["floats"] == pytest.approx(-2)
    assert hidden["ahead"] == pytest.approx(0)


def test_support_is_the_nearest_pixel_that_all_speaks_for() -> None:
    surface = plane()
    surface[:, 40:] = 2.5
    peak = np.full(surface.shape, 0.999, np.float32)
    peak[:, 40:] = 0.5
    maps = feature_maps(replace(clues(surface), peak=peak))
    assert 10 ** maps["support_distance"][20, 39] == pytest.approx(0.5)
    assert 10 ** maps["support_distance"][20, 49] == pytest.approx(10.5, abs=0.6)
    assert 10 ** maps["support_gap"][20, 49] == pytest.approx(0.3 / SCALE.a, rel=1e-3)
    nowhere = feature_maps(clues(surface, accepted=False))
    assert (nowhere["support_share"] == 0).all() and nowhere["support_gap"] == pytest.approx(-3)
    assert 10 ** nowhere["support_distance"].min() == pytest.approx(80.5)


def test_sigma_and_confidence_rank_alike_and_keep_their_order_among_good_pixels() -> None:
    surface = plane()
    peak = 1 - np.geomspace(1e-6, 0.9, surface.size).reshape(surface.shape).astype(np.float32)
    confidence, sigma = estimate(replace(clues(surface), peak=peak), 1 / SCALE.a, model())
    assert confidence.dtype == sigma.dtype == np.float32
    assert (confidence > 0).all() and (confidence < 1).all()
    falling = np.argsort(-peak.ravel(), kind="stable")
    assert (np.diff(sigma.ravel()[falling]) >= 0).all() and (np.diff(confidence.ravel()[falling]) <= 0).all()
    assert len(np.unique(confidence)) > 0.9 * len(np.unique(peak))


def test_sigma_is_in_pixels_of_what_is_asked_for() -> None:
    given = clues(plane())
    small, large = (estimate(given, px / SCALE.a, model())[1] for px in (1.0, 3.0))
    assert large == pytest.approx(3 * small)


def test_an_open_scale_moves_all_depths() -> None:
    given = clues(plane())
    _, own = estimate(given, 0.7, model())
    loose = replace(HERE, sigma_m=0.02)
    unsure = replace(given, pose=loose, sources=[replace(s, pose=loose) for s in given.sources])
    confidence, sigma = estimate(unsure, 0.7, model())
    assert unsure.scale_sigma == pytest.approx(0.02 * 2.2)
    assert sigma == pytest.approx(np.hypot(own, 0.7 * 2.2 * 0.02 * 2.2), rel=1e-4)
    assert (confidence < estimate(given, 0.7, model())[0]).all()


def test_the_shipped_model_trusts_what_everything_speaks_for() -> None:
    sure, sigma_sure = estimate(clues(plane()), 0.7)
    behind = plane(2.2 - 0.5 * SCALE.a)
    poor, sigma_poor = estimate(clues(plane(), seen_by=behind, peak=0.4, accepted=False), 0.7)
    middle = np.s_[10:-10, 10:-10]
    assert sure[middle].min() > 0.99 and (poor < sure)[middle].all()
    assert (sigma_poor > 1.2 * sigma_sure)[middle].all()


def test_curves_go_straight_on() -> None:
    curve = Curve(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0]))
    values = np.array([-1, 0.5, 1.5, 4], np.float32)
    assert curve(values) == pytest.approx([-1, 0.5, 2, 7])


def test_the_model_survives_its_file() -> None:
    shipped = shipped_model()
    again = ConfidenceModel.from_json(shipped.to_json())
    features = np.random.default_rng(0).normal(0, 1, (len(shipped.names), 20000)).astype(np.float32)
    assert again.names == shipped.names
    assert again.log_error(features) == pytest.approx(shipped.log_error(features), abs=1e-4)
    # A block's result does not depend on what else is in the picture.
    assert np.array_equal(shipped.log_error(features)[:8192], shipped.log_error(features[:, :8192]))
    assert (np.diff(shipped.sigma.y) > 0).all() and (np.diff(shipped.logit.y) < 0).all()
