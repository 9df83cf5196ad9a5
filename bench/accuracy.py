"""What each step of the pipeline gains: the stage table over the simulated scenes, and the shipped preset per
scene.

Every number is a mean over scenes that nothing was tuned on, with the worst scene named and shown, at the b·F
that is stated, beside both oracles. Poses are given, and again found from what the rig knows of its turntable
alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lfrig.bench import plots
from lfrig.bench.acceptance import STATED, acceptance
from lfrig.bench.accuracy_table import (
    SETUPS,
    SHIPPED,
    Setup,
    case_oracles,
    pose_errors,
    score_fields,
    stage_rows,
    tables,
)
from lfrig.bench.cases import FAR_DEG, FULL, NEAR_DEG, TARGET_DEG, Case, scene_names, shoot_case
from lfrig.bench.decode_cost import decode_cost_rows, decode_cost_tables
from lfrig.bench.document import write
from lfrig.bench.inputs import INPUTS, TITLES, Input, seen_sources, with_views_of
from lfrig.bench.measure import Cost, in_fresh_process
from lfrig.bench.stages import Stage, stage_table
from lfrig.contracts.bench import BenchDocument
from lfrig.contracts.errors import GeometryRefused, LfrigError
from lfrig.contracts.progress import Monitor, Muted
from lfrig.contracts.score import LightFieldScore
from lfrig.processing.metrics import inner_region, reliability, sparsification
from lfrig.processing.model import F32, Evidence
from lfrig.processing.options import ProcessOptions
from lfrig.processing.pipeline import ProcessResult, process
from lfrig.rig.candidate import Candidate, score_candidate

WORST_PICTURE = "accuracy-worst.png"
STAGES_PICTURE = "accuracy-stages.png"
NOTHING = Cost(0.0, 0.0)


@dataclass
class Worst:
    """The shipped preset's worst case so far, for the picture."""

    mse: float = -1.0
    title: str = ""
    case: Case | None = None
    disparity: F32 | None = None

    def see(self, run: Planned, case: Case, mse: float, disparity: F32) -> None:
        """Keep the case when it is worse than the worst so far."""
        if mse > self.mse:
            self.mse, self.case, self.disparity = mse, case, disparity
            self.title = f"worst case: {case.scene}, {run.setup.name}, {TITLES[run.kind]}, MSE {mse:.4f} px²"


@dataclass
class Run:
    """What a run of the benchmark collects."""

    stages: Sequence[Stage]
    threads: int
    monitor: Monitor
    measure_memory: bool
    scenes: list[dict[str, Any]] = field(default_factory=list)
    worst: Worst = field(default_factory=Worst)


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    half: Literal["reporting", "tuning"] = "reporting",
    scenes: Sequence[str] | None = None,
    size: tuple[int, int] = FULL,
    setups: Sequence[Setup] = SETUPS,
    stages: Sequence[str] | None = None,
    noise_sigma: float = 0.0,
    inputs: Sequence[Input] = INPUTS,
    measure_memory: bool = True,
    cache_dir: Path | None = None,
) -> BenchDocument:
    """Run the benchmark; writes accuracy.json, accuracy.md and two plots into ``out``.

    Parameters
    ----------
    half : {"reporting", "tuning"}
        Which half of the scenes; parameters are chosen on the tuning half only.
    scenes : sequence of str, optional
        These scenes instead of a whole half.
    size : (width, height)
        Of a light-field view; the bounds hold at full size.
    stages : sequence of str, optional
        Keys of `stages.stage_table` to run; the shipped one is always among them.
    noise_sigma : float
        Noise on the recorded pixels [grey levels].
    inputs : sequence of {"views", "noisy", "raw"}
        What the sources come as: ``views`` in all setups, the others with two sources and the turntable's prior.
        With ``raw`` the shipped preset also sees views of equal noise, which tells what the decode costs.
    measure_memory : bool
        Run the shipped preset once more per case, in a process of its own, for time and peak memory.
    """
    chosen = [s for s in stage_table() if stages is None or s.key in {*stages, SHIPPED}]
    state = Run(chosen, threads, monitor or Monitor(), measure_memory)
    names = scene_names(half, scenes)
    plan = _plan(inputs, setups, chosen)
    with state.monitor.task("bench accuracy", len(names) * sum(len(run.stages) for run in plan)):
        for scene in names:
            _run_scene(state, scene, size, plan, noise_sigma, cache_dir)
    rows = stage_rows(state.scenes, chosen, [(run.setup, run.kind) for run in plan])
    decode_cost = decode_cost_rows(state.scenes)
    _draw(out, state, rows)
    bounded = half == "reporting" and scenes is None and size == FULL and noise_sigma == 0
    return write(
        out, "accuracy", rows=[*rows, *decode_cost, *state.scenes],
        checks=acceptance(rows) if bounded else [],
        tables=[*tables(rows, state.scenes), *decode_cost_tables(decode_cost)],
        text=_conditions(names, half, size, noise_sigma, state.scenes),
        pictures=[STAGES_PICTURE, WORST_PICTURE],
    )  # fmt: skip


