"""What a turntable, a light-field camera and a target camera can do, whatever they are made of.

Real drivers and the simulator implement these protocols and pass the same contract suite
(``tests/drivers/contract.py``). Rules for all of them:

- every call that waits takes a deadline ``timeout_s`` and raises `DeviceTimeout` when it passes;
- a lost connection raises `LinkError`, and nothing is known of the device until it is opened anew;
- calls come from one thread; only `Turntable.stop` may come from another;
- angles are degrees, counter-clockwise seen from above, absolute: a move that is sent twice ends where one does.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.capture import CaptureDocument


@dataclass(frozen=True)
class DeviceIdentity:
    """Who answered the handshake; the journal records it and a driver refuses anyone else.

    Examples: ``DeviceIdentity("turntable", "grbl", "Grbl 1.1h", "75735323", "1.1h.20190825")``,
    ``DeviceIdentity("light_field_camera", "lytro", "F01", "A303134643", "v1.0a208")``,
    ``DeviceIdentity("target_camera", "luxonis", "OAK-1", "18443010D1C1E50800", "3.12")``.
    """

    role: Literal["turntable", "light_field_camera", "target_camera"]
    vendor: str
    model: str
    serial: str
    firmware: str = ""


class MotionState(Enum):
    """What a turntable is doing. Examples: GRBL ``<Idle|...>`` IDLE, ``<Run|...>`` MOVING, ``<Hold:0|...>`` HELD,
    ``<Alarm|...>`` ALARM; Zaber ``OK IDLE`` with the warning WR is UNHOMED.
    """

    IDLE = "idle"
    MOVING = "moving"
    HELD = "held"
    UNHOMED = "unhomed"
    ALARM = "alarm"


@dataclass(frozen=True)
class TurntableStatus:
    """One status report; ``position_deg`` is None where the device does not know it (after a reset, unhomed).

    Example: ``<Idle|MPos:15.000,0.000,0.000|FS:0,0>`` is ``TurntableStatus(MotionState.IDLE, 15.0)``.
    """

    state: MotionState
    position_deg: float | None


@runtime_checkable
class Turntable(Protocol):
    """A motorised plate."""

    @property
    def limits_deg(self) -> tuple[float, float]:
        """The soft limits: targets beyond them are refused, not clamped."""
        ...

    @property
    def tolerance_deg(self) -> float:
        """How far from its target the plate may report to stand and be there: a step or an encoder count."""
        ...

    def identity(self) -> DeviceIdentity:
        """Who this is."""
        ...

    def status(self) -> TurntableStatus:
        """Ask the device once."""
        ...

    def home(self, *, timeout_s: float) -> None:
        """Find the reference; afterwards the position is known and the plate stands still.

        Raises
        ------
        MotionError
            Homing failed or is not set up.
        DeviceTimeout, LinkError
        """
        ...

    def move_to(self, angle_deg: float, *, timeout_s: float) -> None:
        """Turn to an absolute angle and return when the plate is idle within `tolerance_deg` of it.

        Raises
        ------
        MotionError
            Beyond the limits (nothing moved), not homed, alarmed, or stopped on the way.
        DeviceTimeout, LinkError
        """
        ...

    def stop(self) -> None:
        """Stop at once, keeping the position if the device can; may be called from any thread, in any state."""
        ...

    def close(self) -> None:
        """Hold still and let go of the device. Calling it twice is harmless."""
        ...


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture as it came from a camera.

    ``frame_id`` is the camera's own name for it (F01: the picture id of its list; Illum: the file name on the card;
    OAK: the sequence number), by which duplicates are told. Either ``pixels``, uint8 [rows, cols, H, W, 3] views of a
    light field or uint8/uint16 [H, W, 3] of a photo, or ``raw``, the bytes of the file that a light-field camera made.
    ``document`` holds what the camera knows: kind, intrinsics, optics, exposure, and under ``raw`` the name of a raw
    file, its SHA-256 where it is known, its calibration; the controller adds the plate's angle.
    """

    frame_id: str
    document: CaptureDocument
    pixels: NDArray[np.uint8] | NDArray[np.uint16] | None = None
    raw: bytes | None = None


@runtime_checkable
class Camera(Protocol):
    """What both cameras do: arm, trigger, fetch."""

    def identity(self) -> DeviceIdentity:
        """Who this is."""
        ...

    def arm(self, *, timeout_s: float) -> None:
        """Make ready to shoot; harmless when it is already. From here to `fetch` the plate must not move.

        Raises
        ------
        CaptureError
            Not ready: card full, battery empty, lens cap.
        DeviceTimeout, LinkError
        """
        ...

    def trigger(self, *, timeout_s: float) -> str:
        """Take one picture and return its ``frame_id`` once there is proof that it exists.

        F01: ``[ShutterPressed]``, then ``[NewPictureAvailable]``, then the picture list holds a new id; the reply to
        the command alone proves nothing. OAK: the first frame whose exposure began after this call.

        Raises
        ------
        CaptureError
            Not armed, or the camera says that it did not shoot.
        DeviceTimeout
            No proof came: a picture may or may not exist; look into `frame_ids` before shooting again.
        LinkError
        """
        ...

    def frame_ids(self) -> list[str]:
        """The pictures that the camera still holds, oldest first."""
        ...

    def fetch(self, frame_id: str, *, timeout_s: float) -> Frame:
        """Read a picture out; may be called again for the same one.

        Raises
        ------
        CaptureError
            The camera holds no such picture, or it arrived damaged.
        DeviceTimeout, LinkError
        """
        ...

    def close(self) -> None:
        """Disarm and let go of the device. Calling it twice is harmless."""
        ...


@runtime_checkable
class LightFieldCamera(Camera, Protocol):
    """A plenoptic camera (Lytro F01, Illum): its frames are of kind ``light_field``, with views or a raw file."""

    @property
    def makes_raw(self) -> bool:
        """Whether frames carry ``raw`` plenoptic files (True) or decoded ``pixels`` (False)."""
        ...


@runtime_checkable
class TargetCamera(Camera, Protocol):
    """The plain camera whose photo is raised (OAK, a folder that a camera writes to): frames of kind ``photo``."""

    @property
    def bit_depth(self) -> Literal[8, 16]:
        """Bits per channel of its pixels."""
        ...
