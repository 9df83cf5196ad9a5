"""Disparity of one light field alone, in a folder of its own.

Beside what `lfrig.processing.report.depth_page.write_depth_result` writes: ``inverse_depth.npy``, float32 [H, W] 1/m,
where baseline, focus and focal length are known; and ``depth.json``, what was found out.
"""

from __future__ import annotations

import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.contracts.files import (
    atomic_folder,
    atomic_write_bytes,
    atomic_write_text,
    refuse_existing,
    refuse_replacing,
)
from lfrig.contracts.progress import Monitor
from lfrig.processing.depth import DepthMap, estimate_disparity
from lfrig.processing.model import F32, LightField


@dataclass(frozen=True)
class DepthOutcome:
    """The folder that was written, and what depth.json says."""

    folder: Path
    document: dict[str, Any]


def depth_of_light_field(
    source: Path,
    out: Path,
    disparity_range: tuple[float, float] | None = None,
    *,
    overwrite: bool = False,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> DepthOutcome:
    """Estimate the disparity of a light field in any format that can be ingested, and write it to ``out``.

    Parameters
    ----------
    disparity_range : (float, float), optional
        (lo, hi) px per view step; found from the views by default.

    Raises
    ------
    BadInput
        The light field cannot be used, or ``out`` exists (seen before any work).
    DiskError
        Writing failed.
    """
    from lfrig.processing.report.depth_page import write_depth_result
    from lfrig.rig.ingest import open_light_field

    monitor = monitor or Monitor()
    refuse_existing(out, overwrite=overwrite)
    refuse_replacing(out, source)
    light_field = open_light_field(source, threads=threads, monitor=monitor)
    with atomic_folder(out, overwrite=overwrite) as folder:
        depth = estimate_disparity(light_field, disparity_range, threads=threads, monitor=monitor)
        document = _document(light_field, depth)
        write_depth_result(folder, light_field, depth)
        inverse_depth = inverse_depth_of(light_field, depth.disparity)
        if inverse_depth is not None:
            stream = io.BytesIO()
            np.save(stream, inverse_depth, allow_pickle=False)
            atomic_write_bytes(folder / "inverse_depth.npy", stream.getvalue())
        atomic_write_text(folder / "depth.json", json.dumps(document, indent=1, allow_nan=False) + "\n")
    return DepthOutcome(out, document)


def inverse_depth_of(light_field: LightField, disparity: F32) -> F32 | None:
    """1/z = δ/(b·F) + 1/z_f, float32 [H, W] 1/m; None where the optics are not known."""
    optics, camera = light_field.optics, light_field.camera
    if camera is None or optics.baseline_m is None or optics.focus_distance_m is None:
        return None
    return np.asarray(disparity / (optics.baseline_m * camera.focal_px) + 1 / optics.focus_distance_m, np.float32)


def _document(light_field: LightField, depth: DepthMap) -> dict[str, Any]:
    rows, cols = light_field.angular
    return {
        "light_field": light_field.id, "width": light_field.width, "height": light_field.height,
        "rows": rows, "cols": cols, "disparity_range_px": [float(bound) for bound in depth.disparity_range],
        "planes": depth.evidence.planes, "noise_sigma": float(depth.evidence.noise_sigma),
        "mean_confidence": float(np.mean(depth.confidence)),
    }  # fmt: skip
