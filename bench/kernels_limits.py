"""What the machine can do in this very run: bytes per CPU second (STREAM triad) and operations per CPU second."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfrig.bench.measure import Cost, stopwatch
from lfrig.processing.kernels.stream import CHAIN_BYTES, multiply_add, triad
from lfrig.processing.model import F32

TRIAD_FLOATS = 24 << 20
"""Per array: three times 96 MiB, several times the caches of the machines that this runs on."""
TRIAD_BYTES = 3 * 4 * TRIAD_FLOATS
ROUNDS = 1_000_000
RUNS = 5


@dataclass(frozen=True)
class Limits:
    """With so many threads: ``bytes_per_cpu_s`` and ``operations_per_cpu_s`` by unit (multiplications and additions
    count one each); ``gigabytes_per_s`` of wall time.
    """

    threads: int
    bytes_per_cpu_s: float
    operations_per_cpu_s: dict[str, float]
    gigabytes_per_s: float

    def least_cpu_s(self, bytes_moved: float, operations: float, unit: str) -> tuple[float, str]:
        """CPU seconds below which nothing can be, and whether memory or arithmetic says so."""
        memory = bytes_moved / self.bytes_per_cpu_s
        arithmetic = operations / self.operations_per_cpu_s[unit]
        return (memory, "memory") if memory >= arithmetic else (arithmetic, "arithmetic")

    def row(self) -> dict[str, Any]:
        """For the document."""
        giga = {f"{unit}_gops_per_cpu_s": rate / 1e9 for unit, rate in self.operations_per_cpu_s.items()}
        return {
            "kind": "limits", "threads": self.threads, "triad_gb_per_s": self.gigabytes_per_s,
            "triad_gb_per_cpu_s": self.bytes_per_cpu_s / 1e9, **giga,
        }  # fmt: skip


def measure_limits(threads: int) -> Limits:
    """Time triad and multiply-adds; of several runs the least disturbed one counts, as in STREAM."""
    moved = _triad_cost(threads)
    rates = {
        "int16": _operations_per_cpu_s(np.ones((threads, CHAIN_BYTES // 2), np.uint16), 3),
        "float32": _operations_per_cpu_s(np.ones((threads, CHAIN_BYTES // 4), np.float32), 0.5),
    }
    return Limits(threads, TRIAD_BYTES / moved.cpu_s, rates, TRIAD_BYTES / moved.wall_s / 1e9)


def _triad_cost(threads: int) -> Cost:
    a, b, c = (np.ones(TRIAD_FLOATS, np.float32) for _ in range(3))
    return _least(lambda: triad(a, b, c, 1.5, threads=threads))


def _operations_per_cpu_s(values: NDArray[np.uint16] | F32, factor: float) -> float:
    cost = _least(lambda: multiply_add(values, factor, 7, ROUNDS))
    return 2 * ROUNDS * values.size / cost.cpu_s


def _least(work: Callable[[], None]) -> Cost:
    costs = []
    for _ in range(RUNS):
        with stopwatch() as watch:
            work()
        assert watch.cost is not None
        costs.append(watch.cost)
    return Cost(min(cost.wall_s for cost in costs), min(cost.cpu_s for cost in costs))