@dataclass(frozen=True)
class Planned:
    """One column of work on every scene."""

    setup: Setup
    kind: Input
    stages: Sequence[Stage]


def _plan(inputs: Sequence[Input], setups: Sequence[Setup], stages: Sequence[Stage]) -> list[Planned]:
    """Runs in the order of the table; those that share their pixels and poses stand together, the largest first."""
    plan = []
    for kind in inputs:
        if kind == "raw":
            plan.append(Planned(STATED, "equal", [stage for stage in stages if stage.key == SHIPPED]))
        for setup in setups if kind == "views" else [STATED]:
            plan.append(Planned(setup, kind, stages))
    return plan


@dataclass
class Shared:
    """The disparity evidence of a scene's sources, computed by the first run and reused by the others."""

    evidence: list[Evidence] = field(default_factory=list)
    cost: Cost = NOTHING

    def first(self, sources: int) -> tuple[list[Evidence] | None, Cost]:
        """That of the first sources and its cost; None and no cost when it has to be computed yet."""
        if len(self.evidence) < sources:
            return None, NOTHING
        share = sources / len(self.evidence)
        return self.evidence[:sources], Cost(share * self.cost.wall_s, share * self.cost.cpu_s)

    def keep(self, result: ProcessResult) -> None:
        """Remember what a run computed."""
        if len(result.sources) > len(self.evidence):
            self.evidence = [found.source.evidence for found in result.sources]
            self.cost = _stage_cost(result, only="evidence")


def _run_scene(
    state: Run, scene: str, size: tuple[int, int], plan: Sequence[Planned], noise_sigma: float, cache_dir: Path | None
) -> None:
    """All of the plan on one scene. Runs with the same poses and pixels share the evidence; the one with the most
    sources computes it.
    """
    oracles: dict[str, LightFieldScore] | None = None
    for poses in dict.fromkeys(run.setup.poses for run in plan):
        most = max(run.setup.sources for run in plan if run.setup.poses == poses)
        clean = shoot_case(
            scene, size, poses=poses, angles_deg=(*NEAR_DEG, *FAR_DEG)[:most], noise_sigma=noise_sigma,
            threads=state.threads, cache_dir=cache_dir, monitor=Muted(state.monitor),
        )  # fmt: skip
        oracles = oracles or case_oracles(clean, state.threads, Muted(state.monitor))
        for kind in dict.fromkeys(run.kind for run in plan if run.setup.poses == poses):
            runs = sorted((r for r in plan if (r.setup.poses, r.kind) == (poses, kind)), key=lambda r: -r.setup.sources)
            case = clean
            if kind != "views":
                seen = seen_sources(kind, scene, size, threads=state.threads, cache_dir=cache_dir)
                case = with_views_of(clean.with_sources(len(seen)), seen)
            shared = Shared()
            for run in runs:
                _run_stages(state, case, run, shared, oracles)


def _run_stages(state: Run, case: Case, run: Planned, shared: Shared, oracles: dict[str, LightFieldScore]) -> None:
    """The rows of one scene in one setup."""
    part = case.with_sources(run.setup.sources)
    for stage in run.stages:
        row: dict[str, Any] = {
            "kind": "scene", "scene": case.scene, "setup": run.setup.name, "input": run.kind, "stage": stage.key
        }  # fmt: skip
        evidence, extra = shared.first(run.setup.sources)
        try:
            result = process(
                part.sources, part.target, part.prior, _options(part, stage, state.threads),
                Muted(state.monitor), evidence=evidence,
            )  # fmt: skip
            shared.keep(result)
            row |= _scene_row(result, case, oracles, extra, state)
            if stage.key == SHIPPED:
                state.worst.see(run, case, row["mse"], result.light_field.disparity)
                if state.measure_memory and run.kind == "views":
                    row |= _measured(part, stage, state)
        except GeometryRefused as refusal:
            row |= {"refused": refusal.code, "message": refusal.message}
        state.scenes.append(row)
        state.monitor.advance()


