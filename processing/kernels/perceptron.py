"""A small multilayer perceptron, evaluated for every pixel. C++ form: ``perceptron.cpp``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.contracts.native import load_native
from lfrig.processing.model import F32

BLOCK = 8192


@dataclass(frozen=True)
class Layer:
    """``weight`` float32 [out, in], ``bias`` float32 [out]."""

    weight: F32
    bias: F32


def perceptron(
    features: Sequence[F32] | F32,
    mean: F32,
    spread: F32,
    layers: Sequence[Layer],
    *,
    limit: float,
    leak: float,
    threads: int = 0,
) -> F32:
    """The output of the last layer, which has one unit.

    Parameters
    ----------
    features : F maps, float32 [N] each
        They enter as (feature − ``mean``) / ``spread``, clipped to ± ``limit``; float32 [F] both.
    layers : Sequence[Layer]
        At most 256 units each; all but the last scale negative sums by ``leak``.

    Returns
    -------
    float32 [N]
    """
    native = load_native("lfrig.processing.kernels._native")
    if native is None:
        return perceptron_numpy(features, mean, spread, layers, limit, leak)
    out = np.empty(len(features[0]), np.float32)
    native.perceptron(
        [np.ascontiguousarray(f, np.float32) for f in features], np.ascontiguousarray(mean, np.float32),
        np.ascontiguousarray(spread, np.float32), [np.ascontiguousarray(part.weight, np.float32) for part in layers],
        [np.ascontiguousarray(part.bias, np.float32) for part in layers], limit, leak, out, threads,
    )  # fmt: skip
    return out


def perceptron_numpy(
    features: Sequence[F32] | F32, mean: F32, spread: F32, layers: Sequence[Layer], limit: float, leak: float
) -> F32:
    """NumPy twin."""
    widths = [len(mean), *(len(layer.weight) for layer in layers)]
    if widths[-1] != 1 or any(layer.weight.shape[1] != n for layer, n in zip(layers, widths, strict=False)):
        raise ValueError("perceptron: layers do not fit")
    out = np.empty(len(features[0]), np.float32)
    # Blocks of one size keep memory low and the order of the sums the same on any machine's thread count.
    for start in range(0, len(out), BLOCK):
        values = np.stack([feature[start : start + BLOCK] for feature in features])
        values = np.clip((values - mean[:, None]) / spread[:, None], -np.float32(limit), np.float32(limit))
        for layer in layers[:-1]:
            values = layer.weight @ values + layer.bias[:, None]
            np.maximum(values, np.float32(leak) * values, out=values)
        out[start : start + BLOCK] = (layers[-1].weight @ values + layers[-1].bias[:, None])[0]
    return out
