"""Libraries that print to the process's stderr, past Python, are silenced at its descriptor."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator


@contextlib.contextmanager
def quiet_stderr() -> Iterator[None]:
    """Close the process's stderr for the block; nothing smaller silences what writes to the descriptor.

    A progress bar drawn meanwhile is lost until it is drawn again, so hold it for short calls only.
    """
    try:
        saved = os.dup(2)
    except OSError:  # closed already
        yield
        return
    try:
        with open(os.devnull, "wb") as sink:  # noqa: PTH123  (os.devnull is no path to join)
            os.dup2(sink.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
