"""Error against CPU time: our preset at three resolutions of its geometry, and the peers on the same inputs.

Poses are given, so that geometry alone is compared. A peer that needs scale fits is charged for them as we are; every
method is charged for rendering the views, which is the same work for all.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lfrig.bench import cotton, peers, plots
from lfrig.bench.accuracy_table import COSTS, SCORES, case_oracles, mean_fields, score_fields
from lfrig.bench.cases import FULL, Case, scene_names, shoot_case
from lfrig.bench.document import Column, Table, write
from lfrig.bench.measure import Cost, in_fresh_process, stopwatch, summary
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.fusion import inverse_depth_range
from lfrig.processing.model import F32, U8, Source
from lfrig.processing.pipeline import ProcessResult, process
from lfrig.processing.synthesis import render_views
from lfrig.rig.candidate import Candidate, score_candidate

RESOLUTIONS = (1.0, 0.5, 0.25)
PICTURE = "pareto.png"
SHARED_STAGES = ("poses", "scale-fit")
"""Stages of ours that a peer working from light fields needs as well."""


@dataclass(frozen=True)
class Output:
    """What a method made of a case: float32 [H, W] px per view step, uint8 [rows, cols, H, W, 3], and its cost."""

    disparity: F32
    views: U8
    cost: Cost


Method = Callable[[Case, ProcessResult, int], Output]


def ours(case: Case, resolution: float, threads: int) -> Output:
    """The shipped preset with its geometry at a fraction of the size."""
    result = process(
        case.sources, case.target, case.prior, case.options(resolution=resolution, threads=threads), Monitor()
    )
    cost = Cost(sum(s.wall_s for s in result.stages), sum(s.cpu_s for s in result.stages))
    return Output(result.light_field.disparity, np.asarray(result.light_field.views, np.uint8), cost)


def sgbm(case: Case, known: ProcessResult, threads: int) -> Output:
    """StereoSGBM on every source's views, carried into the target."""
    return _peer(
        case, known, threads, SHARED_STAGES,
        lambda sources: peers.sgbm_in_target(sources, known.target_camera, known.target_pose, case.request),
    )  # fmt: skip


def copied(case: Case, known: ProcessResult, threads: int) -> Output:
    """The nearest source's disparity, copied to the target and to every view."""
    return _peer(
        case, known, threads, (*SHARED_STAGES, "evidence"),
        lambda sources: peers.copied_disparity(sources, known.target_camera, known.target_pose, case.request),
        copy_field=True,
    )  # fmt: skip


def sweep(case: Case, known: ProcessResult, threads: int) -> Output:
    """A plane sweep over the sources' central views; it needs no light field and no scale fit."""
    limits = case.prior.depth_range_m
    assert limits is not None

    def estimate(sources: Sequence[Source]) -> F32:
        # The range of what there is: the peer at its best, though nothing but our volumes told it.
        found = inverse_depth_range(sources, known.target_camera, known.target_pose, limits)
        return peers.plane_sweep(
            sources, case.target, known.target_camera, known.target_pose, found, case.request, threads=threads
        )

    return _peer(case, known, threads, ("poses",), estimate)


def copied_field(case: Case, known: ProcessResult, threads: int) -> Output:
    """Our disparity with the centre's copied to every view: what a disparity field is worth."""
    with stopwatch() as watch:
        disparity = known.light_field.disparity
        rows, cols = case.request.rows, case.request.cols
        views = peers.copied_field(case.target.image8, disparity, rows, cols, threads=threads)
    geometry = tuple(stage.name for stage in known.stages if stage.name != "synthesis")
    return Output(disparity, views, _plus(watch.cost, known, geometry))


PEERS: dict[str, Method] = {
    "StereoSGBM on the sources' views": sgbm,
    "plane sweep on central views": sweep,
    "nearest source's disparity, copied": copied,
    "preset fast, centre disparity copied to the views": copied_field,
}


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    half: Literal["reporting", "tuning"] = "reporting",
    scenes: Sequence[str] | None = None,
    size: tuple[int, int] = FULL,
    runs: int = 1,
    hci: Path | None = None,
    cache_dir: Path | None = None,
) -> BenchDocument:
    """Run the benchmark; writes pareto.json, pareto.md and a plot into ``out``.

    Parameters
    ----------
    half, scenes, size
        As for `accuracy.run`.
    runs : int
        Times each case is run; costs are medians. Each run of our preset has a process of its own.
    hci : Path, optional
        A scene of the HCI benchmark with its truth, for `lfrig depth` against StereoSGBM; by default *cotton* beside
        the checkout, where it is there.
    """
    monitor = monitor or Monitor()
    names = scene_names(half, scenes)
    rows: list[dict[str, Any]] = []
    with monitor.task("bench pareto", len(names) * (len(RESOLUTIONS) + len(PEERS))):
        for scene in names:
            case = shoot_case(
                scene, size, poses="given", threads=threads, cache_dir=cache_dir, monitor=Muted(monitor)
            ).with_sources(2)
            rows += _run_case(case, runs, threads, monitor)
    means = mean_rows(rows)
    folder = cotton.find(hci)
    alone: list[dict[str, Any]] = []
    alone_tables: list[Table] = []
    alone_checks: list[Check] = []
    if folder is not None:
        alone, table, alone_checks = cotton.run(folder, threads=threads, monitor=monitor)
        alone_tables = [table]
    by_method = {row["method"]: row for row in means if "mse" in row}
    points = {row["method"]: (row["cpu_s"], row["mse"]) for row in means if "mse" in row}
    series = {"preset fast": [points[name] for name in map(_our_name, RESOLUTIONS) if name in points]}
    series |= {name: [points[name]] for name in PEERS if name in points}
    plots.front(out / PICTURE, series, title="error against time", x="CPU s (user + system)", y="MSE px²")
    bf = next((row["bf_px_m"] for row in rows if "bf_px_m" in row), float("nan"))
    columns = (Column("method", "method"), *SCORES, Column("cpu_ratio", "CPU / ours", ".2f"), *COSTS,
               Column("refused", "refused"))  # fmt: skip
    checks = _checks(by_method) if size == FULL and scenes is None else []
    return write(
        out, "pareto", rows=[*means, *rows, *alone], checks=[*checks, *alone_checks],
        tables=[Table("Means", means, columns), *alone_tables],
        text=(
            f"{len(names)} scenes of the {half} half ({', '.join(names)}), views of {size[0]}×{size[1]} px, two "
            f"sources, poses given, bF = {bf:.3f} px·m. CPU s is user + system time; {runs} run(s) per case; "
            "peak memory only for what runs in a process of its own."
        ),
        pictures=[PICTURE],
    )  # fmt: skip


