"""A gate for every change: accuracy and CPU cost of a small benchmark against stored bounds, in about a minute.

    lfrig bench regression --check                      exit 1 when a bound is broken
    python -m lfrig.bench.regression --propose          bounds around today's figures, to be read and stored by hand

The figures are means over three small scenes of the tuning half, so they say whether something became worse, not how
good it is; that is `lfrig bench accuracy`. CPU time is stated as a ratio to a workload of fixed size that is timed
beside it, because machines differ and are shared; wall time is not bounded at all.
"""

from __future__ import annotations

import argparse
import contextlib
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from lfrig.bench.accuracy_table import case_oracles, pose_errors, score_fields
from lfrig.bench.cases import MEDIUM, NEAR_DEG, Case, shoot_case
from lfrig.bench.document import Column, Table, write
from lfrig.bench.measure import stopwatch
from lfrig.bench.reference import reference_cpu_s
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.errors import BadInput, GeometryRefused
from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor, Muted
from lfrig.contracts.score import LightFieldScore
from lfrig.processing.metrics import inner_region, sparsification
from lfrig.processing.pipeline import process
from lfrig.rig.candidate import Candidate, score_candidate
from lfrig.sim.rig import Poses

SCENES = ("tabletop", "reeds", "chequered")
"""Everyday objects, thin structures, repeated texture: of the tuning half, as every setting is chosen there."""
POSES: tuple[Poses, ...] = ("given", "prior")
BOUNDS_FILE = Path(__file__).with_name("regression_bounds.toml")

Direction = Literal["<=", ">="]


@dataclass(frozen=True)
class Kind:
    """A kind of figure: which way is worse, how far `propose` sets the bound off, and why there is one.

    The proposed bound is ``measured · factor + offset``.
    """

    direction: Direction
    factor: float
    offset: float
    why: str


KINDS = {
    "mse": Kind("<=", 1.25, 0.0, "three scenes of thin rods and edges: a quarter is what a harmless change moves"),
    "ppe_005": Kind(">=", 1.0, -1.5, "a real loss of precision moves more than one pixel in seventy"),
    "ppe_010": Kind(">=", 1.0, -1.0, "pixels that leave it have changed sides of an edge"),
    "below_z_buffer_db": Kind("<=", 1.0, 0.2, "a fifth of a dB is what one more misplaced edge costs"),
    "below_shipped_db": Kind(
        "<=", 1.0, 0.2, "what geometry costs, whatever the synthesis: the same with exact geometry"
    ),
    "ause_of_random": Kind("<=", 1.0, 0.06, "a confidence that stops ranking errors misleads whoever filters by it"),
    "pose_error_deg": Kind("<=", 1.5, 0.01, "poses found from small pictures scatter by half from change to change"),
    "pose_error_mm": Kind("<=", 1.5, 0.1, "poses found from small pictures scatter by half from change to change"),
    "refused": Kind("<=", 1.0, 0.0, "a mean over fewer scenes is not the same mean"),
    "cpu": Kind(
        "<=",
        2.0,
        0.5,
        "CPU time over that of the reference: machines and their load differ by up to twice, short stages by more",
    ),
}
SCORED = ("mse", "ppe_005", "ppe_010", "below_z_buffer_db", "below_shipped_db", "ause_of_random")
FOUND_POSES = ("pose_error_deg", "pose_error_mm")


@dataclass(frozen=True)
class Bound:
    """A stored bound: ``figure`` must be ``direction`` ``bound``; ``measured`` is what it was set from."""

    figure: str
    direction: Direction
    bound: float
    measured: float
    why: str


def load_bounds(path: Path = BOUNDS_FILE) -> list[Bound]:
    """The stored bounds.

    Raises
    ------
    BadInput
        The file is no TOML, or a bound lacks a field.
    """
    try:
        entries = tomllib.loads(path.read_text(encoding="utf-8")).get("bound", [])
        return [Bound(**entry) for entry in entries]
    except (tomllib.TOMLDecodeError, TypeError) as error:
        raise BadInput(
            f"is no file of bounds: {error}",
            path=path,
            remedy="make it with python -m lfrig.bench.regression --propose",
        ) from None


