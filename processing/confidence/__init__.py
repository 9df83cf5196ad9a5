"""How far to trust the surface: P(|disparity error| < 0.1 px) and the scale of the error, for every pixel.

``clues``     what the stages saw of a pixel: evidence, agreement of photo and sources, depth steps, support nearby
``features``  the clues as numbers, one map each
``model``     features → expected error → sigma → probability; its numbers are in ``model.json``

The model is fitted on the tuning scenes by ``python -m lfrig.bench.calibrate_confidence`` and checked on the reporting
scenes (docs/benchmarks.md). The one error that no pixel shows, that of the poses' common scale, is added from its
standard deviation.
"""

from lfrig.processing.confidence.clues import Clues
from lfrig.processing.confidence.features import feature_maps
from lfrig.processing.confidence.model import TOLERANCE_PX, ConfidenceModel, estimate, shipped_model

__all__ = ["TOLERANCE_PX", "Clues", "ConfidenceModel", "estimate", "feature_maps", "shipped_model"]