def _run_case(case: Case, runs: int, threads: int, monitor: Monitor) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    request = case.request
    oracles = case_oracles(case, threads, Muted(monitor))

    def row(method: str, outputs: Sequence[tuple[Output, float | None]]) -> dict[str, Any]:
        last = outputs[-1][0]
        score, _ = score_candidate(
            Candidate(last.disparity, last.views, request), case.truth, oracles=oracles, threads=threads
        )
        costs = [Cost(output.cost.wall_s, output.cost.cpu_s, peak) for output, peak in outputs]
        return {"scene": case.scene, "method": method, **score_fields(score), **summary(costs)}

    for resolution in RESOLUTIONS:
        try:
            found = [
                in_fresh_process(ours, case.without_views(), resolution, threads, monitor=monitor) for _ in range(runs)
            ]
            rows.append(row(_our_name(resolution), [(output, cost.peak_rss_mb) for output, cost in found]))
        except GeometryRefused as refusal:
            rows.append({"scene": case.scene, "method": _our_name(resolution), "refused": refusal.code})
        monitor.advance()
    known = process(case.sources, case.target, case.prior, case.options(threads=threads), Muted(monitor))
    for name, method in PEERS.items():
        rows.append(row(name, [(method(case, known, threads), None) for _ in range(runs)]))
        monitor.advance()
    return rows


def mean_rows(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over the scenes per method, with the CPU time relative to our preset at full resolution."""
    means: list[dict[str, Any]] = []
    for method in dict.fromkeys(row["method"] for row in rows):
        mine = [row for row in rows if row["method"] == method]
        scored = [row for row in mine if "refused" not in row]
        refused = [row["scene"] for row in mine if "refused" in row]
        means.append({"method": method, "kind": "mean", "refused": refused})
        if scored:
            means[-1] |= mean_fields(scored)
    reference = next((row["cpu_s"] for row in means if row["method"] == _our_name(1.0) and "cpu_s" in row), None)
    for row in means:
        if reference and "cpu_s" in row:
            row["cpu_ratio"] = row["cpu_s"] / reference
    return means


def _peer(
    case: Case,
    known: ProcessResult,
    threads: int,
    charged: Sequence[str],
    estimate: Callable[[list[Source]], F32],
    *,
    copy_field: bool = False,
) -> Output:
    """Run a peer on the inputs of ours and charge it with the stages of ours that it used."""
    sources = [found.source for found in known.sources]
    rows, cols = case.request.rows, case.request.cols
    with stopwatch() as watch:
        disparity = estimate(sources)
        if copy_field:
            views = peers.copied_field(case.target.image8, disparity, rows, cols, threads=threads)
        else:
            views = np.asarray(render_views(case.target.image8, disparity, rows, cols, threads=threads), np.uint8)
    return Output(disparity, views, _plus(watch.cost, known, charged))


def _plus(cost: Cost | None, known: ProcessResult, charged: Sequence[str]) -> Cost:
    assert cost is not None
    stages = [stage for stage in known.stages if stage.name in charged]
    return Cost(cost.wall_s + sum(stage.wall_s for stage in stages), cost.cpu_s + sum(stage.cpu_s for stage in stages))


def _our_name(resolution: float) -> str:
    return "preset fast" if resolution == 1 else f"preset fast, geometry at 1/{round(1 / resolution)}"


def _checks(means: Mapping[str, dict[str, Any]]) -> list[Check]:
    """Ours against every peer: by the views for what shares our geometry, by the disparity for the others."""
    ours_mean = means.get(_our_name(1.0))
    if ours_mean is None:
        return []
    checks = []
    for name, method in PEERS.items():
        if name not in means:
            continue
        if method is copied_field:
            gain = ours_mean["psnr"] - means[name]["psnr"]
            checks.append(Check.of(f"PSNR over {name} [dB]", gain, ">=", 0.0, "what a disparity field is worth"))
        else:
            ratio = ours_mean["mse"] / means[name]["mse"]
            why = "a peer that is better on the same inputs would be the better pipeline"
            checks.append(Check.of(f"MSE / MSE of {name}", ratio, "<=", 1.0, why))
    return checks
