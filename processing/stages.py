"""What each stage costs: wall and CPU seconds, peak memory, work done and skipped."""

from __future__ import annotations

import contextlib
import resource
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

from lfrig.contracts.progress import Monitor
from lfrig.contracts.result import SkipReport, StageReport
from lfrig.processing.skipping import Tally
from lfrig.processing.threads import opencv_threads


@dataclass
class StageNote:
    """What a stage says of its work."""

    work_done: float = 0.0
    work_skipped: float = 0.0
    unit: str = ""
    tally: Tally = field(default_factory=Tally)

    def done(self, amount: float, unit: str = "") -> None:
        """Record work done."""
        self.work_done, self.unit = float(amount), unit or self.unit

    def skipped(self, amount: float, unit: str = "") -> None:
        """Record work that was not needed."""
        self.work_skipped, self.unit = float(amount), unit or self.unit


@dataclass
class StageClock:
    """Times stages one after the other, and keeps OpenCV in them to ``threads`` (0 = all cores)."""

    monitor: Monitor
    threads: int = 0
    reports: list[StageReport] = field(default_factory=list)

    @contextlib.contextmanager
    def stage(self, name: str, total: int | None) -> Iterator[StageNote]:
        """Time the block; CPU s = user + system time of the whole process."""
        note = StageNote()
        wall, cpu = time.perf_counter(), time.process_time()
        with opencv_threads(self.threads), self.monitor.task(name, total):
            yield note
        self.reports.append(
            StageReport(
                name=name,
                wall_s=time.perf_counter() - wall,
                cpu_s=time.process_time() - cpu,
                peak_rss_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
                work_done=note.work_done,
                work_skipped=note.work_skipped,
                unit=note.unit,
                skips=[
                    SkipReport(name=name, done=c.done, skipped=c.skipped, unit=c.unit, saved_ms=c.saved_ms)
                    for name, c in note.tally.counts.items()
                ],
            )
        )
