"""How a fault ends: refused, flagged, corrected, without effect, or, what must never happen, wrong and silent."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from lfrig.bench.poses_faults import Fault
from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Notice
from lfrig.sim.rig import FULL_WIDTH

Outcome = Literal["refused", "flagged", "corrected", "unaffected", "SILENT WRONG"]

LIMITS = {"rotation_deg": 0.3, "depth_pct": 1.0, "transfer_px": 3.0}
"""Geometry beyond one of these is wrong. A rotation of 0.3° or a transfer of 3 px (at 541 px) shifts evidence by more
than the wide-baseline refinement searches; 1 % of depth is a third of the tenth of a pixel that results are judged by.
"""

ACCEPTED: dict[tuple[bool, bool], Outcome] = {
    (True, True): "flagged",
    (True, False): "SILENT WRONG",
    (False, True): "corrected",
    (False, False): "unaffected",
}
"""By whether the geometry is wrong, and whether a warning names a culprit."""

CLAIM = "-corrected"
NOT_ABOUT_A_FAULT = frozenset({"wide-step", "no-scale"})


def accepted(fault: Fault, figures: dict[str, Any], notices: Sequence[Notice], width: int) -> dict[str, Any]:
    """The fields of a row whose case went through; ``figures`` lack the photo's where its truth is unknown."""
    warned = [n for n in notices if n.code not in NOT_ABOUT_A_FAULT]
    wrong = too_far(figures, width)
    # Where the geometry is wrong, a notice that says it was mended misleads: that is no better than silence.
    heeded = [n for n in warned if not (wrong and n.code.endswith(CLAIM))]
    named = any(names_culprit(fault, n.message) for n in heeded)
    outcome = ACCEPTED[bool(wrong), named]
    return {"outcome": outcome, "named": named, "codes": sorted({n.code for n in warned}), "wrong": wrong}


def refused(fault: Fault, refusal: GeometryRefused) -> dict[str, Any]:
    """The fields of a row whose case was refused."""
    named = names_culprit(fault, refusal.message)
    return {"outcome": "refused", "named": named, "codes": [refusal.code], "message": refusal.message}


def too_far(figures: dict[str, Any], width: int) -> list[str]:
    """Which of `LIMITS` are broken; a photo that shows nothing the sources know cannot have a right pose."""
    if "transfer_px" not in figures:
        return ["photo"]
    scale = {"transfer_px": width / FULL_WIDTH}
    # Written so that a figure that is not a number breaks its limit.
    return [name for name, limit in LIMITS.items() if not figures[name] <= limit * scale.get(name, 1.0)]


def names_culprit(fault: Fault, message: str) -> bool:
    """Whether a message names one of the captures to blame (any message, where all of them are)."""
    return not fault.culprits or any(name in message for name in fault.culprits)
