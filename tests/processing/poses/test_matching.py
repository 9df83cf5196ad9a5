"""Features, matches, epipolar segments, tracks, triangulation: each against a plain way of doing the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.processing import geometry
from lfrig.processing.model import Camera, Pose
from lfrig.processing.poses.epipolar import (
    Segments,
    epipolar_segments,
    fundamental_matrix,
    sampson_distance,
)
from lfrig.processing.poses.features import DESCRIPTOR_LENGTH, Features, extract_features
from lfrig.processing.poses.guide import common_shift
from lfrig.processing.poses.matching import Gallery, likely_pairs, match_candidates, similar_scale
from lfrig.processing.poses.tracks import build_tracks
from lfrig.processing.poses.triangulate import ray_angle_deg, reproject, triangulate

CAMERAS = (Camera.centred(320, 240, 600.0), Camera.centred(300, 220, 560.0), Camera.centred(320, 240, 610.0))


def made_features(xy, descriptor_seed=0, twins=0) -> Features:
    """Random unit descriptors at positions; the last ``twins`` rows repeat the first positions."""
    rng = np.random.default_rng(descriptor_seed)
    root = np.sqrt(rng.dirichlet(np.ones(128), len(xy)))
    place = np.arange(len(xy))
    if twins:
        place[-twins:] = np.arange(twins)
    rounded = np.rint(root * DESCRIPTOR_LENGTH).astype(np.float32)
    return Features(np.asarray(xy, float), np.ones(len(xy)), rounded, place)


def test_features_follow_a_shift_of_a_quarter_pixel(still, studio):
    camera = still.true_cameras[1]
    image = still.sources[1].centre_view
    shifted = Camera(camera.width, camera.height, camera.focal_px, camera.cx + 5.25, camera.cy - 3.5)
    other, _ = studio.render(studio.still_life(), shifted, still.true_poses[1])
    first, second = extract_features(np.ascontiguousarray(image)), extract_features(other)
    matches = Gallery([first, second]).match(0, 1)
    moved = second.xy[matches[:, 1]] - first.xy[matches[:, 0]]
    assert len(matches) > 150
    np.testing.assert_allclose(np.median(moved, axis=0), [5.25, -3.5], atol=0.06)


def test_a_blank_image_has_no_features():
    features = extract_features(np.full((60, 80, 3), 128, np.uint8))
    assert len(features) == 0
    assert Gallery([features, features]).match(0, 1).shape == (0, 2)


def test_descriptors_are_integers_of_fixed_length(still):
    features = extract_features(np.ascontiguousarray(still.sources[0].centre_view))
    np.testing.assert_array_equal(features.descriptor, np.rint(features.descriptor))
    np.testing.assert_allclose(np.linalg.norm(features.descriptor, axis=1), DESCRIPTOR_LENGTH, rtol=0.01)


def test_matching_finds_a_permutation():
    rng = np.random.default_rng(0)
    first = made_features(rng.uniform(0, 200, (80, 2)))
    order = rng.permutation(80)
    second = Features(first.xy[order], first.scale, first.descriptor[order], np.arange(80))
    matches = Gallery([first, second]).match(0, 1)
    np.testing.assert_array_equal(order[matches[:, 1]], matches[:, 0])
    assert len(matches) == 80


def test_a_repeated_descriptor_is_ambiguous_but_a_second_orientation_is_not():
    first = made_features(np.random.default_rng(0).uniform(0, 200, (20, 2)))
    doubled = np.r_[first.descriptor, first.descriptor[:1]]
    elsewhere = Features(np.r_[first.xy, [[5.0, 5.0]]], np.ones(21), doubled, np.arange(21))
    assert 0 not in Gallery([first, elsewhere]).match(0, 1)[:, 0]
    same_place = Features(np.r_[first.xy, first.xy[:1]], np.ones(21), doubled, np.r_[np.arange(20), 0])
    matches = Gallery([first, same_place]).match(0, 1)
    assert [0, 0] in matches.tolist()
    assert len(np.unique(matches[:, 1])) == len(matches)


def test_matches_are_those_of_a_plain_search():
    rng = np.random.default_rng(3)
    first = made_features(rng.uniform(0, 200, (60, 2)), 1)
    spoilt = np.abs(first.descriptor + rng.normal(0, 12, first.descriptor.shape))
    second = Features(first.xy, first.scale, np.rint(spoilt).astype(np.float32), first.place)
    squared = ((first.descriptor[:, None] - second.descriptor[None]) ** 2).sum(2) / DESCRIPTOR_LENGTH**2
    expected = []
    for row in range(60):
        best, runner_up = np.argsort(squared[row])[:2]
        limit = min(0.85**2 * min(squared[row, runner_up], 0.5), 0.5)
        if squared[row, best] < limit and squared[:, best].argmin() == row:
            expected.append([row, best])
    assert len(expected) > 20
    np.testing.assert_array_equal(Gallery([first, second]).match(0, 1), expected)


def test_fewer_candidates_have_fewer_rivals():
    first = made_features([[1.0, 1.0], [50.0, 50.0]])
    twin = Features(first.xy[[0, 0]] + [[0, 0], [9, 9]], np.ones(2), first.descriptor[[0, 0]], np.arange(2))
    candidates = likely_pairs(first, twin)
    assert len(match_candidates(first, twin, candidates)) == 0
    here = candidates.keep(candidates.columns == 0)
    np.testing.assert_array_equal(match_candidates(first, twin, here), [[0, 0]])


def test_scale_must_be_similar():
    first = made_features([[1.0, 1.0], [50.0, 50.0]])
    second = Features(first.xy, np.array([1.5, 3.0]), first.descriptor, first.place)
    candidates = likely_pairs(first, second)
    kept = candidates.keep(similar_scale(first, second, candidates))
    assert kept.rows.tolist() == [0] == kept.columns.tolist()


coordinates = st.floats(0, 100)


@given(
    st.tuples(coordinates, coordinates, coordinates, coordinates),
    st.tuples(coordinates, coordinates),
    st.floats(0.5, 20),
)
def test_a_segment_contains_what_its_frame_says(ends, pixel, margin):
    start, end, xy = np.array(ends[:2]), np.array(ends[2:]), np.array(pixel)
    length = np.linalg.norm(end - start)
    unit = (end - start) / max(length, 1e-12)
    across, along = np.cross(np.r_[unit, 0], np.r_[xy - start, 0])[2], (xy - start) @ unit
    slack = min(abs(abs(across) - margin), abs(along + margin), abs(along - length - margin))
    expected = abs(across) < margin and -margin < along < length + margin
    found = Segments(start[None], unit[None], np.array([length])).contains(np.array([0]), xy[None], margin)[0]
    assert found == expected or slack < 1e-9


@pytest.fixture
def scene(studio):
    poses = [geometry.turntable_pose(studio.mount(), a) for a in (-15.0, 0.0, 12.0)]
    points = np.random.default_rng(1).uniform([-0.06, -0.06, 0], [0.06, 0.06, 0.09], (60, 3))
    sightings = [geometry.project_points(c, p, points) for c, p in zip(CAMERAS, poses, strict=True)]
    return poses, points, [s[0] for s in sightings], [s[1] for s in sightings]


def test_true_matches_satisfy_the_epipolar_constraint(scene):
    poses, _, xy, _ = scene
    f = fundamental_matrix(CAMERAS[0], poses[0], CAMERAS[1], poses[1])
    assert sampson_distance(f, xy[0], xy[1]).max() < 1e-9
    normal_shift = sampson_distance(f, xy[0], xy[1] + [0, 2.0])
    assert (normal_shift > 0.5).all() and (normal_shift < 2.0).all()


def test_segments_contain_the_true_matches(scene):
    poses, _, xy, depth = scene
    interval = 1 / (depth[0] * 1.05), 1 / (depth[0] * 0.95)
    segments = epipolar_segments(xy[0], CAMERAS[:2], (poses[0], poses[1]), interval)
    everyone = np.arange(len(xy[0]))
    assert segments.contains(everyone, xy[1], 1e-6).all()
    beyond = epipolar_segments(xy[0], CAMERAS[:2], (poses[0], poses[1]), (1 / (depth[0] * 1.2), 1 / (depth[0] * 1.1)))
    assert not beyond.contains(everyone, xy[1], 1e-6).any()


def test_triangulation_is_exact_and_its_residuals_vanish(scene):
    poses, points, xy, _ = scene
    features = [made_features(p) for p in xy]
    pairs = np.c_[np.arange(60), np.arange(60)]
    seen = build_tracks(features, {(0, 1): pairs, (1, 2): pairs[:40]})
    assert seen.count == 60 and len(seen) == 160
    found = triangulate(CAMERAS, poses, seen)
    np.testing.assert_allclose(found, points, atol=1e-9)
    residual, depth = reproject(CAMERAS, poses, seen, found)
    assert np.abs(residual).max() < 1e-6 and (depth > 0).all()
    angles = ray_angle_deg(poses, seen, found)
    assert (angles[:40] > 20).all() and (angles[40:] > 10).all() and (angles[40:] < 18).all()


def test_parallel_rays_do_not_break_triangulation():
    pose = Pose(np.eye(3), np.zeros(3))
    seen = build_tracks([made_features([[5.0, 5.0]])] * 2, {(0, 1): np.array([[0, 0]])})
    found = triangulate(CAMERAS[:1] * 2, [pose, pose], seen)
    assert np.isfinite(found).all()
    assert ray_angle_deg([pose, pose], seen, found)[0] == pytest.approx(0, abs=1e-6)


def test_a_track_never_holds_two_features_of_one_view():
    features = [made_features(np.arange(6.0).reshape(3, 2) + k) for k in range(3)]
    matches = {
        (0, 1): np.array([[0, 0], [1, 1]]),
        (1, 2): np.array([[0, 0], [1, 1]]),
        (0, 2): np.array([[0, 1], [2, 2]]),  # [0, 1] contradicts the chain 0–0–0
    }
    seen = build_tracks(features, matches)
    assert seen.count == 3 and len(seen) == 8
    pairs = list(zip(seen.point.tolist(), seen.view.tolist(), strict=True))
    assert len(set(pairs)) == len(pairs)


def test_keeping_rows_drops_points_that_are_seen_once(scene):
    _, _, xy, _ = scene
    pairs = np.c_[np.arange(60), np.arange(60)]
    seen = build_tracks([made_features(p) for p in xy], {(0, 1): pairs, (1, 2): pairs[:40]})
    rows = seen.view != 0
    kept, which = seen.keep(rows)
    assert kept.count == 40 and len(kept) == 80
    np.testing.assert_array_equal(which, np.arange(40))
    assert (np.bincount(kept.point) == 2).all()


def test_candidates_that_share_a_shift_are_found_among_many_false_ones():
    rng = np.random.default_rng(0)
    rows = np.repeat(np.arange(120), 9)
    offsets = rng.uniform(-40, 40, (len(rows), 2))
    true = np.arange(len(rows)) % 9 == 0
    offsets[true] = np.array([17.0, -9.0]) + rng.normal(0, 2, (true.sum(), 2))
    squared = np.full(len(rows), 0.15 * DESCRIPTOR_LENGTH**2, np.float32)
    shift = common_shift(offsets, rows, squared, 40.0)
    np.testing.assert_allclose(shift, [17, -9], atol=2)
    offsets[true] = rng.uniform(-40, 40, (true.sum(), 2))
    assert common_shift(offsets, rows, squared, 40.0) is None
