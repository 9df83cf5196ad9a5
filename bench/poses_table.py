"""Setups, summaries, tables and bounds of the poses benchmark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from lfrig.bench.document import Column, Table
from lfrig.bench.poses_faults import FAULTS
from lfrig.bench.poses_gate import LIMITS, NOT_ABOUT_A_FAULT
from lfrig.bench.poses_priors import (
    ANGLE_SIGMA_DEG,
    ELEVATION_SIGMA_DEG,
    FOCAL_SIGMA,
    OPTICS_SIGMA,
    RADIUS_SIGMA,
)
from lfrig.contracts.bench import Check


@dataclass(frozen=True)
class Setup:
    """Sources at these plate angles."""

    name: str
    angles_deg: tuple[float, ...]


@dataclass(frozen=True)
class PhotoSetup:
    """A photo at this plate angle, its focal length recorded with this relative error."""

    plate_deg: float
    focal_error: float

    @property
    def name(self) -> str:
        """As shown in tables."""
        return f"{self.plate_deg:g}°, focal {'known' if self.focal_error == 0 else f'{100 * self.focal_error:+g} %'}"


SETUPS = (
    Setup("5 at 15°", (0.0, 15.0, 30.0, 45.0, 60.0)),
    Setup("5 at 20°", (0.0, 20.0, 40.0, 60.0, 80.0)),
    Setup("3 at 30°", (0.0, 30.0, 60.0)),
)
UNEVEN = Setup("4 at 0, 10, 45, 60°", (0.0, 10.0, 45.0, 60.0))
"""Needs no render beyond those of the other benchmarks."""

PHOTO_SETUPS = tuple(PhotoSetup(angle, error) for angle in (7.5, 25.0, 37.5, 50.0) for error in (0.0, 0.05))

SUMMARISED = (
    "rotation_deg", "centre_mm", "scale_pct", "focal_pct", "slope_pct", "depth_pct", "outliers_pct",
    "photo_rotation_deg", "photo_centre_mm", "photo_focal_pct", "transfer_px", "cpu_s", "wall_s",
)  # fmt: skip


def summaries(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Per kind and setup: median and maximum of every figure (of its size), fewest anchors, refusals, warnings."""
    keys = dict.fromkeys((row["kind"], row["setup"]) for row in rows if row["kind"] != "fault")
    return [_summary(kind, name, [r for r in rows if (r["kind"], r.get("setup")) == (kind, name)])
            for kind, name in keys]  # fmt: skip


