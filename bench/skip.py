"""What leaving work out saves, and what it costs in error: every switch of `Skips` off in turn, on the same kernels.

Runs of all variants alternate within a scene, so that what else the machine does hits all alike; medians count. Poses
are given, so that the error is that of the geometry; the bundle adjustment alone is judged with poses to be found.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.bench import plots
from lfrig.bench.accuracy_table import score_fields
from lfrig.bench.cases import FAR_DEG, FULL, NEAR_DEG, Case, scene_names, shoot_case
from lfrig.bench.document import Column, Table, write
from lfrig.bench.measure import Cost, stopwatch, summary
from lfrig.bench.memory import BEFORE, stage_peaks
from lfrig.bench.skip_scene import NAME as EVERYTHING
from lfrig.bench.skip_scene import everything
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.options import PRESETS
from lfrig.processing.pipeline import ProcessResult, process
from lfrig.processing.reuse import MemoryStore
from lfrig.processing.skipping import Skips
from lfrig.rig.candidate import Candidate, score_candidate
from lfrig.sim.rig import Poses

RUNS = 3
PICTURE = "skip.png"
ALL, NOTHING = "all on", "all off"
WITH_POSES = ("adjustment",)
"""Switches that matter where poses have to be found."""
ELSEWHERE = {
    "plate": "needs a mask of the turntable, which these scenes do not have",
}
"""Switches that no run of this benchmark can tell anything about, and why."""
KEPT = "unchanged"
"""The switch whose work is saved by an earlier run: its row compares runs with and without kept evidence."""
MEMORY_SOURCES = {2: NEAR_DEG, 4: (*NEAR_DEG, *FAR_DEG)}


@dataclass(frozen=True)
class Variant:
    """A run of a scene: its name, its switches, and whether evidence of an earlier run is kept."""

    name: str
    skips: Skips
    kept: bool = False


def variants(poses: Poses) -> list[Variant]:
    """What is run of every scene: all switches on, and off what can matter."""
    shipped = Skips()
    if poses == "prior":
        return [Variant(ALL, shipped), *(Variant(name, shipped.without(name)) for name in WITH_POSES)]
    single = [name for name in Skips.names() if name not in (*WITH_POSES, *ELSEWHERE, KEPT)]
    return [
        Variant(ALL, shipped),
        Variant(NOTHING, Skips.nothing()),
        *(Variant(name, shipped.without(name)) for name in single),
        Variant(KEPT, shipped, kept=True),
    ]


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    scenes: Sequence[str] | None = None,
    size: tuple[int, int] = FULL,
    runs: int = RUNS,
    cache_dir: Path | None = None,
) -> BenchDocument:
    """Run the benchmark; writes skip.json, skip.md and a plot into ``out``.

    Parameters
    ----------
    scenes : sequence of str, optional
        The typical scenes; the reporting half by default. The one that needs everything always runs.
    """
    monitor = monitor or Monitor()
    names = scene_names("reporting", scenes)
    rows: list[dict[str, Any]] = []
    each = len(variants("given")) + len(variants("prior"))
    with monitor.task("bench skip", (len(names) + 1) * each + len(MEMORY_SOURCES)):
        for scene in [*names, EVERYTHING]:
            for poses in ("given", "prior"):
                case = shoot_case(
                    everything() if scene == EVERYTHING else scene, size, poses=poses, angles_deg=NEAR_DEG,
                    truth_views=False, threads=threads, cache_dir=cache_dir, monitor=Muted(monitor),
                )  # fmt: skip
                rows += case_rows(case, poses, runs, threads, monitor)
        for count, angles in MEMORY_SOURCES.items():
            peaks = stage_peaks(names[0], size, angles, threads=threads, cache_dir=cache_dir, monitor=monitor)
            rows += [{"kind": "memory", "scene": names[0], "sources": count, "stage": stage, "peak_rss_mb": peak}
                     for stage, peak in peaks.items()]  # fmt: skip
            monitor.advance()
    means = switch_rows(rows)
    plots.bars(out / PICTURE, bar_groups(rows), title="skipping on and off", unit="CPU s (user + system)")
    checks = acceptance(means, rows) if size == FULL and scenes is None else []
    return write(
        out, "skip", rows=[*means, *rows], checks=checks, tables=tables(means, rows), text=_text(names, size, runs),
        pictures=[PICTURE],
    )  # fmt: skip


def case_rows(case: Case, poses: Poses, runs: int, threads: int, monitor: Monitor) -> list[dict[str, Any]]:
    """A row per variant with error and cost, and a row per switch and stage with the work done and skipped."""
    chosen = variants(poses)
    costs: dict[str, list[Cost]] = {variant.name: [] for variant in chosen}
    results: dict[str, ProcessResult | GeometryRefused] = {}
    store = MemoryStore()
    _process(case, Variant("warm up", Skips(), kept=True), store, threads, monitor)
    for _ in range(runs):
        for variant in chosen:
            monitor.advance(0)
            with stopwatch() as watch:
                results[variant.name] = _process(case, variant, store, threads, monitor)
            assert watch.cost is not None
            costs[variant.name].append(watch.cost)
    rows: list[dict[str, Any]] = []
    for variant in chosen:
        row = {"kind": "variant", "scene": case.scene, "poses": poses, "variant": variant.name}
        result = results.pop(variant.name)
        monitor.advance()
        if isinstance(result, GeometryRefused):
            rows.append({**row, "refused": result.code})
            continue
        rows.append({**row, **_errors(case, result), **summary(costs[variant.name])})
        if variant.name == ALL:
            rows += _counts(case.scene, poses, result)
    return rows


def _process(
    case: Case, variant: Variant, store: MemoryStore, threads: int, monitor: Monitor
) -> ProcessResult | GeometryRefused:
    options = case.options(settings=replace(PRESETS["fast"].settings, skips=variant.skips), threads=threads)
    kept = store if variant.kept else None
    try:
        return process(case.sources, case.target, case.prior, options, Muted(monitor), store=kept)
    except GeometryRefused as refusal:
        return refusal


def _errors(case: Case, result: ProcessResult) -> dict[str, Any]:
    made = result.light_field
    score, _ = score_candidate(Candidate(made.disparity, None, made.request, result.metric), case.truth)
    fields = score_fields(score)
    return {name: fields[name] for name in ("mse", "ppe_005", "ppe_010")}


def _counts(scene: str, poses: Poses, result: ProcessResult) -> list[dict[str, Any]]:
    return [
        {"kind": "count", "scene": scene, "poses": poses, "stage": stage.name, **skip.model_dump()}
        for stage in result.stages
        for skip in stage.skips
    ]


def switch_rows(rows: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Per variant: mean cost and error over the typical scenes, and on the one that needs everything, against all on.

    ``saves`` is the share of the CPU time that the switch saves (all switches for ``all off``), ``mse_change`` what it
    adds to the error.
    """
    found: list[dict[str, Any]] = []
    runs = _complete([row for row in rows if row["kind"] == "variant"])
    for poses in dict.fromkeys(row["poses"] for row in runs):
        for name in dict.fromkeys(row["variant"] for row in runs if row["poses"] == poses):
            mean: dict[str, Any] = {"kind": "switch", "poses": poses, "variant": name}
            for prefix, typical in (("", True), ("everything_", False)):
                same = [row for row in runs if row["poses"] == poses and (row["scene"] != EVERYTHING) == typical]
                if same:
                    figures = _against_shipped(same, name)
                    mean |= {prefix + field: value for field, value in figures.items()}
            found.append(mean)
    return found


