"""What refuses poses that only a far backdrop holds, and recorded optics that contradict each other."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.contracts.errors import GeometryRefused
from lfrig.processing.agreement import Agreement
from lfrig.processing.poses.anchors import ScaleEstimate, common_scale, furthest_estimate
from lfrig.processing.poses.confirm import refuse_untied, refuse_untied_corrections, refuse_untied_photo
from lfrig.processing.poses.gate import refuse_scattered_views

NAMES = ["000", "001", "002"]


def agreement(ties: list[tuple[int, int]]) -> Agreement:
    """Three sources and a photo that all agree in the far half, and in the near one by ``ties`` only."""
    near = np.full((3, 4), -0.05)
    for i, j in ties:
        near[i, j] = 0.3
    share, whole = np.full((3, 4), 0.4), np.full((3, 4), 0.3)
    return Agreement(share, whole, Agreement(np.full((3, 4), 0.1), near))


def test_ties_are_transitive_and_of_either_direction() -> None:
    assert agreement([(0, 1), (2, 1), (0, 3)]).tied_groups() == [[0, 1, 2, 3]]


def test_a_photo_that_only_the_far_half_holds_is_refused() -> None:
    with pytest.raises(GeometryRefused) as caught:
        refuse_untied(agreement([(0, 1), (1, 2)]), NAMES, "900")
    assert caught.value.code == "photo-disagrees" and "900" in caught.value.message
    refuse_untied_photo(agreement([(0, 3)]), "900")


def test_a_capture_that_only_the_far_half_holds_is_named() -> None:
    with pytest.raises(GeometryRefused, match="001") as caught:
        refuse_untied(agreement([(0, 2), (2, 3)]), NAMES, "900")
    assert caught.value.code == "capture-disagrees" and "000" not in caught.value.message


def test_nothing_is_refused_where_all_is_tied_or_nothing_can_be_told() -> None:
    refuse_untied(agreement([(0, 1), (1, 2), (2, 3)]), NAMES, "900")
    refuse_untied(None, NAMES, "900")
    refuse_scattered_views([[0, 1, 2]], NAMES)


def test_a_correction_that_nothing_near_confirms_is_refused() -> None:
    ties = agreement([(0, 1), (1, 3)])
    refuse_untied_corrections(ties, [1], NAMES)
    refuse_untied_corrections(None, [2], NAMES)
    with pytest.raises(GeometryRefused, match="captures 002:") as caught:
        refuse_untied_corrections(ties, [1, 2], NAMES)
    assert caught.value.code == "capture-disagrees"


def test_scattered_views_are_listed() -> None:
    with pytest.raises(GeometryRefused, match="000, 002 and 001") as caught:
        refuse_scattered_views([[0, 2], [1]], NAMES)
    assert caught.value.code == "unstable-poses"


def test_the_estimate_that_contradicts_the_others_is_found() -> None:
    good = [ScaleEstimate(v, "baseline", 1 + 0.03 * v, 0.04) for v in range(3)]
    assert furthest_estimate(good) is None
    wrong = ScaleEstimate(3, "focus distance", 1.5, 0.04)
    assert furthest_estimate([*good, wrong]) == wrong
    assert common_scale([*good, wrong]) == pytest.approx(1.045)
