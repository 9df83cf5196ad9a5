"""The simulated rig behind the device protocols. What a camera sees is rendered when its picture is fetched."""

from __future__ import annotations

import threading
from typing import Literal

from lfrig.contracts.errors import CaptureError, MotionError
from lfrig.contracts.progress import Monitor
from lfrig.drivers.protocols import DeviceIdentity, Frame, MotionState, TurntableStatus
from lfrig.sim.plenoptic.camera import PlenopticCamera, RawShot
from lfrig.sim.rig import COLS, ROWS, CaptureTruth, SimulatedCapture, SimulatedRig

Record = Literal["views", "raw"]
LIMITS_DEG = (-180.0, 360.0)
TOLERANCE_DEG = 0.01


class SimulatedTurntable:
    """A plate that turns at once. It reports where it was sent; where it truly stands only the `SimulatedRig` knows."""

    def __init__(self, limits_deg: tuple[float, float] = LIMITS_DEG) -> None:
        self._limits = limits_deg
        self._position: float | None = None
        self._stopped = threading.Event()

    @property
    def limits_deg(self) -> tuple[float, float]:
        """Soft limits."""
        return self._limits

    @property
    def tolerance_deg(self) -> float:
        """Within which a move has arrived."""
        return TOLERANCE_DEG

    def identity(self) -> DeviceIdentity:
        """A simulated turntable."""
        return DeviceIdentity("turntable", "lfrig", "simulated turntable", "sim-0")

    def status(self) -> TurntableStatus:
        """Never moving: moves take no time."""
        if self._position is None:
            return TurntableStatus(MotionState.UNHOMED, None)
        return TurntableStatus(MotionState.HELD if self._stopped.is_set() else MotionState.IDLE, self._position)

    def home(self, *, timeout_s: float) -> None:
        """Go to 0°; also ends a `stop`."""
        self._stopped.clear()
        self._position = 0.0

    def move_to(self, angle_deg: float, *, timeout_s: float) -> None:
        """Turn; raises `MotionError` beyond the limits, before homing and after a stop."""
        low, high = self._limits
        if not low <= angle_deg <= high:
            raise MotionError(
                f"the plate cannot turn to {angle_deg:g}°, its limits are {low:g}° to {high:g}°",
                code="out-of-range", remedy="choose other angles",
            )  # fmt: skip
        if self._position is None or self._stopped.is_set():
            why = "was stopped" if self._stopped.is_set() else "has not been homed"
            raise MotionError(f"the plate {why}", code="not-homed", remedy="home it first")
        self._position = angle_deg

    def stop(self) -> None:
        """Refuse moves until homed again."""
        self._stopped.set()

    def close(self) -> None:
        """Nothing to let go of."""


class _SimulatedCamera:
    """What both cameras share: pictures are numbered shots at the angle where the plate stood at the trigger."""

    role: Literal["light_field_camera", "target_camera"]

    def __init__(self, rig: SimulatedRig, turntable: SimulatedTurntable, monitor: Monitor | None = None) -> None:
        self._rig, self._turntable, self._monitor = rig, turntable, monitor or Monitor()
        self._angles: dict[str, float] = {}
        self._fetched: dict[str, SimulatedCapture | RawShot] = {}
        self._armed = False

    def identity(self) -> DeviceIdentity:
        """A simulated camera looking at a scene."""
        return DeviceIdentity(self.role, "lfrig", f"simulated camera, scene {self._rig.scene_name}", "sim-0")

    def arm(self, *, timeout_s: float) -> None:
        """Make ready."""
        self._armed = True

    def trigger(self, *, timeout_s: float) -> str:
        """Note the plate's angle; raises `CaptureError` when not armed or while the plate's position is unknown."""
        status = self._turntable.status()
        if not self._armed:
            raise CaptureError("the camera is not armed", code="not-armed", remedy="arm it first")
        if status.state is not MotionState.IDLE or status.position_deg is None:
            raise CaptureError(
                f"the plate is not at rest ({status.state.value})", code="plate-not-at-rest", remedy="home it first"
            )
        self._armed = False
        frame_id = f"{len(self._angles):04d}"
        self._angles[frame_id] = status.position_deg
        return frame_id

    def frame_ids(self) -> list[str]:
        """All shots so far."""
        return list(self._angles)

    def fetch(self, frame_id: str, *, timeout_s: float) -> Frame:
        """Render the shot. The deadline does not count rendering, which a real camera would not need."""
        if frame_id not in self._angles:
            raise CaptureError(
                f"the camera holds no picture {frame_id!r}", code="no-such-frame", remedy="take it again"
            )
        with self._monitor.task(f"render {self.role.removesuffix('_camera').replace('_', ' ')}", self._steps):
            capture = self._shoot(int(frame_id), self._angles[frame_id])
        self._fetched[frame_id] = capture
        if isinstance(capture, RawShot):
            return Frame(frame_id, capture.document, raw=capture.raw)
        return Frame(frame_id, capture.document, capture.pixels)

    def take_truth(self, frame_id: str) -> CaptureTruth:
        """What really was at a fetched shot; handed out once, then forgotten."""
        return self._fetched.pop(frame_id).truth

    def close(self) -> None:
        """Disarm."""
        self._armed = False

    @property
    def _steps(self) -> int:
        """How often a shot advances the monitor."""
        return ROWS * COLS

    def _shoot(self, index: int, angle_deg: float) -> SimulatedCapture | RawShot:
        raise NotImplementedError


class SimulatedLightFieldCamera(_SimulatedCamera):
    """Records views, or raw files as a plenoptic camera; zoom, focus and exposure differ from shot to shot."""

    role = "light_field_camera"

    def __init__(
        self, rig: SimulatedRig, turntable: SimulatedTurntable, monitor: Monitor | None = None,
        *, record: Record = "views",
    ) -> None:  # fmt: skip
        super().__init__(rig, turntable, monitor)
        self._plenoptic = PlenopticCamera(rig) if record == "raw" else None

    @property
    def makes_raw(self) -> bool:
        """Whether frames are raw files."""
        return self._plenoptic is not None

    @property
    def _steps(self) -> int:
        return super()._steps if self._plenoptic is None else self._plenoptic.steps

    def _shoot(self, index: int, angle_deg: float) -> SimulatedCapture | RawShot:
        if self._plenoptic is not None:
            return self._plenoptic.shoot(index, angle_deg, self._monitor)
        return self._rig.shoot_light_field(index, angle_deg, self._monitor)


class SimulatedTargetCamera(_SimulatedCamera):
    """A plain camera of another focal length, size and exposure on a mount of its own."""

    role = "target_camera"
    bit_depth: Literal[8, 16] = 8

    def _shoot(self, index: int, angle_deg: float) -> SimulatedCapture:
        return self._rig.shoot_photo(index, angle_deg, self._monitor)
