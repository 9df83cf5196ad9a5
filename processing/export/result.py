"""The files of a result folder: arrays, views and report.json.

========================  ==========================================================================
``disparity.pfm``         float32 [H, W] px per view step, centre view; NaN = unknown
``disparity_sigma.npy``   float32 [H, W] px per view step
``confidence.npy``        float32 [H, W], probability that the disparity is right within 0.1 px
``inverse_depth.npy``     float32 [H, W] 1/m
``views/RR_CC.png``       8-bit sRGB (16-bit for uint16 views); the centre view is the photo, bit for bit
``report.json``           `ReportDocument`
========================  ==========================================================================
"""

from __future__ import annotations

import io
import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.capture import PoseSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import disk_errors
from lfrig.contracts.result import ReportDocument, SourceReport, TargetReport, WarningReport
from lfrig.processing.export.pfm import read_pfm, write_pfm
from lfrig.processing.export.png import read_png, write_png
from lfrig.processing.model import F32, Image, LightFieldRequest, Pose

if TYPE_CHECKING:
    from lfrig.processing.pipeline import ProcessResult, SourceResult

DISPARITY, SIGMA = "disparity.pfm", "disparity_sigma.npy"
CONFIDENCE, INVERSE_DEPTH = "confidence.npy", "inverse_depth.npy"
REPORT, VIEWS = "report.json", "views"


@dataclass(frozen=True)
class LoadedResult:
    """A result read from disk. Arrays are float32 [H, W] in the units of the module's table."""

    folder: Path
    report: ReportDocument
    disparity: F32
    disparity_sigma: F32
    confidence: F32
    inverse_depth: F32

    @property
    def request(self) -> LightFieldRequest:
        """Baseline, focus distance and number of views that the result was made for."""
        target = self.report.target
        return LightFieldRequest(target.baseline_m, target.focus_distance_m, target.rows, target.cols)

    @cached_property
    def views(self) -> Image:
        """uint8 or uint16 [rows, cols, H, W, 3], read when first asked for; raises `BadInput`."""
        return read_views(self.folder / VIEWS, self.report.target)


def view_name(row: int, col: int) -> str:
    """File name of a view, zero-based."""
    return f"{row:02d}_{col:02d}.png"


def write_result(folder: Path, result: ProcessResult, *, session: str | None) -> ReportDocument:
    """Write the files of a result into an existing, empty ``folder`` and return its report.

    The caller makes the whole atomic (`lfrig.contracts.files.atomic_folder`).

    Raises
    ------
    DiskError
        Writing failed.
    """
    light_field = result.light_field
    surface = light_field.surface
    write_pfm(folder / DISPARITY, light_field.disparity)
    _write_npy(
        folder / SIGMA,
        surface.sigma * np.float32(light_field.request.baseline_m * light_field.camera.focal_px),
    )
    _write_npy(folder / CONFIDENCE, surface.confidence)
    _write_npy(folder / INVERSE_DEPTH, surface.inverse_depth)
    write_views(folder / VIEWS, _with_photo(light_field.views, result.target.image, result.target.image8))
    report = report_document(result, session=session)
    report.save(folder / REPORT)
    return report


def load_result(folder: Path) -> LoadedResult:
    """Read a result folder; the views are read when they are first used.

    Raises
    ------
    BadInput
        ``folder`` is no result, or one of its files is missing, damaged or of another size than report.json says.
    """
    if not (folder / REPORT).is_file():
        raise BadInput("is not a result folder (no report.json)", path=folder, code="not-a-result",
                       remedy="give a folder that `lfrig process` wrote")  # fmt: skip
    report = ReportDocument.load(folder / REPORT)
    arrays = [read_pfm(folder / DISPARITY)]
    arrays += [_read_npy(folder / name) for name in (SIGMA, CONFIDENCE, INVERSE_DEPTH)]
    size = (report.target.height, report.target.width)
    for name, array in zip((DISPARITY, SIGMA, CONFIDENCE, INVERSE_DEPTH), arrays, strict=True):
        if array.shape != size:
            raise BadInput(
                f"is {list(array.shape)}, report.json says {list(size)}", path=folder / name, code="size-mismatch",
                remedy="process again: the folder mixes two results",
            )  # fmt: skip
    return LoadedResult(folder, report, *arrays)


