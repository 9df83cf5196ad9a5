"""Surface → disparity field of every output view → views in the photo's colours.

- ``settings``  the knobs
- ``field``     the disparity on the grid of an output view, z-buffered or by fixed point; what the photo does not show
- ``matte``     near and far colours of the mixed pixels at depth steps, and how much of each
- ``views``     the views: one layer inpainted view by view, or two layers put over each other

Colours of uncovered pixels do not come from the sources: on the tuning scenes, warped through the continued background
and matched in exposure, they gained .2 dB with exact geometry and lost .2 dB with the estimated one.
"""

from lfrig.processing.synthesis.field import fill_nan, view_field, view_offsets
from lfrig.processing.synthesis.settings import DEFAULT_SYNTHESIS, Method, SynthesisSettings
from lfrig.processing.synthesis.views import render_views

__all__ = [
    "DEFAULT_SYNTHESIS",
    "Method",
    "SynthesisSettings",
    "fill_nan",
    "render_views",
    "view_field",
    "view_offsets",
]
