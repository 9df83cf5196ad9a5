"""From evidence to costs, spans and the mean around each peak."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from lfrig.processing.kernels import sgm, surface
from tests.processing.kernels.test_sgm import problem, spans
from tests.processing.kernels.twins import both

SHAPES = [(1, 1, 1), (2, 9, 15), (9, 1, 16), (13, 17, 33), (17, 8, 60)]


@pytest.mark.parametrize("shape", SHAPES)
def test_evidence_cost_and_its_twin_agree_to_the_bit(monkeypatch, shape) -> None:
    rng = np.random.default_rng(1)
    evidence = rng.normal(-10, 8, shape).astype(np.float32)
    odd = rng.random(shape)
    evidence[odd < 0.05] = np.nan
    evidence[(odd > 0.05) & (odd < 0.1)] = -np.inf
    evidence[(odd > 0.1) & (odd < 0.13)] = 3e38
    evidence[0, 0] = np.nan
    native, twin = both(monkeypatch, lambda: surface.evidence_cost(evidence, 117.0, 20.0, threads=1))
    assert np.array_equal(native, twin)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    assert np.array_equal(native, surface.evidence_cost(evidence, 117.0, 20.0, threads=3))


def test_costs_count_from_the_best_and_end_at_the_cap() -> None:
    evidence = np.full((10, 9, 6), -50.0, np.float32)
    evidence[..., 2], evidence[..., 3], evidence[..., 4] = -3.0, -3.25, -5.0
    cost = surface.evidence_cost(evidence, 100.0, 20.0)
    assert (cost == [2000, 2000, 0, 25, 200, 2000]).all()


@pytest.mark.parametrize("spanned", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize(
    "mean", [surface.PeakMean(0.002, 3), surface.PeakMean(0.001, 17), surface.PeakMean(0.002, 0, True)]
)
def test_sgm_surface_and_its_twin_agree(monkeypatch, shape, spanned, mean) -> None:
    cost, guide, rng = problem(shape)
    span = spans(rng, shape) if spanned else None

    def call(threads=1):  # type: ignore[no-untyped-def]
        return surface.sgm_surface(cost, guide, 40.0, 900.0, 30.0, mean, span=span, threads=threads)

    for a, b in zip(*both(monkeypatch, call), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-5, atol=2e-4)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    for threads in (2, 5):
        assert all(np.array_equal(a, b) for a, b in zip(call(), call(threads), strict=True))


def test_two_labels_equally_good_give_what_lies_between_them(monkeypatch) -> None:
    # Heavy tails to one side: a window that jumps with the best label would take in another label of them.
    lobe = np.abs(np.arange(24) - 9.5) * 300.0
    lobe[10:] *= 0.6
    lobe[9] = lobe[10] = 75
    guide, mean = np.zeros((2, 2, 3), np.uint8), surface.PeakMean(1 / 6000, 3)
    found = []
    for favoured in (9, 10):
        cost = np.tile(np.rint(lobe).astype(np.uint16), (2, 2, 1))
        cost[..., favoured] -= 1
        found.append(both(monkeypatch, partial(surface.sgm_surface, cost, guide, 1.0, 2.0, 30.0, mean))[0][0])
    # A unit of the costs is eight of the sums, 0.0013 of log evidence; a window that jumps moves it by 0.6.
    assert np.abs(found[0] - found[1]).max() < 0.02


def test_a_narrow_span_is_the_same_as_costs_that_nobody_chooses() -> None:
    cost, guide, _ = problem((16, 24, 40))
    cost[..., :12] = cost[..., 30:] = 7000
    cost[..., 12:17] = cost[..., 25:30] = 3000
    cost[..., 17:25] //= 4
    span = np.empty((2, 3, 2), np.int16)
    span[..., 0], span[..., 1] = 12, 30
    mean = surface.PeakMean(0.004, 3)
    wide, narrow = (surface.sgm_surface(cost, guide, 40.0, 900.0, 30.0, mean, span=s) for s in (None, span))
    for a, b in zip(wide, narrow, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-4)


def test_shapes_that_differ_are_refused(monkeypatch) -> None:
    cost, guide, _ = problem((9, 14, 5))
    for native in "01":
        monkeypatch.setenv("LFRIG_NATIVE", native)
        with pytest.raises(ValueError, match="shapes"):
            surface.sgm_surface(cost, guide[1:], 40.0, 900.0, 30.0, surface.PeakMean(0.002, 3))


def test_peak_mean_reads_what_aggregation_leaves() -> None:
    cost, guide, rng = problem((13, 17, 33))
    span, mean = spans(rng, cost.shape), surface.PeakMean(0.002, 3)
    total = sgm.aggregate(cost, guide, 40.0, 900.0, 30.0, span=span)
    read = surface.peak_mean(total, mean)
    for a, b in zip(read, surface.sgm_surface(cost, guide, 40.0, 900.0, 30.0, mean, span=span), strict=True):
        np.testing.assert_allclose(a, b, rtol=2e-5, atol=2e-4)
    none = ~sgm.active_labels(span, cost.shape).any(2)
    assert none.any() and (read[0][none] == 0).all() and (read[1][none] == 0).all()