def _summary(kind: str, name: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    solved = [row for row in rows if "refused" not in row]
    warned = [code for row in solved for code in row["warnings"] if code not in NOT_ABOUT_A_FAULT]
    found: dict[str, Any] = {
        "kind": f"{kind} summary", "setup": name, "runs": len(rows), "refusals": len(rows) - len(solved),
        "refused": sorted({row["refused"] for row in rows if "refused" in row}),
        "alarms": len(warned), "warnings": sorted(set(warned)),
    }  # fmt: skip
    if not solved:
        return found
    for field in SUMMARISED:
        values = np.abs([row[field] for row in solved if field in row])
        if len(values):
            found |= {field: float(np.median(values)), f"{field}_max": float(np.max(values))}
    found |= {"anchors": min(row["anchors"] for row in solved)}
    worst = max(solved, key=lambda row: float(row["photo_rotation_deg" if kind == "photo" else "rotation_deg"]))
    for field in ("agreement", "photo_agreement"):
        if any(field in row for row in solved):
            found[field] = min(row[field] for row in solved if field in row)
    return found | {"worst": f"{worst['scene']}, seed {worst['seed']}"}


def acceptance(means: Sequence[dict[str, Any]], rows: Sequence[dict[str, Any]]) -> list[Check]:
    """The bounds of the pose stage: accuracy, the photo, and no fault that goes by unseen."""
    checks = []
    for row in means:
        if row["kind"] == "sources summary":
            checks += _source_checks(row)
        elif row["kind"] == "photo summary":
            why = "2 px at the edge of a photo 541 px wide is 0.1°: half of that leaves the refinement its range"
            checks.append(_at_most(row, "photo_rotation_deg_max", f"photo at {row['setup']}", 0.05, why))
        elif row["kind"] == "free summary":
            why = "poses that the photo's own evidence contradicts are refused, not handed on"
            checks.append(_at_most(row, "transfer_px_max", f"no rig, {row['setup']}", LIMITS["transfer_px"], why))
    return [*checks, *_fault_checks(rows)]


def _source_checks(row: dict[str, Any]) -> list[Check]:
    name = row["setup"]
    if name == "3 at 30°":
        why = "few anchors are shared over 30°; a tenth of a degree is 2 px, what the refinement can still search"
        checks = [_at_most(row, "rotation_deg_max", name, 0.1, why)]
    else:
        why = "half a pixel at 541 px: below it poses cost nothing that the disparity error would show"
        checks = [
            _at_most(row, "rotation_deg", name, 0.03, why),
            _at_most(row, "rotation_deg_max", name, 0.06, "one pixel, for the unluckiest prior of twenty"),
            Check.of(f"{name}: fewest anchors", row.get("anchors", 0), ">=", 500, "a scale line good to a thousandth"),
        ]
    why = "every prior is within what it states, so there is nothing to refuse or to warn of"
    return [
        *checks,
        Check.of(f"{name}: refused", row["refusals"], "<=", 0, why),
        Check.of(f"{name}: false alarms", row["alarms"], "<=", 0, why),
    ]


def _at_most(row: dict[str, Any], field: str, title: str, bound: float, why: str) -> Check:
    """The field is at most the bound; a summary without one run that went through fails it."""
    return Check.of(f"{title}: {field}", row.get(field, 1e9), "<=", bound, why)


def _fault_checks(rows: Sequence[dict[str, Any]]) -> list[Check]:
    faults = [row for row in rows if row["kind"] == "fault"]
    silent = sum(row["outcome"] == "SILENT WRONG" for row in faults)
    unnamed = sum(row["outcome"] == "refused" and not row["named"] for row in faults)
    return [
        Check.of("faults: wrong and silent", silent, "<=", 0, "nobody can mend what nobody is told of"),
        Check.of("faults: refused without naming the capture", unnamed, "<=", 0,
                 "an operator must know which one to shoot again"),
    ]  # fmt: skip


def fault_summaries(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row per fault: how it ended on every scene, with which codes, and the worst figures that were accepted."""
    table = []
    for fault in FAULTS:
        mine = [row for row in rows if row["kind"] == "fault" and row["fault"] == fault.key]
        if not mine:
            continue
        outcomes = [row["outcome"] for row in mine]
        line: dict[str, Any] = {
            "title": fault.title,
            "outcome": [f"{outcomes.count(o)} {o}" for o in dict.fromkeys(sorted(outcomes))],
            "codes": sorted({code for row in mine for code in row["codes"]}),
            "unnamed": sum(not row["named"] and row["outcome"] != "unaffected" for row in mine),
        }
        for field in ("rotation_deg", "depth_pct", "transfer_px"):
            values = [row[field] for row in mine if field in row]
            if values:
                line[field] = max(values)
        table.append(line)
    return table


def _pair(field: str, title: str, form: str) -> tuple[Column, Column]:
    return Column(field, title, form), Column(f"{field}_max", "max", form)


ENDS = (
    Column("agreement", "least agreement", ".2f"), Column("photo_agreement", "of the photo", ".2f"),
    *_pair("cpu_s", "CPU s", ".2f"), Column("runs", "runs"), Column("refused", "refused"),
    Column("warnings", "warnings"), Column("worst", "worst"),
)  # fmt: skip
SOURCE_COLUMNS = (
    Column("setup", "sources"), *_pair("rotation_deg", "rotation °", ".4f"), *_pair("centre_mm", "centre mm", ".3f"),
    *_pair("scale_pct", "scale %", ".2f"), *_pair("focal_pct", "focal %", ".3f"),
    *_pair("slope_pct", "slope %", ".3f"), *_pair("depth_pct", "anchor depth %", ".3f"),
    Column("outliers_pct", "outliers %", ".2f"), Column("anchors", "fewest anchors"),
    *_pair("transfer_px", "transfer px", ".2f"), *ENDS,
)  # fmt: skip
PHOTO_COLUMNS = (
    Column("setup", "photo"), *_pair("photo_rotation_deg", "rotation °", ".4f"),
    *_pair("photo_centre_mm", "centre mm", ".3f"), *_pair("photo_focal_pct", "focal %", ".3f"),
    *_pair("transfer_px", "transfer px", ".2f"), *ENDS,
)  # fmt: skip
FAULT_COLUMNS = (
    Column("title", "fault"), Column("outcome", "outcome"), Column("codes", "codes"),
    Column("unnamed", "culprit not named"), Column("rotation_deg", "rotation °", ".3f"),
    Column("depth_pct", "anchor depth %", ".2f"), Column("transfer_px", "transfer px", ".2f"),
)  # fmt: skip


def tables(means: Sequence[dict[str, Any]], rows: Sequence[dict[str, Any]]) -> list[Table]:
    """Accuracy, the photo, captures without a rig, and the gate's list."""
    parts = (
        ("Sources, from the turntable's prior", "sources summary", SOURCE_COLUMNS),
        ("The photo, its pose unknown", "photo summary", PHOTO_COLUMNS),
        ("Sources without a rig", "free summary", SOURCE_COLUMNS),
    )
    found = [Table(title, [r for r in means if r["kind"] == kind], columns) for title, kind, columns in parts]
    found.append(Table("Faults in five captures at 15°", fault_summaries(rows), FAULT_COLUMNS))
    return [table for table in found if table.rows]


def conditions(names: Sequence[str], size: tuple[int, int], seeds: int) -> str:
    """The paragraph under the title."""
    return (
        f"{len(names)} scenes ({', '.join(names)}), light-field views of {size[0]}×{size[1]} px, {seeds} draws of the "
        f"prior dealt out over them: angle σ {ANGLE_SIGMA_DEG:g}°, elevation {ELEVATION_SIGMA_DEG:g}°, radius "
        f"{100 * RADIUS_SIGMA:g} %, focal length {100 * FOCAL_SIGMA:g} %, baseline and focus distance "
        f"{100 * OPTICS_SIGMA:g} %, each for every capture. Medians and maxima over the runs of a figure's size. "
        "Rotations are relative, the worst pair of a run; centres, depths and slopes after the best similarity, whose "
        "scale is shown; transfer is the distance in a source between where a pixel of the photo with its true depth "
        f"is and where the solution looks for it. Geometry counts as wrong beyond {LIMITS['rotation_deg']:g}°, "
        f"{LIMITS['depth_pct']:g} % of depth or {LIMITS['transfer_px']:g} px of transfer (at 541 px). CPU s is that "
        "of the pose stage alone, without the disparity evidence that it is given."
    )
