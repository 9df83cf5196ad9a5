"""What is drawn where: bars on a terminal alone, one document with --json, exit codes of benchmarks."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.errors import BadInput, DiskError, Interrupted
from lfrig.rig.cli.failures import explain, one_line
from lfrig.rig.cli.run import hoist_globals, plain


def on_a_terminal(*arguments: str) -> tuple[int, str, str]:
    """Run the command with stderr on a terminal; returns its exit code, stdout, and what the terminal got."""
    master, slave = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    process = subprocess.Popen(
        [sys.executable, "-m", "lfrig.rig.cli", *arguments],
        stdout=subprocess.PIPE, stderr=slave, text=True, env=environment,
    )  # fmt: skip
    os.close(slave)
    drawn = b""
    while True:
        try:
            block = os.read(master, 65536)
        except OSError:  # the terminal is gone once the last writer is
            break
        if not block:
            break
        drawn += block
    os.close(master)
    out, _ = process.communicate()
    return process.returncode, out, drawn.decode(errors="replace")


def test_bars_on_a_terminal(session: Path) -> None:
    code, out, drawn = on_a_terminal("process", str(session))
    assert code == 0
    assert "fusion" in drawn
    assert "\x1b[" in drawn
    assert out.strip() == str(session / "results" / "002-fast" / "report.html")


def test_quiet_draws_nothing(session: Path) -> None:
    code, _, drawn = on_a_terminal("process", str(session), "--quiet")
    assert (code, drawn) == (0, "")


def test_an_error_on_a_terminal_is_a_line_of_its_own(session: Path) -> None:
    (session / "captures" / "001" / "views" / "06_06.png").unlink()
    code, _, drawn = on_a_terminal("process", str(session))
    assert code == 3
    assert drawn.strip().splitlines()[-1].startswith("lfrig: error: ")


@pytest.fixture
def failing_bench(monkeypatch: pytest.MonkeyPatch) -> None:
    import lfrig.bench

    def run(out: Path, **_: object) -> BenchDocument:
        out.mkdir(parents=True)
        (out / "stress.md").write_text("# stress\n", encoding="utf-8")
        bad = Check.of("speed", 3.0, "<=", 2.0, "it must be fast")
        return BenchDocument(name="stress", checks=[bad], rows=[{"value": float("nan")}])

    monkeypatch.setattr(lfrig.bench, "load", lambda name: SimpleNamespace(run=run))


def test_a_failed_check_of_a_benchmark(lfrig, failing_bench: None, tmp_path: Path) -> None:
    assert lfrig("bench", "stress", "--out", tmp_path / "a").code == 0
    checked = lfrig("bench", "stress", "--out", tmp_path / "b", "--check")
    assert checked.code == 1
    assert "speed" in checked.error_line
    as_json = lfrig("bench", "stress", "--out", tmp_path / "c", "--check", "--json")
    assert as_json.code == 1
    assert as_json.json["schema"] == "lfrig.bench/1"
    assert as_json.json["checks"][0]["ok"] is False
    assert as_json.err == ""


def test_global_options_may_stand_anywhere() -> None:
    assert hoist_globals(["process", "S", "--json", "--threads", "3"]) == ["--json", "--threads", "3", "process", "S"]
    assert hoist_globals(["info", "--log-file=x", "P"]) == ["--log-file=x", "info", "P"]
    assert hoist_globals(["info", "--", "--json"]) == ["info", "--", "--json"]


@given(st.lists(st.sampled_from(["process", "S", "--json", "--threads", "4", "--quiet", "--target", "0", "--"])))
def test_hoisting_keeps_every_word_and_the_order_of_the_others(words: list[str]) -> None:
    hoisted = hoist_globals(words)
    assert sorted(hoisted) == sorted(words)
    assert hoist_globals(hoisted) == hoisted


@pytest.mark.parametrize("error, code, kind", [
    (KeyboardInterrupt(), 130, Interrupted),
    (OSError(28, "No space left on device", "/x/y"), 6, DiskError),
    (PermissionError(13, "Permission denied", "/x/y"), 6, DiskError),
    (BadInput("is odd", path="a.json", field="f"), 3, BadInput),
    (MemoryError(), 1, Exception),
    (ValueError("two\nlines"), 1, Exception),
])  # fmt: skip
def test_every_exception_has_a_code_a_message_and_a_remedy(error: BaseException, code: int, kind: type) -> None:
    told = explain(error)
    assert isinstance(told, kind)
    assert told.exit_code == code
    assert one_line(told.message)
    assert told.remedy or isinstance(error, BadInput)


def test_json_holds_no_nan_and_no_path() -> None:
    import numpy as np

    document = {"a": float("nan"), "b": Path("x"), "c": np.float32(1.5), "d": np.array([1.0, np.inf]), "e": (1, True)}
    assert plain(document) == {"a": None, "b": "x", "c": 1.5, "d": [1.0, None], "e": [1, True]}
