"""Given poses by corners alone, and what is remembered from one solve to the next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Optics, Pose
from lfrig.processing.poses import PoseWork, features, patches, solve_poses
from lfrig.processing.skipping import Skips, Tally
from lfrig.processing.still import warn_of_still_background


def solve(shoot, work=None, method="auto", monitor=None, **options):
    return solve_poses(*shoot.arguments(), method, threads=1, monitor=monitor or Monitor(), work=work, **options)


@pytest.fixture(scope="module")
def posed(studio):
    """Light fields whose poses are given."""
    return studio.shoot((-15.0, 0.0, 15.0), given=True, light_fields=True, seed=3)


@pytest.fixture
def counted(monkeypatch):
    """How often features were extracted and pictures aligned."""
    count = {"features": 0, "aligned": 0}
    extract, align = features.extract_features, patches.align_patches

    def extracting(*args, **options):
        count["features"] += 1
        return extract(*args, **options)

    def aligning(*args, **options):
        count["aligned"] += 1
        return align(*args, **options)

    monkeypatch.setattr("lfrig.processing.poses.solve.extract_features", extracting)
    monkeypatch.setattr("lfrig.processing.poses.patches.align_patches", aligning)
    return count


def assert_same(one, two, atol=0.0):
    for a, b in zip((*one.poses, one.target_pose), (*two.poses, two.target_pose), strict=True):
        np.testing.assert_allclose(a.rotation, b.rotation, atol=atol)
        np.testing.assert_allclose(a.translation, b.translation, atol=atol)


def test_given_poses_need_no_features(posed, counted):
    monitor = Monitor()
    solution = solve(posed, monitor=monitor)
    assert solution.method == "given" and counted["features"] == 0 and not monitor.notices
    for found, said in zip(solution.poses, posed.true_poses, strict=True):
        np.testing.assert_allclose(found.translation, said.translation, atol=1e-12)
    assert min(len(a) for a in solution.anchors) >= 100
    ratios = np.concatenate([posed.depth_ratios(solution, v) for v in range(3)])
    assert np.median(np.abs(ratios - 1)) < 0.002


def test_given_poses_of_a_world_far_away(posed, counted):
    far = np.array([4e5, -2e5, 1e5])

    def moved(pose):
        return Pose(pose.rotation, pose.translation - pose.rotation @ far)

    sources = [replace(s, pose=moved(s.pose)) for s in posed.sources]
    shoot = replace(posed, sources=sources, target=replace(posed.target, pose=moved(posed.target.pose)))
    here, there = solve(posed), solve(shoot)
    assert counted["features"] == 0
    for a, b in zip(here.anchors, there.anchors, strict=True):
        assert abs(len(a) - len(b)) <= 2
        assert np.median(np.abs(np.median(a.depth_m) - np.median(b.depth_m))) < 1e-4
        np.testing.assert_allclose(np.median(b.world - far, 0), np.median(a.world, 0), atol=1e-4)


@pytest.mark.parametrize("missing", ["optics", "photo"])
def test_what_corners_cannot_tell_is_asked_of_features(posed, counted, missing):
    shoot = posed
    if missing == "optics":
        shoot = replace(posed, sources=[replace(s, optics=Optics()) for s in posed.sources])
    else:
        shoot = replace(posed, target=replace(posed.target, pose=None))
    solution = solve(shoot)
    assert solution.method == "given" and counted["features"] > 0
    assert shoot.target_error_px(solution) < 0.3


def test_corners_do_not_confirm_a_wrong_given_pose(posed, counted):
    """What matching and the checks that follow say of it is tested elsewhere."""
    turned = posed.sources[1].pose
    a = np.deg2rad(4.0)
    spin = np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1.0]])
    sources = list(posed.sources)
    sources[1] = replace(sources[1], pose=Pose(turned.rotation @ spin, turned.translation))
    solve(replace(posed, sources=sources))
    assert counted["features"] > 0


@pytest.mark.parametrize("kind", ["given", "turntable"])
def test_a_new_target_costs_only_itself(posed, light_still, studio, counted, kind):
    shoot = posed if kind == "given" else light_still
    other = studio.shoot(
        (-15.0, 0.0, 15.0), 2.0, given=kind == "given", light_fields=True, seed=3 if kind == "given" else 4,
        sigma_focal=0.0 if kind == "given" else 0.02, sigma_angle_deg=0.3 if kind == "given" else 0.5,
    )  # fmt: skip
    again = replace(
        shoot, target=other.target, true_target_pose=other.true_target_pose,
        true_target_camera=other.true_target_camera, target_depth=other.target_depth,
    )  # fmt: skip
    work = PoseWork()
    solve(shoot, work)
    first = counted["aligned"]
    warm = solve(again, work)
    spent = counted["aligned"] - first
    cold = solve(again)
    assert warm.method == cold.method
    assert spent < 0.7 * (counted["aligned"] - first - spent)
    assert again.rotation_error_deg(warm) < 0.08 and again.target_error_px(warm) < 0.3


def test_a_new_source_joins_what_is_known(light_still):
    work = PoseWork()
    pair = replace(light_still, sources=light_still.sources[:2], evidence=light_still.evidence[:2])
    solve(pair, work)
    solution = solve(light_still, work)
    assert solution.method == "lf" and light_still.rotation_error_deg(solution) < 0.08


def test_the_same_again_is_the_same(light_still):
    work = PoseWork()
    one = solve(light_still, work)
    assert_same(one, solve(light_still, work), atol=2e-4)


def test_nothing_is_remembered_where_that_is_switched_off(posed, counted):
    work, skips = PoseWork(), Skips().without("unchanged")
    one = solve(posed, work, skips=skips)
    first = counted["aligned"]
    two = solve(posed, work, skips=skips)
    assert counted["aligned"] == 2 * first
    assert_same(one, two)


def test_rounds_are_counted(posed):
    tally, all_rounds = Tally(), Tally()
    one = solve(posed, tally=tally)
    two = solve(posed, skips=Skips().without("adjustment"), tally=all_rounds)
    assert tally.counts["adjustment"].unit == "rounds" and tally.counts["adjustment"].skipped > 0
    assert tally.counts["adjustment"].done <= all_rounds.counts["adjustment"].done
    assert_same(one, two, atol=1e-3)


def test_only_the_very_same_objects_are_recognised():
    work = PoseWork()
    a, b = np.zeros(3), np.zeros(3)
    assert work.once("sum", (a,), lambda: 1) == 1
    assert work.once("sum", (a,), lambda: 2) == 1 and work.once("sum", (b,), lambda: 3) == 3
    assert work.once("other", (a,), lambda: 4) == 4


def test_what_is_not_asked_for_is_forgotten():
    work, a = PoseWork(), np.zeros(3)
    work.once("sum", (a,), lambda: 1)
    for _ in range(3):
        work.begin()
    assert work.recall("sum", (a,)) is None


def test_still_backgrounds_are_compared_once(light_still, monkeypatch):
    calls = []
    work = PoseWork()
    warn_of_still_background(light_still.sources, Monitor(), work)
    monkeypatch.setattr("lfrig.processing.still._share", lambda *a: calls.append(a) or 0.0)
    warn_of_still_background(light_still.sources, Monitor(), work)
    assert not calls


def test_features_of_a_smaller_picture_are_in_pixels_of_the_whole(posed):
    picture = np.ascontiguousarray(posed.sources[0].centre_view)
    whole, half = features.extract_features(picture), features.extract_features(picture, size=0.5)
    assert 20 < len(half) < len(whole)
    nearest = np.linalg.norm(whole.xy[None] - half.xy[:, None], axis=2).min(1)
    assert np.median(nearest) < 1.0
