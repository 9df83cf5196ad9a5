"""Patches carried into other pictures by their own depth: found where the geometry is right, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing import agreement as agreement_module
from lfrig.processing.agreement import (
    DOUBTFUL_ADVANTAGE,
    REFUSE_ADVANTAGE,
    Agreement,
    check_agreement,
    measure_agreement,
)
from lfrig.processing.geometry import rotation_z
from lfrig.processing.model import Evidence, LightField, Photo, Pose, ScaleFit, Source
from tests.processing.scenes import BASELINE_M, CAMERA, FOCAL, FOCUS_M, look

SCALE = ScaleFit(1 / (BASELINE_M * FOCAL), 1 / FOCUS_M)
CENTRES_M = (-0.03, 0.0, 0.025)
ASIDE = Pose(np.eye(3), np.array([-0.012, 0.0, 0.0]))
"""The photo stands 12 mm to the right of the middle."""


def source(name: str, centre_m: float, confidence: float = 0.9) -> Source:
    image, depth = look(centre_m, 0.0)
    disparity = SCALE.disparity((1 / depth).astype(np.float32))
    evidence = Evidence(np.zeros((1, 1, 2), np.uint16), (0, 1), disparity, np.full(depth.shape, confidence, np.float32))
    views = np.broadcast_to(image, (3, 3, *image.shape))
    pose = Pose(np.eye(3), np.array([-centre_m, 0.0, 0.0]))
    return Source(LightField(name, views, CAMERA), CAMERA, pose, evidence, SCALE)


@pytest.fixture
def sources(monkeypatch: pytest.MonkeyPatch) -> list[Source]:
    monkeypatch.setattr(agreement_module, "MIN_PATCHES", 10)  # the pictures are 96 px wide
    return [source(f"00{k}", x) for k, x in enumerate(CENTRES_M)]


def photo(centre_m: float = 0.012) -> Photo:
    return Photo("photo", look(centre_m, 0.0)[0], CAMERA)


def lifted(pose: Pose) -> Pose:
    """20 mm higher: 7 px in the picture, and still in view."""
    return replace(pose, translation=pose.translation + np.array([0.0, 0.02, 0.0]))


def test_right_geometry_finds_its_patches(sources: list[Source]) -> None:
    agreement = measure_agreement(sources, photo(), CAMERA, ASIDE)
    assert agreement.of_photo()[0] > 0.8 and agreement.of_photo()[1] > 0.5
    for k in range(3):
        share, advantage = agreement.of_source(k)
        assert share > 0.8 and advantage > 0.5
    assert agreement.groups() == [[0, 1, 2]]
    monitor = Monitor()
    check_agreement(sources, photo(), CAMERA, ASIDE, monitor)
    assert monitor.notices == []


@pytest.mark.parametrize("wrong", [0, 1, 2])
def test_a_source_at_the_wrong_place_is_named(sources: list[Source], wrong: int) -> None:
    sources[wrong] = replace(sources[wrong], pose=lifted(sources[wrong].pose))
    with pytest.raises(GeometryRefused, match=f"capture 00{wrong}") as caught:
        check_agreement(sources, photo(), CAMERA, ASIDE, Monitor())
    assert caught.value.code == "capture-disagrees" and "--sources" in caught.value.remedy


@pytest.mark.parametrize("wrong", [0, 1])
def test_of_two_that_disagree_the_photo_names_one(sources: list[Source], wrong: int) -> None:
    pair = sources[:2]
    pair[wrong] = replace(pair[wrong], pose=lifted(pair[wrong].pose))
    with pytest.raises(GeometryRefused, match=f"capture 00{wrong}"):
        check_agreement(pair, photo(), CAMERA, ASIDE, Monitor())


def test_a_photo_of_something_else_is_named(sources: list[Source]) -> None:
    other = replace(photo(), image=photo().image[::-1, ::-1].copy())
    with pytest.raises(GeometryRefused, match="photo photo") as caught:
        check_agreement(sources, other, CAMERA, ASIDE, Monitor())
    assert caught.value.code == "photo-disagrees"


def test_a_wrong_scale_is_a_wrong_geometry(sources: list[Source]) -> None:
    stretched = [replace(s, scale=replace(SCALE, c=2 * SCALE.c)) for s in sources]
    with pytest.raises(GeometryRefused, match="look alike"):
        check_agreement(stretched, photo(), CAMERA, ASIDE, Monitor())


def test_exposure_does_not_matter(sources: list[Source]) -> None:
    dim = replace(photo(), image=(photo().image * 0.6 + 20).astype(np.uint8))
    assert measure_agreement(sources, dim, CAMERA, ASIDE).of_photo()[0] > 0.8


def test_what_cannot_be_judged_is_not_judged(sources: list[Source]) -> None:
    plain = [source(f"00{k}", x, confidence=0.1) for k, x in enumerate(CENTRES_M)]
    agreement = measure_agreement(plain, photo(), CAMERA, ASIDE)
    assert np.isnan(agreement.share).all() and np.isnan(agreement.of_photo()).all()
    assert agreement.groups() == [[0, 1, 2]]
    monitor = Monitor()
    check_agreement(plain, photo(), CAMERA, ASIDE, monitor)
    assert monitor.notices == []
    # Looking the other way, nothing is in view: another check's business.
    behind = Pose(np.diag([-1.0, 1.0, -1.0]) @ rotation_z(0.0), np.zeros(3))
    assert np.isnan(measure_agreement(sources, photo(), CAMERA, behind).of_photo()[1])


def test_one_source_is_judged_by_the_photo_alone(sources: list[Source]) -> None:
    monitor = Monitor()
    agreement = check_agreement(sources[:1], photo(), CAMERA, ASIDE, monitor)
    assert np.isnan(agreement.of_source(0)[1]) and agreement.of_photo()[1] > 0.4 and monitor.notices == []


def of_halves(share: np.ndarray, advantage: np.ndarray) -> Agreement:
    """Everything agrees on the whole; in one half this."""
    return Agreement(np.full((3, 4), 0.9), np.full((3, 4), 0.6), Agreement(share, advantage))


def test_a_background_that_fits_is_not_enough(sources: list[Source], monkeypatch: pytest.MonkeyPatch) -> None:
    """A wall that repeats fits at a wrong place; what stands before it does not."""
    share, advantage = np.full((3, 4), 0.8), np.full((3, 4), 0.5)
    share[:, 3], advantage[:, 3] = 0.1, -0.02
    monkeypatch.setattr(agreement_module, "measure_agreement", lambda *_: of_halves(share, advantage))
    monitor = Monitor()
    check_agreement(sources, photo(), CAMERA, ASIDE, monitor)
    assert [n.code for n in monitor.notices] == ["pose-doubtful"] and "photo photo" in monitor.notices[0].message
    share, advantage = np.full((3, 4), 0.8), np.full((3, 4), 0.5)
    share[2, :3] = share[:, 2] = 0.1
    advantage[2, :3] = advantage[:, 2] = -0.02
    monkeypatch.setattr(agreement_module, "measure_agreement", lambda *_: of_halves(share, advantage))
    monitor = Monitor()
    check_agreement(sources, photo(), CAMERA, ASIDE, monitor)
    (notice,) = monitor.notices
    assert notice.code == "pose-doubtful" and "capture 002" in notice.message


@pytest.mark.parametrize(("found", "usual", "said"), [(0.09, 0.4, True), (0.2, 0.4, False), (0.09, 0.15, False)])
def test_a_photo_that_fits_far_worse_than_the_sources(
    sources: list[Source], monkeypatch: pytest.MonkeyPatch, found: float, usual: float, said: bool
) -> None:
    """Seen from behind, before a backdrop that repeats: the table still fits by its grain."""
    share, advantage = np.full((3, 4), 0.8), np.full((3, 4), usual)
    share[:, 3], advantage[:, 3] = 0.45, found
    monkeypatch.setattr(agreement_module, "measure_agreement", lambda *_: of_halves(share, advantage))
    monitor = Monitor()
    check_agreement(sources, photo(), CAMERA, ASIDE, monitor)
    assert [n.code for n in monitor.notices] == ["pose-doubtful"] * said
    assert not said or "photo photo" in monitor.notices[0].message


def test_a_photo_that_shows_nothing_is_not_judged(sources: list[Source]) -> None:
    monitor = Monitor()
    plain = replace(photo(), image=np.full_like(photo().image, 90))
    agreement = check_agreement(sources, plain, CAMERA, ASIDE, monitor)
    assert np.isnan(agreement.of_photo()).all() and monitor.notices == []


def test_the_worse_half_counts(sources: list[Source]) -> None:
    verdicts = measure_agreement(sources, photo(), CAMERA, ASIDE)
    assert verdicts.half is not None
    known = np.isfinite(verdicts.half.advantage)
    assert known.any() and (verdicts.half.advantage[known] <= verdicts.advantage[known] + 0.1).all()


def test_groups_that_contradict_each_other() -> None:
    share = np.full((4, 5), 0.2)
    advantage = np.zeros((4, 5))
    for i, j in ((0, 1), (2, 3)):
        advantage[i, j] = advantage[j, i] = 2 * DOUBTFUL_ADVANTAGE
    split = Agreement(share, advantage)
    assert split.groups() == [[0, 1], [2, 3]]
    bridged = advantage.copy()
    bridged[1, 4] = bridged[2, 4] = 2 * DOUBTFUL_ADVANTAGE
    assert Agreement(share, bridged).groups() == [[0, 1, 2, 3]], "the photo is between them"
    assert all(split.of_source(k)[1] > REFUSE_ADVANTAGE for k in range(4))
