"""How a setting of the pipeline trades errors on the tuning scenes: ``python -m lfrig.bench.sweep``.

    python -m lfrig.bench.sweep dpv.inverse_temperature=3,4,5,8 fusion.surface_tau=2,3 --size full

runs every combination of the given values and prints the mean errors as a Markdown table, and every scene on the way.
The reporting half is not looked at: parameters are chosen here, their effect is reported by `lfrig bench accuracy`.
"""

from __future__ import annotations

import argparse
import ast
import itertools
import sys
from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

from lfrig.bench.accuracy_table import case_oracles, mean_fields, score_fields
from lfrig.bench.cases import FULL, MEDIUM, SMALL, Case, scene_names, shoot_case
from lfrig.bench.document import Column, markdown_table
from lfrig.contracts.errors import LfrigError, UsageError
from lfrig.contracts.progress import Monitor
from lfrig.contracts.score import LightFieldScore
from lfrig.processing.dpv import DpvSettings
from lfrig.processing.model import Evidence
from lfrig.processing.options import Settings
from lfrig.processing.pipeline import process
from lfrig.rig.candidate import Candidate, score_candidate

SIZES = {"full": FULL, "medium": MEDIUM, "small": SMALL}
COLUMNS = (
    Column("settings", "settings"), Column("sources", "sources"), Column("mse", "MSE px²", ".5f"),
    Column("ppe_005", "PPE .05", ".1f"), Column("ppe_010", "PPE .1", ".1f"),
    Column("below_z_buffer_db", "dB below oracle", ".2f"),
)  # fmt: skip


def variants(choices: Sequence[str]) -> dict[str, Settings]:
    """All combinations of ``stage.knob=value,value`` choices, by a readable name.

    Raises
    ------
    UsageError
        There is no such knob, or a value is not a literal.
    """
    axes = [_axis(choice) for choice in choices]
    made = {}
    for combination in itertools.product(*axes):
        settings = Settings()
        for stage, knob, value in combination:
            settings = replace(settings, **{stage: replace(getattr(settings, stage), **{knob: value})})
        made[" ".join(f"{stage}.{knob}={value}" for stage, knob, value in combination) or "as shipped"] = settings
    return made


def _axis(choice: str) -> list[tuple[str, str, Any]]:
    path, _, values = choice.partition("=")
    stage, _, knob = path.partition(".")
    part = getattr(Settings(), stage, None)
    if not is_dataclass(part) or knob not in {known.name for known in fields(part)}:
        raise UsageError(f"there is no setting {path!r}", remedy="write STAGE.KNOB=VALUE,VALUE as in pipeline.Settings")
    return [(stage, knob, _literal(value)) for value in values.split(",")]


def _literal(text: str) -> Any:
    try:
        return ast.literal_eval(text)
    except (ValueError, SyntaxError):
        return text


def run_scene(
    case: Case, counts: Sequence[int], chosen: dict[str, Settings], *, threads: int = 0
) -> list[dict[str, Any]]:
    """One row per number of sources and variant; evidence is computed once per set of its own settings."""
    oracles = case_oracles(case, threads, Monitor())
    evidence: dict[DpvSettings, list[Evidence]] = {}
    rows = []
    for count in sorted(counts, reverse=True):
        part = case.with_sources(count)
        for name, settings in chosen.items():
            row = _run(part, settings, oracles, evidence, threads)
            rows.append({"scene": case.scene, "sources": count, "settings": name, **row})
            print(_line(rows[-1]), file=sys.stderr, flush=True)
    return rows


def _run(
    case: Case,
    settings: Settings,
    oracles: dict[str, LightFieldScore],
    evidence: dict[DpvSettings, list[Evidence]],
    threads: int,
) -> dict[str, Any]:
    known = evidence.get(settings.dpv)
    result = process(
        case.sources, case.target, case.prior, case.options(settings=settings, threads=threads), Monitor(),
        evidence=known[: len(case.sources)] if known else None,
    )  # fmt: skip
    if known is None:
        evidence[settings.dpv] = [found.source.evidence for found in result.sources]
    candidate = Candidate.of(result.light_field, metric=result.metric)
    score, _ = score_candidate(candidate, case.truth, oracles=oracles, threads=threads, monitor=Monitor())
    return score_fields(score)


def _line(row: dict[str, Any]) -> str:
    return (
        f"{row['scene']}, {row['sources']} sources, {row['settings']}: MSE {row['mse']:.5f}, "
        f"PPE {row['ppe_005']:.1f}/{row['ppe_010']:.1f}, {row['below_z_buffer_db']:.2f} dB below the oracle"
    )


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Means over scenes, a Markdown table."""
    groups: dict[tuple[str, int], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["settings"], row["sources"]), []).append(row)
    means = [{"settings": name, "sources": n, **mean_fields(group)} for (name, n), group in groups.items()]
    return markdown_table(sorted(means, key=lambda row: row["sources"]), COLUMNS)


def main() -> None:
    """Read the command line, run, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("choices", nargs="*", metavar="STAGE.KNOB=VALUE,VALUE")
    parser.add_argument("--size", choices=tuple(SIZES), default="medium")
    parser.add_argument("--sources", default="2,4")
    parser.add_argument("--scenes", default="", help="of the tuning half, separated by commas; default all")
    parser.add_argument("--poses", choices=("given", "prior"), default="given")
    parser.add_argument("--threads", type=int, default=0)
    given = parser.parse_args()
    try:
        chosen = variants(given.choices)
        names = scene_names("tuning", [name for name in given.scenes.split(",") if name])
        unknown = sorted(set(names) - set(scene_names("tuning")))
        if unknown:
            raise UsageError(f"{unknown[0]!r} is not a tuning scene", remedy=f"of {', '.join(scene_names('tuning'))}")
    except LfrigError as error:
        parser.error(str(error))
    rows = []
    for name in names:
        case = shoot_case(name, SIZES[given.size], poses=given.poses, threads=given.threads)
        rows += run_scene(case, [int(n) for n in given.sources.split(",")], chosen, threads=given.threads)
    print(table(rows))


if __name__ == "__main__":
    main()
