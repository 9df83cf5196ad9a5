"""Peak memory of each stage of the pipeline, in a process of its own."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from lfrig.bench.measure import in_fresh_process, peak_rss_mb
from lfrig.contracts.progress import Monitor

BEFORE = "before the first stage"
CLEAR_REFS, RESET_PEAK = Path("/proc/self/clear_refs"), "5"


def reset_peak() -> None:
    """Let the peak memory of this process begin at what it holds now (Linux only; elsewhere peaks never fall)."""
    with contextlib.suppress(OSError):
        CLEAR_REFS.write_text(RESET_PEAK, encoding="ascii")


@dataclass
class PeakMonitor(Monitor):
    """Notes the peak memory [MiB] of every outermost task; the peak begins anew with each."""

    peaks: dict[str, float] = field(default_factory=dict)
    depth: int = 0

    def on_start(self, name: str, total: int | None) -> None:
        """A stage begins."""
        if self.depth == 0:
            reset_peak()
        self.depth += 1

    def on_finish(self, name: str) -> None:
        """A stage ends."""
        self.depth -= 1
        if self.depth == 0:
            self.peaks[name] = max(self.peaks.get(name, 0.0), peak_rss_mb())


def stage_peaks(
    scene: str,
    size: tuple[int, int],
    angles_deg: Sequence[float],
    *,
    threads: int = 0,
    cache_dir: Path | None = None,
    monitor: Monitor,
) -> dict[str, float]:
    """Peak memory [MiB] of the process by stage, and before the first one, which holds modules and captures."""
    peaks, _ = in_fresh_process(_measure, scene, size, tuple(angles_deg), threads, cache_dir, monitor=monitor)
    return peaks


def _measure(
    scene: str, size: tuple[int, int], angles_deg: tuple[float, ...], threads: int, cache_dir: Path | None
) -> dict[str, float]:
    """What the process does: the captures come from the cache of renders, so that nothing was in it before."""
    from lfrig.bench.cases import shoot_case
    from lfrig.processing.pipeline import process

    case = shoot_case(
        scene, size, angles_deg=angles_deg, truth_views=False, threads=threads, cache_dir=cache_dir
    ).without_views()  # fmt: skip
    watch = PeakMonitor()
    reset_peak()
    before = peak_rss_mb()
    process(case.sources, case.target, case.prior, case.options(threads=threads), watch)
    return {BEFORE: before, **watch.peaks}