def kind_of(figure: str) -> Kind:
    """The kind of a figure by its name, ``<poses>.<field>`` or ``cpu.<stage>``."""
    group, _, name = figure.partition(".")
    return KINDS["cpu" if group == "cpu" else name]


def propose(figures: dict[str, float]) -> str:
    """Bounds around ``figures`` as the text of the file."""
    lines = ["# What `lfrig bench regression --check` holds figures against; see bench/regression.py."]
    for figure, value in figures.items():
        kind = kind_of(figure)
        lines += [
            "",
            "[[bound]]",
            f'figure = "{figure}"',
            f'direction = "{kind.direction}"',
            f"bound = {float(f'{kind.factor * value + kind.offset:.3g}')!r}",
            f"measured = {float(f'{value:.4g}')!r}",
            f'why = "{kind.why}"',
        ]
    return "\n".join(lines) + "\n"


def checks_of(figures: dict[str, float], bounds: Sequence[Bound], *, cpu: bool = True) -> list[Check]:
    """Figures against bounds. A figure without a bound and a bound without a figure fail.

    Parameters
    ----------
    cpu : bool
        False leaves CPU ratios out: they are stated for the native core.
    """
    checks, known = [], {bound.figure for bound in bounds}
    for bound in bounds:
        if bound.figure.startswith("cpu.") and not cpu:
            continue
        if bound.figure in figures:
            value = figures[bound.figure]
            checks.append(Check.of(bound.figure, value, bound.direction, bound.bound, bound.why))
        else:
            checks.append(Check.of(f"{bound.figure}: measured", 0, ">=", 1, "a bound on nothing holds nothing"))
    missing = "a figure without a bound can become worse unseen"
    return checks + [Check.of(f"{name}: bounded", 0, ">=", 1, missing) for name in figures if name not in known]


@dataclass
class _Tally:
    """What the runs found: rows to show, and each CPU ratio's smallest value per scene."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    ratios: dict[str, dict[str, float]] = field(default_factory=dict)

    def ratio(self, stage: str, scene: str, value: float) -> None:
        """Remember a stage's ratio; the least disturbed run counts."""
        of_stage = self.ratios.setdefault(stage, {})
        of_stage[scene] = min(value, of_stage.get(scene, np.inf))


def measure(
    scenes: Sequence[str] = SCENES,
    size: tuple[int, int] = MEDIUM,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    cache_dir: Path | None = None,
) -> tuple[dict[str, float], list[dict[str, Any]]]:
    """Run the benchmark: the figures by name, and a row per scene and way to poses.

    Parameters
    ----------
    threads : int
        For rendering; the pipeline runs on one, so that its CPU time is comparable.
    """
    monitor, tally = monitor or Monitor(), _Tally()
    with monitor.task("bench regression", len(scenes) * len(POSES)):
        for scene in scenes:
            oracles: dict[str, LightFieldScore] | None = None
            for poses in POSES:
                case = shoot_case(
                    scene, size, poses=poses, angles_deg=NEAR_DEG, threads=threads, cache_dir=cache_dir,
                    monitor=Muted(monitor),
                )  # fmt: skip
                oracles = oracles or case_oracles(case, 1, Muted(monitor))
                tally.rows.append(_run(case, poses, oracles, tally, monitor))
                monitor.advance()
    return _figures(tally), tally.rows


