"""Colour evidence and semi-global matching against their NumPy twins: odd sizes, one plane, hostile values."""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

from lfrig.processing.kernels import colour_evidence, sgm
from lfrig.processing.model import ScaleFit
from tests.processing.kernels.twins import both

pytestmark = pytest.mark.skipif(
    find_spec("lfrig.processing.kernels._native") is None, reason="no native core here: only the twins exist"
)

MATRIX = np.array([[1.0, 0.02, 0.3], [-0.01, 1.0, -0.4], [1e-4, -2e-4, 1.0]])
OFFSET = np.array([3.0, 0.4, 0.05])


@pytest.mark.parametrize("shape", [(1, 1), (7, 5), (12, 33)])
@pytest.mark.parametrize("planes", [1, 11])
def test_colour_evidence(monkeypatch, shape, planes) -> None:
    rng = np.random.default_rng(7)
    photo = np.dstack([rng.uniform(0, 255, (*shape, 3)), rng.choice([0, 0.5], shape)]).astype(np.float32)
    size = (shape[0] + 3, shape[1] + 2)
    image = np.dstack([rng.uniform(0, 255, (*size, 3)), rng.choice([0, 0.5], size)]).astype(np.float32)
    disparity = rng.normal(0, 0.5, size).astype(np.float32)
    disparity.flat[0] = np.nan
    term = colour_evidence.ColourTerm(1.5, 10.0, 3.0, 1.0, 0.06)

    def call():  # type: ignore[no-untyped-def]
        volume = np.zeros((*shape, planes), np.float32)
        scale = ScaleFit(0.7, 1.0)
        colour_evidence.add_colour_evidence(volume, photo, image, disparity, scale, (MATRIX, OFFSET), (0.4, 0.13), term)
        return volume

    native, twin = both(monkeypatch, call)
    np.testing.assert_allclose(native, twin, atol=5e-3)


def test_a_saturated_source_does_not_contradict_a_brighter_photo() -> None:
    def charged(photo_grey: float, source_grey: float, source_saturated: bool) -> float:
        volume = np.zeros((4, 4, 1), np.float32)
        photo = np.dstack([np.full((4, 4, 3), photo_grey), np.zeros((4, 4))]).astype(np.float32)
        image = np.dstack([np.full((8, 8, 3), source_grey), np.full((8, 8), float(source_saturated))])
        colour_evidence.add_colour_evidence(
            volume, photo, image.astype(np.float32), np.full((8, 8), -9, np.float32), ScaleFit(1.0, 0.0),
            (np.eye(3), np.zeros(3)), (1.0, 0.1), colour_evidence.ColourTerm(1.0, 10.0, 3.0, 1.0, 0.06),
        )  # fmt: skip
        return float(volume[1, 1, 0])

    assert charged(240, 200, False) == pytest.approx(-2) and charged(240, 200, True) == pytest.approx(1)
    assert charged(150, 200, True) == pytest.approx(-2), "darker than a lower bound is a contradiction"


@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (11, 14)])
@pytest.mark.parametrize("planes", [1, 6])
def test_shifted_sgm(monkeypatch, shape, planes) -> None:
    rng = np.random.default_rng(8)
    cost = rng.uniform(0, 3, (*shape, planes)).astype(np.float32)
    guide = rng.integers(0, 256, (*shape, 3)).astype(np.uint8)
    shift = rng.integers(-3, 4, (4, *shape)).astype(np.int16)
    shift.flat[0] = 9999
    native, twin = both(monkeypatch, lambda: sgm.aggregate(cost, guide, 0.3, 2.0, 30.0, shift=shift))
    np.testing.assert_allclose(native, twin, atol=1e-4)
    same, plain = (sgm.aggregate(cost, guide, 0.3, 2.0, 30.0, shift=s) for s in (np.zeros_like(shift), None))
    np.testing.assert_allclose(same, plain, atol=1e-5)


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
    found = sgm.aggregate(cost, guide, 0.5, 2.0, 30.0, shift=shift).argmin(2)
    assert (found == label).all()
