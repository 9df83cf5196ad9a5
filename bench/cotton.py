"""`lfrig depth` and StereoSGBM on a scene of the HCI 4D light field benchmark, where its data is at hand.

The data may not be shipped with lfrig (CC BY-NC-SA); the benchmark uses a folder beside the checkout, or the one that
it is given, and leaves this part out elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.bench.document import Column, Table
from lfrig.bench.measure import in_fresh_process
from lfrig.bench.peers import sgbm_disparity
from lfrig.contracts.bench import Check
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.depth import estimate_disparity
from lfrig.processing.dpv import auto_range
from lfrig.processing.export.pfm import read_pfm
from lfrig.processing.metrics import depth_edges, disparity_scores
from lfrig.processing.model import F32
from lfrig.processing.synthesis import fill_nan
from lfrig.rig.ingest.run import open_light_field

BESIDE_CHECKOUT = Path(__file__).resolve().parents[2] / "shared" / "data" / "hci_cotton"
TRUTH_DISPARITY, TRUTH_DEPTH = "gt_disp_lowres.pfm", "gt_depth_lowres.pfm"
OURS, SGBM = "lfrig depth", "StereoSGBM on the cross of views"
BAD_PIXELS = 4.0

COLUMNS = (
    Column("method", "method"), Column("badpix_007", "BadPix .07 %", ".2f"),
    Column("badpix_003", "BadPix .03 %", ".2f"), Column("badpix_001", "BadPix .01 %", ".2f"),
    Column("mse_x100", "MSE × 100", ".2f"), Column("badpix_007_edge", "BadPix .07 % at edges", ".1f"),
    Column("cpu_s", "CPU s", ".1f"), Column("wall_s", "wall s", ".1f"), Column("peak_rss_mb", "peak MB", ".0f"),
)  # fmt: skip


def find(folder: Path | None) -> Path | None:
    """The scene's folder: the given one, or the one beside the checkout when it is there."""
    if folder is not None:
        return folder
    return BESIDE_CHECKOUT if (BESIDE_CHECKOUT / TRUTH_DISPARITY).is_file() else None


def run(folder: Path, *, threads: int, monitor: Monitor) -> tuple[list[dict[str, Any]], Table, list[Check]]:
    """Both methods on the scene in ``folder``, each in a process of its own: rows, their table, and the check."""
    truth = read_pfm(folder / TRUTH_DISPARITY)
    inverse_depth = np.asarray(1 / read_pfm(folder / TRUTH_DEPTH), np.float32)
    edges = depth_edges(inverse_depth)
    methods: dict[str, Callable[[Path, int], F32]] = {OURS: depth_alone, SGBM: sgbm_alone}
    rows = []
    for name, method in methods.items():
        disparity, cost = in_fresh_process(method, folder, threads, monitor=Muted(monitor))
        scores = disparity_scores(disparity, truth, inverse_depth=inverse_depth)
        row = {"kind": "hci", "scene": folder.name, "method": name, **scores["all"].model_dump()}
        row |= {"mse_x100": 100 * scores["all"].mse, "edge_share": float(edges.mean())}
        row |= {"wall_s": cost.wall_s, "cpu_s": cost.cpu_s, "peak_rss_mb": cost.peak_rss_mb, "runs": 1}
        if "edge" in scores:
            row["badpix_007_edge"] = scores["edge"].badpix_007
        rows.append(row)
    why = "the bound that this pipeline was built to; SPO reaches 2.59 % in 2000 s, OAVC 2.5 % with 81 views"
    check = Check.of(f"{OURS} on {folder.name}: BadPix(0.07) [%]", rows[0]["badpix_007"], "<=", BAD_PIXELS, why)
    return rows, Table(f"One light field alone: HCI {folder.name}, 7×7 views", rows, COLUMNS), [check]


def depth_alone(folder: Path, threads: int) -> F32:
    """What `lfrig depth` computes."""
    return estimate_disparity(open_light_field(folder, threads=threads), threads=threads).disparity


def sgbm_alone(folder: Path, threads: int) -> F32:
    """The peer, over the range that ours finds by itself."""
    import cv2

    if threads:
        cv2.setNumThreads(threads)
    light_field = open_light_field(folder, threads=threads)
    return fill_nan(sgbm_disparity(light_field, auto_range(light_field, threads=threads)))
