"""The faults do what they say, and how they end is told apart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from lfrig.bench import poses_faults
from lfrig.bench.poses_faults import FAULTS, FOCAL_ERROR, Fault, Subject
from lfrig.bench.poses_gate import LIMITS, accepted, refused, too_far
from lfrig.bench.poses_priors import PoseCase, draw_case
from lfrig.bench.poses_scene import PLATE_DEG, SceneShots
from lfrig.bench.poses_wall import painted, photo_with_still_wall, wall_points, wall_texture
from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Notice
from tests.bench.test_poses import photo, shot

WIDTH = 541
GOOD = {"rotation_deg": 0.02, "depth_pct": 0.1, "transfer_px": 0.4}
BY_KEY = {fault.key: fault for fault in FAULTS}


@pytest.fixture
def subject() -> Subject:
    shots = [shot(angle) for angle in (0.1, 15.2, 29.7, 45.0, 60.3)]
    stranger = replace(photo(), image=np.full_like(photo().image, 9))
    return Subject(draw_case(shots, photo(), 1), SceneShots("plaster", (48, 32)), 1, lambda: stranger)


def said(case: PoseCase) -> list[float]:
    return [source.turntable_deg or 0.0 for source in case.sources]


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        ("swapped", lambda a: [a[0], a[3], a[2], a[1], a[4]]),
        ("swapped-next", lambda a: [a[0], a[2], a[1], a[3], a[4]]),
        ("angle-6", lambda a: [a[0], a[1] + 6, a[2], a[3], a[4]]),
        ("angle-end", lambda a: [*a[:4], a[4] + 12]),
        ("stretched", lambda a: [1.3 * x for x in a]),
        ("reversed", lambda a: [-x for x in a]),
    ],
)
def test_angles_that_are_wrong(subject: Subject, key: str, expected: Callable[[list[float]], list[float]]) -> None:
    broken = BY_KEY[key].put(subject)
    assert said(broken) == pytest.approx(expected(said(subject.case)))
    assert broken.shots == subject.case.shots, "the truth stays"
    assert [s.id for s in broken.sources] == ["000", "001", "002", "003", "004"]


def test_a_view_shot_twice_is_where_it_was(subject: Subject) -> None:
    broken = BY_KEY["twice"].put(subject)
    moved = np.abs(broken.sources[3].views.astype(int) - subject.case.shots[2].views)
    assert 0 < moved.mean() < 2
    assert broken.shots[3].pose is subject.case.shots[2].pose and said(broken) == said(subject.case)


def test_a_wrong_focal_length(subject: Subject) -> None:
    broken, before = BY_KEY["focal"].put(subject), subject.case.sources
    ratios = [b.camera.focal_px / a.camera.focal_px for a, b in zip(before, broken.sources, strict=True)]
    assert ratios == pytest.approx([1, 1 + FOCAL_ERROR, 1, 1, 1])


def test_a_defocused_capture_has_evidence_of_its_own(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(poses_faults, "BLUR_PX", 30.0)  # 2.7 px at this width
    broken = BY_KEY["defocused"].put(replace(subject, shots=SceneShots("plaster", (48, 32), threads=1)))
    sharp, soft = (np.abs(np.diff(c.sources[1].views.astype(float), axis=3)).mean() for c in (subject.case, broken))
    assert soft < 0.5 * sharp
    assert broken.shots[1].evidence is not subject.case.shots[1].evidence
    assert broken.sources[0].views is subject.case.sources[0].views


@pytest.mark.parametrize("expected", [False, True])
def test_a_photo_of_another_scene_has_no_truth(subject: Subject, expected: bool) -> None:
    broken = BY_KEY["stranger-expected" if expected else "stranger"].put(subject)
    assert broken.photo is None and (broken.target.image == 9).all()
    assert (broken.target.turntable_deg is not None) == expected


def test_ends_are_told_apart() -> None:
    fault = BY_KEY["focal"]
    named, other = Notice("focal-corrected", "capture 001: …"), Notice("few-anchors", "capture 004: …")
    doubt = Notice("pose-doubtful", "capture 001: …")
    ends = [
        (GOOD, [], "unaffected"), (GOOD, [named], "corrected"), (GOOD, [other], "unaffected"),
        (GOOD | {"transfer_px": 9.0}, [named, doubt], "flagged"),
        (GOOD | {"transfer_px": 9.0}, [named], "SILENT WRONG"), (GOOD | {"transfer_px": 9.0}, [other], "SILENT WRONG"),
        (GOOD | {"depth_pct": float("nan")}, [], "SILENT WRONG"),
        (GOOD | {"rotation_deg": 1.0}, [Notice("wide-step", "capture 001: …")], "SILENT WRONG"),
    ]  # fmt: skip
    for figures, notices, outcome in ends:
        assert accepted(fault, figures, notices, WIDTH)["outcome"] == outcome
    refusal = GeometryRefused("capture 002: does not fit", code="x", remedy="y")
    assert refused(fault, refusal)["named"] is False
    assert refused(BY_KEY["reversed"], refusal)["named"] is True, "all are to blame"


def test_limits_are_in_proportion_to_the_width() -> None:
    figures = GOOD | {"transfer_px": 0.6 * LIMITS["transfer_px"]}
    assert too_far(figures, WIDTH) == [] and too_far(figures, WIDTH // 2) == ["transfer_px"]
    assert too_far({"rotation_deg": 0.0, "depth_pct": 0.0}, WIDTH) == ["photo"]


def test_keys_are_unique() -> None:
    assert len(BY_KEY) == len(FAULTS) and all(isinstance(fault, Fault) for fault in FAULTS)


def test_the_wall_stands_still_while_the_plate_turns() -> None:
    shots = SceneShots("plaster", (48, 32), threads=1)
    texture, exposure = wall_texture(1), shots.rig.exposure(0)
    camera = shots.rig.light_field_camera(0, 0.0)
    offsets = np.array([[0.0, 0.0], [3.0, -2.0]])
    blank = np.zeros((1, 2, 32, 48, 3), np.uint8)
    base = shots.rig.true_angle_deg(0.0)
    here = painted(shots, blank, camera, offsets, base, exposure, texture)
    there = painted(shots, blank, camera.on_plate_at(20.0), offsets, base + 20.0, exposure, texture)
    both = (here > 0).any(-1) & (there > 0).any(-1)
    assert both.mean() > 0.1
    difference = np.abs(here.astype(int) - there)[both]
    assert np.median(difference) <= 1 and (difference > 8).mean() < 0.02


def test_wall_points_are_on_the_wall_for_every_view() -> None:
    from lfrig.sim.renderer import render_depth

    shots = SceneShots("plaster", (48, 32), threads=1)
    camera = shots.rig.light_field_camera(PLATE_DEG.index(15.0), 15.0)
    offset = np.array([3.0, -3.0])
    depth = render_depth(shots.rig.packed(), camera, offset[None], threads=1)[0]
    points, mask = wall_points(camera, depth, offset, 0.0)
    assert mask.any()
    radius = np.hypot(points[:, 0], points[:, 1])
    wall = radius > 0.99 * radius.max()
    assert np.ptp(radius[wall]) < 1e-5 * radius.max(), "a cylinder, seen from a corner view"


def test_the_photo_keeps_all_but_the_wall(tmp_path) -> None:
    shots = SceneShots("plaster", (48, 32), threads=1, cache_dir=tmp_path)
    before, after = shots.photo(25.0), photo_with_still_wall(shots, 25.0, wall_texture(1))
    changed = (before.image != after.image).any(-1).mean()
    assert 0.02 < changed < 0.6
    assert after.pose is before.pose
