"""Fits the confidence model's coefficients on the tuning scenes: ``python -m lfrig.bench.calibrate_confidence``.

Logistic regression of "the disparity error is below 0.1 px" on what `processing.confidence.features` saw, by
iteratively reweighted least squares, over every pixel of the tuning half inside the scored border; prints the
coefficients to put into ``processing/confidence.py``. The reporting half is not looked at.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from unittest import mock

import numpy as np

from lfrig.bench.cases import MEDIUM, scene_names, shoot_case
from lfrig.contracts.progress import Monitor
from lfrig.processing import confidence
from lfrig.processing.model import F32, F64
from lfrig.processing.pipeline import process

BORDER_PX = 15
RIDGE = 1.0


def collect(scenes: Sequence[str], size: tuple[int, int]) -> tuple[F64, F64]:
    """Features [N, K] and hits [N] (1 = error below 0.1 px) over scenes and both numbers of sources."""
    rows, hits = [], []
    for scene in scenes:
        for count in (2, 4):
            case = shoot_case(scene, size, poses="prior").with_sources(count)
            seen: list[dict[str, F32]] = []
            original = confidence.features

            def spy(*inputs: F32, seen: list[dict[str, F32]] = seen, call=original) -> dict[str, F32]:  # type: ignore[no-untyped-def]
                seen.append(call(*inputs))
                return seen[-1]

            with mock.patch.object(confidence, "features", spy):
                result = process(case.sources, case.target, case.prior, replace(case.options()), Monitor())
            made = result.light_field
            truth = case.request.disparity(case.truth.inverse_depth, case.truth.focal_px)
            inner = np.s_[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
            good = np.abs(made.disparity - truth)[inner] < confidence.TOLERANCE_PX
            rows.append(np.stack([seen[0][name][inner].ravel() for name in confidence.COEFFICIENTS], 1))
            hits.append(good.ravel())
            print(f"{scene}, {count} sources: {good.mean():.1%} within 0.1 px", file=sys.stderr, flush=True)
    return np.concatenate(rows).astype(np.float64), np.concatenate(hits).astype(np.float64)


def fit(features: F64, hits: F64, iterations: int = 30) -> F64:
    """Logistic regression [K] with a small ridge."""
    beta = np.zeros(features.shape[1])
    for _ in range(iterations):
        p = 1 / (1 + np.exp(-np.clip(features @ beta, -30, 30)))
        weight = np.maximum(p * (1 - p), 1e-6)
        hessian = (features * weight[:, None]).T @ features + RIDGE * np.eye(len(beta))
        beta = beta + np.linalg.solve(hessian, features.T @ (hits - p) - RIDGE * beta)
    return np.asarray(beta, np.float64)


def main() -> None:
    """Collect, fit, print."""
    features, hits = collect(scene_names("tuning"), MEDIUM)
    for name, value in zip(confidence.COEFFICIENTS, fit(features, hits), strict=True):
        print(f'    "{name}": {value:.2f},')


if __name__ == "__main__":
    main()
