"""What work costs: wall seconds, CPU seconds (user + system of the whole process and its children), peak
memory.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import resource
import signal
import statistics
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from lfrig.contracts.errors import CheckFailed, LfrigError
from lfrig.contracts.progress import Monitor

T = TypeVar("T")
KIB_PER_MIB = 1024
POLL_S = 0.2


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


def in_fresh_process(function: Callable[..., T], *args: object, monitor: Monitor) -> tuple[T, Cost]:
    """Call a module-level function in a process of its own, so that its peak memory is its own.

    The cost is that of the call: starting Python and importing ``function``'s module are not in its times,
    but what they hold is in its peak memory, as it is for a user. Arguments and result must be picklable.

    Raises
    ------
    LfrigError
        What the function raised.
    CheckFailed
        The process died, which running out of memory looks like.
    Interrupted
        The monitor was cancelled; the process is ended.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_call, args=(sender, function, args), daemon=True)
    process.start()
    sender.close()
    try:
        while not receiver.poll(POLL_S):
            monitor.advance(0)
        outcome = receiver.recv()
    except EOFError:
        process.join()
        raise CheckFailed(
            f"{function.__name__} died (exit code {process.exitcode})", remedy="is there enough memory?"
        ) from None
    finally:
        receiver.close()
        process.terminate()  # it has sent what it had, or nobody waits for it any more
        process.join()
    if isinstance(outcome, _Expected):
        raise outcome.error()
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


@dataclass(frozen=True)
class _Expected:
    """An `LfrigError` on its way between processes: its subclasses have constructors that pickle cannot call."""

    kind: type[LfrigError]
    message: str
    remedy: str
    code: str

    def error(self) -> LfrigError:
        error = self.kind.__new__(self.kind)
        LfrigError.__init__(error, self.message, remedy=self.remedy, code=self.code)
        return error


def _call(sender: Connection, function: Callable[..., object], args: tuple[object, ...]) -> None:
    """What the fresh process does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    try:
        with stopwatch() as watch:
            result = function(*args)
        assert watch.cost is not None
        sender.send((result, Cost(watch.cost.wall_s, watch.cost.cpu_s, peak_rss_mb())))
    except LfrigError as error:
        sender.send(_Expected(type(error), error.message, error.remedy, error.code))
    except Exception:
        sender.send(RuntimeError(f"in a process of its own:\n{traceback.format_exc()}"))
    finally:
        sender.close()


def _cpu_s() -> float:
    return sum(
        usage.ru_utime + usage.ru_stime
        for usage in (resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN))
    )


def peak_rss_mb() -> float:
    """The most memory that this process held so far [MiB]."""
    status = Path("/proc/self/status")
    if status.is_file():
        # Not ru_maxrss: on Linux it survives exec, so a process would start with the peak of the one it came from.
        for line in status.read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / KIB_PER_MIB
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / KIB_PER_MIB