def _complete(runs: list[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Without the scenes that some variant refused: means over different scenes say nothing."""
    refused = {(row["scene"], row["poses"]) for row in runs if "refused" in row}
    return [row for row in runs if (row["scene"], row["poses"]) not in refused]


def _against_shipped(rows: Sequence[Mapping[str, Any]], name: str) -> dict[str, float]:
    def mean(variant: str, field: str) -> float:
        return float(np.mean([row[field] for row in rows if row["variant"] == variant]))

    with_it, without = (ALL, name) if name != KEPT else (KEPT, ALL)
    return {
        "cpu_s": mean(name, "cpu_s"), "wall_s": mean(name, "wall_s"), "mse": mean(name, "mse"),
        "ppe_005": mean(name, "ppe_005"),
        "saves": 1 - mean(with_it, "cpu_s") / mean(without, "cpu_s"),
        "mse_change": mean(with_it, "mse") / mean(without, "mse") - 1,
    }  # fmt: skip


def acceptance(means: Sequence[Mapping[str, Any]], rows: Sequence[Mapping[str, Any]]) -> list[Check]:
    """What skipping has to save, and may cost."""
    refused = sum("refused" in row for row in rows)
    off = next(row for row in means if row["poses"] == "given" and row["variant"] == NOTHING)
    peak = max(row["peak_rss_mb"] for row in rows if row["kind"] == "memory" and row["sources"] == 4)
    return [
        Check.of("runs refused", refused, "<=", 0, "a mean over fewer scenes is not the same mean"),
        Check.of("CPU time saved, typical scenes [%]", 100 * off["saves"], ">=", 50.0, "else it is not worth its code"),
        Check.of("MSE added, typical scenes [%]", 100 * off["mse_change"], "<=", 2.0, "nobody may see what is skipped"),
        Check.of(
            "CPU time added where everything is needed [%]", -100 * off["everything_saves"], "<=", 5.0,
            "deciding what to skip must cost next to nothing",
        ),
        Check.of("peak memory, 4 sources [MiB]", peak, "<=", 600.0, "several run side by side"),
    ]  # fmt: skip


def bar_groups(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """CPU seconds with all switches on and off, by scene, for the plot."""
    groups: dict[str, dict[str, float]] = {}
    for row in rows:
        if row["kind"] == "variant" and row["poses"] == "given" and row["variant"] in (ALL, NOTHING) and "cpu_s" in row:
            groups.setdefault(row["scene"], {})[row["variant"]] = row["cpu_s"]
    return groups


def tables(means: Sequence[dict[str, Any]], rows: Sequence[dict[str, Any]]) -> list[Table]:
    """Switches, scenes, work counts, memory."""

    def percent(row: Mapping[str, Any]) -> dict[str, Any]:
        fields = ("saves", "mse_change", "everything_saves", "everything_mse_change")
        return {**row, **{name: 100 * row[name] for name in fields if name in row}}

    switches = (
        Column("variant", "off"), Column("poses", "poses"), Column("cpu_s", "CPU s", ".3f"),
        Column("saves", "the switch saves %", ".1f"), Column("mse", "MSE px²", ".5f"),
        Column("mse_change", "and adds to MSE %", "+.2f"),
        Column("everything_saves", "saves % where everything is needed", ".1f"),
        Column("everything_mse_change", "adds % to MSE there", "+.2f"),
    )  # fmt: skip
    scenes = (
        Column("scene", "scene"), Column("poses", "poses"), Column("variant", "off"), Column("cpu_s", "CPU s", ".3f"),
        Column("cpu_s_min", "least", ".3f"), Column("wall_s", "wall s", ".3f"), Column("mse", "MSE px²", ".5f"),
        Column("ppe_005", "PPE .05 %", ".1f"), Column("ppe_010", "PPE .1 %", ".1f"), Column("refused", "refused"),
    )  # fmt: skip
    work = (
        Column("scene", "scene"), Column("poses", "poses"), Column("stage", "stage"), Column("name", "switch"),
        Column("done", "done", ".4g"), Column("skipped", "skipped", ".4g"), Column("unit", "unit"),
        Column("saved_ms", "saved CPU ms, estimated", ".1f"),
    )  # fmt: skip
    memory = (Column("sources", "sources"), Column("stage", "stage"), Column("peak_rss_mb", "peak MiB", ".0f"))
    return [
        Table("Switches, mean over the typical scenes", [percent(row) for row in means], switches),
        Table("Every scene", [row for row in rows if row["kind"] == "variant"], scenes),
        Table("Work with all switches on", [row for row in rows if row["kind"] == "count"], work),
        Table("Peak memory of the process by stage", [row for row in rows if row["kind"] == "memory"], memory),
    ]


def _text(names: Sequence[str], size: tuple[int, int], runs: int) -> str:
    elsewhere = "; ".join(f"`{name}` {why}" for name, why in ELSEWHERE.items())
    return (
        f"{', '.join(names)} ({size[0]}×{size[1]} px, two sources), and *{EVERYTHING}*: 70 textured bodies at all "
        f"depths, where there is little to skip. {runs} runs of each variant, in turn, after one to warm up; CPU s is "
        f"user + system time, medians, then "
        f"means over scenes. `{KEPT}` is the row of runs that find their evidence kept by an earlier run; its "
        f"error is compared with runs that compute it. Not here: {elsewhere}. Memory is that of a process of its own "
        f"on {names[0]}, each stage's peak by itself; *{BEFORE}* holds modules and captures."
    )