def write_views(folder: Path, views: Image) -> None:
    """Write views, uint8 or uint16 [rows, cols, H, W, 3], as ``folder/RR_CC.png``."""
    with disk_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    for row, col in np.ndindex(views.shape[:2]):
        write_png(folder / view_name(row, col), views[row, col])


def read_views(folder: Path, target: TargetReport) -> Image:
    """Read ``folder/RR_CC.png``, uint8 or uint16 [rows, cols, H, W, 3]; raises `BadInput` for a missing or odd one."""
    size = (target.height, target.width)
    views: Image | None = None
    for row, col in np.ndindex(target.rows, target.cols):
        path = folder / view_name(row, col)
        image = read_png(path)
        if views is None:
            views = np.empty((target.rows, target.cols, *size, 3), image.dtype)
        if image.shape[:2] != size or image.dtype != views.dtype:
            raise BadInput(
                f"is {image.dtype} {list(image.shape)}, unlike the other views or report.json",
                path=path,
                code="size-mismatch",
                remedy="process again: the folder mixes two results",
            )
        views[row, col] = image
    if views is None:
        raise BadInput("says that there are no views", path=folder.parent / REPORT, field="target.rows")
    return views


def report_document(result: ProcessResult, *, session: str | None) -> ReportDocument:
    """What report.json says of a result."""
    light_field, request = result.light_field, result.light_field.request
    height, width = light_field.disparity.shape
    return ReportDocument(
        preset=result.preset, native=result.native, version=_version(), threads=result.threads, session=session,
        target=TargetReport(
            id=result.target.id, baseline_m=request.baseline_m, focus_distance_m=request.focus_distance_m,
            fx=light_field.camera.focal_px, width=width, height=height, rows=request.rows, cols=request.cols,
            pose=pose_spec(result.target_pose), metric=result.metric, scale_source=result.scale_source,
        ),
        poses=result.poses_method, stages=list(result.stages),
        sources=[_source_report(source) for source in result.sources],
        warnings=[WarningReport(code=notice.code, message=notice.message) for notice in result.notices],
        options=_plain(result.options),
    )  # fmt: skip


def pose_spec(pose: Pose) -> PoseSpec:
    """A pose as it is written on disk."""
    return PoseSpec(
        R=pose.rotation.tolist(), t=pose.translation.tolist(), sigma_deg=pose.sigma_deg, sigma_m=pose.sigma_m
    )


def _source_report(result: SourceResult) -> SourceReport:
    source, fit = result.source, result.source.scale
    return SourceReport(
        id=source.light_field.id, a=fit.a, c=fit.c, residual=fit.residual, inliers=fit.inliers, anchors=fit.anchors,
        angle_residual_deg=result.angle_residual_deg, pose=pose_spec(source.pose),
    )  # fmt: skip


def _with_photo(views: Image, photo: Image, photo8: Image) -> Image:
    """``views`` with the photo's own pixels in the centre; a grid without a true centre stays as it is."""
    rows, cols = views.shape[:2]
    if rows % 2 == 0 or cols % 2 == 0:
        return views
    views = views.copy()
    views[rows // 2, cols // 2] = photo if photo.dtype == views.dtype else photo8
    return views


def _plain(value: Any) -> Any:
    """``value`` with NumPy scalars, tuples and paths turned into what JSON has."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON has no infinity
    return value if isinstance(value, (str, int, float, bool, type(None))) else str(value)


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("lfrig")
    except PackageNotFoundError:
        return "0+source"  # run from a checkout that was never installed


def _write_npy(path: Path, array: F32) -> None:
    stream = io.BytesIO()
    np.save(stream, np.ascontiguousarray(array, np.float32), allow_pickle=False)
    with disk_errors(path):
        path.write_bytes(stream.getvalue())


def _read_npy(path: Path) -> F32:
    try:
        array: NDArray[Any] = np.load(path, allow_pickle=False)
    except FileNotFoundError:
        raise BadInput("does not exist", path=path, code="missing-file", remedy="process again") from None
    except (ValueError, OSError, EOFError):
        raise BadInput("is not a readable NumPy array", path=path, code="not-npy", remedy="process again") from None
    if array.dtype != np.float32:
        raise BadInput(f"holds {array.dtype}, expected float32", path=path, code="not-npy", remedy="process again")
    return array
