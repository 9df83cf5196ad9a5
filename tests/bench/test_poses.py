from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.bench import poses
from lfrig.bench.cases import MEDIUM
from lfrig.bench.poses_errors import Alignment, pose_figures, relative_rotation_error_deg
from lfrig.bench.poses_priors import ANGLE_SIGMA_DEG, FOCAL_SIGMA, PoseCase, draw_case, without_rig
from lfrig.bench.poses_scene import PLATE_DEG, PhotoShot, Shot
from lfrig.bench.poses_table import SETUPS, Setup, acceptance, fault_summaries, summaries, tables
from lfrig.contracts.bench import BenchDocument
from lfrig.processing.geometry import rotation_angle_deg, rotation_z, turntable_pose, world_points
from lfrig.processing.model import Anchors, Camera, Evidence, Optics, Pose
from lfrig.processing.poses import PoseSolution
from lfrig.sim.optics import look_at

W, H = 48, 32
DEPTH_M = 0.45
ANGLES_DEG = (0.3, 14.8, 30.1)


def mount() -> Pose:
    return Pose(*look_at(np.array([0.0, -0.4, 0.2]), np.array([0.0, 0.0, 0.04])))


def shot(angle_deg: float, focal_px: float = 100.0) -> Shot:
    rng = np.random.default_rng(int(10 * angle_deg))
    views = rng.integers(0, 255, (3, 3, H, W, 3), np.uint8)
    evidence = Evidence(np.full((H, W, 2), 32767, np.uint16), (0.0, 0.1), *np.full((2, H, W), 0.5, np.float32))
    inverse = np.full((H, W), 1 / DEPTH_M, np.float32)
    camera = Camera.centred(W, H, focal_px)
    pose = turntable_pose(mount(), angle_deg)
    return Shot(angle_deg, views, camera, pose, Optics(0.0007, 0.46, 0.0), inverse, evidence)


def photo(angle_deg: float = 25.0) -> PhotoShot:
    own = shot(angle_deg, 110.0)
    return PhotoShot(angle_deg, own.views[1, 1], own.camera, own.pose, own.inverse_depth)


@pytest.fixture
def shots() -> list[Shot]:
    return [shot(angle) for angle in ANGLES_DEG]


def moved(pose: Pose, rotation: np.ndarray, scale: float, shift: np.ndarray) -> Pose:
    """The pose in the world X' = scale · rotation · X + shift."""
    turned = pose.rotation @ rotation.T
    return Pose(turned, scale * pose.translation - turned @ shift)


def solution(case: PoseCase, scale: float = 1.0, shift_m: float = 0.0, turn_rad: float = 0.0) -> PoseSolution:
    """The true geometry in another world, every point of the first row an anchor."""
    rotation, shift = rotation_z(turn_rad), np.full(3, shift_m)
    assert case.photo is not None
    every = [moved(s.pose, rotation, scale, shift) for s in (*case.shots, case.photo)]
    xy = np.c_[np.arange(4.0, W - 4), np.full(W - 8, 9.0)]
    depth = np.full(len(xy), scale * DEPTH_M)
    anchors = [
        Anchors(xy, depth, world_points(s.camera, p, xy, depth)) for s, p in zip(case.shots, every, strict=False)
    ]
    return PoseSolution(
        "colmap-turntable", tuple(every[:-1]), tuple(s.camera for s in case.shots), tuple(anchors),
        (0.0,) * len(case.shots), every[-1], case.photo.camera, True, "mount",
    )  # fmt: skip


def test_priors_are_off_by_what_they_say(shots: Sequence[Shot]) -> None:
    cases = [draw_case(shots, photo(), seed) for seed in range(300)]
    angle = [[s.turntable_deg - t.angle_deg for s, t in zip(c.sources, shots, strict=True)] for c in cases]
    focal = [[s.camera.focal_px / t.camera.focal_px - 1 for s, t in zip(c.sources, shots, strict=True)] for c in cases]
    assert np.std(angle) == pytest.approx(ANGLE_SIGMA_DEG, rel=0.1) and abs(np.mean(angle)) < 0.1
    assert np.std(focal) == pytest.approx(FOCAL_SIGMA, rel=0.1)
    mounts = [c.prior.light_field_from_plate for c in cases]
    turns = [rotation_angle_deg(m.rotation, mount().rotation) for m in mounts]
    assert np.sqrt(np.mean(np.square(turns))) == pytest.approx(1.0, rel=0.1)
    steps = np.array([m.centre - mount().centre for m in mounts])
    assert np.sqrt(np.mean(steps**2)) == pytest.approx(mounts[0].sigma_m, rel=0.1)
    # Elevation moves the camera on its arc and its direction with it: the axis stays where it was in the picture.
    origin = [m.translation[:2] / m.translation[2] for m in mounts]
    assert np.ptp(origin, axis=0) == pytest.approx(0, abs=1e-12)


