"""A card in front of a wall, textured in closed form: depth and views are exact, and no simulator is involved."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np

from lfrig.contracts.capture import CameraSpec, OpticsSpec, PoseSpec, ViewsSpec
from lfrig.contracts.result import ReportDocument, TargetReport
from lfrig.contracts.truth import TruthCapture, TruthDocument
from lfrig.processing.export.pfm import write_pfm
from lfrig.processing.export.result import write_views
from lfrig.processing.model import LightFieldRequest
from lfrig.rig.truth import CaptureTruth

H, W = 56, 80
FOCAL_PX, BASELINE_M, FOCUS_M = 150.0, 0.012, 0.5
VIEWS, SUPERSAMPLING = 3, 3
WALL_M, CARD_M = 0.6, 0.42
CAMERA = CameraSpec(width=W, height=H, fx=FOCAL_PX, fy=FOCAL_PX, cx=39.5, cy=27.5)
IDENTITY = PoseSpec(R=((1, 0, 0), (0, 1, 0), (0, 0, 1)), t=(0, 0, 0))


def texture(x: np.ndarray, y: np.ndarray, phase: float) -> np.ndarray:
    waves = [np.sin(0.31 * x + 0.2 * y + phase + k) * 30 + np.cos(0.17 * x - 0.37 * y + 2 * k) * 30 for k in range(3)]
    return 128 + np.stack(waves, -1)


def on_card(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return (np.abs(x - 40) < 13.5) & (np.abs(y - 28) < 8.5)


@functools.cache
def scene(phase: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Depth of the centre view, float32 [H, W] m, and exact views, uint8 [VIEWS, VIEWS, H, W, 3], antialiased.

    The phase changes the textures, not the depth.
    """
    bf = BASELINE_M * FOCAL_PX
    wall, card = (bf * (1 / z - 1 / FOCUS_M) for z in (WALL_M, CARD_M))
    views = np.zeros((VIEWS, VIEWS, H, W, 3))
    taps = (np.arange(SUPERSAMPLING) - (SUPERSAMPLING - 1) / 2) / SUPERSAMPLING
    for r, c in np.ndindex(VIEWS, VIEWS):
        dr, dc = r - VIEWS // 2, c - VIEWS // 2
        for dy in taps:
            for dx in taps:
                y, x = np.mgrid[0:H, 0:W] + np.array([dy, dx])[:, None, None]
                near = on_card(x + dc * card, y + dr * card)[..., None]
                front = texture(x + dc * card, y + dr * card, 2 + phase)
                back = texture(x + dc * wall, y + dr * wall, phase)
                views[r, c] += np.where(near, front, back) / SUPERSAMPLING**2
    y, x = np.mgrid[0:H, 0:W]
    return np.where(on_card(x, y), CARD_M, WALL_M).astype(np.float32), np.rint(views).astype(np.uint8)


def capture_truth(noise_sigma: float = 0.0) -> CaptureTruth:
    depth_m, views = scene()
    return CaptureTruth("007", 1 / depth_m, FOCAL_PX, BASELINE_M, FOCUS_M, views, noise_sigma)


def request(baseline_m: float = BASELINE_M) -> LightFieldRequest:
    return LightFieldRequest(baseline_m, FOCUS_M, VIEWS, VIEWS)


def write_truth(folder: Path, phases: dict[str, float] | None = None) -> None:
    """The truth of captures by id, each with the phase of its textures."""
    captures = {}
    for name, phase in (phases or {"007": 0.0}).items():
        depth_m, views = scene(phase)
        captures[name] = TruthCapture(
            kind="light_field", camera=CAMERA, optics=OpticsSpec(baseline_m=BASELINE_M, focus_distance_m=FOCUS_M),
            pose=IDENTITY, turntable_deg=0.0, views=ViewsSpec(rows=VIEWS, cols=VIEWS),
        )  # fmt: skip
        place = folder / "captures" / name
        write_views(place / "views", views)
        np.save(place / "depth.npy", depth_m)
    TruthDocument(scene="card", seed=0, captures=captures).save(folder / "truth.json")


def write_result_folder(
    folder: Path,
    disparity: np.ndarray,
    views: np.ndarray,
    *,
    name: str = "007",
    session: str | None = None,
    optics: LightFieldRequest | None = None,
) -> None:
    """A result as `lfrig process` would leave it, with this disparity and these views."""
    optics = optics or request()
    folder.mkdir(parents=True)
    write_pfm(folder / "disparity.pfm", disparity)
    np.save(folder / "inverse_depth.npy", optics.inverse_depth(disparity, FOCAL_PX))
    for flat in ("disparity_sigma", "confidence"):
        np.save(folder / f"{flat}.npy", np.ones((H, W), np.float32))
    write_views(folder / "views", views)
    target = TargetReport(
        id=name, baseline_m=optics.baseline_m, focus_distance_m=optics.focus_distance_m, fx=FOCAL_PX,
        width=W, height=H, rows=VIEWS, cols=VIEWS,
    )  # fmt: skip
    ReportDocument(preset="fast", version="0", target=target, session=session).save(folder / "report.json")
