"""What synthesis can be told."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Method = Literal["layered", "z_buffer", "fixed_point"]
"""``layered``: z-buffered field, spline interpolation, a background behind near surfaces and matted depth steps.
``z_buffer``: the same field, bicubic, disoccluded pixels inpainted view by view. ``fixed_point``: ``g(u) = d(u + g)``,
bicubic; it rewards fat foregrounds. The last two are the oracles: the yardsticks that results are measured with.
"""


@dataclass(frozen=True)
class SynthesisSettings:
    """Knobs; ``_px`` of disparity are px per view step, ``_grey`` are grey levels of 0..255."""

    method: Method = "layered"
    match_px: float = 0.08
    """The fixed-point polish keeps the splatted disparity unless it moves less than this."""
    hidden_px: float = 0.06
    """A gathered sample this much nearer than the field shows the foreground: the point is disoccluded."""
    inpaint_radius: int = 2
    """Of ``z_buffer``."""
    step_px: float = 0.2
    """Adjacent pixels that differ by more are two surfaces, one behind the other; a smaller step uncovers less than a
    pixel in the outermost of 7×7 views."""
    matte_contrast_grey: float = 20.0
    """Least difference (rms over the channels) between near and far colour that tells how much of each a pixel has."""
    matte_fit_grey: float = 15.0
    """A pixel whose colour is farther (rms over the channels) from any mixture of the two is no mixture."""


DEFAULT_SYNTHESIS = SynthesisSettings()
