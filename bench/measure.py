"""What work costs: wall seconds, CPU seconds (user + system of the whole process and its children), peak
memory.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, TypeVar

from lfrig.contracts.errors import CheckFailed, LfrigError

T = TypeVar("T")
KIB_PER_MIB = 1024


@dataclass(frozen=True)
class Cost:
    """``wall_s`` and ``cpu_s`` [s]; ``peak_rss_mb`` [MiB], None where only a process of its own could
    tell.
    """

    wall_s: float
    cpu_s: float
    peak_rss_mb: float | None = None


@dataclass
class Stopwatch:
    """Filled in when the block of `stopwatch` ends."""

    cost: Cost | None = None


@contextlib.contextmanager
def stopwatch() -> Iterator[Stopwatch]:
    """Measure a block in this process: wall and CPU, not memory (the peak of a process never falls)."""
    watch = Stopwatch()
    wall, cpu = time.perf_counter(), _cpu_s()
    yield watch
    watch.cost = Cost(time.perf_counter() - wall, _cpu_s() - cpu)


def in_fresh_process(function: Callable[..., T], *args: object) -> tuple[T, Cost]:
    """Call a module-level function in a process of its own, so that its peak memory is its own.

    The cost is that of the call: starting Python and importing ``function``'s module are not in its times,
    but what they hold is in its peak memory, as it is for a user. Arguments and result must be picklable.

    Raises
    ------
    LfrigError
        What the function raised.
    CheckFailed
        The process died, which running out of memory looks like.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_call, args=(sender, function, args), daemon=True)
    process.start()
    sender.close()
    try:
        outcome = receiver.recv()
    except EOFError:
        process.join()
        raise CheckFailed(
            f"{function.__name__} died (exit code {process.exitcode})", remedy="is there enough memory?"
        ) from None
    finally:
        receiver.close()
        if process.is_alive():
            process.join(timeout=10)
        if process.is_alive():
            process.terminate()
    if isinstance(outcome, BaseException):
        raise outcome
    result: T
    cost: Cost
    result, cost = outcome
    return result, cost


def summary(costs: Sequence[Cost]) -> dict[str, Any]:
    """Fields of a row over several runs: medians, with min and max of both times, and the number of runs."""
    fields: dict[str, Any] = {"runs": len(costs)}
    for name in ("wall_s", "cpu_s"):
        values = [getattr(cost, name) for cost in costs]
        fields[name] = statistics.median(values)
        fields[f"{name}_min"], fields[f"{name}_max"] = min(values), max(values)
    peaks = [cost.peak_rss_mb for cost in costs if cost.peak_rss_mb is not None]
    if peaks:
        fields["peak_rss_mb"] = max(peaks)
    return fields


def _call(sender: Connection, function: Callable[..., object], args: tuple[object, ...]) -> None:
    """What the fresh process does."""
    try:
        with stopwatch() as watch:
            result = function(*args)
        assert watch.cost is not None
        sender.send((result, Cost(watch.cost.wall_s, watch.cost.cpu_s, _peak_rss_mb())))
    except LfrigError as error:
        sender.send(_portable(error))
    finally:
        sender.close()


def _portable(error: LfrigError) -> LfrigError:
    """The error in a form that survives pickling: subclasses have other constructors."""
    portable = LfrigError(error.message, remedy=error.remedy, code=error.code)
    portable.exit_code = error.exit_code
    return portable


def _cpu_s() -> float:
    return sum(
        usage.ru_utime + usage.ru_stime
        for usage in (resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN))
    )


def _peak_rss_mb() -> float:
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / KIB_PER_MIB
