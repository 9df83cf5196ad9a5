"""The capture loop over the device protocols: move, settle, trigger, fetch, store; one view after another.

Each shot passes through the states of the journal: planned, moving, settling, armed, trigger (the intent, before it
happens), frame_seen, ingested (with the hash of what was stored). The plate does not move between armed and ingested,
and nothing is triggered before the plate has twice reported to be idle at its angle. Whatever goes wrong, the plate is
stopped, the journal says why, and the session holds whole captures only.
"""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import CaptureError, Interrupted, LfrigError, MotionError
from lfrig.contracts.files import sha256_files
from lfrig.contracts.progress import Monitor
from lfrig.drivers.protocols import Camera, Frame, LightFieldCamera, MotionState, TargetCamera, Turntable
from lfrig.rig.journal import JOURNAL_FILE, Journal
from lfrig.rig.plan import CapturePlan
from lfrig.rig.session.store import SessionStore

Ingested = Callable[[str, Frame], None]
"""Called with the capture's id and its frame once it is in the session."""


@dataclass(frozen=True)
class Devices:
    """The rig's devices; ``target_camera`` may be None when the plan has no photo."""

    turntable: Turntable
    light_field_camera: LightFieldCamera
    target_camera: TargetCamera | None = None


@dataclass(frozen=True)
class _Shot:
    index: int
    kind: str
    angle_deg: float
    camera: Camera


def run_plan(
    plan: CapturePlan,
    devices: Devices,
    store: SessionStore,
    *,
    monitor: Monitor | None = None,
    on_ingested: Ingested | None = None,
    sleep: Callable[[float], None] = time.sleep,
) -> list[str]:
    """Shoot a plan into a session.

    Returns
    -------
    list of str
        Ids of the captures, in order: the light fields, then the photo.

    Raises
    ------
    MotionError
        An angle is beyond the turntable's limits (nothing was shot), or a move failed.
    RigError
        A device failed; the captures before it are in the session.
    Interrupted
        ``monitor`` was cancelled, or Ctrl-C; the same.
    """
    monitor = monitor or Monitor()
    shots = _shots(plan, devices)
    _check_limits(shots, devices.turntable)
    ids: list[str] = []
    with Journal(store.path / JOURNAL_FILE) as journal, monitor.task("capture", len(shots)):
        journal.record("run", plan=plan.model_dump(mode="json"), devices=_identities(devices))
        try:
            devices.turntable.home(timeout_s=plan.home_timeout_s)
            journal.record("homed")
            for shot in shots:
                journal.record("planned", shot=shot.index, kind=shot.kind, angle_deg=shot.angle_deg)
            for shot in shots:
                ids.append(_take(shot, plan, devices.turntable, store, journal, monitor, on_ingested, sleep))
                monitor.advance()
        except BaseException as error:
            devices.turntable.stop()
            _journal_failure(journal, error, ids)
            if isinstance(error, (Interrupted, KeyboardInterrupt)):
                raise _interrupted(ids, shots, store) from None
            raise
        journal.record("done", captures=ids)
    return ids


def _interrupted(ids: Sequence[str], shots: Sequence[_Shot], store: SessionStore) -> Interrupted:
    error = Interrupted(f"interrupted; {len(ids)} of {len(shots)} captures are whole and in {store.path}")
    error.remedy = "shoot the missing angles into it, or begin a new session"
    return error


def _shots(plan: CapturePlan, devices: Devices) -> list[_Shot]:
    shots = [
        _Shot(index, "light_field", angle, devices.light_field_camera) for index, angle in enumerate(plan.angles_deg)
    ]
    if plan.target_deg is not None:
        if devices.target_camera is None:
            raise CaptureError(
                "the plan has a photo but the rig no target camera", code="no-target-camera",
                remedy="leave the target's angle out",
            )  # fmt: skip
        shots.append(_Shot(len(shots), "photo", plan.target_deg, devices.target_camera))
    return shots


def _check_limits(shots: Sequence[_Shot], turntable: Turntable) -> None:
    low, high = turntable.limits_deg
    for shot in shots:
        if not low <= shot.angle_deg <= high:
            raise MotionError(
                f"the plan has {shot.angle_deg:g}°, the turntable's limits are {low:g}° to {high:g}°",
                code="out-of-range", remedy="choose other angles",
            )  # fmt: skip


