"""Fits the confidence model on the tuning scenes, or says how good the shipped one is.

    python -m lfrig.bench.calibrate_confidence --write                  fit, and store processing/confidence/model.json
    python -m lfrig.bench.calibrate_confidence --evaluate reporting     the shipped model on the other half
    python -m lfrig.bench.calibrate_confidence --evaluate reporting --plot reliability.png

Fitting runs the pipeline with given poses, at full size, with two and four sources and with two noisy ones: the error
of the poses' scale is none that a pixel can show, and is added from its sigma. What is printed is cross-validated:
every scene is judged by a model that was trained without it. The reporting half is looked at by ``--evaluate
reporting`` only.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

from lfrig.bench.cases import FULL, Case, scene_names, shoot_case
from lfrig.bench.confidence_fit import EPOCHS, Shot, draw, log_sigma_at_request, logit_curve, sigma_curve, train
from lfrig.bench.document import Column, markdown_table
from lfrig.contracts.progress import Monitor
from lfrig.processing import confidence
from lfrig.processing.confidence import Clues, ConfidenceModel
from lfrig.processing.confidence.model import FILE
from lfrig.processing.metrics import Reliability, inner_region, reliability, sparsification
from lfrig.processing.model import F32, Evidence
from lfrig.processing.pipeline import process
from lfrig.sim.rig import Poses

NOISE_GREY = 5.0
FIGURE_COLUMNS = (
    Column("scene", "scene"), Column("setup", "setup"), Column("mean_error_px", "mean \\|error\\| px", ".4f"),
    Column("within_tolerance", "within .1 px %", ".1f"), Column("ause_of_random", "AUSE / random", ".3f"),
    Column("ece", "ECE", ".3f"), Column("within_sigma", "within σ %", ".0f"),
)  # fmt: skip
CURVE_COLUMNS = (
    Column("setup", "setup"), Column("predicted", "predicted %", ".1f"), Column("observed", "observed %", ".1f"),
    Column("share", "pixels %", ".2f"),
)  # fmt: skip
EVALUATED: tuple[tuple[Poses, int], ...] = (("given", 2), ("given", 4), ("prior", 2), ("prior", 4))


def collect(scenes: Sequence[str], size: tuple[int, int], threads: int) -> tuple[tuple[str, ...], list[Shot]]:
    """Names of the features, and the pixels of every scene inside the scored border."""
    names: tuple[str, ...] = ()
    shots: list[Shot] = []
    for scene in scenes:
        clean = shoot_case(scene, size, threads=threads)
        evidence: Sequence[Evidence] = ()
        for count in (4, 2):
            clues, shot, evidence = _run(clean.with_sources(count), f"{count} sources", evidence[:count], threads)
            names = tuple(clues)
            shots.append(shot)
        noisy = shoot_case(scene, size, noise_sigma=NOISE_GREY, threads=threads).with_sources(2)
        shots.append(_run(noisy, f"2 sources, noise {NOISE_GREY:g}", (), threads)[1])
    return names, shots


def _run(
    case: Case, setup: str, evidence: Sequence[Evidence], threads: int
) -> tuple[dict[str, F32], Shot, Sequence[Evidence]]:
    """The features of one run, its pixels, and the evidence that it used."""
    seen: list[tuple[Clues, float]] = []

    def spy(clues: Clues, px_per_inverse: float, *, threads: int) -> tuple[F32, F32]:
        seen.append((clues, px_per_inverse))
        return np.ones_like(clues.surface), np.ones_like(clues.surface)

    with mock.patch.object(confidence, "estimate", spy):
        options = case.options(rows=1, cols=1, threads=threads)
        result = process(case.sources, case.target, case.prior, options, Monitor(), evidence=evidence or None)
    clues, px_per_inverse = seen[0]
    to_request = clues.unit * px_per_inverse
    inner = inner_region(clues.surface.shape)
    maps = confidence.feature_maps(clues)
    error = (result.light_field.disparity - _truth(case))[inner].ravel() / np.float32(to_request)
    features = np.stack([values[inner].ravel() for values in maps.values()]).astype(np.float16)
    _say(f"{case.scene}, {setup}: mean |error| {np.abs(error).mean() * to_request:.4f} px")
    return maps, Shot(case.scene, setup, features, error, to_request), [s.source.evidence for s in result.sources]


def _truth(case: Case) -> F32:
    return case.request.disparity(case.truth.inverse_depth, case.truth.focal_px)


def fit(
    names: Sequence[str], shots: Sequence[Shot], epochs: int = EPOCHS
) -> tuple[ConfidenceModel, list[dict[str, Any]]]:
    """The model, and its cross-validated figures for every shot."""
    unseen: list[F32] = [np.empty(0, np.float32)] * len(shots)
    for scene in dict.fromkeys(shot.scene for shot in shots):
        model = train(names, draw([shot for shot in shots if shot.scene != scene]), epochs)
        for i, shot in enumerate(shots):
            if shot.scene == scene:
                unseen[i] = model.log_error(shot.features.astype(np.float32))
        _say(f"trained without {scene}")
    model = train(names, draw(shots), epochs)
    model = calibrated(model, unseen, shots)
    rows = []
    for shot, log_error in zip(shots, unseen, strict=True):
        sigma = np.exp(log_sigma_at_request(model, log_error, shot))
        rows.append(figures(shot.scene, shot.setup, shot.error_px * shot.to_request, model.probability(sigma), sigma))
    return model, rows


def calibrated(model: ConfidenceModel, log_errors: Sequence[F32], shots: Sequence[Shot]) -> ConfidenceModel:
    """The model with curves fitted to predictions for pixels that it was not trained on."""
    model = replace(model, sigma=sigma_curve(log_errors, shots))
    sigmas = [log_sigma_at_request(model, log_error, shot) for log_error, shot in zip(log_errors, shots, strict=True)]
    return replace(model, logit=logit_curve(sigmas, shots))


def figures(scene: str, setup: str, error_px: F32, probability: F32, sigma_px: F32) -> dict[str, Any]:
    """How well probability and sigma rank and predict the errors; arrays of one shape."""
    return {
        "scene": scene,
        "setup": setup,
        "ause_of_random": sparsification(error_px, probability).ause_of_random,
        "ece": reliability(error_px, probability).ece,
        "within_sigma": float((np.abs(error_px) < sigma_px).mean()),
        "mean_error_px": float(np.abs(error_px).mean()),
        "within_tolerance": float((np.abs(error_px) < confidence.TOLERANCE_PX).mean()),
    }


def evaluate(
    scenes: Sequence[str], size: tuple[int, int], threads: int
) -> tuple[list[dict[str, Any]], dict[str, Reliability]]:
    """Figures of the shipped model for every scene and setup, and the reliability curve of every setup."""
    rows: list[dict[str, Any]] = []
    pixels: dict[str, list[tuple[F32, F32]]] = {}
    for scene in scenes:
        evidence: Sequence[Evidence] = ()
        for poses, count in sorted(EVALUATED, key=lambda e: -e[1]):
            case = shoot_case(scene, size, poses=poses, threads=threads).with_sources(count)
            result = process(
                case.sources, case.target, case.prior, case.options(rows=1, cols=1, threads=threads), Monitor(),
                evidence=evidence[:count] or None,
            )  # fmt: skip
            evidence = evidence or [s.source.evidence for s in result.sources]
            made, setup = result.light_field, f"{count} sources, poses {poses}"
            inner = inner_region(made.disparity.shape)
            error, probability = (made.disparity - _truth(case))[inner], made.surface.confidence[inner]
            px_per_inverse = np.float32(case.request.baseline_m * made.camera.focal_px)
            rows.append(figures(scene, setup, error, probability, made.surface.sigma[inner] * px_per_inverse))
            pixels.setdefault(setup, []).append((error.ravel(), probability.ravel()))
            _say(table(rows[-1:]).splitlines()[-1])
    joined = {
        setup: reliability(*(np.concatenate(p) for p in zip(*parts, strict=True))) for setup, parts in pixels.items()
    }
    return rows, joined


def table(rows: Iterable[dict[str, Any]]) -> str:
    """The figures as Markdown, with the mean of every setup."""
    listed = list(rows)
    for setup in dict.fromkeys(row["setup"] for row in listed):
        same = [row for row in listed if row["setup"] == setup]
        if len(same) > 1:
            means = {
                key: float(np.mean([row[key] for row in same])) for key in same[0] if key not in ("scene", "setup")
            }
            listed.append({"scene": "**mean**", "setup": setup, **means})
    percent = ("within_tolerance", "within_sigma")
    return markdown_table([row | {key: 100 * row[key] for key in percent} for row in listed], FIGURE_COLUMNS)


def curve_table(curves: dict[str, Reliability]) -> str:
    """Reliability curves as Markdown: what was predicted, what happened."""
    rows = [
        {"setup": setup, "predicted": 100 * float(p), "observed": 100 * float(o), "share": 100 * float(n / total)}
        for setup, curve in curves.items()
        for total in [curve.pixels.sum()]
        for p, o, n in zip(curve.predicted, curve.observed, curve.pixels, strict=True)
        if n
    ]
    return markdown_table(rows, CURVE_COLUMNS)


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def main(arguments: Sequence[str] | None = None) -> None:
    """Fit and print or store; or evaluate and print."""
    parser = argparse.ArgumentParser(prog="python -m lfrig.bench.calibrate_confidence", description=__doc__)
    parser.add_argument("--write", action="store_true", help="store the model in the package")
    parser.add_argument("--evaluate", choices=("tuning", "reporting"), help="judge the shipped model instead")
    parser.add_argument("--plot", type=Path, help="with --evaluate: PNG of the reliability curves")
    parser.add_argument("--scenes", nargs="+", help="only these of the half")
    parser.add_argument("--threads", type=int, default=0)
    wanted = parser.parse_args(arguments)
    if wanted.evaluate:
        rows, curves = evaluate(scene_names(wanted.evaluate, wanted.scenes), FULL, wanted.threads)
        print(table(rows), curve_table(curves), sep="\n\n")
        if wanted.plot:
            from lfrig.bench.plots import reliability_curves

            reliability_curves(wanted.plot, curves)
        return
    names, shots = collect(scene_names("tuning", wanted.scenes), FULL, wanted.threads)
    model, rows = fit(names, shots)
    text = json.dumps(model.to_json(), separators=(",", ":")).replace('],"', '],\n"').replace("],[", "],\n[") + "\n"
    print(table(rows))
    if wanted.write:
        FILE.write_text(text, encoding="utf-8")
    else:
        print(text)


if __name__ == "__main__":
    main()
