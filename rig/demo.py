"""The whole way in one go: a simulated rig, its captures, a result, its score, its report."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lfrig.contracts.errors import UsageError
from lfrig.contracts.files import atomic_folder, refuse_existing
from lfrig.contracts.progress import Monitor
from lfrig.contracts.result import ReportDocument
from lfrig.contracts.score import ScoreDocument

if TYPE_CHECKING:
    from lfrig.processing.options import ProcessOptions
    from lfrig.rig.session.store import SessionStore

SESSION = "session"


@dataclass(frozen=True)
class DemoPlan:
    """What is shot: a simulated scene, and plate angles of the light fields and of the photo [deg]."""

    scene: str = "figurines"
    angles_deg: tuple[float, ...] = (0.0, 15.0, 30.0, 45.0, 60.0)
    target_deg: float = 37.0


PLANS = {"tiny": DemoPlan(angles_deg=(0.0, 15.0), target_deg=8.0)}
"""By size; the others are all alike."""


@dataclass(frozen=True)
class DemoOutcome:
    """Where everything is, what it cost [s, user + system time of the process], and how good it is."""

    folder: Path
    result: Path
    plan: DemoPlan
    size: tuple[int, int]
    cpu_s: dict[str, float]
    wall_s: float
    report: ReportDocument
    score: ScoreDocument

    def as_document(self) -> dict[str, Any]:
        """For --json."""
        return {
            "path": self.folder, "result": self.result, "scene": self.plan.scene,
            "size": self.size, "sources": [source.id for source in self.report.sources],
            "cpu_s": self.cpu_s, "wall_s": self.wall_s, "score": self.score,
        }  # fmt: skip


@dataclass
class _Clock:
    start: float = field(default_factory=time.perf_counter)
    cpu_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        before = time.process_time()
        yield
        self.cpu_s[name] = time.process_time() - before


def run_demo(
    out: Path,
    *,
    size: str = "medium",
    overwrite: bool = False,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> DemoOutcome:
    """Make ``out`` with a simulated session, its truth, one result and its score.

    The request is that of every benchmark (b·F = 0.70 px·m at 541 px of width, in proportion to the width elsewhere;
    focus 0.46 m), so the errors compare. All light fields serve as sources.

    Raises
    ------
    UsageError
        There is no such size.
    BadInput
        ``out`` exists.
    """
    from lfrig.rig.process import process_session
    from lfrig.rig.scoring import score_result
    from lfrig.rig.sim_capture import SIZES, capture_simulated

    if size not in SIZES:
        raise UsageError(f"--size: unknown {size!r}", remedy=f"choose one of {', '.join(SIZES)}")
    refuse_existing(out, overwrite=overwrite)
    plan, monitor, clock = PLANS.get(size, DemoPlan()), monitor or Monitor(), _Clock()
    with atomic_folder(out, overwrite=overwrite) as folder:
        session = folder / SESSION
        with clock.step("capture"):
            store = capture_simulated(
                session, scene=plan.scene, size=size, angles_deg=plan.angles_deg, target_deg=plan.target_deg,
                threads=threads, monitor=monitor,
            )  # fmt: skip
        with clock.step("process"):
            options = _request(store.truth_path, threads)
            result = process_session(session, sources=_light_fields(store), options=options, monitor=monitor)
        with clock.step("score"):
            score, _ = score_result(result, threads=threads, monitor=monitor)
        report = ReportDocument.load(result / "report.json")
        place = result.relative_to(folder)
    wall_s = time.perf_counter() - clock.start
    return DemoOutcome(out, out / place, plan, SIZES[size], clock.cpu_s, wall_s, report, score)


def _request(truth: Path, threads: int) -> ProcessOptions:
    """Ask for the light field that the simulator can show: only then are its views comparable."""
    from lfrig.contracts.truth import TruthDocument
    from lfrig.processing.options import ProcessOptions

    captures = TruthDocument.load(truth / "truth.json").captures.values()
    [optics] = [capture.optics for capture in captures if capture.kind == "photo"]
    return ProcessOptions(target_baseline_m=optics.baseline_m, target_focus_m=optics.focus_distance_m, threads=threads)


def _light_fields(store: SessionStore) -> list[str]:
    return [name for name, capture in store.captures().items() if capture.kind == "light_field"]