def test_a_draw_depends_on_its_seed_alone(shots: Sequence[Shot]) -> None:
    one, two, other = (draw_case(shots, photo(), seed) for seed in (3, 3, 4))
    assert [s.turntable_deg for s in one.sources] == [s.turntable_deg for s in two.sources]
    assert one.sources[0].turntable_deg != other.sources[0].turntable_deg
    told = draw_case(shots, photo(), 3, photo_expected=True)
    assert told.target.turntable_deg is not None and told.prior.target_from_plate is not None
    assert one.target.turntable_deg is None and one.prior.target_from_plate is None
    assert [s.turntable_deg for s in told.sources] == [s.turntable_deg for s in one.sources]
    exact = draw_case(shots, photo(), 3, photo_focal=(0.05, 0.05)).target.camera
    assert exact is not None and exact.focal_px == pytest.approx(1.05 * photo().camera.focal_px)


def test_without_a_rig_nothing_ties_captures_to_a_plate(shots: Sequence[Shot]) -> None:
    case = without_rig(draw_case(shots, photo(), 0, photo_expected=True))
    assert all(s.turntable_deg is None and s.depth_range_m is None and s.camera is not None for s in case.sources)
    assert case.target.turntable_deg is None and case.prior.light_field_from_plate is None


def test_the_truth_has_no_error_in_any_frame(shots: Sequence[Shot]) -> None:
    case = draw_case(shots, photo(), 0)
    for found in (solution(case), solution(case, scale=1.3, shift_m=0.2, turn_rad=2.0)):
        figures = pose_figures(found, case)
        for name in ("rotation_deg", "centre_mm", "focal_pct", "depth_pct", "outliers_pct", "photo_rotation_deg",
                     "photo_centre_mm", "transfer_px"):  # fmt: skip
            assert figures[name] == pytest.approx(0, abs=1e-4), name
    assert figures["scale_pct"] == pytest.approx(30) and figures["anchors"] == W - 8


def test_errors_are_those_that_were_put_in(shots: Sequence[Shot]) -> None:
    case = draw_case(shots, photo(), 0)
    found = solution(case, scale=1.3, turn_rad=2.0)
    turn = rotation_z(np.deg2rad(0.4))
    bent = replace(
        found.poses[1], rotation=turn @ found.poses[1].rotation, translation=turn @ found.poses[1].translation
    )
    wrong = replace(
        found,
        poses=(found.poses[0], bent, found.poses[2]),
        cameras=(replace(found.cameras[0], focal_px=103.0), *found.cameras[1:]),
        anchors=tuple(replace(a, depth_m=1.05 * a.depth_m) for a in found.anchors),
        target_pose=replace(found.target_pose, translation=found.target_pose.translation + np.array([0, 0, 0.0013])),
    )
    figures = pose_figures(wrong, case)
    assert figures["rotation_deg"] == pytest.approx(0.4)
    assert figures["focal_pct"] == pytest.approx(3)
    assert figures["depth_pct"] == pytest.approx(5, abs=0.1) and figures["outliers_pct"] == 100
    assert figures["photo_centre_mm"] == pytest.approx(1.0, abs=0.2)
    assert figures["transfer_px"] > 0.2


def test_one_pair_is_enough_to_be_wrong(shots: Sequence[Shot]) -> None:
    true = [s.pose for s in shots]
    assert relative_rotation_error_deg(true, true) == pytest.approx(0, abs=1e-9)
    spoiled = [*true[:2], turntable_pose(true[2], 0.5)]
    assert relative_rotation_error_deg(spoiled, true) == pytest.approx(0.5)
    assert Alignment.between(true, true).scale == pytest.approx(1)


