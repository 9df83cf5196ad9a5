"""Training and calibration of the confidence model."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.bench import confidence_fit
from lfrig.bench.calibrate_confidence import collect, curve_table, figures, fit, table
from lfrig.bench.confidence_fit import Shot, draw, logit_curve, sigma_curve, train
from lfrig.processing.confidence.model import shipped_model
from lfrig.processing.metrics import reliability, sparsification

NAMES = ("tells", "noise")


def shot(scene: str, seed: int, pixels: int = 6000) -> Shot:
    """Errors of exponential size that one feature tells over two decades, and a feature that tells nothing."""
    rng = np.random.default_rng(seed)
    features = rng.uniform(-1, 1, (2, pixels)).astype(np.float32)
    expected = np.float32(0.03) * np.exp(2.3 * features[0])
    error = expected * rng.exponential(1, pixels).astype(np.float32) * rng.choice([-1, 1], pixels)
    return Shot(scene, "2 sources", features.astype(np.float16), error.astype(np.float32), 1.0)


@pytest.fixture(scope="module")
def fitted():  # type: ignore[no-untyped-def]
    shots = [shot(scene, seed) for seed, scene in enumerate("abc")]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(confidence_fit, "BATCH", 512)
        return fit(NAMES, shots, epochs=40)


def test_the_expected_error_is_found(fitted) -> None:  # type: ignore[no-untyped-def]
    fresh = shot("d", 9)
    expected = np.log(0.03) + 2.3 * fresh.features[0].astype(np.float32)
    found = fitted[0].log_error(fresh.features.astype(np.float32))
    assert np.corrcoef(found, expected)[0, 1] > 0.98
    assert np.abs(found - expected).mean() < 0.2


def test_figures_are_cross_validated_and_good(fitted) -> None:  # type: ignore[no-untyped-def]
    rows = fitted[1]
    assert [row["scene"] for row in rows] == ["a", "b", "c"]
    # What the best ranking reaches on errors that are random around what is expected.
    best = [
        sparsification(s.error_px, -s.features[0].astype(np.float32)).ause_of_random for s in map(shot, "abc", range(3))
    ]
    assert [row["ause_of_random"] for row in rows] == pytest.approx(best, abs=0.03)
    assert all(row["ece"] < 0.04 for row in rows)
    assert all(0.64 < row["within_sigma"] < 0.73 for row in rows)


def test_drawing_prefers_wrong_pixels_and_weighs_for_it() -> None:
    one = shot("a", 5, 20000)
    sample = draw([one], pixels=4000)
    assert 2500 < len(sample.error_px) < 5000 and sample.weight.sum() == pytest.approx(1, abs=1e-4)
    assert (sample.error_px > 0.03).mean() > (np.abs(one.error_px) > 0.03).mean() + 0.1
    assert np.average(sample.error_px, weights=sample.weight) == pytest.approx(np.abs(one.error_px).mean(), rel=0.1)


def test_gradients_are_those_of_the_loss() -> None:
    rng = np.random.default_rng(0)
    shapes = ((4, 3), (4,), (1, 4), (1,))
    parameters = [rng.normal(0, 0.5, shape).astype(np.float32) for shape in shapes]
    values, error = rng.normal(0, 1, (8, 3)).astype(np.float32), rng.uniform(0.5, 2, 8).astype(np.float32)
    weight = np.ones(8, np.float32)
    found = confidence_fit._gradients(parameters, values, error, weight)

    def loss() -> float:
        hidden = values.astype(np.float64) @ parameters[0].T + parameters[1]
        log_b = np.maximum(hidden, 0.05 * hidden) @ parameters[2].T + parameters[3]
        decay = 0.5 * confidence_fit.DECAY * sum((w.astype(np.float64) ** 2).sum() for w in parameters[::2])
        return float((log_b[:, 0] + error / np.exp(log_b[:, 0])).mean() + decay)

    for parameter, gradient in zip(parameters, found, strict=True):
        at = (0,) * parameter.ndim
        kept, step = parameter[at], np.float32(1e-2)
        parameter[at] = kept + step
        above = loss()
        parameter[at] = kept - step
        below = loss()
        parameter[at] = kept
        assert gradient[at] == pytest.approx((above - below) / 0.02, abs=2e-3)


def test_curves_are_monotone_and_calibrated() -> None:
    shots = [shot("a", 0, 40000)]
    log_errors = [(np.log(0.03) + 2.3 * shots[0].features[0]).astype(np.float32)]
    sigma = sigma_curve(log_errors, shots)
    assert (np.diff(sigma.y) > 0).all()
    # 68.3 % of an exponential distribution lie below 1.149 means.
    assert sigma(np.array([-3.5], np.float32))[0] == pytest.approx(-3.5 + np.log(1.149), abs=0.15)
    logit = logit_curve(log_errors, shots)
    assert (np.diff(logit.y) < 0).all()
    chance = 1 - np.exp(-0.1 / np.exp(-2.0))
    assert 1 / (1 + np.exp(-logit(np.array([-2.0], np.float32))[0])) == pytest.approx(chance, abs=0.05)


def test_training_repeats_itself() -> None:
    sample = draw([shot("a", 0)])
    first, second = (train(NAMES, sample, epochs=2) for _ in range(2))
    assert all(np.array_equal(a.weight, b.weight) for a, b in zip(first.layers, second.layers, strict=True))


def test_tables_name_scenes_and_means() -> None:
    rng = np.random.default_rng(0)
    error, p = rng.normal(0, 0.1, 500).astype(np.float32), rng.uniform(0, 1, 500).astype(np.float32)
    rows = [figures(scene, "2 sources", error, p, np.full_like(p, 0.1)) for scene in ("a", "b")]
    lines = table(rows).splitlines()
    assert len(lines) == 5 and lines[-1].startswith("| **mean** | 2 sources |")
    curves = curve_table({"2 sources": reliability(error, p)}).splitlines()
    assert len(curves) == 12 and curves[2].startswith("| 2 sources | ")


def test_pixels_are_collected_from_runs_of_the_pipeline(tmp_path, monkeypatch) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    names, shots = collect(["blocks"], (96, 67), threads=1)
    assert names == shipped_model().names
    assert [(s.scene, s.features.shape[0]) for s in shots] == [("blocks", len(names))] * 3
    assert all(np.isfinite(s.features).all() and s.features.shape[1] == s.error_px.size for s in shots)
