"""``--format hci``: the folder layout of the HCI 4D light field benchmark.

``input_CamNNN.png`` (NNN = row · cols + col), ``gt_disp_lowres.pfm``, ``gt_depth_lowres.pfm`` and ``parameters.cfg``.
The benchmark's disparity has the sign and the unit of ours, and its camera the focal length in pixels
``focal_length_mm / sensor_size_mm · max(width, height)`` (Honauer et al., ACCV 2016, and its tools); *cotton*'s ground
truth agrees with that to 4 digits. The "ground truth" written here is the estimate: the layout has no other name.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from lfrig.contracts.files import disk_errors
from lfrig.contracts.progress import Monitor
from lfrig.processing.export.content import Content
from lfrig.processing.export.pfm import write_pfm
from lfrig.processing.export.png import to_8_bit, write_png
from lfrig.processing.model import F64

SENSOR_MM = 35.0
"""Nominal sensor size: the layout wants millimetres, only the ratio to the focal length means anything."""


def export_hci(content: Content, out: Path, monitor: Monitor) -> None:
    """Fill ``out`` with 8-bit views, the maps that are known, and ``parameters.cfg``."""
    views = to_8_bit(content.views)
    rows, cols = views.shape[:2]
    with monitor.task("hci", rows * cols):
        for row, col in np.ndindex(rows, cols):
            write_png(out / f"input_Cam{row * cols + col:03d}.png", views[row, col])
            monitor.advance()
    depth = content.depth_m()
    if content.disparity is not None:
        write_pfm(out / "gt_disp_lowres.pfm", content.disparity)
    if depth is not None:
        write_pfm(out / "gt_depth_lowres.pfm", depth)
    with disk_errors(out):
        (out / "parameters.cfg").write_text(parameters(content), encoding="utf-8")


def parameters(content: Content) -> str:
    """The text of ``parameters.cfg``; what is not known is left out, never invented."""
    rows, cols, height, width = content.views.shape[:4]
    intrinsics: dict[str, object] = {"image_resolution_x_px": width, "image_resolution_y_px": height}
    if content.focal_px is not None:
        intrinsics |= {
            "focal_length_mm": content.focal_px * SENSOR_MM / max(width, height),
            "sensor_size_mm": SENSOR_MM,
        }
    extrinsics: dict[str, object] = {"num_cams_x": cols, "num_cams_y": rows}
    if content.baseline_m is not None:
        extrinsics["baseline_mm"] = content.baseline_m * 1e3
    if content.focus_distance_m is not None:
        extrinsics["focus_distance_m"] = content.focus_distance_m
    extrinsics |= _camera_position(content)
    return "\n".join(
        _section(name, values)
        for name, values in (("intrinsics", intrinsics), ("extrinsics", extrinsics), ("meta", _meta(content)))
    )


def blender_angles(rotation: F64) -> tuple[float, float, float]:
    """XYZ Euler angles [rad] of a camera in Blender, whose cameras look along −z with y up, from our R [3, 3]."""
    world = rotation.T @ np.diag([1.0, -1.0, -1.0])  # columns: Blender's camera axes in the world
    y = -math.asin(max(-1.0, min(1.0, world[2, 0])))
    return math.atan2(world[2, 1], world[2, 2]), y, math.atan2(world[1, 0], world[0, 0])


def _camera_position(content: Content) -> dict[str, object]:
    if content.rotation is None or content.translation is None:
        return {}
    centre = -content.rotation.T @ content.translation
    position: dict[str, object] = {f"center_cam_{axis}_m": float(m) for axis, m in zip("xyz", centre, strict=True)}
    for axis, angle in zip("xyz", blender_angles(content.rotation), strict=True):
        position[f"center_cam_r{axis}_rad"] = angle
    return position


def _meta(content: Content) -> dict[str, object]:
    meta: dict[str, object] = {
        "scene": content.name,
        "category": "lfrig",
        "depth_map_scale": 1.0,
    }
    if content.disparity is not None and np.isfinite(content.disparity).any():
        low, high = np.nanmin(content.disparity), np.nanmax(content.disparity)
        meta |= {"disp_min": math.floor(low * 10) / 10, "disp_max": math.ceil(high * 10) / 10}
        # The frustum is the range that an estimator should search: a little more than what is there.
        meta |= {"frustum_disp_min": math.floor(low) - 0.5, "frustum_disp_max": math.ceil(high) + 0.5}
    return meta


def _section(name: str, values: dict[str, object]) -> str:
    return f"[{name}]\n" + "".join(f"{key} = {value}\n" for key, value in values.items())
