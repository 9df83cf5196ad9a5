"""A map with its slopes: local planes through an inverse-depth map."""

from __future__ import annotations

from dataclasses import dataclass

from lfrig.processing.model import F32


@dataclass(frozen=True)
class Planes:
    """A map with its slopes: ``value``, ``slope_x``, ``slope_y`` (per pixel), float32 [H, W] each."""

    value: F32
    slope_x: F32
    slope_y: F32