def good_row(**changes: Any) -> dict[str, Any]:
    return {
        "kind": "sources", "setup": SETUPS[0].name, "scene": "desk", "seed": 0, "rotation_deg": 0.01, "anchors": 900,
        "photo_rotation_deg": 0.02, "transfer_px": 0.3, "scale_pct": -0.4, "warnings": ["wide-step"],
    } | changes  # fmt: skip


def test_summaries_hold_medians_maxima_and_refusals() -> None:
    rows = [good_row(rotation_deg=r, seed=i, anchors=700 + i) for i, r in enumerate((0.01, 0.05, 0.02))]
    rows[1]["warnings"] = ["angle-corrected"]
    refusal = {"kind": "sources", "setup": SETUPS[0].name, "scene": "fence", "seed": 9, "refused": "too-few-matches"}
    (row,) = summaries([*rows, refusal])
    assert (row["rotation_deg"], row["rotation_deg_max"], row["anchors"]) == (0.02, 0.05, 700)
    assert (row["runs"], row["refusals"], row["alarms"], row["worst"]) == (4, 1, 1, "desk, seed 1")
    assert row["scale_pct"] == 0.4, "of its size"


@pytest.mark.parametrize(
    ("row", "failing"),
    [
        ({}, 0),
        ({"rotation_deg": 0.031}, 1),
        ({"rotation_deg": 0.061}, 2),
        ({"anchors": 499}, 1),
        ({"warnings": ["angle-corrected"]}, 1),
        ({"setup": "3 at 30°", "rotation_deg": 0.09, "anchors": 90}, 0),
        ({"setup": "3 at 30°", "rotation_deg": 0.11}, 1),
        ({"kind": "photo", "setup": "25°, focal known", "photo_rotation_deg": 0.051}, 1),
        ({"kind": "free", "transfer_px": 4.0}, 1),
    ],
)
def test_every_bound_can_fail(row: dict[str, Any], failing: int) -> None:
    rows = [good_row(**row)]
    assert sum(not check.ok for check in acceptance(summaries(rows), rows)) == failing


def test_nothing_that_went_through_passes_nothing() -> None:
    rows = [{"kind": "sources", "setup": SETUPS[0].name, "scene": "desk", "seed": 0, "refused": "x"}]
    failed = [check.name for check in acceptance(summaries(rows), rows) if not check.ok]
    assert len(failed) == 4 and any("refused" in name for name in failed)


def test_a_silent_fault_fails_the_acceptance() -> None:
    fault = {"kind": "fault", "fault": "focal", "scene": "desk", "outcome": "corrected", "named": True, "codes": ["a"]}
    cases: list[tuple[dict[str, Any], int]] = [
        ({}, 0), ({"outcome": "SILENT WRONG", "named": False}, 1), ({"outcome": "refused", "named": False}, 1)
    ]  # fmt: skip
    for change, failing in cases:
        assert sum(not check.ok for check in acceptance([], [fault | change])) == failing
    (line,) = fault_summaries([fault, fault | {"outcome": "refused", "transfer_px": 2.0}])
    assert line["outcome"] == ["1 corrected", "1 refused"] and line["transfer_px"] == 2.0


def test_tables_leave_out_what_was_not_run() -> None:
    rows = [good_row()]
    assert [t.title for t in tables(summaries(rows), rows)] == ["Sources, from the turntable's prior"]


def test_setups_use_the_plate_angles_that_are_shot() -> None:
    assert all(set(setup.angles_deg) <= set(PLATE_DEG) for setup in SETUPS)


@pytest.mark.slow
def test_the_benchmark_end_to_end(tmp_path: Path) -> None:
    document = poses.run(
        tmp_path / "out", scenes=["figurines"], size=MEDIUM, seeds=1, parts=("sources", "faults"), threads=1,
        setups=[Setup("3 at 15°", (0.0, 15.0, 30.0))], faults=["angle-12"], cache_dir=tmp_path / "cache",
    )  # fmt: skip
    assert BenchDocument.load(tmp_path / "out" / "poses.json") == document
    rows = {row["kind"]: row for row in document.rows}
    assert rows["sources"]["rotation_deg"] < 0.1 and rows["sources"]["cpu_s"] > 0
    assert rows["fault"]["outcome"] == "corrected"
    assert document.checks == [], "the bounds hold at full size on the default scenes"
    assert "one angle wrong by 12°" in (tmp_path / "out" / "poses.md").read_text(encoding="utf-8")
