"""A raw light field as it comes from file and calibration: sensor values, white image, hot pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lfrig.processing.lenslet.metadata import RawMetadata

U16 = NDArray[np.uint16]


@dataclass(frozen=True, eq=False)
class WhiteImage:
    """A picture of a uniform light: ``sensor`` uint16 [Hs, Ws], ``sha1`` (40 hex digits) of its packed bytes.

    ``metadata`` is its own, or the shot's where it has none; ``name`` says where it came from.
    """

    sensor: U16
    sha1: str
    metadata: RawMetadata
    name: str


@dataclass(frozen=True, eq=False)
class RawCapture:
    """A raw light field.

    ``sensor`` is uint16 [Hs, Ws] as recorded. ``white`` was chosen by ``rule``: ``"exact"``, ``"nearest"`` (zoom, then
    focus, of the same camera), ``"embedded"`` (in the shot's own file), or ``"none"`` with no white image at all.
    ``zoom_steps`` and ``focus_steps`` say how far from the shot's it was taken. ``hot_pixels`` is int32 [N, 2]
    (x, y). ``problems`` names what a partial read left out.
    """

    path: Path
    metadata: RawMetadata
    sensor: U16
    white: WhiteImage | None
    rule: str
    hot_pixels: NDArray[np.int32]
    zoom_steps: int | None = None
    focus_steps: int | None = None
    problems: tuple[str, ...] = ()
