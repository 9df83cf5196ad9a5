"""How many threads OpenCV works with."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator


@contextlib.contextmanager
def opencv_threads(threads: int) -> Iterator[None]:
    """Let OpenCV use that many threads for a while (0 = all): its pool is the process's, and waits by spinning."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(threads if threads > 0 else -1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
