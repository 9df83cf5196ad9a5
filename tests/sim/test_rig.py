"""The simulated rig: what it records is what a rig would know, and the truth is exact."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.contracts.capture import PoseSpec
from lfrig.contracts.errors import BadInput
from lfrig.sim.optics import rotation_z
from lfrig.sim.recorded import FOCAL_SIGMA, MOUNT_SIGMA_DEG, MOUNT_SIGMA_M, OPTICS_SIGMA
from lfrig.sim.renderer import render_depth
from lfrig.sim.rig import TURNTABLE_SIGMA_DEG, SimulatedRig, target_size
from lfrig.sim.scene import F64, pack
from lfrig.sim.scenes import REPORTING
from tests.sim.small import CENTRE, one_of_each, scene

SCENE = scene(*one_of_each())
W, H = 36, 24


def rig(seed: int = 0, **options: object) -> SimulatedRig:
    return SimulatedRig(SCENE, W, H, seed=seed, **options)  # type: ignore[arg-type]


def arrays(pose: PoseSpec) -> tuple[F64, F64]:
    return np.array(pose.R), np.array(pose.t)


def angle_deg(a: F64, b: F64) -> float:
    return float(np.rad2deg(np.arccos(np.clip((np.trace(a.T @ b) - 1) / 2, -1, 1))))


def test_mounts_are_recorded_with_errors_of_the_stated_size() -> None:
    turns, shifts = [], []
    for seed in range(40):
        r = rig(seed)
        cameras = r.rig_spec().cameras
        for mount, camera in (
            (cameras.light_field, r.light_field_camera(0, 0.0)),
            (cameras.target, r.target_camera(0.0)),
        ):
            assert mount is not None
            assert mount.camera_from_plate is not None
            rotation, translation = arrays(mount.camera_from_plate)
            true = camera.rotation @ rotation_z(-np.deg2rad(r.true_angle_deg(0.0)))
            turns.append(angle_deg(rotation, true))
            shifts.append(-rotation.T @ translation + true.T @ camera.translation)
            assert mount.camera_from_plate.sigma_deg == MOUNT_SIGMA_DEG
            assert mount.camera_from_plate.sigma_m == MOUNT_SIGMA_M
    # Three components each: the expected square is three times the variance.
    assert np.sqrt(np.mean(np.square(turns)) / 3) == pytest.approx(MOUNT_SIGMA_DEG, rel=0.2)
    assert np.std(shifts) == pytest.approx(MOUNT_SIGMA_M, rel=0.2)


def test_plate_stands_near_where_it_was_sent() -> None:
    errors = [rig(seed).true_angle_deg(15.0) - 15.0 for seed in range(200)]
    assert np.std(errors) == pytest.approx(TURNTABLE_SIGMA_DEG, rel=0.15)
    assert rig(3).true_angle_deg(15.0) == rig(3).true_angle_deg(15.0)


def test_plate_turns_counter_clockwise() -> None:
    """Seen from above, a point of the plate moves counter-clockwise, so the camera goes clockwise in its frame."""
    r = rig()
    azimuth = [np.rad2deg(np.arctan2(*r.light_field_camera(0, a).centre[1::-1])) for a in (0.0, 30.0)]
    assert azimuth[1] - azimuth[0] == pytest.approx(-30.0, abs=2.0)
    assert r.light_field_camera(0, 30.0).centre[2] == pytest.approx(r.light_field_camera(0, 0.0).centre[2])


def test_each_shot_has_its_own_zoom_focus_and_exposure() -> None:
    r = rig()
    cameras = [r.light_field_camera(i, 0.0) for i in range(6)]
    assert len({round(c.focal_px, 6) for c in cameras}) == 6
    assert len({round(c.focus_m, 6) for c in cameras}) == 6
    assert len({r.exposure(i).gain for i in range(6)}) == 6
    # The pupil scales with the zoom: a lens of fixed f-number.
    ratios = [c.baseline_m / (c.focal_px * (1 - 0.02 / c.focus_m)) for c in cameras]
    np.testing.assert_allclose(ratios, np.mean(ratios), rtol=0.01)


def test_baseline_times_focal_length_is_about_what_benchmarks_state() -> None:
    products = [
        c.baseline_m * c.focal_px * 541 / W
        for name in REPORTING
        for c in [SimulatedRig(name, W, H).light_field_camera(i, 0.0) for i in range(5)]
    ]
    assert min(products) > 0.5
    assert max(products) < 1.1
    assert np.mean(products) == pytest.approx(0.75, abs=0.1)


def test_target_asks_for_the_standard_light_field() -> None:
    camera = rig().target_camera(20.0)
    width, height = target_size(W, H)
    assert (camera.width, camera.height) == (width, height) != (W, H)
    assert camera.baseline_m * camera.focal_px == pytest.approx(0.70 * width / 541)
    assert camera.focus_m == 0.46


@pytest.mark.parametrize(
    ("size", "expected"), [((541, 376), (540, 360)), ((270, 188), (270, 180)), ((96, 64), (90, 60))]
)
def test_photo_sizes(size: tuple[int, int], expected: tuple[int, int]) -> None:
    assert target_size(*size) == expected


def test_prior_records_estimates_only() -> None:
    capture = rig().shoot_light_field(1, 15.0)
    document, truth = capture.document, capture.truth.record
    assert document.pose is None
    assert document.turntable_deg == 15.0
    assert truth.turntable_deg != 15.0
    assert document.camera is not None
    assert document.optics is not None
    pairs = [
        (document.camera.fx, truth.camera.fx, FOCAL_SIGMA),
        (document.optics.baseline_m, truth.optics.baseline_m, OPTICS_SIGMA),
        (document.optics.focus_distance_m, truth.optics.focus_distance_m, OPTICS_SIGMA),
    ]
    for recorded, true, sigma in pairs:
        assert recorded is not None
        assert true is not None
        assert 0 < abs(recorded / true - 1) <= 2 * sigma


def test_given_records_the_true_pose_and_focal_length() -> None:
    r = rig(poses="given")
    for capture in (r.shoot_light_field(0, 15.0), r.shoot_photo(0, 20.0, truth_views=False)):
        assert capture.document.pose == capture.truth.record.pose
        assert capture.document.camera == capture.truth.record.camera
        assert capture.document.camera is not None
        assert capture.document.camera.sigma_f == 0
    assert r.rig_spec() == rig().rig_spec()


def test_true_depth_is_what_the_true_camera_sees() -> None:
    r = rig()
    capture = r.shoot_light_field(2, 30.0)
    expected = render_depth(pack(SCENE), r.light_field_camera(2, 30.0), CENTRE)[0]
    np.testing.assert_array_equal(capture.truth.depth_m, expected)
    assert capture.pixels.shape == (7, 7, H, W, 3)


def test_photo_is_the_true_centre_view_up_to_noise() -> None:
    clean, noisy = (rig(noise_sigma=s).shoot_photo(0, 20.0) for s in (0.0, 4.0))
    assert clean.truth.views is not None
    assert noisy.truth.views is not None
    np.testing.assert_array_equal(clean.pixels, clean.truth.views[3, 3])
    np.testing.assert_array_equal(noisy.truth.views, clean.truth.views)
    inside = (clean.pixels > 16) & (clean.pixels < 239)
    assert (noisy.pixels.astype(int) - clean.pixels)[inside].std() == pytest.approx(4.0, rel=0.06)
    assert noisy.truth.record.noise_sigma == 4.0


def test_truth_views_can_be_left_out() -> None:
    whole, quick = (rig().shoot_photo(0, 20.0, truth_views=wanted) for wanted in (True, False))
    assert quick.truth.views is None
    assert quick.truth.record.views is None
    np.testing.assert_array_equal(whole.pixels, quick.pixels)


def test_shot_does_not_depend_on_the_shots_before_it() -> None:
    r = rig()
    r.shoot_light_field(0, 0.0)
    after, alone = r.shoot_light_field(1, 15.0), rig().shoot_light_field(1, 15.0)
    np.testing.assert_array_equal(after.pixels, alone.pixels)
    assert after.document == alone.document


def test_seed_decides_everything_that_is_random() -> None:
    first, other = (rig(seed).shoot_light_field(0, 15.0) for seed in (0, 1))
    assert first.document != other.document
    assert first.truth.record.pose != other.truth.record.pose


def test_unknown_scene() -> None:
    with pytest.raises(BadInput, match="nowhere"):
        SimulatedRig("nowhere", W, H)