def _options(case: Case, stage: Stage, threads: int) -> ProcessOptions:
    return case.options(settings=stage.settings, threads=threads)


def _scene_row(
    result: ProcessResult, case: Case, oracles: dict[str, LightFieldScore], extra: Cost, state: Run
) -> dict[str, Any]:
    """The numbers of one run; ``extra`` is the cost of the evidence that it was given."""
    candidate = Candidate.of(result.light_field, metric=result.metric)
    score, error_px = score_candidate(
        candidate, case.truth, oracles=oracles, threads=state.threads, monitor=Muted(state.monitor)
    )
    cost, confidence = _stage_cost(result), result.light_field.surface.confidence
    inner = inner_region(error_px.shape)
    curves = sparsification(error_px[inner], confidence[inner])
    return {
        **score_fields(score),
        "ause": curves.ause,
        "ause_of_random": curves.ause_of_random,
        "ece": reliability(error_px[inner], confidence[inner]).ece,
        "wall_s": cost.wall_s + extra.wall_s,
        "cpu_s": cost.cpu_s + extra.cpu_s,
        **pose_errors(result, case),
        "noise_grey": float(np.mean([found.source.evidence.noise_sigma for found in result.sources])),
        "warnings": [notice.code for notice in result.notices],
    }


def _stage_cost(result: ProcessResult, only: str | None = None) -> Cost:
    stages = [stage for stage in result.stages if only in (None, stage.name)]
    return Cost(sum(s.wall_s for s in stages), sum(s.cpu_s for s in stages))


def process_alone(case: Case, options: ProcessOptions) -> Cost:
    """What a process of its own runs: the whole pipeline once; its cost by its own clock."""
    return _stage_cost(process(case.sources, case.target, case.prior, options, Monitor()))


def _measured(case: Case, stage: Stage, state: Run) -> dict[str, Any]:
    """Time and peak memory of the shipped preset, in a process of its own."""
    options = _options(case, stage, state.threads)
    try:
        cost, whole = in_fresh_process(process_alone, case.without_views(), options, monitor=state.monitor)
    except GeometryRefused:
        raise
    except LfrigError as error:
        return {"peak_rss_note": error.message}
    return {"wall_s": cost.wall_s, "cpu_s": cost.cpu_s, "peak_rss_mb": whole.peak_rss_mb, "runs": 1}


def _draw(out: Path, state: Run, rows: Sequence[dict[str, Any]]) -> None:
    groups: dict[str, dict[str, float]] = {}
    for row in rows:
        if "mse" in row:
            name = row["setup"] if row["input"] == "views" else f"{row['setup']}, {TITLES[row['input']]}"
            groups.setdefault(row["stage"], {})[name] = row["mse"]
    plots.bars(out / STAGES_PICTURE, groups, title="mean disparity MSE by stage", unit="px²")
    worst = state.worst
    if worst.case is not None and worst.disparity is not None:
        request = worst.case.request
        plots.error_picture(
            out / WORST_PICTURE, worst.case.target.image8,
            worst.case.truth.disparity(request.baseline_m, request.focus_distance_m), worst.disparity,
            title=worst.title,
        )  # fmt: skip


def _conditions(
    names: Sequence[str], half: str, size: tuple[int, int], noise_sigma: float, scenes: Sequence[dict[str, Any]]
) -> str:
    bf = next((row["bf_px_m"] for row in scenes if "bf_px_m" in row), float("nan"))
    return (
        f"{len(names)} scenes of the {half} half ({', '.join(names)}), light-field views of {size[0]}×{size[1]} px, "
        f"errors in px per view step at bF = {bf:.3f} px·m, noise σ {noise_sigma:g}. Two sources stand "
        f"{NEAR_DEG[0] - TARGET_DEG:+g}° and {NEAR_DEG[1] - TARGET_DEG:+g}° from the target, four also "
        f"{FAR_DEG[0] - TARGET_DEG:+g}° and {FAR_DEG[1] - TARGET_DEG:+g}°; "
        "every capture has its own zoom, focus, exposure and white balance. 15 px at the border are not scored. CPU "
        "s is user + system time of the whole process; every row counts the disparity evidence, which is computed "
        "once per scene; rows with a peak memory were run whole in a process of their own."
    )
