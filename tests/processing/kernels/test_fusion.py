"""The fused cost volume against its NumPy twin, over odd sizes and hostile values, and what its rules mean."""

from __future__ import annotations

from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels.fusion import (
    ColourTerm,
    CostScale,
    FusedCost,
    Pool,
    SourceVolume,
    SurfaceRule,
    fuse_volume,
)
from lfrig.processing.kernels.occupancy import TILE_PX, occupancy
from lfrig.processing.model import Evidence, ScaleFit
from tests.processing.kernels.twins import both

native = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)
MATRIX = np.array([[1, 0.02, -3], [0.01, 1.1, 1], [0.1 / 200, 0, 0.95]])
OFFSET = np.array([2.0, -1.0, 0.03])
STRAIGHT = (np.eye(3), np.zeros(3))
PLANES = (1.4, 0.15)
TERM = ColourTerm(1.5, 10.0, 3.0, 1.0, 6.0)
RULE = SurfaceRule(3, 2.0, 4.0, 10.0)


def source(
    rng: np.random.Generator,
    height: int,
    width: int,
    planes: int,
    way: tuple[np.ndarray, np.ndarray] = (MATRIX, OFFSET),
) -> SourceVolume:
    """Mass on two or three neighbouring planes of each pixel: a rough surface with a step, and empty bricks."""
    ys, xs = np.mgrid[0:height, 0:width]
    centre = (planes - 1) * (0.3 + 0.1 * np.sin(xs / 9) + 0.3 * (ys > height / 2)) + rng.normal(0, 0.2, (height, width))
    p = np.clip(1.2 - np.abs(np.arange(planes) - centre[..., None]), 0, None) ** 2 + 1e-9
    p /= p.sum(2, keepdims=True)
    probability = (p * 65535).astype(np.uint16)
    step = 1.0 / max(planes - 1, 1)
    disparity = (-0.5 + step * centre).astype(np.float32)
    disparity.flat[0] = np.nan
    evidence = Evidence(probability, (-0.5, step), disparity, p.max(2).astype(np.float32))
    colour = rng.integers(0, 256, (height, width, 4)).astype(np.uint8)
    colour[..., 3] = rng.choice([0, 200], (height, width), p=[0.9, 0.1])
    return SourceVolume(evidence, ScaleFit(1.4, 2.0), way, occupancy(probability, disparity, 4, threads=1), colour)


