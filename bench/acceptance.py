"""What the shipped preset has to keep: means over the reporting half at full size, bF = 0.70 px·m."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from lfrig.bench.accuracy_table import SHIPPED, Setup
from lfrig.bench.inputs import Input
from lfrig.contracts.bench import Check

Bounds = tuple[tuple[str, float, Literal["<=", ">="], str], ...]
"""(field, bound, direction, why) of what a row of means has to keep."""

STATED = Setup(2, "prior")
"""The setup that the accuracy is promised for: the least that a rig has."""

BOUNDS: dict[Input, Bounds] = {
    "views": (
        ("mse", 0.0015, "<=", "what the prototype reached with exact poses on its two worst scenes"),
        ("ppe_005", 95.0, ">=", "a tenth of the smallest step that refocusing shows"),
        ("ppe_010", 98.0, ">=", "the pixels that a viewer would call right"),
        ("below_z_buffer_db", 0.8, "<=", "what geometry may cost of the views' quality"),
        ("ause_of_random", 0.3, "<=", "a confidence has to know most of what there is to know of the errors"),
    ),
    "noisy": (
        ("mse", 0.003, "<=", "noise may double the error: it hides the faint texture of plain surfaces"),
        ("ppe_005", 90.0, ">=", "twice as many pixels off as on clean views"),
        ("ppe_010", 96.0, ">=", "twice as many pixels off as on clean views"),
    ),
    "raw": (
        ("mse", 0.004, "<=", "sensor noise, and what the decode adds to it at depth edges"),
        ("ppe_005", 88.0, ">=", "noise and decode move the median"),
        ("ppe_010", 95.0, ">=", "three points below clean views"),
    ),
}

OTHER_SETUPS: Bounds = (
    ("mse", 0.004, "<=", "twice what the prototype reached on four scenes; edges and unseen areas make it up"),
    ("ppe_005", 88.0, ">=", "a tenth of the smallest step that refocusing shows"),
    ("ppe_010", 94.0, ">=", "the pixels that a viewer would call right"),
    ("below_z_buffer_db", 1.0, "<=", "what geometry may cost of the views' quality"),
)


def bounds_of(setup: str, kind: Input) -> Bounds:
    """What a row of means of the shipped preset has to keep; none for an input that is only there to compare."""
    if setup == STATED.name:
        return BOUNDS.get(kind, ())
    return OTHER_SETUPS if kind == "views" else ()


def acceptance(rows: Sequence[dict[str, Any]]) -> list[Check]:
    """The checks on the rows of means, and that no scene is missing in them."""
    checks = []
    for row in rows:
        bounds = bounds_of(row["setup"], row["input"])
        if row["stage"] != SHIPPED or not bounds:
            continue
        title = f"{row['setup']}, {row['input']}"
        if "mse" in row:
            checks += [Check.of(f"{title}: {name}", row[name], way, bound, why) for name, bound, way, why in bounds]
        why = "a mean over fewer scenes is not the same mean"
        checks.append(Check.of(f"{title}: scenes refused", len(row["refused"]), "<=", 0, why))
    return checks
