"""A seeded mutation fuzzer of the readers of raw files: ``python -m lfrig.bench.fuzz_containers --count N --seed S``.

Small valid shots and calibrations are broken (bits, lengths, sections, JSON values, tar headers, splices) and read as
the program reads them. Any exception but `LfrigError`, more than `CASE_CPU_S` of CPU for a case, or more than
`MEMORY_CAP_MB` of memory beyond the start is a failure, named by seed and case: ``--seed S --first CASE --count 1``.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import json
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from types import FrameType

from lfrig.bench.fuzz_mutations import mutated_calibration, mutated_shot
from lfrig.bench.lytro_files import SmallShot, calibration_files, shot_file, tar_bytes
from lfrig.contracts.errors import LfrigError
from lfrig.contracts.lytro import F01
from lfrig.contracts.progress import Monitor
from lfrig.processing.lenslet.calibration import Calibration
from lfrig.processing.lenslet.container import parse_container, read_container
from lfrig.processing.lenslet.priors import camera_and_optics
from lfrig.processing.lenslet.raw import assemble

CASE_CPU_S = 1.0
HANG_CPU_S = 10.0
MEMORY_CAP_MB = 64
CALIBRATION_EVERY, FILE_EVERY = 8, 16
"""One case in so many breaks the calibration; one in so many goes through a file instead of memory."""
ACCEPTED = "read"


class Hang(Exception):
    """A case took more than `HANG_CPU_S` of CPU."""


@dataclass
class Tally:
    """``outcomes`` counts cases by what came of them (an error's code, or `ACCEPTED`); ``failures`` are (case, why)."""

    outcomes: collections.Counter[str] = field(default_factory=collections.Counter)
    failures: list[tuple[int, str]] = field(default_factory=list)
    slowest_cpu_s: float = 0.0
    memory_growth_mb: float = 0.0


def run(count: int, seed: int, *, first: int = 0, folder: Path) -> Tally:
    """Run cases ``first`` … ``first + count − 1``; ``folder`` is for the files of cases that need one."""
    tally = Tally()
    before_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with _memory_cap(), _hang_signal():
        reader = _Reader(folder)
        for case in range(first, first + count):
            started = time.process_time()
            signal.setitimer(signal.ITIMER_VIRTUAL, HANG_CPU_S)
            try:
                outcome = reader.read(seed, case)
            except LfrigError as error:
                outcome = error.code
            except Exception as error:
                outcome = "FAILED"
                where = traceback.extract_tb(error.__traceback__)[-1]
                place = f"{Path(where.filename).name}:{where.lineno}"
                tally.failures.append((case, f"{type(error).__name__}: {error} at {place}"))
            finally:
                signal.setitimer(signal.ITIMER_VIRTUAL, 0)
            taken = time.process_time() - started
            if taken > CASE_CPU_S:
                tally.failures.append((case, f"took {taken:.1f} CPU s"))
            tally.slowest_cpu_s = max(tally.slowest_cpu_s, taken)
            tally.outcomes[outcome] += 1
    tally.memory_growth_mb = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib) / 1024
    if tally.memory_growth_mb > MEMORY_CAP_MB:
        tally.failures.append((first, f"memory grew by {tally.memory_growth_mb:.0f} MiB"))
    return tally


class _Reader:
    """Reads a case's files as ingest, info and the decode would."""

    def __init__(self, folder: Path) -> None:
        white = SmallShot(embedded_white=True, hot_pixels=[(3, 4), (5, 6)])
        shots = [white, SmallShot(figures=F01, seed=1), SmallShot(width=17, height=19, geometry=None)]
        self._shots = [(shot, shot_file(shot)) for shot in shots]
        self._calibrated = [SmallShot(zoom_step=500, geometry=b"1"), SmallShot(focus_step=3, geometry=b"2")]
        self._shot_path, self._tar_path = folder / "case.lfr", folder / "case.tar"
        whole = folder / "whole.tar"
        whole.write_bytes(tar_bytes(calibration_files(self._calibrated, [(1, 2)])))
        self._calibration = Calibration.open(whole)

    def read(self, seed: int, case: int) -> str:
        rng = Random((seed << 48) + case)
        monitor = Monitor()
        if case % CALIBRATION_EVERY == 0:
            self._tar_path.write_bytes(mutated_calibration(rng, calibration_files(self._calibrated, [(1, 2)])))
            known = Calibration.open(self._tar_path)
            whole = parse_container(memoryview(self._shots[0][1]), self._shot_path)
            assemble(whole, known, monitor)
            return f"{ACCEPTED} (calibration)"
        data = mutated_shot(rng, self._shots)
        partial = rng.random() < 0.5
        if case % FILE_EVERY == 1:
            self._shot_path.write_bytes(data)
            container = read_container(self._shot_path, partial=partial)
        else:
            container = parse_container(memoryview(data), self._shot_path, partial=partial)
        capture = assemble(container, self._calibration, monitor)
        camera_and_optics(capture.metadata)
        if case % 2:
            container.check()
        return f"{ACCEPTED} (partly)" if capture.problems else ACCEPTED


@contextlib.contextmanager
def _memory_cap() -> Iterator[None]:
    """Refuse more than `MEMORY_CAP_MB` of address space beyond what is in use, where the system can tell."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except OSError:
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    cap = pages * resource.getpagesize() + (MEMORY_CAP_MB << 20)
    resource.setrlimit(resource.RLIMIT_AS, (cap, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextlib.contextmanager
def _hang_signal() -> Iterator[None]:
    def stop(number: int, frame: FrameType | None) -> None:
        raise Hang(f"more than {HANG_CPU_S:g} CPU s")

    before: Callable[[int, FrameType | None], object] | int | None = signal.signal(signal.SIGVTALRM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGVTALRM, before)


def main() -> int:
    """Command line; prints one JSON object, exit code 1 on a failure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0)
    options = parser.parse_args()
    started = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        tally = run(options.count, options.seed, first=options.first, folder=Path(folder))
    report = {
        "seed": options.seed,
        "first": options.first,
        "count": options.count,
        "cpu_s": round(time.process_time() - started, 1),
        "slowest_case_cpu_s": round(tally.slowest_cpu_s, 4),
        "memory_growth_mb": round(tally.memory_growth_mb, 1),
        "outcomes": dict(sorted(tally.outcomes.items())),
        "failures": [
            {"case": case, "why": why, "again": f"--seed {options.seed} --first {case} --count 1"}
            for case, why in tally.failures[:20]
        ],
    }
    sys.stdout.write(json.dumps(report, indent=1) + "\n")
    return 1 if tally.failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
