"""Evidence that is not computed twice: it is known by a hash of everything that it depends on.

The key covers the pixels, the layout of the views, the disparities that may occur, the knobs, the switches and the
code itself, so that a newer version never takes over what an older one computed.
"""

from __future__ import annotations

import functools
import hashlib
from collections import OrderedDict
from pathlib import Path
from typing import Protocol

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.dpv import DpvSettings
from lfrig.processing.model import Evidence, LightField
from lfrig.processing.skipping import Skips


class EvidenceStore(Protocol):
    """Keeps evidence by its key. A store may forget; it never gives anything else than what was saved."""

    def load(self, key: str) -> Evidence | None:
        """What was saved under the key, or None."""

    def save(self, key: str, evidence: Evidence) -> None:
        """Keep evidence."""


class MemoryStore:
    """Evidence in memory, the latest used first, up to ``limit_bytes`` (the newest entry always stays)."""

    def __init__(self, limit_bytes: int = 512 << 20) -> None:
        self.limit_bytes = limit_bytes
        self._kept: OrderedDict[str, Evidence] = OrderedDict()

    def load(self, key: str) -> Evidence | None:
        """See `EvidenceStore`."""
        if key not in self._kept:
            return None
        self._kept.move_to_end(key)
        return self._kept[key]

    def save(self, key: str, evidence: Evidence) -> None:
        """See `EvidenceStore`."""
        self._kept[key] = evidence
        self._kept.move_to_end(key)
        while len(self._kept) > 1 and self.held_bytes > self.limit_bytes:
            self._kept.popitem(last=False)

    @property
    def held_bytes(self) -> int:
        """Size of all that is kept."""
        return sum(size_bytes(evidence) for evidence in self._kept.values())


def size_bytes(evidence: Evidence) -> int:
    """Bytes of the arrays of one light field's evidence."""
    return evidence.probability.nbytes + evidence.disparity.nbytes + evidence.confidence.nbytes


def evidence_key(
    light_field: LightField, expected_px: tuple[float, float] | None, settings: DpvSettings, skips: Skips
) -> str:
    """Hash of all that evidence depends on, 64 hexadecimal digits.

    Parameters
    ----------
    expected_px : (lo, hi), optional
        Disparities that the rig allows [px per view step].
    """
    total = hashlib.sha256(code_digest())
    total.update(repr((light_field.views.shape, expected_px, settings, skips)).encode())
    total.update(np.ascontiguousarray(light_field.views).data)
    return total.hexdigest()


@functools.cache
def code_digest() -> bytes:
    """Hash of the code that evidence is computed with: this package's modules and the native core."""
    here = Path(__file__).parent
    total = hashlib.sha256(b"native" if load_native("lfrig.processing.kernels._native") else b"numpy")
    for pattern in ("*.py", "kernels/*.py", "kernels/_native*"):
        for path in sorted(here.glob(pattern)):
            total.update(path.read_bytes())
    return total.digest()