def _identities(devices: Devices) -> list[dict[str, str]]:
    present = (devices.turntable, devices.light_field_camera, devices.target_camera)
    return [asdict(device.identity()) for device in present if device is not None]


def _take(
    shot: _Shot,
    plan: CapturePlan,
    turntable: Turntable,
    store: SessionStore,
    journal: Journal,
    monitor: Monitor,
    on_ingested: Ingested | None,
    sleep: Callable[[float], None],
) -> str:
    """One shot from moving to ingested; returns the capture's id."""
    timeout_s = plan.camera_timeout_s
    monitor.advance(0)
    journal.record("moving", shot=shot.index, angle_deg=shot.angle_deg)
    turntable.move_to(shot.angle_deg, timeout_s=plan.move_timeout_s)
    journal.record("settling", shot=shot.index)
    sleep(plan.settle_s)
    monitor.advance(0)
    shot.camera.arm(timeout_s=timeout_s)
    journal.record("armed", shot=shot.index)
    _check_at_rest(turntable, shot.angle_deg)
    journal.record("trigger", shot=shot.index)
    frame_id = shot.camera.trigger(timeout_s=timeout_s)
    journal.record("frame_seen", shot=shot.index, frame_id=frame_id)
    frame = shot.camera.fetch(frame_id, timeout_s=timeout_s)
    capture_id = _store(frame, shot, store)
    try:
        files = sorted(path for path in store.capture_folder(capture_id).rglob("*") if path.is_file())
        if on_ingested is not None:
            on_ingested(capture_id, frame)
        journal.record("ingested", shot=shot.index, capture=capture_id, sha256=sha256_files(files))
    except BaseException:
        # A capture that is known only by half, without its journal line or its truth, would be in the way for ever.
        store.discard(capture_id)
        raise
    return capture_id


def _check_at_rest(turntable: Turntable, angle_deg: float) -> None:
    """Two reports in a row must say: idle, and at the angle."""
    for _ in range(2):
        status = turntable.status()
        arrived = status.position_deg is not None and abs(status.position_deg - angle_deg) <= turntable.tolerance_deg
        if status.state is not MotionState.IDLE or not arrived:
            where = "somewhere" if status.position_deg is None else f"at {status.position_deg:g}°"
            raise MotionError(
                f"the plate should rest at {angle_deg:g}° but is {status.state.value} {where}",
                code="plate-not-at-rest", remedy="check that nothing blocks the plate, then capture again",
            )  # fmt: skip


def _store(frame: Frame, shot: _Shot, store: SessionStore) -> str:
    if frame.document.kind != shot.kind:
        raise CaptureError(
            f"the camera delivered a {frame.document.kind} where a {shot.kind} was due", code="wrong-frame",
            remedy="check which camera is which",
        )  # fmt: skip
    document = frame.document.model_copy(update={"turntable_deg": shot.angle_deg})
    if frame.raw is not None:
        return _store_raw(frame.raw, document, store)
    if frame.pixels is None:
        raise CaptureError("the camera delivered no picture", code="no-picture", remedy="take it again")
    if shot.kind == "photo":
        return store.add_photo_array(frame.pixels, document)
    return store.add_light_field(frame.pixels, document)  # type: ignore[arg-type]  # views have 8 bits


def _store_raw(raw: bytes, document: CaptureDocument, store: SessionStore) -> str:
    """The file as it came, under the name that the document gives it."""
    spec = document.raw
    if document.kind != "light_field" or spec is None:
        raise CaptureError(
            "the camera delivered a raw file that its record does not name", code="raw-frame",
            remedy="update the camera's driver",
        )  # fmt: skip
    if spec.sha256 is not None and hashlib.sha256(raw).hexdigest() != spec.sha256:
        raise CaptureError("the raw file arrived damaged", code="damaged-frame", remedy="fetch it again")
    path = spec.path

    def build(folder: Path) -> CaptureDocument:
        (folder / path).write_bytes(raw)
        return document

    return store.add_captures([build])[0]


def _journal_failure(journal: Journal, error: BaseException, ids: list[str]) -> None:
    """Say why a run ended. The error itself matters more than a full disk that keeps this from being written."""
    code = error.code if isinstance(error, LfrigError) else type(error).__name__
    with contextlib.suppress(LfrigError):
        journal.record("aborted", code=code, message=str(error), captures=ids)
