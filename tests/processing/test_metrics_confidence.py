from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.contracts.errors import BadInput
from lfrig.processing.metrics import reliability, sparsification


def errors(seed: int = 0, n: int = 5000) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, 0.1, n).astype(np.float32)


def test_a_confidence_that_knows_the_error_is_perfect() -> None:
    e = errors()
    s = sparsification(e, -np.abs(e))
    assert s.ause == pytest.approx(0, abs=1e-9)
    assert s.by_confidence[0] == 1 and (np.diff(s.by_confidence) <= 1e-12).all()


def test_a_constant_confidence_removes_nothing_of_the_error() -> None:
    e = errors()
    s = sparsification(e, np.full_like(e, 0.5))
    assert s.by_confidence == pytest.approx(np.ones(100))
    assert s.ause == pytest.approx(1 - s.by_error.mean())


def test_better_confidences_have_smaller_areas() -> None:
    e = errors()
    rng = np.random.default_rng(1)
    ause = [sparsification(e, (-np.abs(e) + rng.normal(0, s, e.shape)).astype(np.float32)).ause for s in (0.01, 0.1, 1)]
    assert 0 < ause[0] < ause[1] < ause[2]
    assert sparsification(e, np.abs(e)).ause > ause[2]


@given(seed=st.integers(0, 50), scale=st.floats(0.01, 100))
def test_sparsification_is_invariant_to_order_unit_and_monotone_maps(seed: int, scale: float) -> None:
    e = errors(seed, 400)
    # Few levels, so that there are ties.
    c = np.round(np.random.default_rng(seed).uniform(0, 1, e.shape), 1).astype(np.float32)
    order = np.random.default_rng(seed + 1).permutation(len(e))
    reference = sparsification(e, c).ause
    assert sparsification(e[order], c[order]).ause == pytest.approx(reference, abs=1e-6)
    assert sparsification((e * scale).astype(np.float32), np.exp(c)).ause == pytest.approx(reference, abs=1e-5)


def test_no_error_at_all_has_no_area() -> None:
    zero = np.zeros(10, np.float32)
    assert sparsification(zero, zero).ause == 0


def test_calibrated_probabilities_are_on_the_diagonal() -> None:
    rng = np.random.default_rng(0)
    p = rng.uniform(0, 1, 40000).astype(np.float32)
    e = np.where(rng.uniform(0, 1, p.shape) < p, 0.01, 1.0).astype(np.float32)
    r = reliability(e, p)
    assert r.ece < 0.02 and r.pixels.sum() == p.size
    assert np.abs(r.predicted - r.observed).max() < 0.05
    assert reliability(e, 1 - p).ece > 0.4


def test_reliability_by_hand() -> None:
    e = np.array([0, 0, 0.2, 0.2, np.nan], np.float32)
    c = np.array([1, 0.95, 0.95, 0.05, np.nan], np.float32)
    r = reliability(e, c, bins=2)
    assert r.pixels.tolist() == [2, 3]
    assert r.observed == pytest.approx([0, 2 / 3])
    assert r.predicted == pytest.approx([0.025, 2.9 / 3])
    assert r.ece == pytest.approx((2 * 0.025 + 0.9) / 5)


def test_nothing_to_compare_is_refused() -> None:
    with pytest.raises(BadInput):
        sparsification(np.full(3, np.nan, np.float32), np.ones(3, np.float32))
    with pytest.raises(BadInput):
        sparsification(np.ones(3, np.float32), np.ones(4, np.float32))
    with pytest.raises(BadInput):
        reliability(np.ones(3, np.float32), np.ones(4, np.float32))