def photo(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    return np.dstack([rng.integers(0, 256, (*shape[:2], 3)), rng.choice([0, 255], shape[:2])]).astype(np.uint8)


def evidence_of(fused: FusedCost, unit: float) -> np.ndarray:
    return fused.best[..., None] - fused.cost * np.float32(unit)


@native
@pytest.mark.parametrize("shape", [(1, 1, 1), (7, 5, 9), (8, 16, 2), (15, 27, 33)])
@pytest.mark.parametrize("size", [(19, 23, 11), (40, 50, 30), (1, 9, 5), (5, 4, 1)])
@pytest.mark.parametrize("pool", [Pool(), Pool(margin_px=None), Pool(log_pool=False), Pool(literal=True)])
def test_twin(monkeypatch, shape, size, pool) -> None:
    rng = np.random.default_rng(sum(shape) + sum(size))
    sources = [source(rng, *size), source(rng, *size, (np.eye(3) + MATRIX * 0.1, -OFFSET))]
    unit = 1 / 256

    def call() -> FusedCost:
        return fuse_volume(
            sources, shape, PLANES, pool, photo=photo(np.random.default_rng(1), shape), colour=TERM,
            surface=RULE if pool.log_pool else None, scale=CostScale(unit, 40.0),
        )  # fmt: skip

    ours, twin = both(monkeypatch, call)
    assert ours.cost.shape == shape and np.isfinite(ours.best).all() and (ours.cost.min(2) == 0).all()
    # Rounding may put a voxel on the other side of the frame's edge, of a nearest-pixel tie or of the colours' reach;
    # a first surface behind it carries that along its ray.
    far = np.abs(evidence_of(ours, unit) - evidence_of(twin, unit)) > 3 * unit
    assert far.mean() < 2e-3
    assert abs(ours.inside - twin.inside) <= 1 + 2e-3 * twin.inside
    assert ours.inside > 1000 or min(*shape, *size) < 9, "the test geometry must overlap"


@native
def test_threads_and_skips_change_nothing(monkeypatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    rng, shape = np.random.default_rng(3), (50, 61, 40)
    sources = [source(rng, 60, 70, 50), source(rng, 60, 70, 50, (MATRIX + 0.05, -5 * OFFSET))]
    # An exact table: only what holds nothing at all is left out.
    sources = [
        replace(s, occupancy=occupancy(s.evidence.probability, s.evidence.disparity, 0, threads=2)) for s in sources
    ]

    def call(**knobs) -> FusedCost:
        return fuse_volume(
            sources, shape, (1.3, 0.04), Pool(), photo=photo(np.random.default_rng(1), shape), colour=TERM,
            surface=RULE, **knobs,
        )  # fmt: skip

    one, four = call(threads=1), call(threads=4)
    assert one.cost.tobytes() == four.cost.tobytes() and one.best.tobytes() == four.best.tobytes()
    everything = call(skip_bricks=False, skip_sources=False)
    assert everything.empty == everything.unseen == 0 and everything.inside == one.inside
    assert one.empty > 0.2 * everything.sampled and one.unseen > 0
    assert one.sampled + one.empty + one.unseen == everything.sampled
    # Sums of two sources in another order: a count up or down.
    assert np.abs(one.cost.astype(int) - everything.cost).max() <= 1


def straight_source(disparity: float = -9.0) -> SourceVolume:
    """A grey source that sees the target's own rays and knows nothing of its depths."""
    probability = np.zeros((8, 8, 4), np.uint16)
    shown = np.full((8, 8), disparity, np.float32)
    colour = np.zeros((8, 8, 4), np.uint8)
    evidence = Evidence(probability, (0.0, 1.0), shown, np.ones((8, 8), np.float32))
    return SourceVolume(evidence, ScaleFit(1.0, 0.0), STRAIGHT, occupancy(probability, shown, 0), colour)


@pytest.mark.parametrize("force", ["0", "1"])
def test_a_saturated_source_does_not_contradict_a_brighter_photo(monkeypatch, force) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", force)

    def charged(photo_grey: int, source_grey: int, source_saturated: bool) -> float:
        colour = np.dstack([np.full((8, 8, 3), source_grey), np.full((8, 8), 255 * source_saturated)]).astype(np.uint8)
        seen = np.dstack([np.full((4, 4, 3), photo_grey), np.zeros((4, 4))]).astype(np.uint8)
        given = replace(straight_source(), colour=colour)
        term = ColourTerm(1.0, 10.0, 3.0, 1.0)
        with_colour, without = (
            fuse_volume([given], (4, 4, 1), (1.0, 0.1), Pool(), photo=seen, colour=t).best[1, 1] for t in (term, None)
        )
        return float(with_colour - without)

    assert charged(240, 200, False) == pytest.approx(-2) and charged(240, 200, True) == pytest.approx(1)
    assert charged(150, 200, True) == pytest.approx(-2), "darker than a lower bound is a contradiction"


@pytest.mark.parametrize("force", ["0", "1"])
def test_colours_speak_only_within_their_reach(monkeypatch, force) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", force)
    given = straight_source()
    given.evidence.probability[..., 1:3] = 32000  # planes 1..2 of the source: a clear surface
    given = replace(given, occupancy=occupancy(given.evidence.probability, given.evidence.disparity, 0))
    seen = np.full((4, 4, 4), 0, np.uint8)

    def gained(reach: float) -> np.ndarray:
        term, scale = ColourTerm(1.0, 10.0, 3.0, 1.0, reach), CostScale(1 / 64, 60.0)
        with_colour, without = (
            fuse_volume([given], (4, 4, 32), (0.1, 0.1), Pool(), photo=seen, colour=t, scale=scale)
            for t in (term, None)
        )
        return np.asarray(evidence_of(with_colour, 1 / 64) - evidence_of(without, 1 / 64))[2, 2]

    everywhere, near = gained(99.0), gained(2.0)
    assert (everywhere == 1).all(), "the same colour supports every voxel"
    assert near[14] == 1 and near[0] == 0 and near[-1] == 0 and 0 < near.sum() < 32


@pytest.mark.parametrize("force", ["0", "1"])
def test_a_surface_in_front_makes_a_source_neutral(monkeypatch, force) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", force)
    hidden, seen = (
        fuse_volume([straight_source(d)], (4, 4, 8), (0.1, 0.1), Pool(), scale=CostScale(1 / 1024, 60.0)).best[1, 1]
        for d in (9.0, -9.0)
    )
    assert hidden == pytest.approx(np.log(1 / 8), abs=1e-2) and seen == pytest.approx(np.log(0.05 / 8), abs=1e-2)


@pytest.mark.parametrize("force", ["0", "1"])
def test_first_surface_lowers_only_what_lies_behind(monkeypatch, force) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", force)
    rng, unit = np.random.default_rng(8), 1 / 256
    sources = [source(rng, 40, 50, 30, STRAIGHT)] * 2
    with_rule, without = (
        evidence_of(
            fuse_volume(sources, (9, 17, 32), (1.4, 0.04), Pool(), surface=r, scale=CostScale(unit, 60.0)), unit
        )
        for r in (SurfaceRule(6, 2.0, 4.0, 10.0), None)
    )
    assert (with_rule <= without + 1e-4).all() and (with_rule < without - 1).any()
    np.testing.assert_array_equal(with_rule[..., -6:], without[..., -6:], "the nearest planes have nothing in front")
    assert (without - with_rule).max() <= 10 + unit


@native
@pytest.mark.parametrize("shape", [(1, 1, 1), (7, 5, 3), (33, 65, 12)])
def test_occupancy(monkeypatch, shape) -> None:
    rng = np.random.default_rng(2)
    volume = rng.choice([0, 3, 9], shape, p=[0.98, 0.01, 0.01]).astype(np.uint16)
    disparity = rng.normal(0, 1, shape[:2]).astype(np.float32)
    disparity.flat[-1] = np.nan
    ours, twin = both(monkeypatch, lambda: occupancy(volume, disparity, 3, threads=2))
    np.testing.assert_array_equal(ours.sums, twin.sums)
    np.testing.assert_array_equal(ours.least, twin.least)
    np.testing.assert_array_equal(ours.greatest, twin.greatest)
    box = volume[:TILE_PX, :TILE_PX, :2]
    assert (ours.sums[1, 1, min(2, shape[2])] > 0) == (box > 3).any()
    assert np.isneginf(ours.least[-1, -1])


@native
def test_wrong_shapes_are_refused(monkeypatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "1")
    rng = np.random.default_rng(1)
    good = source(rng, 19, 23, 11)
    short = replace(good.evidence, disparity=np.zeros((19, 22), np.float32))
    for bad in (replace(good, evidence=short), replace(good, colour=np.zeros((4, 4, 4), np.uint8))):
        with pytest.raises(ValueError, match="shapes"):
            fuse_volume([bad], (8, 8, 4), PLANES, Pool(), photo=photo(rng, (8, 8)), colour=TERM)
