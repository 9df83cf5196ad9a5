"""``--format webm``: a parallax loop as VP9, which every browser plays, through OpenCV's FFmpeg; decoded to check."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from lfrig.contracts.errors import ProcessingError
from lfrig.contracts.progress import Monitor
from lfrig.contracts.stderr import quiet_stderr
from lfrig.processing.export.content import Content
from lfrig.processing.export.sweep import Sweep, circle
from lfrig.processing.model import F64

FRAMES = 72
FRAMES_PER_S = 24.0
MAX_WIDTH = 1280
MAX_ERROR = 12.0
"""Mean absolute difference [grey levels] of a decoded frame from its original; VP9 at OpenCV's rate stays below 4."""
_REMEDY = "install OpenCV with FFmpeg and VP9 (the opencv-contrib-python-headless wheel), or use gif"


def export_webm(content: Content, out: Path, monitor: Monitor) -> None:
    """Write a VP9 video of one turn on a circle through the aperture to ``out`` (it ends in ``.webm``).

    Raises
    ------
    ProcessingError
        OpenCV here cannot encode VP9, or what it wrote does not decode to what was put in.
    """
    import cv2

    height, width = content.views.shape[2:4]
    scale = min(1.0, MAX_WIDTH / width)
    # VP9 stores colour at half resolution: even sizes only.
    size = max(2, int(width * scale) // 2 * 2), max(2, int(height * scale) // 2 * 2)
    sweep = Sweep(content, size)
    # OpenCV's FFmpeg back end prints that it ignores the VP90 tag and goes on.
    with quiet_stderr():
        writer = cv2.VideoWriter(str(out), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"VP90"), FRAMES_PER_S, size)
    if not writer.isOpened():
        raise ProcessingError("OpenCV cannot encode VP9 here", code="codec-missing", remedy=_REMEDY)
    path = circle(content.angular, FRAMES)
    try:
        with monitor.task("webm", FRAMES):
            for row, col in path:
                writer.write(np.ascontiguousarray(sweep.picture(row, col)[..., ::-1]))
                monitor.advance()
    finally:
        writer.release()
    _check(out, sweep, path)


def _check(out: Path, sweep: Sweep, path: F64) -> None:
    """Decode ``out`` and compare its frame count, and its first frame's pixels, with what went in."""
    import cv2

    reader = cv2.VideoCapture(str(out), cv2.CAP_FFMPEG)
    try:
        ok, first = reader.read()
        frames = 0
        while ok:
            frames += 1
            ok, _ = reader.read()
    finally:
        reader.release()
    if frames != len(path):
        raise ProcessingError(
            f"the video decodes to {frames} of {len(path)} frames", code="codec-broken", remedy=_REMEDY
        )
    expected = sweep.picture(*path[0])[..., ::-1].astype(np.int16)
    error = float(np.abs(first.astype(np.int16) - expected).mean()) if first.shape == expected.shape else 255.0
    if error > MAX_ERROR:
        raise ProcessingError(
            f"the video decodes to other pixels (mean difference {error:.0f} of 255)", code="codec-broken",
            remedy=_REMEDY,
        )  # fmt: skip
