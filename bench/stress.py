"""What must hold, or be refused by name, on inputs that break things. One row per trial, and each is a check.

A trial either measures a value that has a bound, or expects a named refusal. Anything else that escapes is a crash,
which is a failed row and never a traceback.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from lfrig.bench.document import Column, Table, write
from lfrig.bench.measure import stopwatch
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.errors import Interrupted, LfrigError
from lfrig.contracts.progress import Monitor


@dataclass(frozen=True)
class Trial:
    """One thing to try.

    ``run`` returns the value to compare with ``bound``, or raises. ``refusal`` names the codes of the errors one of
    which is the right answer; then a value means that the input was wrongly accepted.
    """

    group: str
    name: str
    run: Callable[[], float]
    why: str
    bound: float = 1.0
    direction: Literal["<=", ">="] = "<="
    refusal: tuple[str, ...] = ()


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    size: tuple[int, int] | None = None,
    groups: Sequence[str] | None = None,
    cache_dir: Path | None = None,
) -> BenchDocument:
    """Run all trials; writes stress.json and stress.md into ``out``.

    Parameters
    ----------
    size : (width, height), optional
        Of the simulated light-field views; 270×188 by default.
    groups : sequence of str, optional
        Only the trials of these groups.
    """
    from lfrig.bench.stress_trials import all_trials

    monitor = monitor or Monitor()
    trials = all_trials(size, threads, cache_dir, monitor)
    trials = [trial for trial in trials if groups is None or trial.group in groups]
    rows = []
    with monitor.task("bench stress", len(trials)):
        for trial in trials:
            rows.append(attempt(trial))
            monitor.advance()
    return write(
        out, "stress", rows=rows, checks=[check_of(row) for row in rows],
        tables=[Table("Trials", rows, COLUMNS)],
        text=(
            "Each trial has a bound, or a refusal that is the right answer. A refusal counts only with its own code; "
            "whatever else escapes is a crash and fails."
        ),
    )  # fmt: skip


def attempt(trial: Trial) -> dict[str, Any]:
    """Run a trial and judge it; only a cancel passes through."""
    expected = " or ".join(trial.refusal)
    row: dict[str, Any] = {
        "group": trial.group, "name": trial.name, "why": trial.why, "value": None,
        "expected": f"refused: {expected}" if expected else f"{trial.direction} {trial.bound:g}",
    }  # fmt: skip
    with stopwatch() as watch:
        try:
            value = trial.run()
        except Interrupted:
            raise
        except LfrigError as error:
            row |= {"outcome": f"refused: {error.code}", "message": error.message, "ok": error.code in trial.refusal}
        except Exception as error:
            row |= {"outcome": f"crashed: {type(error).__name__}", "message": str(error), "ok": False}
        else:
            inside = value <= trial.bound if trial.direction == "<=" else value >= trial.bound
            row |= {"outcome": f"{value:.3g}", "value": value, "ok": bool(inside) and not trial.refusal}
    assert watch.cost is not None
    return row | {"bound": trial.bound, "direction": trial.direction, "cpu_s": watch.cost.cpu_s,
                  "wall_s": watch.cost.wall_s}  # fmt: skip


def check_of(row: dict[str, Any]) -> Check:
    """A row as a check: its value against its bound, or 1 for a refusal as expected."""
    name = f"{row['group']}: {row['name']}"
    if row["value"] is not None and not row["expected"].startswith("refused"):
        return Check.of(name, row["value"], row["direction"], row["bound"], row["why"])
    return Check.of(name, float(row["ok"]), ">=", 1.0, f"{row['why']} (1 = {row['expected']})")


COLUMNS = (
    Column("group", "group"), Column("name", "trial"), Column("expected", "expected"), Column("outcome", "outcome"),
    Column("ok", "ok"), Column("why", "why"), Column("message", "message"), Column("cpu_s", "CPU s", ".1f"),
)  # fmt: skip
