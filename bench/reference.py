"""A workload of fixed size that CPU time is compared with."""

from __future__ import annotations

import time

import numpy as np

ELEMENTS = 1 << 20
"""4 MiB per array: three of them are larger than most second-level caches, smaller than most memories."""
TRIADS, ROOTS, SORTS = 60, 30, 3


def reference_cpu_s(runs: int = 3) -> float:
    """CPU seconds (user + system, this thread) of the reference: STREAM triads (McCalpin 1995), square roots and a sort
    in NumPy, which stand for bandwidth, arithmetic and branches. The least of ``runs``, since others only add to it.
    """
    rng = np.random.default_rng(0)
    a, b = (rng.random(ELEMENTS, np.float32) for _ in range(2))
    out = np.empty_like(a)
    times = []
    for _ in range(runs):
        start = time.thread_time()
        for _ in range(TRIADS):
            np.multiply(a, np.float32(1.5), out=out)
            out += b
        for _ in range(ROOTS):
            np.sqrt(b, out=out)
            np.divide(a, out, out=out)
        for _ in range(SORTS):
            out[:] = np.sort(a)
        times.append(time.thread_time() - start)
    return min(times)
