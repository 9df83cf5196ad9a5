"""The pose stage against the truth: accuracy from drawn priors, the target photo, captures without a rig, and faults.

Renders and disparity evidence are shared; what a seed draws is the prior: every recorded angle, mount, focal length
and baseline is off by a normal number times the sigma that is stated with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from lfrig.bench.cases import FULL
from lfrig.bench.document import write
from lfrig.bench.measure import stopwatch
from lfrig.bench.poses_errors import Alignment, fitted_sources, pose_figures, slope_error_pct
from lfrig.bench.poses_faults import FAULTS, PHOTO_DEG, Fault, Subject, good_case
from lfrig.bench.poses_gate import accepted, refused
from lfrig.bench.poses_priors import PoseCase, draw_case, without_rig
from lfrig.bench.poses_scene import SceneShots
from lfrig.bench.poses_table import (
    PHOTO_SETUPS,
    SETUPS,
    PhotoSetup,
    Setup,
    acceptance,
    conditions,
    summaries,
    tables,
)
from lfrig.contracts.bench import BenchDocument
from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.agreement import check_agreement
from lfrig.processing.poses import PoseMethod, solve_poses
from lfrig.processing.sharpness import warn_of_defocus
from lfrig.processing.still import warn_of_still_background

SCENES = ("desk", "masonry", "fence", "figurines")
"""Of the reporting half, every other kind of texture: five more renders each than the other benchmarks need."""

SEEDS = 20
FREE_SEEDS = 8
PARTS = ("sources", "photo", "free", "faults")


@dataclass
class Run:
    """What a run of the benchmark collects."""

    method: PoseMethod
    threads: int
    monitor: Monitor
    rows: list[dict[str, Any]] = field(default_factory=list)


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    scenes: Sequence[str] | None = None,
    size: tuple[int, int] = FULL,
    seeds: int = SEEDS,
    method: PoseMethod = "auto",
    parts: Sequence[str] = PARTS,
    setups: Sequence[Setup] = SETUPS,
    faults: Sequence[str] | None = None,
    cache_dir: Path | None = None,
) -> BenchDocument:
    """Run the benchmark; writes poses.json and poses.md into ``out``.

    Parameters
    ----------
    scenes : sequence of str, optional
        Scenes of the library instead of `SCENES`; a scene's first run renders nine light fields.
    size : (width, height)
        Of a light-field view; the bounds hold at full size.
    seeds : int
        Draws of the prior per setup, dealt out over the scenes.
    parts : sequence of {"sources", "photo", "free", "faults"}
        What to run: accuracy of the sources, of the photo, of captures without a rig, and the gate's list.
    faults : sequence of str, optional
        Keys of `poses_faults.FAULTS` to run instead of all.
    """
    state = Run(method, threads, monitor or Monitor())
    names = list(scenes or SCENES)
    chosen = [fault for fault in FAULTS if faults is None or fault.key in faults]
    with state.monitor.task("bench poses", len(names)):
        for index, scene in enumerate(names):
            shots = SceneShots(scene, size, threads, cache_dir, Muted(state.monitor))
            if "sources" in parts:
                _run_sources(state, shots, setups, range(index, seeds, len(names)))
            if "photo" in parts:
                _run_photos(state, shots, index)
            if "free" in parts:
                _run_free(state, shots, setups, range(index, min(seeds, FREE_SEEDS), len(names)))
            if "faults" in parts:
                stranger = next(name for name in (*names[index + 1 :], *SCENES) if name != scene)
                other = SceneShots(stranger, size, threads, cache_dir, Muted(state.monitor))
                _run_faults(state, shots, other, index, chosen)
            state.monitor.advance()
    means = summaries(state.rows)
    bounded = scenes is None and size == FULL and seeds == SEEDS and set(parts) == set(PARTS) and faults is None
    return write(
        out, "poses", rows=[*means, *state.rows], checks=acceptance(means, state.rows) if bounded else [],
        tables=tables(means, state.rows), text=conditions(names, size, seeds),
    )  # fmt: skip


def _run_sources(state: Run, shots: SceneShots, setups: Sequence[Setup], seeds: Sequence[int]) -> None:
    for setup in setups:
        own = [shots.light_field(angle) for angle in setup.angles_deg]
        for seed in seeds:
            row = {"kind": "sources", "setup": setup.name, "scene": shots.scene, "seed": seed}
            state.rows.append(row | _solved(state, draw_case(own, shots.photo(PHOTO_DEG), seed)))


def _run_photos(state: Run, shots: SceneShots, seed: int) -> None:
    own = [shots.light_field(angle) for angle in SETUPS[0].angles_deg]
    for setup in PHOTO_SETUPS:
        row = {"kind": "photo", "setup": setup.name, "scene": shots.scene, "seed": seed}
        case = draw_case(own, shots.photo(setup.plate_deg), seed, photo_focal=_focal(setup))
        state.rows.append(row | _solved(state, case))


def _focal(setup: PhotoSetup) -> tuple[float, float]:
    return setup.focal_error, abs(setup.focal_error)


def _run_free(state: Run, shots: SceneShots, setups: Sequence[Setup], seeds: Sequence[int]) -> None:
    for setup in setups:
        own = [shots.light_field(angle) for angle in setup.angles_deg]
        for seed in seeds:
            row = {"kind": "free", "setup": setup.name, "scene": shots.scene, "seed": seed}
            state.rows.append(row | _solved(state, without_rig(draw_case(own, shots.photo(PHOTO_DEG), seed))))


def _run_faults(state: Run, shots: SceneShots, other: SceneShots, seed: int, faults: Sequence[Fault]) -> None:
    subject = Subject(good_case(shots, seed), shots, seed, lambda: other.photo(PHOTO_DEG))
    for fault in faults:
        row: dict[str, Any] = {"kind": "fault", "fault": fault.key, "title": fault.title, "scene": shots.scene}
        monitor = Muted(state.monitor)
        broken = fault.put(subject)
        try:
            figures = _figures(state, broken, monitor)
            row |= figures | accepted(fault, figures, monitor.notices, shots.size[0])
        except GeometryRefused as refusal:
            row |= refused(fault, refusal)
        state.rows.append(row)
        state.monitor.advance(0)


def _solved(state: Run, case: PoseCase) -> dict[str, Any]:
    """The figures of one run and its warnings, or how it was refused."""
    monitor = Muted(state.monitor)
    try:
        figures = _figures(state, case, monitor)
    except GeometryRefused as refusal:
        return {"refused": refusal.code, "message": refusal.message}
    state.monitor.advance(0)
    return figures | {"warnings": [notice.code for notice in monitor.notices]}


def _figures(state: Run, case: PoseCase, monitor: Monitor) -> dict[str, Any]:
    """Pose stage, scale fit and the pipeline's checks around them; the time is that of the pose stage alone."""
    warn_of_defocus(case.sources, monitor)
    warn_of_still_background(case.sources, monitor)
    with stopwatch() as watch:
        solution = solve_poses(
            case.sources, case.evidence, case.target, case.prior, state.method, threads=state.threads, monitor=monitor
        )
    assert watch.cost is not None
    ready = fitted_sources(solution, case, monitor)
    agreement = check_agreement(ready, case.target, solution.target_camera, solution.target_pose, monitor)
    alignment = Alignment.between(solution.poses, [shot.pose for shot in case.shots])
    return pose_figures(solution, case) | {
        "slope_pct": slope_error_pct(ready, case.shots, alignment),
        "agreement": min(agreement.of_source(k)[1] for k in range(len(ready))),
        "photo_agreement": agreement.of_photo()[1],
        "cpu_s": watch.cost.cpu_s,
        "wall_s": watch.cost.wall_s,
    }
