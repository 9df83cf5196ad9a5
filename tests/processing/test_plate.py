"""Only what stands on the plate: the box holds all of it, the result inside is the same, the work is less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.contracts.progress import Monitor
from lfrig.processing.geometry import project_points, rotation_z, turntable_pose
from lfrig.processing.live import LiveFusion
from lfrig.processing.model import Camera, Photo, Plate, Pose, RigPrior
from lfrig.processing.options import ProcessOptions
from lfrig.processing.pipeline import process
from lfrig.processing.plate import crop_photo, light_field_box, photo_box, uncrop_camera
from lfrig.processing.skipping import Skips
from tests.processing import scenes

CAMERA = Camera.centred(640, 480, 700.0)
DOWN_ON = np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]])
"""A camera that looks along +y with the plate's +z up."""


def mount(distance_m: float, height_m: float, sigma_deg: float = 0.0) -> Pose:
    centre = np.array([0.0, -distance_m, height_m])
    return Pose(DOWN_ON, -DOWN_ON @ centre, sigma_deg)


@given(
    radius=st.floats(0.02, 0.12), height=st.floats(0.01, 0.15), x=st.floats(-1, 1), y=st.floats(-1, 1),
    up=st.floats(0, 1), turn=st.floats(-180, 180),
)  # fmt: skip
def test_the_box_holds_all_of_the_load(
    radius: float, height: float, x: float, y: float, up: float, turn: float
) -> None:
    pose = mount(0.6, 0.1)
    box = photo_box(Photo("t", np.zeros((480, 640, 3), np.uint8), CAMERA, turntable_pose(pose, turn)),
                    RigPrior(plate=Plate(radius, height)))  # fmt: skip
    assert box is not None
    point = np.array([[x, y, 0.0]]) * radius / max(1.0, np.hypot(x, y)) + [[0, 0, up * height]]
    (u, v), _ = (a[0] for a in project_points(CAMERA, pose, point @ rotation_z(np.deg2rad(turn)).T))
    u, v = np.clip(u, 0, 639), np.clip(v, 0, 479)
    assert box.x0 <= u < box.x1 and box.y0 <= v < box.y1


def test_an_uncertain_mount_widens_the_box() -> None:
    prior = RigPrior(mount(0.6, 0.1), mount(0.6, 0.1, sigma_deg=1.0), plate=Plate(0.08, 0.1))
    photo = Photo("t", np.zeros((480, 640, 3), np.uint8), CAMERA)
    wide = photo_box(photo, prior)
    tight = photo_box(photo, replace(prior, target_from_plate=mount(0.6, 0.1)))
    assert wide is not None and tight is not None
    assert wide.width - tight.width == pytest.approx(2 * 3 * np.deg2rad(1) * 700, abs=2)
    cropped = crop_photo(photo, tight).camera
    assert cropped is not None and uncrop_camera(cropped, tight, 640, 480) == CAMERA


@pytest.mark.parametrize(
    ("photo", "prior"),
    [
        (Photo("t", np.zeros((480, 640, 3), np.uint8), CAMERA), RigPrior(target_from_plate=mount(0.6, 0.1))),
        (Photo("t", np.zeros((480, 640, 3), np.uint8), CAMERA), RigPrior(plate=Plate(0.1, 0.1))),
        (Photo("t", np.zeros((480, 640, 3), np.uint8)), RigPrior(None, mount(0.6, 0.1), plate=Plate(0.1, 0.1))),
        (Photo("t", np.zeros((480, 640, 3), np.uint8), CAMERA, mount(0.6, 0.1)), RigPrior(plate=Plate(0.5, 0.5))),
        (Photo("t", np.zeros((480, 640, 3), np.uint8), CAMERA, mount(0.1, 0.1)), RigPrior(plate=Plate(0.2, 0.1))),
    ],
    ids=["no plate", "no mount", "no focal length", "fills the picture", "camera among the load"],
)
def test_where_it_cannot_be_told_everything_is_computed(photo: Photo, prior: RigPrior) -> None:
    assert photo_box(photo, prior) is None


