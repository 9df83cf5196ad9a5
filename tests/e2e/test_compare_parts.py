"""The numbers of `lfrig compare`, and the angles by which sources are chosen."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.processing.geometry import turn_deg
from lfrig.rig.compare import map_difference

angles = st.floats(-1000, 1000, allow_nan=False)


def test_only_pixels_known_in_both_count() -> None:
    first = np.array([[1.0, 2.0, np.nan, np.nan]], np.float32)
    second = np.array([[1.5, np.nan, 3.0, np.nan]], np.float32)
    found = map_difference(first, second, "px")
    assert (found.pixels, found.only_one) == (1, 2)
    assert found.mean == found.max == found.median == 0.5


def test_nothing_in_common() -> None:
    nothing = np.full((2, 2), np.nan, np.float32)
    found = map_difference(nothing, np.ones((2, 2), np.float32), "px")
    assert found.pixels == 0
    assert math.isnan(found.max)


@given(angles, angles)
def test_a_turn_is_the_short_way_round(first: float, second: float) -> None:
    assert 0 <= turn_deg(first, second) <= 180
    assert turn_deg(first, second) == pytest.approx(turn_deg(second, first), abs=1e-9)
    assert turn_deg(first, first + 360) == pytest.approx(0, abs=1e-9)


def test_an_unknown_angle_is_farthest() -> None:
    assert turn_deg(None, 0.0) == turn_deg(0.0, None) == math.inf
