"""A small, complete `ProcessResult` made without the pipeline: a slanted wall with a ball in front, on a turntable."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfrig.contracts.progress import Notice
from lfrig.contracts.result import StageReport
from lfrig.processing.export.result import write_result
from lfrig.processing.model import (
    Anchors,
    Camera,
    Evidence,
    LightField,
    LightFieldRequest,
    Optics,
    Photo,
    Pose,
    ScaleFit,
    Source,
    Surface,
    SynthesizedLightField,
)
from lfrig.processing.pipeline import ProcessResult, SourceResult

WIDTH, HEIGHT = 96, 64
HOSTILE_ID = "<b>shot</b> & 'co'"
"""An id that would break a page which does not escape what it shows."""


def texture(width: int, height: int, seed: int) -> np.ndarray:
    """Smooth colourful noise at several scales, uint8 [H, W, 3]."""
    rng = np.random.default_rng(seed)
    total = np.zeros((height, width, 3), np.float32)
    for cells, weight in ((4, 1.0), (12, 0.6), (32, 0.35)):
        coarse = rng.random((max(2, cells * height // width), cells, 3)).astype(np.float32)
        total += weight * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    total = (total - total.min()) / np.ptp(total)
    return np.rint(20 + 215 * total).astype(np.uint8)


def inverse_depth_map(width: int, height: int, shift: float = 0.0) -> np.ndarray:
    """float32 [H, W] 1/m: a wall from 0.66 to 0.56 m and a ball at 0.40 m, moved right by ``shift`` widths."""
    ys, xs = np.mgrid[:height, :width].astype(np.float32)
    wall = 1 / (0.66 - 0.10 * xs / width)
    r2 = ((xs / width - 0.45 - shift) ** 2 + ((ys - 0.55 * height) / width) ** 2) / 0.2**2
    ball = 1 / (0.44 - 0.04 * np.sqrt(np.clip(1 - r2, 0, 1)))
    return np.where(r2 < 1, ball, wall).astype(np.float32)


def render(image: np.ndarray, disparity: np.ndarray, rows: int, cols: int) -> np.ndarray:
    """Views [rows, cols, H, W, 3] of a disparity map, by a few fixed-point steps; occlusion is not modelled."""
    height, width = disparity.shape
    ys, xs = np.mgrid[:height, :width].astype(np.float32)
    views = np.empty((rows, cols, height, width, 3), image.dtype)
    for row, col in np.ndindex(rows, cols):
        dv, du = np.float32(row - (rows - 1) / 2), np.float32(col - (cols - 1) / 2)
        field = disparity
        for _ in range(4):
            field = cv2.remap(disparity, xs + du * field, ys + dv * field, 1, borderMode=cv2.BORDER_REPLICATE)
        x, y = xs + du * field, ys + dv * field
        views[row, col] = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    views[rows // 2, cols // 2] = image
    return views


def look_at_axis(angle_deg: float, distance_m: float = 0.5, height_m: float = 0.2) -> Pose:
    """A camera on a ring around the z axis that looks at the origin."""
    a = np.deg2rad(angle_deg)
    centre = np.array([distance_m * np.cos(a), distance_m * np.sin(a), height_m])
    forward = -centre / np.linalg.norm(centre)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    return Pose(rotation, -rotation @ centre)


def make_source(index: int, angle_deg: float, width: int, height: int) -> SourceResult:
    """One source whose evidence is a Gaussian around the truth."""
    camera = Camera.centred(width, height, 1.93 * width)
    fit = ScaleFit(a=1.4, c=2.15, residual=0.011, inliers=0.94, anchors=120 + index)
    inverse_depth = inverse_depth_map(width, height, 0.05 * index)
    disparity = fit.disparity(inverse_depth)
    planes = np.linspace(-0.6, 0.6, 25, dtype=np.float32)
    probability = np.exp(-(((planes - disparity[..., None]) / 0.06) ** 2)) + 0.002
    probability /= probability.sum(-1, keepdims=True)
    evidence = Evidence(
        probability.astype(np.float16), (-0.6, 0.05), disparity, probability.max(-1).astype(np.float32), 1.5, 48
    )
    name = HOSTILE_ID if index == 0 else f"{index:03d}"
    views = render(texture(width, height, 10 + index), disparity, 5, 5)
    pose = look_at_axis(angle_deg)
    light_field = LightField(name, views, camera, Optics(0.00071, 0.46), pose, angle_deg)
    rng = np.random.default_rng(index)
    xy = rng.uniform([0, 0], [width - 1, height - 1], (40, 2))
    depth = 1 / inverse_depth[xy[:, 1].astype(int), xy[:, 0].astype(int)].astype(np.float64)
    rays = np.c_[(xy - [camera.cx, camera.cy]) / camera.focal_px, np.ones(len(xy))] * depth[:, None]
    anchors = Anchors(xy, depth, (rays - pose.translation) @ pose.rotation)
    return SourceResult(Source(light_field, camera, pose, evidence, fit), anchors, 0.02 * index)


def make_result(
    width: int = WIDTH, height: int = HEIGHT, *, dtype: type = np.uint8, unknown: bool = True
) -> ProcessResult:
    """A result with three sources, a warning, four stages and (``unknown``) a corner that nothing is known of."""
    camera = Camera.centred(width, height, 1.93 * width)
    request = LightFieldRequest(0.00067 * 541 / width * 4, 0.46)
    inverse_depth = inverse_depth_map(width, height)
    image = texture(width, height, 1)
    full = request.disparity(inverse_depth, camera.focal_px)
    if dtype == np.uint16:
        image = image.astype(np.uint16) * 257 - np.arange(width, dtype=np.uint16)[:, None]
    views = render(image, full, request.rows, request.cols)
    if unknown:
        inverse_depth[: height // 6, -width // 8 :] = np.nan
    ys, xs = np.mgrid[:height, :width].astype(np.float32)
    confidence = np.where(np.isfinite(inverse_depth), 0.97 - 0.3 * ys / height, 0).astype(np.float32)
    sigma = (0.02 + 0.05 * xs / width).astype(np.float32)
    seen = np.where(np.isfinite(inverse_depth), 3, 0).astype(np.float32)
    surface = Surface(inverse_depth, confidence, sigma, seen)
    pose = look_at_axis(20.0, 0.52)
    light_field = SynthesizedLightField(
        views, request.disparity(inverse_depth, camera.focal_px), surface, request, camera
    )
    stages = (
        StageReport(
            name="evidence", wall_s=1.9, cpu_s=3.4, peak_rss_mb=310, work_done=18, work_skipped=7, unit="planes"
        ),
        StageReport(name="poses", wall_s=0.0, cpu_s=0.0, peak_rss_mb=310),
        StageReport(
            name="fusion", wall_s=0.8, cpu_s=1.5, peak_rss_mb=420, work_done=96, work_skipped=32, unit="planes"
        ),
        StageReport(name="synthesis", wall_s=0.5, cpu_s=0.9, peak_rss_mb=512, work_done=48, unit="views"),
    )
    return ProcessResult(
        light_field=light_field, target=Photo("900", image, camera, pose), target_camera=camera, target_pose=pose,
        sources=tuple(make_source(i, a, width, height) for i, a in enumerate((0.0, 15.0, 40.0))), stages=stages,
        notices=(Notice("narrow-range", "the disparity range of 001 is narrow: <0.2 px"),), poses_method="given",
        metric=True, preset="fast", native=False, threads=2, options={"resolution": np.float32(1), "limit": np.inf},
    )  # fmt: skip


@pytest.fixture(scope="session")
def build() -> Callable[..., ProcessResult]:
    """`make_result`, for the tests that need another one."""
    return make_result


@pytest.fixture(scope="session")
def result() -> ProcessResult:
    """8-bit, 96×64, 7×7 views."""
    return make_result()


@pytest.fixture(scope="session")
def _written(result: ProcessResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("written") / "900-fast"
    folder.mkdir()
    write_result(folder, result, session="bench")
    return folder


@pytest.fixture
def result_folder(_written: Path, tmp_path: Path) -> Path:
    """A result on disk that the test may damage."""
    return Path(shutil.copytree(_written, tmp_path / "900-fast"))
