"""``--format views``: one PNG per view, ``RR_CC.png``, the very files of the result where it has them."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.export.content import Content
from lfrig.processing.export.png import write_png
from lfrig.processing.export.result import view_name


def export_views(content: Content, out: Path, monitor: Monitor) -> None:
    """Fill ``out`` with ``RR_CC.png``, uint8 or uint16 as the views are."""
    rows, cols = content.views.shape[:2]  # reading them also checks that every file of a result is whole
    with monitor.task("views", rows * cols):
        for row, col in np.ndindex(rows, cols):
            name = view_name(row, col)
            if content.views_folder:
                shutil.copyfile(content.views_folder / name, out / name)
            else:
                write_png(out / name, content.views[row, col])
            monitor.advance()
