"""truth.json beside a simulated session: what really was. Read by scoring alone, never by processing.

``SESSION.truth/truth.json``; ``SESSION.truth/captures/<id>/depth.npy`` float32 [H, W] m along the optical axis of the
centre view; ``SESSION.truth/captures/<id>/views/RR_CC.png`` the noise-free views (of a photo: the light field that the
target camera would have taken, at ``optics``).
"""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from lfrig.contracts.capture import CameraSpec, OpticsSpec, PoseSpec, ViewsSpec
from lfrig.contracts.schema import Document, Finite, Model, NonNegative


class TruthCapture(Model):
    """The true state of one capture."""

    kind: str
    camera: CameraSpec
    optics: OpticsSpec
    pose: PoseSpec
    turntable_deg: Finite
    views: ViewsSpec | None = None
    """The views without noise; None when the truth holds none (a light field recorded without noise is its own)."""
    noise_sigma: NonNegative = 0.0
    """Standard deviation of the noise on the recorded pixels [grey levels of 255]."""


class TruthDocument(Document):
    """truth.json."""

    NAME: ClassVar[str] = "lfrig.truth"

    scene: str
    seed: int
    captures: dict[str, TruthCapture] = Field(default_factory=dict)
