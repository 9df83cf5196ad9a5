"""The simulated rig's devices through the contract suite, and what is theirs alone."""

from __future__ import annotations

import numpy as np
import pytest

from lfrig.contracts.errors import CaptureError, Interrupted
from lfrig.contracts.progress import Monitor
from lfrig.drivers.protocols import Camera, Turntable
from lfrig.sim.devices import Record, SimulatedLightFieldCamera, SimulatedTargetCamera, SimulatedTurntable
from lfrig.sim.rig import SimulatedRig
from tests.drivers.contract import TIMEOUT_S, CameraContract, TurntableContract
from tests.sim.small import backdrop, flat, ground, scene, sphere


def rig() -> SimulatedRig:
    ball = sphere((0.02, 0.0, 0.03), 0.03, flat(0.9))
    return SimulatedRig(scene(ground(0.9, flat(0.4)), backdrop(0.25, flat(0.6)), ball), 18, 12)


def homed() -> SimulatedTurntable:
    turntable = SimulatedTurntable()
    turntable.home(timeout_s=TIMEOUT_S)
    return turntable


class TestTurntable(TurntableContract):
    def open(self) -> Turntable:
        return SimulatedTurntable()


class TestLightFieldCamera(CameraContract):
    role, kind = "light_field_camera", "light_field"

    def open(self) -> Camera:
        return SimulatedLightFieldCamera(rig(), homed())


class TestRawLightFieldCamera(CameraContract):
    role, kind = "light_field_camera", "light_field"

    def open(self) -> Camera:
        return SimulatedLightFieldCamera(rig(), homed(), record="raw")


class TestTargetCamera(CameraContract):
    role, kind = "target_camera", "photo"

    def open(self) -> Camera:
        return SimulatedTargetCamera(rig(), homed())


def test_camera_sees_the_plate_where_it_stood_at_the_trigger() -> None:
    turntable = homed()
    camera = SimulatedTargetCamera(rig(), turntable)
    turntable.move_to(40.0, timeout_s=TIMEOUT_S)
    camera.arm(timeout_s=TIMEOUT_S)
    name = camera.trigger(timeout_s=TIMEOUT_S)
    turntable.move_to(0.0, timeout_s=TIMEOUT_S)
    frame = camera.fetch(name, timeout_s=TIMEOUT_S)
    assert frame.document.turntable_deg == 40.0
    assert camera.take_truth(name).record.turntable_deg == pytest.approx(40.0, abs=1.5)
    expected = rig().shoot_photo(0, 40.0).pixels
    assert frame.pixels is not None
    np.testing.assert_array_equal(frame.pixels, expected)


@pytest.mark.parametrize("record", ["views", "raw"])
def test_light_field_camera_delivers_what_it_says_it_makes(record: Record) -> None:
    camera = SimulatedLightFieldCamera(rig(), homed(), record=record)
    assert camera.makes_raw == (record == "raw")
    camera.arm(timeout_s=TIMEOUT_S)
    name = camera.trigger(timeout_s=TIMEOUT_S)
    frame = camera.fetch(name, timeout_s=TIMEOUT_S)
    assert (frame.raw is not None) == camera.makes_raw
    assert (frame.document.raw is not None) == camera.makes_raw
    assert camera.take_truth(name).views is not None


def test_no_picture_while_the_plate_is_not_at_rest() -> None:
    camera = SimulatedTargetCamera(rig(), SimulatedTurntable())
    camera.arm(timeout_s=TIMEOUT_S)
    with pytest.raises(CaptureError, match="not at rest"):
        camera.trigger(timeout_s=TIMEOUT_S)


def test_rendering_can_be_cancelled() -> None:
    monitor = Monitor()
    camera = SimulatedLightFieldCamera(rig(), homed(), monitor)
    camera.arm(timeout_s=TIMEOUT_S)
    name = camera.trigger(timeout_s=TIMEOUT_S)
    monitor.cancel()
    with pytest.raises(Interrupted):
        camera.fetch(name, timeout_s=TIMEOUT_S)
