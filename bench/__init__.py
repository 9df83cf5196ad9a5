"""Benchmarks: numbers with their cost, and checks with their reasons. `lfrig bench NAME` loads one of them.

- ``accuracy``  what each step of the pipeline gains, over the simulated scenes
- ``pareto``    error against CPU time, ours and the peers'
- ``poses``     the pose stage against the truth, and what it makes of faults
- ``decode``    what the decode of raw light fields costs and loses
- ``speed``     how long whole runs, updates of a live session and single stages take, and their memory
- ``kernels``   each native kernel against its reference and against the machine's limits
- ``skip``      what leaving work out saves, and what it costs in error
- ``stress``    what must hold, or be refused by name, on inputs that break things
- ``regression``  figures of a small benchmark against stored bounds, for every change
- ``peers``     other methods on the same inputs
- ``sweep`` ``calibrate_confidence``   how settings are chosen, on the tuning half (``python -m``)
- ``measure`` ``document`` ``plots`` ``cases``   what they share

Every module of `BENCHES` has ``run(out, *, monitor, ...) -> BenchDocument``, which writes
``OUT/<name>.json``, ``OUT/<name>.md`` and its plots.
"""

from __future__ import annotations

import importlib
from types import ModuleType

from lfrig.contracts.errors import UsageError

BENCHES = {
    "accuracy": "lfrig.bench.accuracy",
    "pareto": "lfrig.bench.pareto",
    "stress": "lfrig.bench.stress",
    "decode": "lfrig.bench.decode",
    "regression": "lfrig.bench.regression",
    "poses": "lfrig.bench.poses",
    "speed": "lfrig.bench.speed",
    "kernels": "lfrig.bench.kernels",
    "skip": "lfrig.bench.skip",
}


def load(name: str) -> ModuleType:
    """The module of a benchmark; raises `UsageError` when there is none of that name."""
    if name not in BENCHES:
        raise UsageError(f"there is no benchmark {name!r}", remedy=f"one of {', '.join(BENCHES)}")
    return importlib.import_module(BENCHES[name])
