"""One invocation of the command line: its global options, its output and its monitor."""

from __future__ import annotations

import contextlib
import json
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from lfrig.contracts.errors import LfrigError
from lfrig.rig.cli.failures import one_line
from lfrig.rig.cli.monitor import CliMonitor, LogFile

if TYPE_CHECKING:
    from rich.console import Console

GLOBAL_FLAGS = ("--json", "--debug", "--quiet")
GLOBAL_VALUES = ("--log-file", "--threads")


def hoist_globals(arguments: Sequence[str]) -> list[str]:
    """The arguments with the global options first, so that they may stand anywhere before a ``--``."""
    first: list[str] = []
    rest: list[str] = []
    pending = iter(arguments)
    for argument in pending:
        if argument == "--":
            rest += [argument, *pending]
        elif argument in GLOBAL_FLAGS or argument.startswith(tuple(f"{name}=" for name in GLOBAL_VALUES)):
            first.append(argument)
        elif argument in GLOBAL_VALUES:
            first += [argument, *[value for value in [next(pending, None)] if value is not None]]
        else:
            rest.append(argument)
    return first + rest


@dataclass
class Run:
    """What the commands share.

    Attributes
    ----------
    json : bool
        Print one JSON document on stdout and nothing else there.
    debug : bool
        Show the traceback of a failure.
    quiet : bool
        No progress, no warnings, no text: failures and files only.
    threads : int
        Threads of the processing; 0 = all cores. Never changes a result.
    """

    json: bool = False
    debug: bool = False
    quiet: bool = False
    threads: int = 0
    log: LogFile | None = None
    _monitor: CliMonitor | None = field(default=None, repr=False)

    @property
    def monitor(self) -> CliMonitor:
        """The monitor of this invocation: bars on a terminal, warnings as lines, everything in the log file."""
        if self._monitor is None:
            self._monitor = CliMonitor(quiet=self.quiet, log=self.log)
        return self._monitor

    def open_log(self, path: Path) -> None:
        """Keep a full log; raises `DiskError` when the file cannot be written."""
        self.log = LogFile(path)

    def emit(self, document: Any, show: Callable[[Console], None] | None = None) -> None:
        """Print the outcome: the JSON document, or what ``show`` draws for people."""
        self.monitor.pause()
        if self.json:
            sys.stdout.write(json.dumps(plain(document), indent=1, allow_nan=False, ensure_ascii=False) + "\n")
            sys.stdout.flush()
        elif show is not None and not self.quiet:
            show(text_console())

    def fail(self, error: LfrigError, cause: BaseException) -> int:
        """Tell the user of a failure and return its exit code."""
        self.monitor.pause()
        message, remedy = one_line(error.message), one_line(error.remedy)
        if self.log is not None:
            self.log.failure(message, cause)
        if self.debug:
            traceback.print_exception(cause, file=sys.stderr)
        if self.json:
            body = {"error": {"code": error.code, "message": message, "remedy": remedy}}
            sys.stdout.write(json.dumps(body, indent=1, ensure_ascii=False) + "\n")
        else:
            print(f"lfrig: error: {message}" + (f" — {remedy}" if remedy else ""), file=sys.stderr)
        return int(error.exit_code)

    def close(self) -> None:
        """End the progress display and the log."""
        if self._monitor is not None:
            self._monitor.pause()
        if self.log is not None:
            self.log.close()
            self.log = None

    @contextlib.contextmanager
    def signals(self) -> Iterator[None]:
        """SIGINT and SIGTERM both cancel: worker threads through the monitor, this one by an exception."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def interrupt(number: int, frame: FrameType | None) -> None:
            if self._monitor is not None:
                self._monitor.cancel()
            raise KeyboardInterrupt

        previous = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            yield
        finally:
            for number, handler in previous.items():
                signal.signal(number, handler)


def text_console() -> Console:
    """A rich console on stdout that never breaks lines where stdout is no terminal."""
    from rich.console import Console

    class Quitting(Console):
        def on_broken_pipe(self) -> None:
            raise BrokenPipeError  # rich would exit with 1; nobody reading on is no failure

    console = Quitting(file=sys.stdout, highlight=False)
    return console if console.is_terminal else Quitting(file=sys.stdout, highlight=False, width=200)


def plain(value: Any) -> Any:
    """``value`` as JSON can hold it.

    Documents as they are on disk, paths as text, arrays and NumPy numbers as Python's, NaN and infinity as null.
    """
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, float):
        return value if value - value == 0 else None
    if hasattr(value, "to_json"):
        return json.loads(value.to_json())
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    return value
