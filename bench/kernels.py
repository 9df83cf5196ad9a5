"""Each native kernel against its reference and against what the machine can do, at three sizes, on one and two threads.

The reference is OpenCV where it has the operation, else the NumPy twin. Runs of both alternate, so that what else the
machine does hits both alike; medians count. The limit of a call is the longer of two times: its bytes at the speed of
the STREAM triad, its operations at the speed of multiply-adds in registers, both measured in the same run.
"""

from __future__ import annotations

import functools
import statistics
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lfrig.bench import plots
from lfrig.bench.cases import FULL, MEDIUM, SMALL
from lfrig.bench.document import Column, Table, write
from lfrig.bench.kernels_data import SCENE, record_calls
from lfrig.bench.kernels_limits import Limits, measure_limits
from lfrig.bench.kernels_registry import KERNELS, Kernel
from lfrig.bench.kernels_replay import Array, Call, Replay, largest_difference, native_switched
from lfrig.bench.measure import Cost, stopwatch
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.errors import UsageError
from lfrig.contracts.native import load_native
from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.stream import vector_level

SIZES = {"quarter": SMALL, "half": MEDIUM, "full": FULL}
THREADS = (1, 2)
RUNS = 5
REFERENCE_S = 3.0
"""CPU seconds after which a reference is not run again."""
TWIN = "NumPy twin"
PICTURE = "kernels.png"

BOUNDS: tuple[tuple[str, str, float, str], ...] = (
    ("sweep", "OpenCV, warps", 8.0, "one warp per view and plane is what OpenCV has for it"),
    ("sweep-masked", "OpenCV, warps", 30.0, "planes and tiles that a coarse sweep ruled out cost nothing"),
    ("fusion", "OpenCV, remap", 6.0, "a correct fusion from two-dimensional look-ups"),
    ("warp", "OpenCV, remap", 4.0, "one remap per view"),
)
"""(kernel, reference, least ratio of CPU times, why) at full size on two threads, with AVX-512."""


@dataclass(frozen=True)
class Timing:
    """Costs of one kernel's runs with one number of threads: its own, and its references' by title."""

    native: list[Cost]
    references: dict[str, list[Cost]]


def run(
    out: Path,
    *,
    monitor: Monitor | None = None,
    threads: int = 0,
    sizes: Sequence[str] = tuple(SIZES),
    kernels: Sequence[Kernel] = KERNELS,
    runs: int = RUNS,
    cache_dir: Path | None = None,
) -> BenchDocument:
    """Run the benchmark; writes kernels.json, kernels.md and a plot into ``out``.

    Parameters
    ----------
    threads : int
        For making the data; kernels run on `THREADS`.
    runs : int
        Of every kernel at every size and number of threads.

    Raises
    ------
    UsageError
        The native core is not there, or switched off.
    """
    if load_native("lfrig.processing.kernels._native") is None:
        raise UsageError("the native core is not in use", remedy="install with a C++ compiler, without LFRIG_NATIVE=0")
    monitor = monitor or Monitor()
    rows: list[dict[str, Any]] = []
    with monitor.task("bench kernels", len(sizes) * (1 + len(kernels))):
        limits = {count: measure_limits(count) for count in THREADS}
        for size in sizes:
            with tempfile.TemporaryDirectory(prefix="lfrig-") as name:
                record_calls(kernels, SIZES[size], Path(name), threads=threads, cache_dir=cache_dir, monitor=monitor)
                monitor.advance()
                for kernel in kernels:
                    path = Path(name) / f"{kernel.name}.pkl"
                    if path.is_file():
                        rows += kernel_rows(kernel, Call.load(path), size, limits, runs, monitor)
                        path.unlink()
                    monitor.advance()
    rows = [*(limit.row() for limit in limits.values()), *rows]
    plots.bars(out / PICTURE, bar_groups(rows, sizes[-1]), title=f"kernels, {sizes[-1]} size, 1 thread", unit="CPU ms")
    return write(
        out, "kernels", rows=rows, checks=acceptance(rows, kernels, sizes, vector_level()),
        tables=tables(rows, sizes), text=_text(runs), pictures=[PICTURE],
    )  # fmt: skip


def kernel_rows(
    kernel: Kernel, call: Call, size: str, limits: dict[int, Limits], runs: int, monitor: Monitor
) -> list[dict[str, Any]]:
    """One row per number of threads and reference."""
    replay = Replay(kernel.spot, call)
    ours = _outputs(kernel, replay, lambda: replay.run(1))
    moved, operations = kernel.bytes_moved(call, ours), 0.0
    if kernel.operations is not None:
        operations = kernel.operations(call, ours)
    promised = kernel.compared(call, ours)
    with native_switched(False):
        replay.reset()
        with stopwatch() as watch:
            returned = replay.run()
        twins = kernel.compared(call, replay.outputs(returned))
    difference = largest_difference(promised, twins, ties=kernel.ties, relative=kernel.relative)
    assert watch.cost is not None
    twin = [watch.cost]
    del ours, promised, returned, twins
    rows = []
    for count in THREADS if kernel.spot.threaded else THREADS[:1]:
        timing = _time(kernel, replay, count, runs, twin, monitor)
        least, bound = limits[count].least_cpu_s(moved, operations, kernel.unit)
        own = _medians(timing.native)
        for title, costs in timing.references.items():
            other = _medians(costs)
            rows.append({
                "kind": "kernel", "kernel": kernel.name, "title": kernel.title, "size": size, "threads": count,
                "cpu_ms": 1e3 * own.cpu_s, "wall_ms": 1e3 * own.wall_s, "runs": len(timing.native),
                "reference": title, "reference_cpu_ms": 1e3 * other.cpu_s, "reference_wall_ms": 1e3 * other.wall_s,
                "reference_runs": len(costs), "cpu_ratio": other.cpu_s / own.cpu_s,
                "wall_ratio": other.wall_s / own.wall_s, "limit_ms": 1e3 * least, "bound": bound,
                "of_limit": own.cpu_s / least, "bytes": moved, "operations": operations, "difference": difference,
            })  # fmt: skip
    return rows


