"""The best label of aggregated costs and how distinct it is."""

from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest

from lfrig.processing.kernels import sgm
from lfrig.processing.kernels.label_peak import label_peak, sgm_label_peak
from tests.processing.kernels.test_sgm_u16 import problem, spans
from tests.processing.kernels.twins import both

SHAPES = [(1, 1, 1), (2, 9, 2), (9, 1, 3), (13, 17, 32), (11, 20, 47)]


def same(native, twin) -> None:  # type: ignore[no-untyped-def]
    for a, b in zip(astuple(native), astuple(twin), strict=True):
        assert a.dtype == b.dtype == np.float32
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("spanned", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_kernels_and_twins_agree(monkeypatch, shape, spanned) -> None:
    cost, guide, rng = problem(shape)
    span = spans(rng, shape) if spanned else None
    shift = rng.integers(-2, 3, (4, *shape[:2])).astype(np.int16)

    def fused(threads=1):  # type: ignore[no-untyped-def]
        return sgm_label_peak(cost, guide, 40.0, 900.0, 30.0, 0.01, span=span, shift=shift, threads=threads)

    total = sgm.aggregate_u16(cost, guide, 40.0, 900.0, 30.0, span=span, shift=shift)
    native, twin = both(monkeypatch, lambda: label_peak(total, 0.01))
    same(native, twin)
    same(*both(monkeypatch, fused))
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    for threads in (1, 2, 5):
        parts = zip(astuple(fused(threads)), astuple(label_peak(total, 0.01, threads=threads)), strict=True)
        assert all(
            np.array_equal(a, b) and np.array_equal(b, c) for (a, b), c in zip(parts, astuple(native), strict=True)
        )


@pytest.mark.parametrize("native", ["0", "1"])
def test_a_valley_between_labels(monkeypatch, native) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    labels = np.arange(20)
    valley = (30 * (labels - 7.25) ** 2 + 100).astype(np.uint16)
    valley[15] = 400
    peak = label_peak(np.tile(valley, (3, 4, 1)), 0.5)
    assert peak.label == pytest.approx(7.25, abs=0.02)
    assert peak.margin == pytest.approx(0.5 * (min(400, valley[10], valley[4]) - valley[7]))
    assert peak.curvature == pytest.approx(0.5 * (int(valley[5]) + int(valley[9]) - 2 * int(valley[7])))


@pytest.mark.parametrize("native", ["0", "1"])
def test_ends_and_equals(monkeypatch, native) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", native)
    rows = np.array([[5, 9, 9, 9, 30, 40], [9, 9, 9, 9, 9, 5], [7, 7, 7, 7, 7, 7], [65535] * 6], np.uint16)
    peak = label_peak(rows[None], 1.0)
    assert peak.label[0].tolist() == [0, 5, 0, 0], "beside an end there is no parabola; the first of equals is taken"
    assert peak.margin[0].tolist() == [4, 4, 0, 0]
    assert peak.curvature[0].tolist() == [4, 4, 0, 0], "an end stands for the labels beyond it"


def test_inactive_labels_are_no_neighbours(monkeypatch) -> None:
    rows = np.full((1, 1, 40), 65535, np.uint16)
    rows[0, 0, 20:24] = [10, 40, 50, 60]
    for peak in both(monkeypatch, lambda: label_peak(rows, 1.0)):
        assert [float(values[0, 0]) for values in astuple(peak)] == [20, 50, 40]
