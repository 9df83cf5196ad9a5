"""Disparity evidence of a session's light fields, computed once: ``SESSION/cache/evidence/<hash>/``.

Another target of the same session then costs no evidence, and a further source only its own. Safe to delete at any
time; the oldest entries go when there are more than `LIMIT_BYTES`.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import DiskError
from lfrig.contracts.files import atomic_folder, atomic_write_text
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import Evidence

LIMIT_BYTES = 2 << 30
ARRAYS = {"probability": (np.uint16, 3), "disparity": (np.float32, 2), "confidence": (np.float32, 2)}
FIGURES = "evidence.json"


class EvidenceCache:
    """An `lfrig.processing.reuse.EvidenceStore` in a folder.

    Files are not forced to the disk, which would cost more than they save; what is read is checked instead.

    Parameters
    ----------
    folder : Path
        Made when something is saved.
    monitor : Monitor, optional
        Warned with ``cache-not-written`` when there is no room; processing goes on.
    """

    def __init__(self, folder: Path, monitor: Monitor | None = None, *, limit_bytes: int = LIMIT_BYTES) -> None:
        self.folder = folder
        self.limit_bytes = limit_bytes
        self._monitor = monitor or Monitor()

    def load(self, key: str) -> Evidence | None:
        """What was saved under the key; None when it is not there, or damaged. Arrays are mapped, not read."""
        place = self.folder / key
        try:
            figures = json.loads((place / FIGURES).read_text(encoding="utf-8"))
            arrays = {name: np.load(place / f"{name}.npy", mmap_mode="r", allow_pickle=False) for name in ARRAYS}
            first, step = figures["planes_px"]
            noise, views, tested = figures["noise_sigma"], figures["views_used"], figures["occlusion_tested"]
            sums = figures["sums"]
            found = Evidence(
                arrays["probability"], (float(first), float(step)), np.asarray(arrays["disparity"]),
                np.asarray(arrays["confidence"]), float(noise), int(views), float(tested),
            )  # fmt: skip
        except (OSError, ValueError, KeyError, TypeError, EOFError):
            return None
        if any(arrays[name].dtype != kind or arrays[name].ndim != axes for name, (kind, axes) in ARRAYS.items()):
            return None
        if not found.probability.shape[:2] == found.disparity.shape == found.confidence.shape:
            return None
        if sums != {name: _sum(array) for name, array in arrays.items()}:
            return None  # written when the machine stopped
        with contextlib.suppress(OSError):
            os.utime(place)  # the age that decides what goes first
        return found

    def save(self, key: str, evidence: Evidence) -> None:
        """Keep evidence; entries appear whole or not at all."""
        figures = {
            "planes_px": list(evidence.planes_px), "noise_sigma": evidence.noise_sigma,
            "views_used": evidence.views_used, "occlusion_tested": evidence.occlusion_tested,
            "sums": {name: _sum(getattr(evidence, name)) for name in ARRAYS},
        }  # fmt: skip
        try:
            with atomic_folder(self.folder / key, overwrite=True, sync=False) as staging:
                for name in ARRAYS:
                    np.save(staging / f"{name}.npy", getattr(evidence, name))
                atomic_write_text(staging / FIGURES, json.dumps(figures) + "\n")
        except DiskError as error:
            self._monitor.warn("cache-not-written", f"evidence is not kept: {error.message}")
            return
        self._prune(key)

    def _prune(self, newest: str) -> None:
        """Remove the entries that were not used for longest until the rest fits."""
        entries = []
        for place in self.folder.iterdir():
            with contextlib.suppress(OSError):
                size = sum(path.stat().st_size for path in place.iterdir())
                entries.append((place.stat().st_mtime_ns, size, place))
        total = sum(size for _, size, _ in entries)
        for _, size, place in sorted(entries):
            if total <= self.limit_bytes:
                break
            if place.name != newest:
                shutil.rmtree(place, ignore_errors=True)
                total -= size


class Pending:
    """A store that writes to a cache only when told: a session that was refused stays as it was."""

    def __init__(self, cache: EvidenceCache) -> None:
        self._cache = cache
        self._kept: dict[str, Evidence] = {}

    def load(self, key: str) -> Evidence | None:
        """See `EvidenceCache.load`."""
        return self._kept.get(key) or self._cache.load(key)

    def save(self, key: str, evidence: Evidence) -> None:
        """Keep evidence until `write`."""
        self._kept[key] = evidence

    def write(self) -> None:
        """Hand everything on to the cache."""
        for key, evidence in self._kept.items():
            self._cache.save(key, evidence)
        self._kept.clear()


def _sum(array: NDArray[Any]) -> int:
    """Sum of all bytes in words of two, modulo 2^64: pages that never reached the disk read as zeros and change it."""
    return int(np.ascontiguousarray(array).view(np.uint16).sum(dtype=np.uint64))
