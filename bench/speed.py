"""How long the product takes: whole runs, single updates of a live session, one light field alone, and peak memory.

CPU seconds are user + system of the process, wall seconds stand beside them; every figure is the median of some runs
after one that warmed up (imports, pages, caches of the kernels' tables). On a shared machine CPU seconds still rise
when neighbours use the same core or memory: the STREAM triad of the same run stands beside them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.bench import cotton
from lfrig.bench.cases import FULL, MEDIUM, TARGET_DEG, Case, scene_names, shoot_case
from lfrig.bench.document import Column, Table, write
from lfrig.bench.measure import Cost, in_fresh_process, stopwatch, summary
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.depth import estimate_disparity
from lfrig.processing.live import LiveFusion
from lfrig.processing.model import Photo
from lfrig.processing.options import PRESETS, ProcessOptions, Settings, without_wide_baseline
from lfrig.processing.pipeline import process
from lfrig.processing.poses import solve_poses
from lfrig.processing.prepare import find_evidence
from lfrig.processing.skipping import Tally
from lfrig.rig.ingest.run import open_light_field

RUNS = 5
SIZES = {"full": FULL, "half": MEDIUM}
POSE_ANGLES_DEG = (10.0, 45.0, 0.0, 60.0, 15.0, 30.0)
FIVE_VIEWS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0)
OTHER_TARGET_DEG = 20.0

BOUNDS: dict[str, tuple[float, str]] = {
    "all stages, 2 sources": (1.2, "an operator sees the result before the next shot is taken"),
    "all stages, 4 sources": (2.0, "an operator sees the result before the next shot is taken"),
    "without stage D, 2 sources": (0.5, "what a preview at full size may cost"),
    "without stage D, 4 sources": (0.9, "what a preview at full size may cost"),
    "poses of 5 views": (0.5, "less than everything else together"),
    "new target, 4 sources known": (0.4, "evidence and poses of the sources are kept"),
    "preview: new target, 2 sources": (0.08, "a tablet follows at ten frames a second"),
    "preview: new target, 4 sources": (0.15, "a tablet follows at ten frames a second"),
    "lfrig depth, cotton": (0.6, "a full sweep without masking takes 0.8 to 0.9"),
}
"""CPU seconds at full size."""
PEAK_MB = 600.0


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    scenes: Sequence[str] | None = None,
    size: str = "full",
    runs: int = RUNS,
    cache_dir: Path | None = None,
) -> BenchDocument:
    """Run the benchmark; writes speed.json and speed.md into ``out``.

    Parameters
    ----------
    scenes : sequence of str, optional
        The reporting half by default.
    size : {"full", "half"}
        Bounds are those of full size.
    """
    monitor = monitor or Monitor()
    names = scene_names("reporting", scenes)
    rows: list[dict[str, Any]] = []
    with monitor.task("bench speed", len(names) + 1):
        for scene in names:
            rows += _scene_rows(scene, SIZES[size], threads, runs, cache_dir, monitor)
            monitor.advance()
        folder = cotton.find(None)
        if folder is not None:
            rows.append(_cotton_row(folder, threads, runs, monitor))
        monitor.advance()
    means = _medians(rows)
    checks = _acceptance(means) if size == "full" and scenes is None else []
    return write(out, "speed", rows=[*rows, *means], checks=checks, tables=_tables(rows, means), text=_text(size, runs))


def _scene_rows(
    scene: str, size: tuple[int, int], threads: int, runs: int, cache_dir: Path | None, monitor: Monitor
) -> Iterator[dict[str, Any]]:
    def shot(**changes: Any) -> Case:
        return shoot_case(scene, size, truth_views=False, threads=threads, cache_dir=cache_dir, **changes)

    case = shot()
    other = shot(target_deg=OTHER_TARGET_DEG).target
    work: dict[str, Callable[[], object]] = {}
    for count in (2, 4):
        some = case.with_sources(count)
        work[f"all stages, {count} sources"] = _whole(some, case.options(threads=threads), monitor)
        plain = case.options(threads=threads, settings=without_stage_d(PRESETS["fast"].settings))
        work[f"without stage D, {count} sources"] = _whole(some, plain, monitor)
        preview = _updates(some, other, ProcessOptions(preset="preview", threads=threads), monitor)
        work |= {f"preview: {what}, {count} sources": do for what, do in preview.items()}
    full = _updates(case, other, ProcessOptions(threads=threads), monitor)
    work["new target, 4 sources known"] = full["new target"]
    work["poses of 5 views"] = _poses(shot(poses="prior", angles_deg=POSE_ANGLES_DEG), threads, monitor)
    for what, do in work.items():
        monitor.advance(0)
        yield {"kind": "time", "scene": scene, "what": what, **summary(_costs(do, runs))}
    _, cost = in_fresh_process(_whole_alone, case.without_views(), threads, monitor=monitor)
    yield {"kind": "memory", "scene": scene, "what": "all stages, 4 sources", "peak_rss_mb": cost.peak_rss_mb}


def without_stage_d(settings: Settings) -> Settings:
    """The same settings without wide-baseline refinement, what rests on it, and the edge test."""
    return replace(without_wide_baseline(settings), edges=replace(settings.edges, enabled=False))


def _whole(case: Case, options: ProcessOptions, monitor: Monitor) -> Callable[[], object]:
    return lambda: process(case.sources, case.target, case.prior, options, Muted(monitor))


def _whole_alone(case: Case, threads: int) -> None:
    """One whole run, in a process of its own."""
    process(case.sources, case.target, case.prior, case.options(threads=threads), Monitor())


def _updates(case: Case, other: Photo, options: ProcessOptions, monitor: Monitor) -> dict[str, Callable[[], object]]:
    """What a live session does when something changed: another target, a source (a retake), a frame."""
    fusion = LiveFusion(case.prior, options)
    for source in case.sources:
        fusion.add_source(source, Muted(monitor))
    targets = [case.target, other]
    fusion.set_target(targets[0], Muted(monitor))

    def new_target() -> object:
        targets.reverse()
        return fusion.set_target(targets[0], Muted(monitor))

    return {
        "new target": new_target,
        "new source": lambda: fusion.add_source(case.sources[0], Muted(monitor)),
        "new frame": lambda: fusion.show(targets[0].image, Muted(monitor)),
    }


def _poses(case: Case, threads: int, monitor: Monitor) -> Callable[[], object]:
    sources = [source for source in case.sources if source.turntable_deg in FIVE_VIEWS_DEG]
    evidence = find_evidence(
        sources, case.prior, PRESETS["fast"].settings, threads=threads, monitor=Muted(monitor), tally=Tally()
    )
    return lambda: solve_poses(
        sources, evidence, case.target, case.prior, "auto", threads=threads, monitor=Muted(monitor)
    )


def _cotton_row(folder: Path, threads: int, runs: int, monitor: Monitor) -> dict[str, Any]:
    light_field = open_light_field(folder, threads=threads, monitor=Muted(monitor))
    costs = _costs(lambda: estimate_disparity(light_field, threads=threads), runs)
    return {"kind": "time", "scene": folder.name, "what": "lfrig depth, cotton", **summary(costs)}


def _costs(work: Callable[[], object], runs: int) -> list[Cost]:
    work()
    costs = []
    for _ in range(runs):
        with stopwatch() as watch:
            work()
        assert watch.cost is not None
        costs.append(watch.cost)
    return costs


def _medians(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Per piece of work the median over scenes, and the worst scene."""
    found = []
    for what in dict.fromkeys(row["what"] for row in rows if row["kind"] == "time"):
        same = [row for row in rows if row["kind"] == "time" and row["what"] == what]
        worst = max(same, key=lambda row: row["cpu_s"])
        found.append({
            "kind": "median", "what": what, "scenes": len(same),
            **{name: float(np.median([row[name] for row in same])) for name in ("cpu_s", "wall_s")},
            "worst_cpu_s": worst["cpu_s"], "worst_scene": worst["scene"],
        })  # fmt: skip
    peaks = [row["peak_rss_mb"] for row in rows if row["kind"] == "memory"]
    if peaks:
        found.append({"kind": "peak", "what": "all stages, 4 sources", "peak_rss_mb": max(peaks)})
    return found