def _time(kernel: Kernel, replay: Replay, threads: int, runs: int, twin: list[Cost], monitor: Monitor) -> Timing:
    """The native form and its references in turn; a slow reference is run less often.

    ``twin`` holds the twin's runs so far: it has one thread, whatever the native form has.
    """
    import cv2

    call = replay.call
    references: dict[str, Callable[[], object]] = {
        title: functools.partial(function, call) for title, function in kernel.opencv().items()
    }
    timing = Timing([], {title: [] for title in references} or {TWIN: twin})
    before = cv2.getNumThreads()
    cv2.setNumThreads(threads)
    try:
        for _ in range(runs):
            timing.native.append(_cost(replay, lambda: replay.run(threads)))
            for title, costs in timing.references.items():
                monitor.advance(0)
                if sum(cost.cpu_s for cost in costs) < REFERENCE_S:
                    with native_switched(False):
                        costs.append(_cost(replay, references.get(title, replay.run)))
    finally:
        cv2.setNumThreads(before)
    return timing


def _cost(replay: Replay, work: Callable[[], object]) -> Cost:
    replay.reset()
    with stopwatch() as watch:
        work()
    assert watch.cost is not None
    return watch.cost


def _medians(costs: Sequence[Cost]) -> Cost:
    return Cost(*(statistics.median(getattr(cost, name) for cost in costs) for name in ("wall_s", "cpu_s")))


def _outputs(kernel: Kernel, replay: Replay, work: Callable[[], object]) -> list[Array]:
    replay.reset()
    return [array.copy() for array in replay.outputs(work())]


def bar_groups(rows: Sequence[dict[str, Any]], size: str) -> dict[str, dict[str, float]]:
    """Native, references and limit by kernel, for the plot [CPU ms]."""
    groups: dict[str, dict[str, float]] = {}
    for row in rows:
        if row["kind"] == "kernel" and row["size"] == size and row["threads"] == 1:
            group = groups.setdefault(row["kernel"], {})
            group |= {"limit": row["limit_ms"], "native": row["cpu_ms"], row["reference"]: row["reference_cpu_ms"]}
    return groups


def acceptance(
    rows: Sequence[dict[str, Any]], kernels: Sequence[Kernel], sizes: Sequence[str], level: str
) -> list[Check]:
    """Twins agree at every size; with AVX-512 at full size, the ratios that were promised."""
    checks = []
    for kernel in kernels:
        found = [row["difference"] for row in rows if row["kind"] == "kernel" and row["kernel"] == kernel.name]
        if found:
            worst = min(max(found), 1e30)  # infinity is no JSON number
            why = "a kernel and its twin are one definition"
            checks.append(Check.of(f"{kernel.name}: difference to the twin", worst, "<=", kernel.tolerance, why))
    if level != "AVX-512" or "full" not in sizes:
        return checks
    for name, reference, bound, why in BOUNDS:
        for row in rows:
            if (row.get("kernel"), row.get("reference"), row.get("size"), row["threads"]) == (
                name,
                reference,
                "full",
                2,
            ):
                checks.append(Check.of(f"{name}: CPU time of {reference} / ours", row["cpu_ratio"], ">=", bound, why))
    return checks


def tables(rows: Sequence[dict[str, Any]], sizes: Sequence[str]) -> list[Table]:
    """The limits, and a table per size."""
    limits = (
        Column("threads", "threads"), Column("triad_gb_per_s", "triad GB/s", ".1f"),
        Column("triad_gb_per_cpu_s", "GB per CPU s", ".1f"),
        Column("int16_gops_per_cpu_s", "16-bit G op per CPU s", ".0f"),
        Column("float32_gops_per_cpu_s", "float32 G op per CPU s", ".0f"),
    )  # fmt: skip
    columns = (
        Column("title", "kernel"), Column("threads", "threads"), Column("cpu_ms", "CPU ms", ".2f"),
        Column("wall_ms", "wall ms", ".2f"), Column("reference", "reference"),
        Column("reference_cpu_ms", "CPU ms", ".1f"), Column("reference_wall_ms", "wall ms", ".1f"),
        Column("cpu_ratio", "CPU ratio", ".1f"), Column("wall_ratio", "wall ratio", ".1f"),
        Column("limit_ms", "limit CPU ms", ".2f"), Column("bound", "set by"), Column("of_limit", "× limit", ".1f"),
        Column("difference", "difference to the twin", ".2g"),
    )  # fmt: skip
    found = [Table("Limits of this machine", [row for row in rows if row["kind"] == "limits"], limits)]
    for size in sizes:
        width, height = SIZES[size]
        of_size = [row for row in rows if row["kind"] == "kernel" and row["size"] == size]
        found.append(Table(f"{size.capitalize()} size, {width}×{height}", of_size, columns))
    return found


def _text(runs: int) -> str:
    return (
        f"Calls that the pipeline makes on {SCENE} with two sources (of each kernel the largest), the decode of a raw "
        f"file of views of that size, and all fields of 7×7 views; {runs} runs, alternating with the reference, which "
        f"is run until it has used {REFERENCE_S:g} CPU s. CPU ms are medians of user + system time over all threads. "
        "The limit is the longer of: bytes that have to move at least once at the triad's speed, operations at the "
        f"speed of multiply-adds in registers. Vector level in use: {vector_level()}; the processor chooses it when "
        "the module is loaded and no variable switches it, so other levels are measured on machines that have no more."
    )