@pytest.fixture(scope="module")
def rig() -> tuple[list, Photo, RigPrior]:
    """The analytic scene; its near plane stands on a plate whose axis is the world's z, along the line of sight."""
    lights = [scenes.light_field(name, x) for name, x in (("a", -0.05), ("b", 0.05))]
    # a disc of 3 cm about the near plane's middle, 45 cm before the cameras
    prior = RigPrior(depth_range_m=(0.35, 0.8), plate=Plate(0.035, 0.5))
    return lights, scenes.photo()[0], prior


OPTIONS = ProcessOptions(target_baseline_m=scenes.BASELINE_M, target_focus_m=scenes.FOCUS_M, rows=3, cols=3, threads=1)


def moved(rig: tuple[list, Photo, RigPrior]) -> tuple[list, Photo, RigPrior]:
    """The same with the world's origin 40 cm before the cameras, so that the plate lies there and reaches back."""
    lights, photo, prior = rig
    shift = np.array([0.0, 0.0, 0.4])

    def there(pose: Pose) -> Pose:
        return Pose(pose.rotation, pose.translation + pose.rotation @ shift)

    lights = [replace(lf, pose=there(lf.pose)) for lf in lights]
    return lights, replace(photo, pose=there(photo.pose)), prior


def test_the_load_is_the_same_and_costs_less(rig: tuple[list, Photo, RigPrior]) -> None:
    lights, photo, prior = moved(rig)
    boxes = [light_field_box(light, prior) for light in lights]
    assert all(box is not None for box in boxes)
    made = process(lights, photo, prior, OPTIONS, Monitor())
    whole = process(lights, photo, replace(prior, plate=None), OPTIONS, Monitor())
    counts = {skip.name: skip for skip in made.stages[0].skips}["plate"]
    assert counts.skipped > 0.2 * (counts.done + counts.skipped)
    assert made.light_field.views.shape == whole.light_field.views.shape
    assert np.array_equal(made.light_field.views[1, 1], photo.image)
    assert made.target_camera == whole.target_camera
    box = photo_box(photo, prior)
    assert box is not None
    truth = 1 / scenes.photo()[1]
    px = scenes.BASELINE_M * scenes.FOCAL
    inner = np.s_[box.y0 + 8 : box.y1 - 8, box.x0 + 8 : box.x1 - 8]
    error = np.abs(px * (made.light_field.surface.inverse_depth - truth))[inner]
    assert np.median(error) < 0.02 and (error < 0.1).mean() > 0.93
    outside = np.ones(truth.shape, bool)
    outside[box.y0 : box.y1, box.x0 : box.x1] = False
    assert outside.any() and (made.light_field.surface.confidence[outside] == 0).all()
    assert np.isfinite(made.light_field.disparity).all()
    off = replace(OPTIONS, settings=replace(OPTIONS.knobs, skips=Skips().without("plate")))
    again = process(lights, photo, prior, off, Monitor())
    assert again.light_field.disparity.tobytes() == whole.light_field.disparity.tobytes()


def test_live_fusion_crops_alike(rig: tuple[list, Photo, RigPrior]) -> None:
    lights, photo, prior = moved(rig)
    fusion = LiveFusion(prior, replace(OPTIONS, preset="preview", resolution=1.0))
    for light in lights:
        fusion.add_source(light)
    view = fusion.set_target(photo)
    whole = process(lights, photo, prior, replace(OPTIONS, preset="preview", resolution=1.0), Monitor())
    assert view is not None
    assert view.light_field.disparity.tobytes() == whole.light_field.disparity.tobytes()
    shown = fusion.show(photo.image)
    assert shown.light_field.views.tobytes() == whole.light_field.views.tobytes()
