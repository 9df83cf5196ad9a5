"""What the decode costs, told apart from the sensor's noise: views decoded from raw files against views of the same
noise that no sensor, no file and no decode was between.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from lfrig.bench.accuracy_table import SHIPPED, mean_fields
from lfrig.bench.document import Column, Table
from lfrig.bench.inputs import TITLES, Input

STEPS: tuple[tuple[Input, str], ...] = (("views", "nothing"), ("equal", "the noise"), ("raw", "the decode"))
FIELDS = ("mse", "mse_edge", "mse_textureless", "ppe_005", "ppe_010", "psnr")


def decode_cost_rows(scenes: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The preset's means per step from clean views to raw files, and what each step changed: ``added_<field>``.

    Only scenes that were scored in every step count, so that the steps differ in nothing else; none when a step was
    not run.
    """
    rows = []
    shipped = [row for row in scenes if row["stage"] == SHIPPED]
    for setup in dict.fromkeys(row["setup"] for row in shipped):
        by_step = [
            {row["scene"]: row for row in shipped if (row["setup"], row["input"]) == (setup, kind) and "mse" in row}
            for kind, _ in STEPS
        ]
        common = sorted(set.intersection(*(set(scored) for scored in by_step)))
        before: dict[str, float] | None = None
        for (kind, cause), scored in zip(STEPS, by_step, strict=True):
            if not common:
                break
            means = mean_fields([scored[scene] for scene in common])
            known = {name: means[name] for name in (*FIELDS, "noise_grey") if name in means}
            row = {"kind": "decode cost", "setup": setup, "input": kind, "title": TITLES[kind], "cause": cause, **known}
            row |= {"scenes": len(common)}
            if before is not None:
                row |= {f"added_{name}": known[name] - before[name] for name in FIELDS if name in known}
            rows.append(row)
            before = known
    return rows


COLUMNS = (
    Column("setup", "setup"), Column("title", "sources"), Column("noise_grey", "noise found", ".1f"),
    Column("mse", "MSE px²", ".5f"), Column("cause", "changed by"), Column("added_mse", "MSE", "+.5f"),
    Column("added_mse_edge", "MSE edge", "+.5f"), Column("added_mse_textureless", "MSE textureless", "+.5f"),
    Column("added_ppe_005", "PPE .05", "+.1f"), Column("added_ppe_010", "PPE .1", "+.1f"),
    Column("added_psnr", "PSNR dB", "+.2f"), Column("scenes", "scenes"),
)  # fmt: skip


def decode_cost_tables(rows: Sequence[dict[str, Any]]) -> list[Table]:
    """The table, when there is something in it."""
    return [Table("What noise and decode cost: preset fast, step by step", rows, COLUMNS)] if rows else []
