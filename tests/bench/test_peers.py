"""The peers on two textured planes whose geometry is known exactly."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from lfrig.bench import peers
from lfrig.processing.metrics import disparity_scores
from lfrig.processing.model import Evidence, LightFieldRequest, ScaleFit, Source
from tests.processing import scenes

REQUEST = LightFieldRequest(scenes.BASELINE_M, scenes.FOCUS_M, 5, 5)
SCALE = ScaleFit(1 / (scenes.BASELINE_M * scenes.FOCAL), 1 / scenes.FOCUS_M)


@cache
def sources() -> tuple[Source, ...]:
    """Two sources beside the target with exact scale, pose and disparity."""
    made = []
    for name, x in (("000", -0.03), ("001", 0.03)):
        light_field = scenes.light_field(name, x)
        disparity = SCALE.disparity((1 / scenes.look(x, 0.0)[1]).astype(np.float32))
        evidence = Evidence(
            np.zeros((1, 1, 40), np.float16), (-0.4, 0.03), disparity, np.ones_like(disparity), views_used=25
        )
        assert light_field.pose is not None
        made.append(Source(light_field, scenes.CAMERA, light_field.pose, evidence, SCALE))
    return tuple(made)


def target() -> tuple[np.ndarray, np.ndarray]:
    """True disparity and depth of the target."""
    depth_m = scenes.photo()[1]
    return REQUEST.disparity((1 / depth_m).astype(np.float32), scenes.FOCAL), depth_m


@pytest.mark.parametrize("pairs", ["row", "cross"])
def test_sgbm_finds_the_planes(pairs: str) -> None:
    source = sources()[0]
    settings = peers.SgbmSettings(pairs=pairs)
    found = peers.sgbm_disparity(source.light_field, (-0.4, 0.8), settings)
    error = np.abs(found - source.evidence.disparity)[8:-8, 8:-8]
    assert np.nanmedian(error) < 0.05
    assert np.nanmean(error < 0.1) > 0.8


def test_a_mirrored_light_field_turns_the_sign() -> None:
    light_field = sources()[0].light_field
    mirrored = type(light_field)("m", np.ascontiguousarray(light_field.views[::-1, ::-1]))
    found = peers.sgbm_disparity(mirrored, (-0.8, 0.4))
    error = np.abs(found + sources()[0].evidence.disparity)[8:-8, 8:-8]
    assert np.nanmedian(error) < 0.05


def test_carrying_exact_disparity_gives_exact_depth() -> None:
    pose = scenes.photo()[0].pose
    assert pose is not None
    depth_m = target()[1]
    for source in sources():
        carried = peers.carry_to_target(source, source.evidence.disparity, scenes.CAMERA, pose)
        known = np.isfinite(carried)
        assert known.mean() > 0.7
        # Away from the steps, where rounding to the nearest pixel decides.
        assert np.mean(np.abs(carried[known] * depth_m[known] - 1) < 1e-3) > 0.9


def test_merging_keeps_the_nearest_surface_and_averages_agreement() -> None:
    nan = np.nan
    a = np.array([[1.0, 2.0, nan, nan]], np.float32)
    b = np.array([[1.1, 3.0, 2.0, nan]], np.float32)
    merged = peers.merge([a, b], 0.2)
    assert merged[0, :3] == pytest.approx([1.05, 3.0, 2.0]) and np.isnan(merged[0, 3])


def test_sgbm_in_the_target_beats_a_copy() -> None:
    pose = scenes.photo()[0].pose
    assert pose is not None
    truth = target()[0]
    carried = peers.sgbm_in_target(sources(), scenes.CAMERA, pose, REQUEST)
    copied = peers.copied_disparity(sources(), scenes.CAMERA, pose, REQUEST)
    assert np.isfinite(carried).all()
    assert disparity_scores(carried, truth)["all"].mse < 0.5 * disparity_scores(copied, truth)["all"].mse


def test_the_plane_sweep_finds_the_planes_from_central_views_alone() -> None:
    photo = scenes.photo()[0]
    assert photo.pose is not None
    truth = target()[0]
    settings = peers.SweepSettings(planes=48)
    found = peers.plane_sweep(sources(), photo, scenes.CAMERA, photo.pose, (1 / 0.75, 1 / 0.38), REQUEST, settings)
    assert disparity_scores(found, truth)["all"].ppe_010 > 85


def test_zncc_ignores_exposure_and_knows_flat() -> None:
    a = np.random.default_rng(0).uniform(0, 200, (30, 40)).astype(np.float32)
    assert peers.zncc(a, a * np.float32(0.6) + np.float32(20), 5) == pytest.approx(1, abs=1e-2)
    assert peers.zncc(a, 255 - a, 5) == pytest.approx(-1, abs=1e-2)
    assert np.abs(peers.zncc(a, np.full_like(a, 90), 5)).max() < 1e-3


def test_a_copied_field_is_a_plain_shift_on_a_plane() -> None:
    image = scenes.photo()[0].image8
    views = peers.copied_field(image, np.full(image.shape[:2], 2.0, np.float32), 3, 3)
    assert (views[1, 1] == image).all()
    assert (views[1, 2][:, 4:-4] == np.roll(image, -2, 1)[:, 4:-4]).all()
