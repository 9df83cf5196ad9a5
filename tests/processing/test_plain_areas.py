"""Disparity of softly shaded areas from differences of less than a grey level."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.processing.dpv import DEFAULT_DPV, light_field_evidence
from lfrig.processing.matching_views import matching_views
from lfrig.processing.model import LightField
from lfrig.processing.plain_areas import DEFAULT_PLAIN, find_plain_areas


def shaded(disparity: float, noise: float = 0.0) -> LightField:
    """A plane of a given disparity [px per view step] with nothing but soft shading, 8-bit views 7×7 of 96×64 px."""
    ys, xs = np.mgrid[0:64, 0:96].astype(np.float64)
    rng = np.random.default_rng(3)
    views = np.empty((7, 7, 64, 96, 3), np.uint8)
    for r in range(7):
        for c in range(7):
            x, y = xs + (c - 3) * disparity, ys + (r - 3) * disparity
            grey = 120 + 0.12 * x + 0.18 * y + 6 * np.sin(x / 23) * np.cos(y / 19)
            pixels = grey[..., None] * [1.0, 0.93, 0.85] + rng.normal(0, noise, (64, 96, 3))
            views[r, c] = np.clip(np.rint(pixels), 0, 255)
    return LightField("plain", views)


@pytest.mark.parametrize("disparity", [-0.43, 0.21])
def test_shading_of_a_fraction_of_a_grey_level_gives_disparity(disparity: float) -> None:
    light_field = shaded(disparity)
    views = matching_views(light_field, 0.0)
    found = find_plain_areas(views.full, views.half, 0.0, DEFAULT_PLAIN)
    inner = (slice(10, -10), slice(10, -10))
    assert found.weight[inner].min() > 0.9
    assert np.median(np.abs(found.disparity[inner] - disparity)) < 0.012


def test_evidence_of_a_plain_area_is_not_drawn_to_zero() -> None:
    light_field = shaded(0.21)
    plain, absolute = (
        light_field_evidence(
            light_field, (-0.6, 0.6), replace(DEFAULT_DPV, plain=replace(DEFAULT_PLAIN, enabled=on))
        ).disparity[10:-10, 10:-10]
        for on in (True, False)
    )
    assert np.median(np.abs(plain - 0.21)) < 0.02
    assert np.median(np.abs(plain - 0.21)) < 0.5 * np.median(np.abs(absolute - 0.21))


def test_textured_areas_are_left_alone() -> None:
    rng = np.random.default_rng(0)
    pictures = np.broadcast_to(rng.integers(0, 255, (48, 64, 3), np.uint8), (5, 5, 48, 64, 3))
    views = matching_views(LightField("t", np.ascontiguousarray(pictures)), 0.0)
    assert not find_plain_areas(views.full, views.half, 0.0, DEFAULT_PLAIN).weight.any()
