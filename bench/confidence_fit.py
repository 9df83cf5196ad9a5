"""Training of the confidence model: a small perceptron by Adam, then two monotone curves.

The perceptron minimises log b + |e| / b, the likelihood of exponentially distributed |e|, whose minimum over b is
E|e|: what a ranking for the least remaining error has to follow. The curves are fitted to predictions for scenes that
the perceptron has not seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lfrig.processing.confidence.model import LEAK, LIMIT, SIGMA_LIMITS_PX, TOLERANCE_PX, ConfidenceModel, Curve
from lfrig.processing.kernels.perceptron import Layer
from lfrig.processing.model import F32, F64

HIDDEN = (32, 16)
EPOCHS = 16
BATCH = 4096
RATE = 3e-3
DECAY = 1e-4
"""Of the weights, against fitting the ten scenes by heart."""
ERROR_CAP_PX = 0.5
"""A pixel that is wrong is wrong: by how much says little about the next scene."""
ERROR_FLOOR_PX = 1e-4
LOG_LIMITS = (-9.0, 1.0)
STEP_CAP = 20.0
PIXELS = 9000
BINS = 24


@dataclass(frozen=True)
class Shot:
    """Pixels of one run: ``features`` float16 [F, N], ``error_px`` float32 [N] in px per view step of the sources, and
    how many px of the requested light field one of those is.
    """

    scene: str
    setup: str
    features: np.ndarray
    error_px: F32
    to_request: float


@dataclass(frozen=True)
class Sample:
    """Pixels to learn from: ``features`` float32 [N, F]; ``error_px`` ≥ 0 and ``weight``, sum 1, float32 [N] each."""

    features: F32
    error_px: F32
    weight: F32


def draw(shots: Sequence[Shot], pixels: int = PIXELS) -> Sample:
    """About ``pixels`` of every shot, wrong ones more often, and weights that make up for it."""
    rng = np.random.default_rng(0)
    parts = []
    for shot in shots:
        error = np.abs(shot.error_px)
        chance = np.clip(error / 0.03, 0.08, 1)
        chance = np.minimum(chance * (pixels / chance.sum()), 1)
        taken = rng.random(len(error)) < chance
        weight = 1 / chance[taken]
        parts.append((shot.features[:, taken].T.astype(np.float32), error[taken], weight / weight.sum()))
    features, errors, weights = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Sample(features, errors.astype(np.float32), (weights / weights.sum()).astype(np.float32))


def train(names: Sequence[str], sample: Sample, epochs: int = EPOCHS) -> ConfidenceModel:
    """Train the perceptron; the curves are those of an uncalibrated model."""
    mean, spread = sample.features.mean(0), sample.features.std(0) + np.float32(1e-3)
    values = np.clip((sample.features - mean) / spread, -LIMIT, LIMIT)
    error = np.asarray(np.minimum(sample.error_px, ERROR_CAP_PX) + ERROR_FLOOR_PX, np.float32)
    weight = np.asarray(sample.weight * len(error), np.float32)
    rng = np.random.default_rng(0)
    sizes = (len(names), *HIDDEN, 1)
    parameters: list[F32] = []
    for wide, narrow in pairwise(sizes):
        parameters += [rng.normal(0, wide**-0.5, (narrow, wide)).astype(np.float32), np.zeros(narrow, np.float32)]
    parameters[-2] *= np.float32(0.1)
    parameters[-1] += np.float32(np.average(np.log(error), weights=weight))
    steps = epochs * (len(error) // BATCH)
    adam = _Adam(parameters, steps)
    for _ in range(epochs):
        order = rng.permutation(len(error))
        for start in range(0, len(order) - BATCH + 1, BATCH):
            batch = order[start : start + BATCH]
            adam.step(_gradients(parameters, values[batch], error[batch], weight[batch]))
    layers = tuple(Layer(parameters[i], parameters[i + 1]) for i in range(0, len(parameters), 2))
    same = Curve(np.array([-10.0, 2.0]), np.array([-10.0, 2.0]))
    return ConfidenceModel(tuple(names), mean, spread, layers, same, Curve(same.x, -same.y))


def _gradients(parameters: Sequence[F32], values: F32, error: F32, weight: F32) -> list[F32]:
    """Of the mean loss of a batch float32 [B, F], by back-propagation."""
    weights, biases = parameters[::2], parameters[1::2]
    kept = [values]
    for i, (w, b) in enumerate(zip(weights, biases, strict=True)):
        out = kept[-1] @ w.T + b
        kept.append(np.maximum(out, LEAK * out) if i < len(weights) - 1 else out)
    log_b = np.clip(kept[-1][:, 0], *LOG_LIMITS)
    slope = np.clip(weight * (1 - error / np.exp(log_b)), -STEP_CAP, STEP_CAP)[:, None] / np.float32(len(error))
    slope = slope.astype(np.float32)
    found: list[F32] = []
    for i in range(len(weights) - 1, -1, -1):
        found = [slope.T @ kept[i] + np.float32(DECAY) * weights[i], slope.sum(0), *found]
        if i:
            slope = (slope @ weights[i]) * np.where(kept[i] > 0, np.float32(1), LEAK)
    return found


class _Adam:
    """Kingma & Ba, ICLR 2015, with a warm-up and a cosine decay; changes the parameters in place."""

    def __init__(self, parameters: Sequence[F32], steps: int) -> None:
        self._parameters, self._steps, self._done = parameters, max(steps, 1), 0
        self._mean = [np.zeros_like(p) for p in parameters]
        self._square = [np.zeros_like(p) for p in parameters]

    def step(self, gradients: Sequence[F32]) -> None:
        """One step down."""
        self._done += 1
        t = self._done
        rate = RATE * min(1.0, t / 100) * (0.5 * (1 + np.cos(np.pi * t / self._steps)) + 0.02)
        for p, g, m, v in zip(self._parameters, gradients, self._mean, self._square, strict=True):
            m += np.float32(0.1) * (g - m)
            v += np.float32(0.001) * (g * g - v)
            p -= np.float32(rate) * (m / np.float32(1 - 0.9**t)) / (np.sqrt(v / np.float32(1 - 0.999**t)) + 1e-8)


def sigma_curve(log_errors: Sequence[F32], shots: Sequence[Shot]) -> Curve:
    """Curve from log E|e| to the log of the error that 68.3 % stay below; the same weight for every shot."""
    x, y, w = _joined(log_errors, [np.abs(s.error_px) for s in shots])
    knots, values = [], []
    for part in _bins(x, w):
        order = part[np.argsort(y[part])]
        mass = np.cumsum(w[order])
        knots.append(float(np.average(x[part], weights=w[part])))
        values.append(float(np.log(y[order[np.searchsorted(mass, 0.683 * mass[-1])]] + 1e-6)))
    return _increasing(np.array(knots), np.array(values))


def logit_curve(log_sigmas: Sequence[F32], shots: Sequence[Shot]) -> Curve:
    """Curve from log σ to the logit of P(|e| < 0.1 px), both at the requested baseline; strictly falling."""
    hits = [(np.abs(s.error_px) * s.to_request < TOLERANCE_PX).astype(np.float64) for s in shots]
    x, y, w = _joined(log_sigmas, hits)
    knots, values = [], []
    for part in _bins(x, w):
        # Half a pixel in a thousand for each outcome: no bin is certain.
        share = (np.average(y[part], weights=w[part]) + 5e-5) / (1 + 1e-4)
        knots.append(float(np.average(x[part], weights=w[part])))
        values.append(float(np.log(share / (1 - share))))
    rising = _increasing(np.array(knots), -np.array(values))
    return Curve(rising.x, -rising.y)


def _joined(predictions: Sequence[F32], outcomes: Sequence[np.ndarray]) -> tuple[F64, F64, F64]:
    weights = [np.full(len(p), 1 / len(p)) for p in predictions]
    return tuple(np.concatenate(part).astype(np.float64) for part in (predictions, outcomes, weights))  # type: ignore[return-value]


def _bins(x: F64, weight: F64) -> list[np.ndarray]:
    """Indices by rising x: bins of equal width over what occurs, so that the rare doubtful pixels get theirs."""
    order = np.argsort(x, kind="stable")
    lo, hi = x[order[int(0.001 * len(x))]], x[order[int(0.9995 * len(x))]]
    edges = np.searchsorted(x[order], np.linspace(lo, hi, BINS + 1)[1:-1])
    return [part for part in np.split(order, edges) if len(part) >= 200]


def _increasing(x: F64, y: F64, least_slope: float = 0.05) -> Curve:
    """The nearest increasing curve through the knots: pool adjacent violators, and a least slope against ties."""
    pools: list[list[float]] = []
    for value in y - least_slope * x:
        pools.append([value, 1.0])
        while len(pools) > 1 and pools[-2][0] >= pools[-1][0]:
            (a, n), (b, m) = pools[-2:]
            pools[-2:] = [[(a * n + b * m) / (n + m), n + m]]
    level = np.concatenate([np.full(int(n), value) for value, n in pools])
    return Curve(x, level + least_slope * x)


def log_sigma_at_request(model: ConfidenceModel, log_error: F32, shot: Shot) -> F32:
    """Logarithms of σ of a shot's pixels in px per view step of the requested light field, without the poses' share."""
    sigma = np.exp(model.sigma(log_error)) * np.float32(shot.to_request)
    return np.asarray(np.log(np.clip(sigma, *SIGMA_LIMITS_PX)), np.float32)
