"""``--format gif``: a parallax loop on a circle through the aperture, no larger than asked for."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image as Pillow

from lfrig.contracts.files import disk_errors
from lfrig.contracts.progress import Monitor
from lfrig.processing.export.content import Content
from lfrig.processing.export.sweep import Sweep, circle

FRAMES = 30
FRAME_MS = 70
PALETTE_PIXELS = 40_000
"""Sampled to choose the palette."""
MAX_BYTES = 8_000_000
MAX_WIDTH = 800
MIN_WIDTH = 120
"""Below this nothing can be seen, so a larger file is accepted instead."""


def export_gif(content: Content, out: Path, monitor: Monitor, *, max_bytes: int = MAX_BYTES) -> None:
    """Write an endlessly looping GIF to ``out``, made smaller until it fits ``max_bytes``."""
    height, width = content.views.shape[2:4]
    scale = min(1.0, MAX_WIDTH / width)
    with monitor.task("gif"):
        while True:
            size = max(1, round(width * scale)), max(1, round(height * scale))
            data = _animation(content, size, monitor)
            if len(data) <= max_bytes or size[0] <= MIN_WIDTH:
                break
            # Size goes with the area; a little less than needed, so that one more round is the rule.
            scale *= min(0.9, 0.97 * (max_bytes / len(data)) ** 0.5)
    with disk_errors(out):
        out.write_bytes(data)


def _animation(content: Content, size: tuple[int, int], monitor: Monitor) -> bytes:
    sweep = Sweep(content, size)
    pictures: list[Pillow.Image] = []
    for row, col in circle(content.angular, FRAMES):
        pictures.append(Pillow.fromarray(sweep.picture(row, col)))
        monitor.advance()
    palette = _palette(pictures)
    # One palette and error diffusion for all frames: colours do not flicker from frame to frame.
    frames = [picture.quantize(palette=palette, dither=Pillow.Dither.FLOYDSTEINBERG) for picture in pictures]
    stream = io.BytesIO()
    frames[0].save(stream, "GIF", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, optimize=False)
    return stream.getvalue()


def _palette(pictures: list[Pillow.Image]) -> Pillow.Image:
    """256 colours that serve four frames a quarter turn apart, hence all."""
    mosaic = np.concatenate([np.asarray(picture) for picture in pictures[:: max(1, len(pictures) // 4)]])
    stride = max(1, int((mosaic.shape[0] * mosaic.shape[1] / PALETTE_PIXELS) ** 0.5))
    sample = Pillow.fromarray(np.ascontiguousarray(mosaic[::stride, ::stride]))
    return sample.quantize(256, method=Pillow.Quantize.MEDIANCUT)
