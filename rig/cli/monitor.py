"""Progress bars on a terminal's stderr, warnings as lines, and the log file."""

from __future__ import annotations

import datetime
import sys
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING

from lfrig.contracts.files import disk_errors
from lfrig.contracts.progress import Monitor, Notice
from lfrig.rig.cli.failures import one_line

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID


class LogFile:
    """A plain text log, one line an event, appended and flushed at once so that it survives a crash."""

    def __init__(self, path: Path) -> None:
        with disk_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = path.open("a", encoding="utf-8")

    def line(self, level: str, text: str) -> None:
        """Append one event."""
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="milliseconds")
        self._stream.write(f"{now} {level:<7} {text}\n")
        self._stream.flush()

    def failure(self, message: str, cause: BaseException) -> None:
        """Append an error with its traceback."""
        self.line("ERROR", message)
        self._stream.write("".join(traceback.format_exception(cause)))
        self._stream.flush()

    def close(self) -> None:
        """Close the file."""
        self._stream.close()


class CliMonitor(Monitor):
    """Draws one bar per running task when stderr is a terminal, and prints each warning as one line."""

    def __init__(self, *, quiet: bool = False, log: LogFile | None = None) -> None:
        super().__init__()
        self._quiet = quiet
        self._log = log
        self._tasks: list[tuple[str, TaskID | None, float]] = []
        self._progress: Progress | None = None

    def pause(self) -> None:
        """Take the bars off the screen; the next task draws them again."""
        if self._progress is not None:
            self._progress.stop()
            self._progress = None
            self._tasks = [(name, None, start) for name, _, start in self._tasks]

    def on_start(self, name: str, total: int | None) -> None:
        """Add a bar."""
        bar: TaskID | None = None
        if not self._quiet and sys.stderr.isatty():
            bar = self._bars().add_task(name, total=total)
        self._tasks.append((name, bar, time.perf_counter()))
        if self._log is not None:
            self._log.line("START", name)

    def on_advance(self, steps: int) -> None:
        """Move the innermost bar."""
        if self._progress is not None and self._tasks and self._tasks[-1][1] is not None:
            self._progress.advance(self._tasks[-1][1], steps)

    def on_finish(self, name: str) -> None:
        """Remove the bar; the last one takes the display with it."""
        if not self._tasks:
            return
        _, bar, start = self._tasks.pop()
        if self._progress is not None and bar is not None:
            self._progress.remove_task(bar)
        if self._log is not None:
            self._log.line("DONE", f"{name} {time.perf_counter() - start:.3f} s")
        if not self._tasks:
            self.pause()

    def on_warn(self, notice: Notice) -> None:
        """Print a warning."""
        text = f"{one_line(notice.message)} [{notice.code}]"
        if self._log is not None:
            self._log.line("WARNING", text)
        if self._quiet:
            return
        if self._progress is not None:
            self._progress.console.print(f"lfrig: warning: {text}", markup=False, highlight=False, soft_wrap=True)
        else:
            print(f"lfrig: warning: {text}", file=sys.stderr)

    def _bars(self) -> Progress:
        if self._progress is None:
            from rich.console import Console
            from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

            self._progress = Progress(
                TextColumn("{task.description}"),
                BarColumn(),
                TextColumn("{task.percentage:>3.0f} %"),
                TimeElapsedColumn(),
                console=Console(stderr=True),
                transient=True,
            )
            self._progress.start()
        return self._progress
