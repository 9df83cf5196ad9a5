"""Progress, warnings, cancel; errors and their exit codes."""

from __future__ import annotations

import pytest

from lfrig.contracts.errors import (
    BadInput,
    DiskError,
    ExitCode,
    GeometryRefused,
    Interrupted,
    LfrigError,
    LinkError,
    NotInThisVersion,
    UsageError,
)
from lfrig.contracts.native import load_native, native_wanted
from lfrig.contracts.progress import Monitor, Notice


class Recorder(Monitor):
    def __init__(self) -> None:
        super().__init__()
        self.events: list[object] = []

    def on_start(self, name: str, total: int | None) -> None:
        self.events.append(("start", name, total))

    def on_advance(self, steps: int) -> None:
        self.events.append(steps)

    def on_finish(self, name: str) -> None:
        self.events.append(("finish", name))

    def on_warn(self, notice: Notice) -> None:
        self.events.append(notice)


def test_tasks_start_advance_and_finish() -> None:
    monitor = Recorder()
    with monitor.task("read", 2):
        monitor.advance()
        monitor.advance(0)
        monitor.advance()
    assert monitor.events == [("start", "read", 2), 1, 1, ("finish", "read")]


def test_a_cancel_is_noticed_at_the_next_step_and_the_task_is_closed() -> None:
    monitor = Recorder()
    with pytest.raises(Interrupted) as caught, monitor.task("read"):
        monitor.cancel()
        monitor.advance(0)
    assert caught.value.exit_code == ExitCode.INTERRUPTED
    assert monitor.events[-1] == ("finish", "read")
    with pytest.raises(Interrupted), monitor.task("next"):
        pytest.fail("a cancelled monitor starts nothing")
    assert ("start", "next", None) not in monitor.events


def test_the_same_warning_is_given_once() -> None:
    monitor = Recorder()
    monitor.warn("a", "one")
    monitor.warn("a", "two")
    monitor.warn("a", "one")
    assert monitor.notices == monitor.events == [Notice("a", "one"), Notice("a", "two")]


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UsageError("m"), 2),
        (NotInThisVersion("m"), 2),
        (BadInput("m"), 3),
        (GeometryRefused("m"), 4),
        (LinkError("m"), 5),
        (DiskError("m"), 6),
        (Interrupted(), 130),
    ],
)
def test_exit_codes(error: LfrigError, code: int) -> None:
    assert error.exit_code == code


def test_an_error_leads_with_file_and_field() -> None:
    error = BadInput("is wrong", path="a/b.json", field="pose.t", remedy="correct it")
    assert error.message == "a/b.json: pose.t: is wrong"
    assert str(error) == "a/b.json: pose.t: is wrong (correct it)"
    assert (error.path, error.field, error.code) == ("a/b.json", "pose.t", "bad-input")


@pytest.mark.parametrize(("value", "wanted"), [("0", False), ("off", False), ("FALSE", False), ("1", True), ("", True)])
def test_the_native_core_is_switched_by_the_environment(
    monkeypatch: pytest.MonkeyPatch, value: str, wanted: bool
) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", value)
    assert native_wanted() is wanted
    assert (load_native("json") is not None) is wanted
    assert load_native("lfrig.no_such_module") is None
