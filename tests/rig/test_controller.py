"""The capture loop, on devices that do what a test tells them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.contracts.capture import CaptureDocument, ViewsSpec
from lfrig.contracts.errors import CaptureError, DeviceTimeout, Interrupted, LfrigError, MotionError
from lfrig.contracts.progress import Monitor
from lfrig.drivers.protocols import DeviceIdentity, Frame, LightFieldCamera, MotionState, TargetCamera, TurntableStatus
from lfrig.rig.controller import Devices, run_plan
from lfrig.rig.journal import JOURNAL_FILE, read_journal
from lfrig.rig.plan import CapturePlan
from lfrig.rig.session.store import SessionStore
from lfrig.sim.devices import SimulatedTurntable

Hook = Callable[[], None]


@dataclass
class Bench:
    """Scripted devices that write down what is asked of them; ``hooks`` run at the n-th call of a name."""

    calls: list[str] = field(default_factory=list)
    hooks: dict[tuple[str, int], Hook] = field(default_factory=dict)

    def called(self, name: str) -> None:
        self.calls.append(name)
        hook = self.hooks.get((name.split(" ")[0], sum(c.split(" ")[0] == name.split(" ")[0] for c in self.calls)))
        if hook:
            hook()


class ScriptedTurntable(SimulatedTurntable):
    def __init__(self, bench: Bench) -> None:
        super().__init__((-90.0, 90.0))
        self.bench = bench
        self.reports: list[TurntableStatus] = []

    def home(self, *, timeout_s: float) -> None:
        self.bench.called("home")
        super().home(timeout_s=timeout_s)

    def move_to(self, angle_deg: float, *, timeout_s: float) -> None:
        self.bench.called(f"move {angle_deg:g}")
        super().move_to(angle_deg, timeout_s=timeout_s)

    def status(self) -> TurntableStatus:
        self.bench.called("status")
        return self.reports.pop(0) if self.reports else super().status()

    def stop(self) -> None:
        self.bench.called("stop")
        super().stop()


class ScriptedCamera:
    makes_raw = False
    bit_depth = 8

    def __init__(self, bench: Bench, kind: str) -> None:
        self.bench, self.kind, self.delivers, self.taken = bench, kind, kind, 0

    def identity(self) -> DeviceIdentity:
        role = "light_field_camera" if self.kind == "light_field" else "target_camera"
        return DeviceIdentity(role, "test", "scripted", "1")  # type: ignore[arg-type]

    def arm(self, *, timeout_s: float) -> None:
        self.bench.called("arm")

    def trigger(self, *, timeout_s: float) -> str:
        self.bench.called("trigger")
        self.taken += 1
        return str(self.taken)

    def frame_ids(self) -> list[str]:
        return [str(k + 1) for k in range(self.taken)]

    def fetch(self, frame_id: str, *, timeout_s: float) -> Frame:
        self.bench.called("fetch")
        grey = 40 * int(frame_id)
        if self.delivers == "photo":
            pixels = np.full((6, 8, 3), grey, np.uint8)
            return Frame(frame_id, CaptureDocument(kind="photo", image="photo.png"), pixels)
        pixels = np.full((3, 3, 6, 8, 3), grey, np.uint8)
        return Frame(frame_id, CaptureDocument(kind="light_field", views=ViewsSpec(rows=3, cols=3)), pixels)

    def close(self) -> None:
        self.bench.called("close")


class Rig:
    """A bench with a session to shoot into."""

    def __init__(self, folder: Path) -> None:
        self.bench = Bench()
        self.turntable = ScriptedTurntable(self.bench)
        self.light_field, self.photo = ScriptedCamera(self.bench, "light_field"), ScriptedCamera(self.bench, "photo")
        self.store = SessionStore.create(folder / "session")
        self.slept: list[float] = []

    def run(self, plan: CapturePlan, **options: Any) -> list[str]:
        devices = Devices(self.turntable, self.light_field, self.photo)
        return run_plan(plan, devices, self.store, sleep=self.slept.append, **options)

    @property
    def journal(self) -> list[dict[str, Any]]:
        return read_journal(self.store.path / JOURNAL_FILE)

    @property
    def events(self) -> list[str]:
        return [record["event"] for record in self.journal]

    def listed(self) -> list[str]:
        return SessionStore.open(self.store.path).document.captures


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


PLAN = CapturePlan(angles_deg=(0.0, 15.0), target_deg=8.0, settle_s=0.25)


def test_scripted_cameras_are_cameras(rig: Rig) -> None:
    assert isinstance(rig.light_field, LightFieldCamera)
    assert isinstance(rig.photo, TargetCamera)


def test_order_of_a_shot(rig: Rig) -> None:
    rig.run(CapturePlan(angles_deg=(15.0,), settle_s=0.25))
    assert rig.bench.calls == ["home", "move 15", "arm", "status", "status", "trigger", "fetch"]
    assert rig.slept == [0.25]


def test_captures_carry_the_commanded_angle(rig: Rig) -> None:
    assert rig.run(PLAN) == ["000", "001", "002"]
    captures = rig.store.captures()
    assert [c.kind for c in captures.values()] == ["light_field", "light_field", "photo"]
    assert [c.turntable_deg for c in captures.values()] == [0.0, 15.0, 8.0]
    assert (rig.store.load_light_field("001").views == 80).all()


def test_journal_tells_intent_before_and_hash_after(rig: Rig) -> None:
    rig.run(PLAN)
    per_shot = ["moving", "settling", "armed", "trigger", "frame_seen", "ingested"]
    assert rig.events == ["run", "homed", *["planned"] * 3, *per_shot * 3, "done"]
    header, last = rig.journal[0], rig.journal[-1]
    assert CapturePlan.model_validate(header["plan"]) == PLAN
    assert [d["role"] for d in header["devices"]] == ["turntable", "light_field_camera", "target_camera"]
    assert last["captures"] == ["000", "001", "002"]
    hashes = [r["sha256"] for r in rig.journal if r["event"] == "ingested"]
    assert len(set(hashes)) == 3
    assert [r["seq"] for r in rig.journal] == list(range(len(rig.journal)))


def test_progress_is_reported_per_capture(rig: Rig) -> None:
    class Counting(Monitor):
        started: tuple[str, int | None] | None = None
        steps = 0

        def on_start(self, name: str, total: int | None) -> None:
            self.started = name, total

        def on_advance(self, steps: int) -> None:
            self.steps += steps

    monitor = Counting()
    rig.run(PLAN, monitor=monitor)
    assert monitor.started == ("capture", 3)
    assert monitor.steps == 3


def test_callback_gets_each_capture_with_its_frame(rig: Rig) -> None:
    seen: list[tuple[str, str]] = []
    rig.run(PLAN, on_ingested=lambda name, frame: seen.append((name, frame.frame_id)))
    assert seen == [("000", "1"), ("001", "2"), ("002", "1")]


@pytest.mark.parametrize(
    ("at", "kept"),
    [(("home", 1), 0), (("move", 2), 1), (("arm", 2), 2), (("trigger", 2), 2), (("fetch", 2), 2), (("fetch", 3), 3)],
)
def test_cancel_leaves_whole_captures_and_a_stopped_plate(rig: Rig, at: tuple[str, int], kept: int) -> None:
    """Once armed a shot is finished: its picture may exist already."""
    monitor = Monitor()
    rig.bench.hooks[at] = monitor.cancel
    with pytest.raises(Interrupted, match=f"{kept} of 3 captures are whole"):
        rig.run(PLAN, monitor=monitor)
    assert rig.bench.calls[-1] == "stop"
    assert rig.listed() == [f"{k:03d}" for k in range(kept)]
    for name in rig.listed():
        rig.store.load_photo(name)
    assert rig.journal[-1]["event"] == "aborted"
    assert rig.journal[-1]["captures"] == rig.listed()


def test_ctrl_c_is_a_cancel(rig: Rig) -> None:
    def press() -> None:
        raise KeyboardInterrupt

    rig.bench.hooks["fetch", 2] = press
    with pytest.raises(Interrupted):
        rig.run(PLAN)
    assert rig.listed() == ["000"]
    assert rig.bench.calls[-1] == "stop"


@pytest.mark.parametrize("call", ["home", "move", "arm", "trigger", "fetch"])
@pytest.mark.parametrize("error", [DeviceTimeout("no answer"), CaptureError("card full")])
def test_device_failures_are_passed_on_after_stopping(rig: Rig, call: str, error: LfrigError) -> None:
    def fail() -> None:
        raise error

    rig.bench.hooks[call, 1] = fail
    with pytest.raises(type(error)):
        rig.run(PLAN)
    assert rig.bench.calls[-1] == "stop"
    assert rig.listed() == []
    assert rig.journal[-1] | {"code": error.code, "event": "aborted"} == rig.journal[-1]


def test_angles_beyond_the_limits_are_refused_before_anything_moves(rig: Rig) -> None:
    with pytest.raises(MotionError, match="limits"):
        rig.run(CapturePlan(angles_deg=(0.0, 91.0)))
    assert rig.bench.calls == []
    assert rig.listed() == []


@pytest.mark.parametrize(
    "report",
    [
        TurntableStatus(MotionState.MOVING, 0.0),
        TurntableStatus(MotionState.IDLE, 0.5),
        TurntableStatus(MotionState.IDLE, None),
        TurntableStatus(MotionState.ALARM, None),
    ],
)
@pytest.mark.parametrize("which", [0, 1])
def test_nothing_is_triggered_unless_the_plate_rests_twice(rig: Rig, report: TurntableStatus, which: int) -> None:
    good = TurntableStatus(MotionState.IDLE, 0.0)
    rig.turntable.reports = [report] if which == 0 else [good, report]
    with pytest.raises(MotionError, match="should rest"):
        rig.run(PLAN)
    assert "trigger" not in rig.bench.calls


def test_photo_without_a_target_camera(rig: Rig) -> None:
    with pytest.raises(CaptureError, match="no target camera"):
        run_plan(PLAN, Devices(rig.turntable, rig.light_field), rig.store)


def test_cameras_that_are_swapped_are_noticed(rig: Rig) -> None:
    rig.light_field.delivers = "photo"
    with pytest.raises(CaptureError, match="which camera is which"):
        rig.run(PLAN)
    assert rig.listed() == []


def test_second_run_goes_on_in_the_same_journal(rig: Rig) -> None:
    rig.run(PLAN)
    first = len(rig.journal)
    rig.run(PLAN)
    assert rig.listed() == [f"{k:03d}" for k in range(6)]
    assert [r["seq"] for r in rig.journal] == list(range(2 * first))