def _acceptance(medians: Sequence[dict[str, Any]]) -> list[Check]:
    checks = []
    for row in medians:
        if row["kind"] == "peak":
            why = "three runs fit beside each other into 2 GB"
            checks.append(Check.of("peak memory, 4 sources [MiB]", row["peak_rss_mb"], "<=", PEAK_MB, why))
        elif row["what"] in BOUNDS:
            bound, why = BOUNDS[row["what"]]
            checks.append(Check.of(f"{row['what']} [CPU s]", row["cpu_s"], "<=", bound, why))
    return checks


def _tables(rows: Sequence[dict[str, Any]], medians: Sequence[dict[str, Any]]) -> list[Table]:
    scenes = [
        Column("scene", "scene"), Column("what", "work"), Column("cpu_s", "CPU s", ".3f"),
        Column("cpu_s_min", "least", ".3f"), Column("wall_s", "wall s", ".3f"),
        Column("peak_rss_mb", "peak MiB", ".0f"),
    ]  # fmt: skip
    summaries = [
        Column("what", "work"), Column("scenes", "scenes"), Column("cpu_s", "CPU s", ".3f"),
        Column("wall_s", "wall s", ".3f"), Column("worst_cpu_s", "worst CPU s", ".3f"),
        Column("worst_scene", "worst scene"), Column("peak_rss_mb", "peak MiB", ".0f"),
    ]  # fmt: skip
    return [Table("Medians over the scenes", medians, summaries), Table("Every scene", rows, scenes)]


def _text(size: str, runs: int) -> str:
    width, height = SIZES[size]
    return (
        f"Captures of {width}×{height} px and 7×7 views, given poses unless said otherwise, from views in memory; "
        f"photo at {TARGET_DEG:g}°. Medians of {runs} runs after one to warm up. *Poses of 5 views*: the pose stage "
        "alone, light fields every 15° and a photo, from what the rig knows of its turntable. *New target*: another "
        "photo, with evidence and light fields kept. *Preview* works at half size. *Without wide baseline*: neither "
        "the refinement against the sources' centre views nor the continuation that rests on it."
    )
