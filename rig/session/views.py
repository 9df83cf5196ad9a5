"""The views of a light field: from many files into one volume, and which of them are used."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import U8
from lfrig.rig.session.images import read_image8, write_png

MAX_VOLUME_BYTES = 1 << 32
"""Largest light field that is loaded [bytes]."""
MAX_THREADS = 8


def taken_range(rows: int, cols: int) -> tuple[range, range]:
    """Which rows and columns of a stored grid are used.

    Of 14×14 (the ESLF of a Lytro Illum, whose outer views are vignetted) rows and columns 3..9, centre 6. Any
    other even count has no middle either: its last row or column is left out, so that the view at (n − 2)/2 is in
    the middle. Odd counts are used whole.
    """
    if (rows, cols) == (14, 14):
        return range(3, 10), range(3, 10)
    return range(rows - 1 + rows % 2), range(cols - 1 + cols % 2)


def read_views(
    files: Sequence[Sequence[Path]],
    *,
    threads: int = 0,
    monitor: Monitor | None = None,
    transform: Callable[[U8], U8] | None = None,
) -> U8:
    """Read a grid of pictures, row by row, into uint8 [rows, cols, H, W, 3] RGB.

    Parameters
    ----------
    files : sequence of sequences of Path
        rows × cols file names.
    threads : int
        Files decoded at once; 0 = as many as there are processors, at most 8.
    transform : callable, optional
        Applied to each picture as it arrives (a resampling).

    Raises
    ------
    BadInput
        A file is missing, damaged or no picture; sizes differ; the volume would be larger than 4 GiB.
    Interrupted
        ``monitor`` was cancelled.
    """
    monitor = monitor or Monitor()
    paths = [path for row in files for path in row]
    refuse_missing(paths)
    first = read_image8(paths[0])
    shape = first.shape
    done = transform(first) if transform else first
    volume = _allocate(len(files), len(files[0]), done.shape, paths[0])
    flat = volume.reshape(-1, *done.shape)
    flat[0] = done

    def load(index: int) -> None:
        image = read_image8(paths[index])
        if image.shape != shape:
            raise BadInput(
                f"is {image.shape[1]}×{image.shape[0]} px, but {paths[0].name} is {shape[1]}×{shape[0]}",
                path=paths[index], code="mixed-sizes", remedy="all views of a light field have one size",
            )  # fmt: skip
        flat[index] = transform(image) if transform else image

    with monitor.task("read views", len(paths)):
        monitor.advance()
        workers = threads or min(MAX_THREADS, os.cpu_count() or 1)
        with ThreadPoolExecutor(max(1, min(workers, len(paths)))) as pool:
            _wait([pool.submit(load, index) for index in range(1, len(paths))], monitor)
    return volume


def write_views(folder: Path, views: U8, pattern: Callable[[int, int], str], *, threads: int = 0) -> None:
    """Write uint8 [rows, cols, H, W, 3] as PNG files named by ``pattern(row, col)`` in ``folder``."""
    rows, cols = views.shape[:2]
    with ThreadPoolExecutor(threads or min(MAX_THREADS, os.cpu_count() or 1)) as pool:
        _wait(
            [
                pool.submit(write_png, folder / pattern(row, col), views[row, col])
                for row in range(rows)
                for col in range(cols)
            ],
            Monitor(),
        )


def _wait(futures: Sequence[Future[None]], monitor: Monitor) -> None:
    """Wait for all, in order, so that the first error in order is the one raised; nothing is started after it."""
    try:
        for future in futures:
            future.result()
            monitor.advance()
    except BaseException:
        for future in futures:
            future.cancel()
        raise


def _allocate(rows: int, cols: int, shape: tuple[int, ...], path: Path) -> U8:
    size = rows * cols * int(np.prod(shape))
    if size > MAX_VOLUME_BYTES:
        raise BadInput(
            f"{rows}×{cols} views of this size take {size / 2**30:.0f} GiB", path=path, code="too-large",
            remedy="make the views smaller first",
        )  # fmt: skip
    return np.empty((rows, cols, *shape), np.uint8)


def refuse_missing(paths: Sequence[Path]) -> None:
    """Raise `BadInput` that names the first file of a light field that is not there, and counts them."""
    missing = [path for path in paths if not path.is_file()]
    if missing:
        raise BadInput(
            f"is missing ({len(missing)} of {len(paths)} views are)", path=missing[0], code="missing-views",
            remedy="copy the whole light field again, or correct 'views' in its capture.json",
        )  # fmt: skip
