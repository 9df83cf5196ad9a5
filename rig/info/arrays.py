"""Descriptions of float maps and arrays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lfrig.contracts.errors import BadInput
from lfrig.rig.info.text import Description


def describe_pfm(path: Path) -> Description:
    """A portable float map; raises `BadInput` when it is damaged."""
    from lfrig.processing.export.pfm import read_pfm

    return {"type": "pfm", **_facts(read_pfm(path), "float map")}


def describe_npy(path: Path) -> Description:
    """A NumPy array of numbers; raises `BadInput` for anything else."""
    import numpy as np

    try:
        array = np.load(path, mmap_mode="r", allow_pickle=False)
    except (ValueError, OSError, EOFError):
        array = None
    if not isinstance(array, np.ndarray) or not np.issubdtype(array.dtype, np.number):
        raise BadInput("is not an array of numbers", path=path, code="not-npy", remedy="restore the file")
    return {"type": "npy", **_facts(array, "array")}


def _facts(array: Any, what: str) -> Description:
    import numpy as np

    finite = array[np.isfinite(array)]
    return {
        "summary": f"{what}, {array.dtype} [{', '.join(map(str, array.shape))}]",
        "shape": list(array.shape),
        "dtype": str(array.dtype),
        "min": float(finite.real.min()) if finite.size else None,
        "max": float(finite.real.max()) if finite.size else None,
        "not_finite": int(array.size - finite.size),
    }
