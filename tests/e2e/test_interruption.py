"""What happens to files when the disk, the permissions or the user say no: the real things, in a process of its own."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

COMMAND = [sys.executable, "-m", "lfrig.rig.cli"]
PR_CAPBSET_DROP = 24  # linux/prctl.h
CAP_DAC = (1, 2)  # CAP_DAC_OVERRIDE, CAP_DAC_READ_SEARCH of linux/capability.h


def run(
    *arguments: str | Path, before: Callable[[], None] | None = None, **options: object
) -> subprocess.CompletedProcess[str]:
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, preexec_fn=before, check=False, **options)


def error_line(done: subprocess.CompletedProcess[str]) -> str:
    lines = [line for line in done.stderr.splitlines() if not line.startswith("lfrig: warning: ")]
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("lfrig: error: ")
    return lines[0]


def everything_in(folder: Path) -> set[str]:
    """Hidden names too: they would be left-overs."""
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_in_the_middle(session: Path, number: signal.Signals) -> None:
    before = everything_in(session)
    process = subprocess.Popen([*COMMAND, "process", str(session)], stderr=subprocess.PIPE, text=True)
    try:
        _wait_for_work(session / "results", process)
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    finally:
        with contextlib.suppress(OSError):
            process.kill()
    assert process.returncode == 130, err
    lines = [line for line in err.splitlines() if not line.startswith("lfrig: warning: ")]
    assert lines == ["lfrig: error: interrupted; nothing was changed — run the same command again"]
    assert everything_in(session) == before


def _wait_for_work(results: Path, process: subprocess.Popen[str]) -> None:
    """Until the hidden folder of the result in the making is there: the work has begun and has not ended."""
    while process.poll() is None:
        if results.is_dir() and any(results.iterdir()):
            return
        time.sleep(0.002)
    raise AssertionError("it ended before it could be interrupted")


def test_ctrl_c_keeps_the_result_that_was_there(session: Path, content) -> None:
    assert run("process", session).returncode == 0
    before = content(session)
    names = everything_in(session)
    process = subprocess.Popen([*COMMAND, "process", str(session), "--overwrite"], stderr=subprocess.DEVNULL)
    while process.poll() is None and len(list((session / "results").iterdir())) < 2:
        time.sleep(0.002)
    process.send_signal(signal.SIGINT)
    assert process.wait(timeout=60) == 130
    assert content(session) == before
    assert everything_in(session) == names


def test_a_full_disk(session: Path, content) -> None:
    """A limit on the size of files is the one kind of full disk that needs no file system of its own."""
    before, names = content(session), everything_in(session)
    done = run("process", session, before=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096)))
    assert done.returncode == 6, done.stderr
    assert "no space left" in error_line(done)
    assert content(session) == before
    assert everything_in(session) == names


def bound_by_permissions() -> None:
    """Drop what lets root ignore file modes, for the program that is started next."""
    if os.geteuid() == 0:
        libc = ctypes.CDLL(None, use_errno=True)
        for capability in CAP_DAC:
            assert libc.prctl(PR_CAPBSET_DROP, capability, 0, 0, 0) == 0


def test_a_read_only_session(session: Path, content) -> None:
    before = content(session)
    session.chmod(0o555)
    done = run("process", session, before=bound_by_permissions)
    session.chmod(0o755)
    assert done.returncode == 6, done.stderr
    assert "read-only" in error_line(done)
    assert content(session) == before
    assert not (session / "results").exists()


@pytest.mark.parametrize(
    "arguments", [["depth", "{capture}", "--out", "{closed}/d"], ["ingest", "{closed}", "{capture}"]]
)
def test_a_read_only_folder(session: Path, tmp_path: Path, arguments: list[str]) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o555)
    capture = session / "captures" / "000"
    done = run(*(text.format(capture=capture, closed=closed) for text in arguments), before=bound_by_permissions)
    assert done.returncode == 6, done.stderr
    error_line(done)
    assert list(closed.iterdir()) == []


def test_a_capture_that_may_not_be_read(session: Path) -> None:
    path = session / "captures" / "000" / "capture.json"
    path.chmod(0)
    done = run("process", session, before=bound_by_permissions)
    assert done.returncode == 3, done.stderr
    assert str(path) in error_line(done)


def test_a_reader_that_goes_away(session: Path) -> None:
    """`lfrig info … | head -0`: no traceback, and no failure."""
    script = f"{sys.executable} -m lfrig.rig.cli info {session} | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "0"
    assert done.stderr == ""


def test_an_unexpected_failure_is_one_line_without_debug(session: Path) -> None:
    code = (
        "import sys, lfrig.rig.process as p\n"
        "def broken(*a): raise KeyError('oops')\n"
        "p.load_inputs = broken\n"
        "from lfrig.rig.cli import main\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    plain, debug = (
        subprocess.run([sys.executable, "-c", code, *options, "process", str(session)], capture_output=True, text=True)
        for options in ([], ["--debug"])
    )
    assert plain.returncode == debug.returncode == 1
    assert "KeyError" in error_line(plain)
    assert "--debug" in error_line(plain)
    assert "Traceback" in debug.stderr


@pytest.mark.parametrize("arguments", [["demo", "--size", "tiny", "--out", "{out}"], ["evaluate", "{session}"]])
def test_ctrl_c_leaves_nothing_of_longer_work(session: Path, tmp_path: Path, arguments: list[str]) -> None:
    before = everything_in(tmp_path)
    words = [word.format(out=tmp_path / "demo", session=session) for word in arguments]
    process = subprocess.Popen([*COMMAND, *words], stderr=subprocess.PIPE, text=True)
    while process.poll() is None and everything_in(tmp_path) == before:
        time.sleep(0.01)
    time.sleep(0.3)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, err
    assert err.splitlines()[-1].startswith("lfrig: error: interrupted")
    assert everything_in(tmp_path) - {"session/results"} == before  # an empty folder is no result


def test_an_interrupt_inside_an_executed_string_has_our_exit_code(tmp_path: Path) -> None:
    """As when it strikes while a dataclass is being made at import."""
    (tmp_path / "struck.py").write_text(
        "import sys\n"
        "from lfrig.rig.cli import app, main\n"
        "app.app = lambda **_: exec('raise KeyboardInterrupt')\n"
        "sys.exit(main(['doctor']))\n"
    )
    outcome = subprocess.run(
        [sys.executable, "-m", "struck"], capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])},
    )  # fmt: skip
    assert outcome.returncode == 130, outcome.stderr
    assert outcome.stderr.splitlines()[-1].startswith("lfrig: error: interrupted")
