"""Small captures for the tests of sessions, ingest and info, made from closed formulas."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.contracts.capture import CameraSpec, CaptureDocument, OpticsSpec, ViewsSpec
from lfrig.processing.model import U8
from lfrig.rig.session.images import write_png

H, W = 12, 16
IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]


def view(row: int, col: int, height: int = H, width: int = W, seed: int = 0) -> U8:
    """A picture that tells (row, col, seed) apart from all others: [height, width, 3]."""
    y, x = np.mgrid[:height, :width]
    channels = [x * 7 + row * 31 + seed, y * 9 + col * 29 + seed, (x + y) * 3 + row * 5 + col * 11 + seed * 13]
    return np.stack([channel % 251 for channel in channels], -1).astype(np.uint8)


def views(rows: int = 3, cols: int = 3, height: int = H, width: int = W, seed: int = 0) -> U8:
    """[rows, cols, height, width, 3]."""
    return np.stack([np.stack([view(r, c, height, width, seed) for c in range(cols)]) for r in range(rows)])


def light_field_document(rows: int = 3, cols: int = 3, **known: Any) -> CaptureDocument:
    return CaptureDocument(kind="light_field", views=ViewsSpec(rows=rows, cols=cols), **known)


def known_document() -> CaptureDocument:
    """A light field of which everything is known, 3×3 views of W×H."""
    return CaptureDocument.model_validate(
        {
            "kind": "light_field",
            "views": {"rows": 3, "cols": 3},
            "camera": CameraSpec(width=W, height=H, fx=30.0, fy=30.0, cx=7.0, cy=6.0, sigma_f=0.02),
            "optics": OpticsSpec(baseline_m=0.001, focus_distance_m=0.5, sigma_baseline=0.01),
            "depth_range_m": (0.3, 0.8),
            "turntable_deg": 15.0,
            "pose": {"R": IDENTITY, "t": [0, 0, 0.5], "sigma_deg": 0.1, "sigma_m": 0.001},
        }
    )


def write_capture_folder(folder: Path, document: dict[str, Any], pictures: dict[str, U8]) -> Path:
    """A capture as a person would write it: the JSON as given, pictures by name."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "capture.json").write_text(json.dumps({"schema": "lfrig.capture/1", **document}))
    for name, picture in pictures.items():
        write_png(folder / name, picture)
    return folder


def write_view_folder(
    folder: Path, pattern: str, rows: range = range(3), cols: range = range(3), seed: int = 0
) -> Path:
    """A folder of views, numbered as given, view (r, c) of the light field at the r-th row and c-th column."""
    for r, row in enumerate(rows):
        for c, col in enumerate(cols):
            write_png(folder / pattern.format(row=row, col=col), view(r, c, seed=seed))
    return folder


def tree(folder: Path) -> dict[str, bytes]:
    """Every file beneath a folder with its bytes."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


@contextlib.contextmanager
def read_only(folder: Path) -> Iterator[None]:
    """Take away the right to write to a folder and all beneath it, from root too (by another effective user)."""
    folders = [folder, *(path for path in folder.rglob("*") if path.is_dir())]
    modes = [path.stat().st_mode for path in folders]
    opened = [path for path in folder.parents if path.stat().st_uid == os.geteuid() and not path.stat().st_mode & 0o005]
    opened_modes = [path.stat().st_mode for path in opened]
    for path in opened:
        path.chmod(0o755)
    for path in folders:
        path.chmod(0o555)
    user = os.geteuid()
    if user == 0:
        os.seteuid(65534)
    try:
        yield
    finally:
        os.seteuid(user)
        for path, mode in zip([*folders, *opened], [*modes, *opened_modes], strict=True):
            path.chmod(mode)
