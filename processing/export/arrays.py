"""``--format pfm`` and ``--format npy``: the maps, and for NumPy the views, under plain names.

``disparity`` and ``disparity_sigma`` px per view step, ``depth_m`` m along the optical axis, ``confidence`` 0..1;
NaN = unknown.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.progress import Monitor
from lfrig.processing.export.content import Content
from lfrig.processing.export.pfm import write_pfm
from lfrig.processing.model import F32


def export_pfm(content: Content, out: Path, monitor: Monitor) -> None:
    """Fill ``out`` with one PFM per map; raises `BadInput` when there is no disparity."""
    content.require_disparity()
    with monitor.task("pfm"):
        for name, array in maps(content).items():
            write_pfm(out / f"{name}.pfm", array)
            monitor.advance()


def export_npy(content: Content, out: Path, monitor: Monitor) -> None:
    """Fill ``out`` with ``views.npy`` [rows, cols, H, W, 3] and one array per known map."""
    arrays: dict[str, NDArray[np.generic]] = {"views": content.views, **maps(content)}
    with monitor.task("npy", len(arrays)):
        for name, array in arrays.items():
            np.save(out / f"{name}.npy", np.ascontiguousarray(array), allow_pickle=False)
            monitor.advance()


def maps(content: Content) -> dict[str, F32]:
    """The known maps by the names that they are exported under, float32 [H, W]."""
    named = {
        "disparity": content.disparity,
        "disparity_sigma": content.sigma,
        "depth_m": content.depth_m(),
        "confidence": content.confidence,
    }
    return {name: array for name, array in named.items() if array is not None}
