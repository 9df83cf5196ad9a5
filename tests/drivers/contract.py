"""What every turntable and camera must do, real or simulated. A device's test module subclasses these and says how to
open one: the methods of the base classes then run on it.
"""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np
import pytest

from lfrig.contracts.errors import CaptureError, MotionError
from lfrig.drivers.protocols import Camera, LightFieldCamera, MotionState, TargetCamera, Turntable

TIMEOUT_S = 30.0


class TurntableContract(ABC):
    """Of a `Turntable`."""

    @abstractmethod
    def open(self) -> Turntable:
        """A turntable as it is after switching on: not homed."""

    @pytest.fixture
    def fresh(self) -> Turntable:
        return self.open()

    @pytest.fixture
    def homed(self, fresh: Turntable) -> Turntable:
        fresh.home(timeout_s=TIMEOUT_S)
        return fresh

    def test_is_a_turntable(self, fresh: Turntable) -> None:
        assert isinstance(fresh, Turntable)
        assert fresh.identity().role == "turntable"
        assert fresh.identity().model
        assert fresh.limits_deg[0] < fresh.limits_deg[1]
        assert fresh.tolerance_deg > 0

    def test_does_not_know_where_it_is_before_homing(self, fresh: Turntable) -> None:
        assert fresh.status().state in (MotionState.UNHOMED, MotionState.ALARM)
        assert fresh.status().position_deg is None
        with pytest.raises(MotionError):
            fresh.move_to(10.0, timeout_s=TIMEOUT_S)

    def test_is_idle_at_a_known_place_after_homing(self, homed: Turntable) -> None:
        assert homed.status().state is MotionState.IDLE
        assert homed.status().position_deg is not None

    @pytest.mark.parametrize("angle_deg", [15.0, 0.0, 47.25])
    def test_moves_end_at_the_target_and_may_be_sent_twice(self, homed: Turntable, angle_deg: float) -> None:
        for _ in range(2):
            homed.move_to(angle_deg, timeout_s=TIMEOUT_S)
            status = homed.status()
            assert status.state is MotionState.IDLE
            assert status.position_deg == pytest.approx(angle_deg, abs=homed.tolerance_deg)

    def test_refuses_targets_beyond_its_limits_and_stays(self, homed: Turntable) -> None:
        homed.move_to(5.0, timeout_s=TIMEOUT_S)
        for beyond in (homed.limits_deg[0] - 1, homed.limits_deg[1] + 1, float("nan")):
            with pytest.raises(MotionError):
                homed.move_to(beyond, timeout_s=TIMEOUT_S)
        assert homed.status().position_deg == pytest.approx(5.0, abs=homed.tolerance_deg)

    def test_stop_holds_until_homed(self, homed: Turntable) -> None:
        homed.move_to(5.0, timeout_s=TIMEOUT_S)
        homed.stop()
        homed.stop()
        assert homed.status().state is not MotionState.MOVING
        with pytest.raises(MotionError):
            homed.move_to(10.0, timeout_s=TIMEOUT_S)
        homed.home(timeout_s=TIMEOUT_S)
        homed.move_to(10.0, timeout_s=TIMEOUT_S)

    def test_may_be_closed_twice(self, homed: Turntable) -> None:
        homed.close()
        homed.close()


class CameraContract(ABC):
    """Of a `Camera`; ``role`` and ``kind`` are those of the device."""

    role: str
    kind: str

    @abstractmethod
    def open(self) -> Camera:
        """A camera that holds no pictures, before a plate at rest."""

    @pytest.fixture
    def camera(self) -> Camera:
        return self.open()

    def shoot(self, camera: Camera) -> str:
        camera.arm(timeout_s=TIMEOUT_S)
        return camera.trigger(timeout_s=TIMEOUT_S)

    def test_is_what_it_says(self, camera: Camera) -> None:
        assert isinstance(camera, Camera)
        assert isinstance(camera, LightFieldCamera if self.kind == "light_field" else TargetCamera)
        assert camera.identity().role == self.role

    def test_does_not_shoot_unarmed(self, camera: Camera) -> None:
        with pytest.raises(CaptureError):
            camera.trigger(timeout_s=TIMEOUT_S)
        self.shoot(camera)
        with pytest.raises(CaptureError):
            camera.trigger(timeout_s=TIMEOUT_S)
        assert len(camera.frame_ids()) == 1

    def test_arming_twice_is_harmless(self, camera: Camera) -> None:
        camera.arm(timeout_s=TIMEOUT_S)
        self.shoot(camera)
        assert len(camera.frame_ids()) == 1

    def test_names_its_pictures_in_order(self, camera: Camera) -> None:
        assert camera.frame_ids() == []
        shots = [self.shoot(camera) for _ in range(3)]
        assert len(set(shots)) == 3
        assert camera.frame_ids() == shots

    def test_delivers_the_picture_that_was_asked_for(self, camera: Camera) -> None:
        first, second = self.shoot(camera), self.shoot(camera)
        for name in (second, first):
            frame = camera.fetch(name, timeout_s=TIMEOUT_S)
            assert frame.frame_id == name
            assert frame.document.kind == self.kind
            assert (frame.pixels is None) != (frame.raw is None)
            if frame.pixels is not None:
                assert frame.pixels.shape[-1] == 3
                assert frame.pixels.ndim == (5 if self.kind == "light_field" else 3)

    def test_a_picture_can_be_fetched_again(self, camera: Camera) -> None:
        name = self.shoot(camera)
        first, again = (camera.fetch(name, timeout_s=TIMEOUT_S) for _ in range(2))
        assert first.raw == again.raw
        if first.pixels is not None and again.pixels is not None:
            np.testing.assert_array_equal(first.pixels, again.pixels)

    def test_knows_no_picture_that_was_not_taken(self, camera: Camera) -> None:
        with pytest.raises(CaptureError):
            camera.fetch("no such picture", timeout_s=TIMEOUT_S)

    def test_may_be_closed_twice(self, camera: Camera) -> None:
        camera.close()
        camera.close()