def _run(
    case: Case, poses: Poses, oracles: dict[str, LightFieldScore], tally: _Tally, monitor: Monitor
) -> dict[str, Any]:
    """One scene through the shipped preset, between two runs of the reference."""
    row: dict[str, Any] = {"scene": case.scene, "poses": poses}
    before_s = reference_cpu_s()
    try:
        with stopwatch() as watch:
            result = process(case.sources, case.target, case.prior, case.options(threads=1), Muted(monitor))
    except GeometryRefused as refusal:
        return row | {"refused": refusal.code}
    reference_s = (before_s + reference_cpu_s()) / 2
    for stage in result.stages:
        tally.ratio(stage.name, case.scene, stage.cpu_s / reference_s)
    assert watch.cost is not None
    tally.ratio("total", case.scene, watch.cost.cpu_s / reference_s)
    score, error_px = score_candidate(
        Candidate.of(result.light_field, metric=result.metric), case.truth, oracles=oracles, threads=1
    )
    inner = inner_region(error_px.shape)
    curves = sparsification(error_px[inner], result.light_field.surface.confidence[inner])
    found = score_fields(score) | {"ause_of_random": curves.ause_of_random}
    row |= {name: found[name] for name in SCORED} | {"cpu_ratio": watch.cost.cpu_s / reference_s}
    return row | (pose_errors(result, case) if poses == "prior" else {})


def _figures(tally: _Tally) -> dict[str, float]:
    figures: dict[str, float] = {}
    for poses in POSES:
        mine = [row for row in tally.rows if row["poses"] == poses]
        scored = [row for row in mine if "refused" not in row]
        figures[f"{poses}.refused"] = float(len(mine) - len(scored))
        for name in (*SCORED, *(FOUND_POSES if poses == "prior" else ())):
            if scored:
                figures[f"{poses}.{name}"] = float(np.mean([row[name] for row in scored]))
    means = {stage: float(np.mean(list(by_scene.values()))) for stage, by_scene in tally.ratios.items()}
    return figures | {f"cpu.{stage}": value for stage, value in means.items()}


COLUMNS = (
    Column("scene", "scene"), Column("poses", "poses"), Column("mse", "MSE px²", ".5f"),
    Column("ppe_005", "PPE .05 %", ".1f"), Column("ppe_010", "PPE .1 %", ".1f"),
    Column("below_z_buffer_db", "below oracle dB", ".2f"), Column("below_shipped_db", "geometry dB", ".2f"),
    Column("ause_of_random", "AUSE / random", ".3f"),
    Column("pose_error_deg", "pose °", ".3f"), Column("pose_error_mm", "pose mm", ".2f"),
    Column("cpu_ratio", "CPU / reference", ".1f"), Column("refused", "refused"),
)  # fmt: skip


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    scenes: Sequence[str] = SCENES,
    size: tuple[int, int] = MEDIUM,
    bounds: Path = BOUNDS_FILE,
    cache_dir: Path | None = None,
) -> BenchDocument:
    """Run the benchmark against its bounds; writes regression.json and regression.md into ``out``."""
    stored = load_bounds(bounds)
    figures, rows = measure(scenes, size, monitor=monitor, threads=threads, cache_dir=cache_dir)
    native = load_native("lfrig.processing.kernels._native") is not None
    text = (
        f"Preset fast on {', '.join(scenes)} at {size[0]}×{size[1]} px, two sources. CPU time is that of one thread "
        "over that of the reference."
    )
    if not native:
        text += " CPU ratios are not checked: they are stated for the native core, which is not in use."
    return write(
        out, "regression", rows=[{"kind": "figures", **figures}, *rows], checks=checks_of(figures, stored, cpu=native),
        tables=[Table("Scenes", rows, COLUMNS)], text=text,
    )  # fmt: skip


def main() -> None:
    """``python -m lfrig.bench.regression``: run against the bounds, or propose new ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--propose", action="store_true", help="print bounds around today's figures")
    parser.add_argument("--out", type=Path, help="folder of regression.json and regression.md; none by default")
    given = parser.parse_args()
    if given.propose:
        print(propose(measure()[0]), end="")
        return
    with contextlib.ExitStack() as stack:
        out = given.out or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="lfrig-")))
        document = run(out)
        print((out / "regression.md").read_text(encoding="utf-8"))
    sys.exit(0 if all(check.ok for check in document.checks) else 1)


if __name__ == "__main__":
    main()
