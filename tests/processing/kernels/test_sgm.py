"""Semi-global matching: the kernel, its twin and the recursion that both stand for."""

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
        monkeypatch, lambda: sgm.aggregate(cost, guide, 40.2, 900.0, 30.0, span=span, shift=shift, threads=1)
    )
    assert np.array_equal(native, twin)
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    for threads in (2, 3, 7):
        again = sgm.aggregate(cost, guide, 40.2, 900.0, 30.0, span=span, shift=shift, threads=threads)
        assert np.array_equal(again, native)


def along(cost: np.ndarray, penalty, p1: float, dy: int, dx: int) -> np.ndarray:  # type: ignore[no-untyped-def]
    """One path of the published recursion, in floating point, pixel by pixel."""
    height, width, labels = cost.shape
    path = np.zeros(cost.shape)
    for y in range(height)[:: -1 if dy < 0 else 1]:
        for x in range(width)[:: -1 if dx < 0 else 1]:
            path[y, x] = cost[y, x]
            if 0 <= y - dy < height and 0 <= x - dx < width:
                before = path[y - dy, x - dx]
                beside = np.pad(before, 1, constant_values=np.inf)
                jump = before.min() + penalty(y, x, y - dy, x - dx)
                best = np.minimum.reduce([before, beside[:-2] + p1, beside[2:] + p1, np.full(labels, jump)])
                path[y, x] += best - before.min()
    return path


def test_it_is_the_published_recursion() -> None:
    cost, guide, _ = problem((9, 13, 10))
    colours = guide.astype(int)

    def penalty(*at: int) -> float:
        step = np.abs(colours[at[0], at[1]] - colours[at[2], at[3]]).sum()
        return max(1.5 * 40, 900 / (1 + step / 30))

    directions = [(dy, dx) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
    expected = sum(along(cost.astype(float), penalty, 40, dy, dx) for dy, dx in directions)
    # Each path rounds P2 once per pixel; what it carries on from there is at most P2, so errors do not add up for long.
    np.testing.assert_allclose(sgm.aggregate(cost, guide, 40.0, 900.0, 30.0), expected, atol=32)


def test_huge_costs_count_as_the_most_that_fits() -> None:
    cost, guide, _ = problem((9, 14, 35))
    cost[2:5, 3:9] = 65535
    capped = np.minimum(cost, sgm.PATH_LIMIT - 900).astype(np.uint16)
    huge, most = (sgm.aggregate(c, guide, 40.0, 900.0, 30.0) for c in (cost, capped))
    assert np.array_equal(huge, most)
    full = sgm.aggregate(np.full_like(cost, 65535), guide, 40.0, 900.0, 30.0)
    assert (full >= 8 * (sgm.PATH_LIMIT - 900)).all(), "a sum has run over"


@pytest.mark.parametrize("penalties", [(4.0, 50.0), (0.2, 2.0), (3.0, 1.0)])
def test_the_finest_unit_just_fits(penalties) -> None:
    p1, p2 = penalties
    cap = 20.0
    unit = sgm.finest_unit(cap, p1, p2)
    guide = np.zeros((3, 4, 3), np.uint8)
    assert sgm.Penalties.of(guide, unit * p1, unit * p2, 30.0).cap >= unit * cap
    finer = 1.02 * (unit + 1)
    assert sgm.Penalties.of(guide, finer * p1, finer * p2, 30.0).cap < finer * cap
    with pytest.raises(ValueError, match="do not fit"):
        sgm.finest_unit(9000.0, p1, p2)


def test_spans_that_cover_every_label_change_nothing() -> None:
    cost, guide, _ = problem((19, 27, 45))
    span = np.zeros((3, 4, 2), np.int16)
    span[..., 1] = 45
    plain, spanned = (sgm.aggregate(cost, guide, 40.0, 900.0, 30.0, span=s) for s in (None, span))
    assert np.array_equal(plain, spanned)


def test_inactive_labels_are_not_read() -> None:
    cost, guide, rng = problem((19, 27, 45))
    span = spans(rng, cost.shape)
    active = sgm.active_labels(span, cost.shape)
    other = np.where(active, cost, rng.integers(0, 65536, cost.shape)).astype(np.uint16)
    one, same = (sgm.aggregate(c, guide, 40.0, 900.0, 30.0, span=span) for c in (cost, other))
    assert np.array_equal(one, same)
    assert (one[~active] == sgm.INACTIVE).all() and (one[active] < sgm.INACTIVE).all()


def test_a_result_can_be_written_where_the_caller_wants_it() -> None:
    cost, guide, _ = problem((9, 14, 35))
    out = np.full_like(cost, 77)
    assert sgm.aggregate(cost, guide, 40.0, 900.0, 30.0, out=out) is out
    assert np.array_equal(out, sgm.aggregate(cost, guide, 40.0, 900.0, 30.0))


def test_what_does_not_fit_is_refused(monkeypatch) -> None:
    cost, guide, _ = problem((9, 14, 5))
    for native in "01":
        monkeypatch.setenv("LFRIG_NATIVE", native)
        for p1, p2 in ((40.0, 8191.0), (5461.0, 5461.0), (-1.0, 900.0)):
            with pytest.raises(ValueError, match="coarser unit"):
                sgm.aggregate(cost, guide, p1, p2, 30.0)
        with pytest.raises(ValueError, match="shapes"):
            sgm.aggregate(cost, guide[1:], 40.0, 900.0, 30.0)
        with pytest.raises(ValueError, match="shapes"):
            sgm.aggregate(cost, guide, 40.0, 900.0, 30.0, span=np.zeros((1, 1, 2), np.int16))


def test_a_lone_outlier_is_smoothed_but_a_step_kept() -> None:
    cost = np.full((15, 20, 8), 500, np.uint16)
    cost[:, :10, 2] = cost[:, 10:, 6] = 0
    cost[7, 4] = 500
    cost[7, 4, 7] = 400
    guide = np.zeros((15, 20, 3), np.uint8)
    guide[:, 10:] = 200
    best = sgm.aggregate(cost, guide, 50.0, 600.0, 10.0).argmin(2)
    assert best[7, 4] == 2
    assert (best[:, :10] == 2).all() and (best[:, 10:] == 6).all()


def test_shifts_of_nothing_change_nothing() -> None:
    cost, guide, _ = problem((11, 14, 6))
    still = np.zeros((4, 11, 14), np.int16)
    same, plain = (sgm.aggregate(cost, guide, 30.0, 200.0, 30.0, shift=shift) for shift in (still, None))
    assert np.array_equal(same, plain)


def test_shifts_make_a_ramp_as_cheap_as_a_plane() -> None:
    height, width, planes = 12, 20, 9
    guide = np.zeros((height, width, 3), np.uint8)
    label = np.arange(width) % 3 + 3  # a staircase of labels that the shifts declare to be one plane
    cost = np.full((height, width, planes), 1.0, np.float32)
    cost[:, np.arange(width), label] = 0.0
    cost[6, 10] = 1.0  # nothing known here
    shift = np.zeros((4, height, width), np.int16)
    step = np.diff(label, append=label[-1:])
    shift[0], shift[2] = step, step
    shift[3, :, 1:] = -np.diff(label)
    found = sgm.aggregate((100 * cost).astype(np.uint16), guide, 50, 200, 30.0, shift=shift).argmin(2)
    assert (found == label).all()
