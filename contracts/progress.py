"""How long work reports progress and warnings, and how it hears of a cancel.

Processing functions take a `Monitor`; the base class does nothing visible, the command line draws bars, the
tests count. `Monitor.advance` is the one place where a cancel is noticed, so every loop worth a bar is also
cancellable.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from lfrig.contracts.errors import Interrupted


@dataclass(frozen=True)
class Notice:
    """A warning in words: ``code`` for machines, ``message`` for people."""

    code: str
    message: str


@dataclass
class Monitor:
    """Receives progress; silent by default.

    Attributes
    ----------
    notices : list of Notice
        The warnings so far, in order, each code and message once.
    """

    notices: list[Notice] = field(default_factory=list)
    _cancel: threading.Event = field(default_factory=threading.Event)

    def cancel(self) -> None:
        """Ask the running work to stop (from any thread)."""
        self._cancel.set()

    @contextlib.contextmanager
    def task(self, name: str, total: int | None = None) -> Iterator[None]:
        """Bracket a named piece of work of ``total`` steps (None = unknown)."""
        self.advance(0)
        self.on_start(name, total)
        try:
            yield
        finally:
            self.on_finish(name)

    def advance(self, steps: int = 1) -> None:
        """Report ``steps`` done; raises `Interrupted` after `cancel`."""
        if self._cancel.is_set():
            raise Interrupted
        if steps:
            self.on_advance(steps)

    def warn(self, code: str, message: str) -> None:
        """Record a warning."""
        notice = Notice(code, message)
        if notice not in self.notices:
            self.notices.append(notice)
            self.on_warn(notice)

    def on_start(self, name: str, total: int | None) -> None:
        """Hook: a task begins."""

    def on_advance(self, steps: int) -> None:
        """Hook: the innermost task moved on."""

    def on_finish(self, name: str) -> None:
        """Hook: a task ended."""

    def on_warn(self, notice: Notice) -> None:
        """Hook: a warning was recorded."""


class Muted(Monitor):
    """Keeps warnings until it is known which of them hold, if any; a cancel is the outer monitor's."""

    def __init__(self, outer: Monitor) -> None:
        super().__init__()
        self.outer = outer

    def advance(self, steps: int = 1) -> None:
        """Notice a cancel of the outer monitor."""
        self.outer.advance(0)

    def release(self, holds: Callable[[Notice], bool] = lambda _: True) -> None:
        """Hand on the warnings that hold."""
        for notice in self.notices:
            if holds(notice):
                self.outer.warn(notice.code, notice.message)
