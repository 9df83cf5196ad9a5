"""Features → expected error → sigma → probability.

A perceptron of two small hidden layers gives log E|error| in px per view step of the sources. Two monotone curves make
it sigma, the error that 68.3 % of such pixels stay below, and sigma the probability of an error below 0.1 px; so both
rank pixels alike. Between them the standard deviation of the poses' common scale is added: it
moves all depths by one factor, which no pixel can see. Calibration after training: Niculescu-Mizil & Caruana, ICML
2005.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.processing.confidence.clues import Clues
from lfrig.processing.confidence.features import feature_maps
from lfrig.processing.kernels.curve import curve
from lfrig.processing.kernels.perceptron import Layer, perceptron
from lfrig.processing.model import F32, F64

TOLERANCE_PX = 0.1
FILE = Path(__file__).with_name("model.json")
FORMAT = "lfrig.confidence/1"
LIMIT = 4.0
"""Standard deviations beyond which a feature says no more than the tuning scenes taught."""
LEAK = 0.05
SIGMA_LIMITS_PX = (1e-4, 4.0)
COMMON_SHARE = np.float32(0.5)
"""How much of the common scale's sigma the probability counts: it has no gross errors, a pixel of that sigma has. Half
ranks and predicts best on the tuning scenes, with poses from the turntable's prior."""


@dataclass(frozen=True)
class Curve:
    """Monotone, piecewise linear through (``x``, ``y``), float64 [K] each; straight on beyond its ends."""

    x: F64
    y: F64

    def __call__(self, values: F32, *, threads: int = 0) -> F32:
        """The curve at ``values``, float32 of the same shape."""
        return curve(values, self.x, self.y, threads=threads)


@dataclass(frozen=True)
class ConfidenceModel:
    """``names`` of the features, their ``mean`` and ``spread`` float32 [F], the ``layers`` of the perceptron;
    ``sigma`` takes log E|error| to log σ, ``logit`` takes log σ (at the requested baseline) to the logit of P.
    """

    names: tuple[str, ...]
    mean: F32
    spread: F32
    layers: tuple[Layer, ...]
    sigma: Curve
    logit: Curve

    def log_error(self, features: Sequence[F32] | F32, *, threads: int = 0) -> F32:
        """Logarithm of E|error| [px per view step of the sources], float32 [N], of ``features`` float32 [N] each."""
        return perceptron(features, self.mean, self.spread, self.layers, limit=LIMIT, leak=LEAK, threads=threads)

    def probability(self, sigma_px: F32, *, threads: int = 0) -> F32:
        """P(|error| < 0.1 px) of pixels whose error has the scale ``sigma_px``, float32 of the same shape."""
        return np.asarray(1 / (1 + np.exp(-self.logit(np.log(sigma_px), threads=threads))), np.float32)

    def to_json(self) -> dict[str, Any]:
        """The content of ``model.json``."""

        def numbers(values: F32 | F64) -> Any:
            return np.round(np.asarray(values, np.float64), 5).tolist()

        return {
            "format": FORMAT,
            "features": {
                n: [numbers(m), numbers(s)] for n, m, s in zip(self.names, self.mean, self.spread, strict=True)
            },
            "layers": [{"weight": numbers(layer.weight), "bias": numbers(layer.bias)} for layer in self.layers],
            "log_sigma_of_log_error": [numbers(self.sigma.x), numbers(self.sigma.y)],
            "logit_of_log_sigma": [numbers(self.logit.x), numbers(self.logit.y)],
        }

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> ConfidenceModel:
        """The inverse of `to_json`."""
        features = document["features"]
        table = np.asarray(list(features.values()), np.float32)
        layers = tuple(
            Layer(np.asarray(layer["weight"], np.float32), np.asarray(layer["bias"], np.float32))
            for layer in document["layers"]
        )
        sigma, logit = (
            Curve(np.asarray(document[key][0], np.float64), np.asarray(document[key][1], np.float64))
            for key in ("log_sigma_of_log_error", "logit_of_log_sigma")
        )
        return cls(tuple(features), table[:, 0], table[:, 1], layers, sigma, logit)


@cache
def shipped_model() -> ConfidenceModel:
    """The model fitted on the tuning scenes."""
    return ConfidenceModel.from_json(json.loads(FILE.read_text(encoding="utf-8")))


def estimate(
    clues: Clues, px_per_inverse: float, model: ConfidenceModel | None = None, *, threads: int = 0
) -> tuple[F32, F32]:
    """Confidence and sigma of a surface.

    Parameters
    ----------
    px_per_inverse : float
        b·F of the requested light field [px·m].

    Returns
    -------
    confidence : float32 [H, W], P(|disparity error| < 0.1 px)
    sigma_px : float32 [H, W]
        Scale of the error [px per view step]: 68.3 % of the pixels of one sigma have smaller errors.
    """
    model = model or shipped_model()
    maps = feature_maps(clues)
    features = [maps[name].ravel() for name in model.names]
    log_sigma = model.sigma(model.log_error(features, threads=threads), threads=threads).reshape(clues.surface.shape)
    own = np.exp(log_sigma) * np.float32(clues.unit * px_per_inverse)
    common = clues.surface * np.float32(clues.scale_sigma * px_per_inverse)
    sigma_px, judged = (
        np.asarray(np.clip(np.hypot(own, share * common), *SIGMA_LIMITS_PX), np.float32)
        for share in (np.float32(1), COMMON_SHARE)
    )
    return model.probability(judged, threads=threads), sigma_px
