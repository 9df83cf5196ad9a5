"""Semi-global matching in 16-bit fixed point: the kernel, its twin and the float form it stands for."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.processing.kernels import sgm
from tests.processing.kernels.twins import both

SHAPES = [(1, 1, 1), (1, 9, 4), (9, 1, 31), (13, 17, 32), (17, 23, 33), (6, 40, 70), (25, 34, 8), (3, 5, 7)]


def problem(shape, seed=0):  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(seed)
    cost = rng.integers(0, 2000, shape).astype(np.uint16)
    guide = rng.integers(0, 256, (*shape[:2], 3)).astype(np.uint8)
    guide[: shape[0] // 2] //= 16  # smooth areas too
    return cost, guide, rng


def spans(rng: np.random.Generator, shape: tuple[int, int, int]) -> sgm.I16:
    """Random ranges of labels, some of them empty, some beyond the ends."""
    tiles = (-(-shape[0] // 8), -(-shape[1] // 8))
    first = rng.integers(-1, shape[2], tiles)
    last = first + rng.integers(-1, shape[2] + 2, tiles)
    return np.stack([first, last], -1).astype(np.int16)


@pytest.mark.parametrize("shifted", [False, True])
@pytest.mark.parametrize("spanned", [False, True])
@pytest.mark.parametrize("shape", SHAPES)
def test_kernel_and_twin_agree_to_the_bit(monkeypatch, shape, spanned, shifted) -> None:
    cost, guide, rng = problem(shape)
    span = spans(rng, shape) if spanned else None
    shift = rng.integers(-3, 4, (4, *shape[:2])).astype(np.int16) if shifted else None
    if shift is not None:
        shift.flat[0] = 9999
    native, twin = both(
        monkeypatch, lambda: sgm.aggregate_u16(cost, guide, 40.2, 900.0, 30.0, span=span, shift=shift, threads=1)
    )
    assert np.array_equal(native, twin)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    for threads in (2, 3, 7):
        again = sgm.aggregate_u16(cost, guide, 40.2, 900.0, 30.0, span=span, shift=shift, threads=threads)
        assert np.array_equal(again, native)


def test_it_is_the_sum_of_the_float_forms_paths() -> None:
    cost, guide, _ = problem((21, 30, 40))
    whole = sgm.aggregate_u16(cost, guide, 40.0, 900.0, 30.0)
    mean = sgm.aggregate(cost.astype(np.float32), guide, 40.0, 900.0, 30.0)
    # Each path rounds P2 once per pixel; what it carries on from there is at most P2, so errors do not add up for long.
    np.testing.assert_allclose(whole / 8, mean, atol=4)


def test_huge_costs_count_as_the_most_that_fits() -> None:
    cost, guide, _ = problem((9, 14, 35))
    cost[2:5, 3:9] = 65535
    capped = np.minimum(cost, sgm.PATH_LIMIT - 900).astype(np.uint16)
    huge, most = (sgm.aggregate_u16(c, guide, 40.0, 900.0, 30.0) for c in (cost, capped))
    assert np.array_equal(huge, most)
    full = sgm.aggregate_u16(np.full_like(cost, 65535), guide, 40.0, 900.0, 30.0)
    assert (full >= 8 * (sgm.PATH_LIMIT - 900)).all(), "a sum has run over"


def test_spans_that_cover_every_label_change_nothing() -> None:
    cost, guide, _ = problem((19, 27, 45))
    span = np.zeros((3, 4, 2), np.int16)
    span[..., 1] = 45
    plain, spanned = (sgm.aggregate_u16(cost, guide, 40.0, 900.0, 30.0, span=s) for s in (None, span))
    assert np.array_equal(plain, spanned)


def test_inactive_labels_are_not_read() -> None:
    cost, guide, rng = problem((19, 27, 45))
    span = spans(rng, cost.shape)
    active = sgm.active_labels(span, cost.shape)
    other = np.where(active, cost, rng.integers(0, 65536, cost.shape)).astype(np.uint16)
    one, same = (sgm.aggregate_u16(c, guide, 40.0, 900.0, 30.0, span=span) for c in (cost, other))
    assert np.array_equal(one, same)
    assert (one[~active] == sgm.INACTIVE).all() and (one[active] < sgm.INACTIVE).all()


def test_a_result_can_be_written_where_the_caller_wants_it() -> None:
    cost, guide, _ = problem((9, 14, 35))
    out = np.full_like(cost, 77)
    assert sgm.aggregate_u16(cost, guide, 40.0, 900.0, 30.0, out=out) is out
    assert np.array_equal(out, sgm.aggregate_u16(cost, guide, 40.0, 900.0, 30.0))


def test_what_does_not_fit_is_refused(monkeypatch) -> None:
    cost, guide, _ = problem((9, 14, 5))
    for native in "01":
        monkeypatch.setenv("LFRIG_NATIVE", native)
        for p1, p2 in ((40.0, 8191.0), (5461.0, 5461.0), (-1.0, 900.0)):
            with pytest.raises(ValueError, match="coarser unit"):
                sgm.aggregate_u16(cost, guide, p1, p2, 30.0)
        with pytest.raises(ValueError, match="shapes"):
            sgm.aggregate_u16(cost, guide[1:], 40.0, 900.0, 30.0)
        with pytest.raises(ValueError, match="shapes"):
            sgm.aggregate_u16(cost, guide, 40.0, 900.0, 30.0, span=np.zeros((1, 1, 2), np.int16))


def test_a_lone_outlier_is_smoothed_but_a_step_kept() -> None:
    cost = np.full((15, 20, 8), 500, np.uint16)
    cost[:, :10, 2] = cost[:, 10:, 6] = 0
    cost[7, 4] = 500
    cost[7, 4, 7] = 400
    guide = np.zeros((15, 20, 3), np.uint8)
    guide[:, 10:] = 200
    best = sgm.aggregate_u16(cost, guide, 50.0, 600.0, 10.0).argmin(2)
    assert best[7, 4] == 2
    assert (best[:, :10] == 2).all() and (best[:, 10:] == 6).all()
