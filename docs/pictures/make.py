"""Makes the README's pictures from a result: ``make pictures``, or ``python docs/pictures/make.py RESULT``."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image

from lfrig.processing.export.result import load_result
from lfrig.processing.report.depth_page import CONFIDENCE, preview
from lfrig.processing.report.pictures import robust_scale

HERE = Path(__file__).resolve().parent
FRAMES, FRAME_MS = 16, 80


def main(result_folder: Path) -> None:
    """Write photo.jpg, disparity.png, confidence.png and the animated parallax.webp beside this file."""
    result = load_result(result_folder)
    rows, cols = result.views.shape[:2]
    Image.fromarray(result.views[rows // 2, cols // 2]).save(HERE / "photo.jpg", quality=88)
    maps = {
        "disparity": preview(result.disparity, robust_scale(result.disparity)),
        "confidence": preview(result.confidence, CONFIDENCE),
    }
    for name, picture in maps.items():
        Image.fromarray(picture).quantize(128).save(HERE / f"{name}.png", optimize=True)
    frames = [Image.fromarray(result.views[row, col]) for row, col in _circle(rows, cols)]
    frames[0].save(
        HERE / "parallax.webp", save_all=True, append_images=frames[1:], duration=FRAME_MS, loop=0, quality=60, method=6
    )


def _circle(rows: int, cols: int) -> list[tuple[int, int]]:
    """Views once round the rim of the aperture."""
    turns = 2 * np.pi * np.arange(FRAMES) / FRAMES
    down, right = (rows - 1) / 2 * (1 + np.sin(turns)), (cols - 1) / 2 * (1 + np.cos(turns))
    return [(round(row), round(col)) for row, col in zip(down, right, strict=True)]


if __name__ == "__main__":
    main(Path(sys.argv[1]))
