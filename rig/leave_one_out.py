"""Leave-one-out: each light field in turn is the target, its centre view the photo, its own views the truth.

This is how the paper evaluates, and it works on real sessions. Where the session has a truth, the disparity
is scored against the true depth, and the oracles stand beside the views; elsewhere against the disparity that
the left-out light field itself shows, which is an estimate too and is called so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.contracts.bench import BenchDocument
from lfrig.contracts.errors import BadInput, GeometryRefused
from lfrig.contracts.files import atomic_folder, atomic_write_text, refuse_existing
from lfrig.contracts.progress import Monitor
from lfrig.contracts.score import ScoreDocument
from lfrig.processing.depth import DepthMap, estimate_disparity
from lfrig.processing.export.result import LoadedResult, load_result
from lfrig.processing.model import LightField, LightFieldRequest
from lfrig.processing.options import ProcessOptions
from lfrig.processing.scale_fit import fit_affine
from lfrig.rig.candidate import Candidate, score_candidate
from lfrig.rig.process import OnlyNotices, process_session
from lfrig.rig.session.store import SessionStore
from lfrig.rig.truth import CaptureTruth, load_capture_truth, truth_beside

SURE = 0.5
"""Where both confidences exceed this, a left-out light field may tell the optics that nobody recorded."""

MIN_FIT_PIXELS, FIT_PIXELS = 200, 20_000


@dataclass(frozen=True)
class Evaluation:
    """The evaluation of one preset: its folder, with a result per target, and what evaluate.json says."""

    preset: str
    folder: Path
    document: BenchDocument


def evaluate_session(
    session: Path,
    presets: Sequence[str] = ("fast",),
    options: ProcessOptions | None = None,
    monitor: Monitor | None = None,
    *,
    out: Path | None = None,
    overwrite: bool = False,
) -> list[Evaluation]:
    """Evaluate presets on a session of at least two light fields.

    Writes, per preset, ``SESSION/results/evaluate-<preset>/`` with one result folder per target (score.json
    and its report included), evaluate.json (a `BenchDocument`) and evaluate.md. The whole folder appears or
    nothing does. The results do not depend on SESSION.truth; only score.json, the report pages and evaluate.*
    do.

    Parameters
    ----------
    presets : sequence of str
        Each replaces ``options.preset``.
    out : Path, optional
        Where the ``evaluate-<preset>`` folders go, instead of SESSION/results.

    Raises
    ------
    BadInput
        No session, fewer than two light fields, or the folder exists and ``overwrite`` is false.
    GeometryRefused
        Every target was refused. A single refusal is a row with its reason and a warning.
    """
    options, monitor = options or ProcessOptions(), monitor or Monitor()
    store = SessionStore.open(session)
    targets = [name for name, capture in store.captures().items() if capture.kind == "light_field"]
    if len(targets) < 2:
        raise BadInput(
            f"has {len(targets)} light field{'s' * (len(targets) != 1)}; leaving one out needs two or more",
            path=session, code="too-few-light-fields", remedy="capture or ingest more light fields",
        )  # fmt: skip
    folders = {preset: (out or store.path / "results") / f"evaluate-{preset}" for preset in presets}
    for folder in folders.values():
        refuse_existing(folder, overwrite=overwrite)
    evaluations = []
    for preset, folder in folders.items():
        with atomic_folder(folder, overwrite=overwrite) as temporary:
            document = _evaluate_preset(store, targets, replace(options, preset=preset), temporary, monitor)
        evaluations.append(Evaluation(preset, folder, document))
    return evaluations


def _evaluate_preset(
    store: SessionStore, targets: list[str], options: ProcessOptions, folder: Path, monitor: Monitor
) -> BenchDocument:
    rows: list[dict[str, Any]] = []
    refusals: list[GeometryRefused] = []
    with monitor.task(f"evaluate {options.preset}", total=len(targets)):
        for target in targets:
            left_out = store.load_light_field(target, threads=options.threads, monitor=OnlyNotices(monitor))
            own_size = replace(options, rows=left_out.angular[0], cols=left_out.angular[1])
            try:
                process_session(store.path, target, None, own_size, folder / target, False, monitor)
                rows.append(_score_left_out(store, left_out, folder / target, options, monitor))
            except GeometryRefused as error:
                refusals.append(error)
                monitor.warn("target-refused", f"target {target}: {error}")
                rows.append({"target": target, "refused": error.code, "message": error.message})
            monitor.advance()
    if len(refusals) == len(targets):
        raise refusals[0]
    document = BenchDocument(name=f"evaluate-{options.preset}", rows=[*rows, _means(rows)])
    document.save(folder / "evaluate.json")
    atomic_write_text(folder / "evaluate.md", markdown(document))
    return document


def _score_left_out(
    store: SessionStore, left_out: LightField, folder: Path, options: ProcessOptions, monitor: Monitor
) -> dict[str, Any]:
    """Score one result against the light field that was left out, write score.json, and return its row."""
    from lfrig.processing.report.page import add_score

    result, known = load_result(folder), truth_beside(store.path)
    has_truth = (known / "truth.json").is_file()
    if has_truth:
        truth = load_capture_truth(known, left_out.id)
        candidate = _true_candidate(result, left_out, truth, options, monitor)
    else:
        truth, candidate = own_truth(result, left_out, options, monitor)
    score, error_px = score_candidate(
        candidate, truth, recorded_views=left_out.views, oracles=None if has_truth else {},
        threads=options.threads, monitor=monitor,
    )  # fmt: skip
    notes = [*score.notes, f"views of b = {candidate.request.baseline_m:.6g}, z_f = "
             f"{candidate.request.focus_distance_m:.6g}: those of the left-out light field"]  # fmt: skip
    if not has_truth:
        notes.append("no truth: the disparity is scored against that of the left-out light field, an estimate")
    score = score.model_copy(update={"notes": notes})
    score.save(folder / "score.json")
    add_score(folder, score, error_px)
    return _row(result, score, "truth" if has_truth else "own light field (estimated)")


def _true_candidate(
    result: LoadedResult, left_out: LightField, truth: CaptureTruth, options: ProcessOptions, monitor: Monitor
) -> Candidate:
    """The result as a light field of the left-out one's true optics: the recorded ones have errors of their own."""
    if not result.report.target.metric or truth.baseline_m is None or truth.focus_distance_m is None:
        own = estimate_disparity(left_out, None, options.knobs.dpv, threads=options.threads, monitor=monitor)
        request = fitted_request(own, result, result.request, result.report.target.fx)
    else:
        request = replace(result.request, baseline_m=truth.baseline_m, focus_distance_m=truth.focus_distance_m)
    return _with_optics(result, left_out, request, options, monitor)


def own_truth(
    result: LoadedResult, left_out: LightField, options: ProcessOptions, monitor: Monitor
) -> tuple[CaptureTruth, Candidate]:
    """What stands for the truth of a left-out light field when there is none: its own disparity and views.

    Recorded optics are trusted when they claim to be exact; otherwise they are fitted between the two geometries.
    """
    own = estimate_disparity(left_out, None, options.knobs.dpv, threads=options.threads, monitor=monitor)
    request, focal_px, optics = result.request, result.report.target.fx, left_out.optics
    exact = optics.sigma_baseline == 0 and optics.baseline_m is not None and optics.focus_distance_m is not None
    if not exact:
        request = fitted_request(own, result, request, focal_px)
    candidate = _with_optics(result, left_out, request, options, monitor)
    truth = CaptureTruth(
        id=left_out.id,
        inverse_depth=request.inverse_depth(own.disparity, focal_px),
        focal_px=focal_px,
        baseline_m=request.baseline_m,
        focus_distance_m=request.focus_distance_m,
        views=left_out.views,
        noise_sigma=0.0,
    )
    # In its own truth's units, whatever the gauge: both geometries are in the same one.
    return truth, replace(candidate, metric=True)


def _with_optics(
    result: LoadedResult,
    left_out: LightField,
    request: LightFieldRequest,
    options: ProcessOptions,
    monitor: Monitor,
) -> Candidate:
    """The result's geometry as a light field of ``request``; its views are made again when that is another one."""
    from lfrig.processing.synthesis import fill_nan, render_views

    target, made = result.report.target, result.request
    if request == made:
        return Candidate(result.disparity, result.views, made, target.metric)
    disparity = request.disparity(result.inverse_depth, target.fx)
    views = render_views(
        left_out.centre_view, fill_nan(disparity), *left_out.angular, threads=options.threads, monitor=monitor
    )
    return Candidate(disparity, views, request, target.metric)


def fitted_request(
    own: DepthMap, result: LoadedResult, request: LightFieldRequest, focal_px: float
) -> LightFieldRequest:
    """The optics of a left-out light field that nobody recorded: the line 1/z = a δ + c between its own
    disparity and the result's depth, where both are sure.

    Raises
    ------
    GeometryRefused
        There is no such line, or it has the wrong sign.
    """
    sure = (own.confidence > SURE) & (result.confidence > SURE) & np.isfinite(result.inverse_depth)
    disparity, inverse_depth = (x[sure].astype(np.float64) for x in (own.disparity, result.inverse_depth))
    every = max(1, disparity.size // FIT_PIXELS)
    if disparity.size >= MIN_FIT_PIXELS:
        fit = fit_affine(disparity[::every], inverse_depth[::every])
        if fit.a > 0 and fit.c > 0:
            return replace(request, baseline_m=1 / (fit.a * focal_px), focus_distance_m=1 / fit.c)
    raise GeometryRefused(
        "the left-out light field's own disparity does not follow the result's depth", code="no-own-optics",
        remedy="give the light field's optics in its capture.json",
    )  # fmt: skip


def markdown(document: BenchDocument) -> str:
    """The table of an evaluation."""
    columns = [
        ("target", "target", ""), ("reference", "disparity against", ""), ("mse", "MSE px²", ".5f"),
        ("ppe_005", "PPE .05 %", ".2f"), ("ppe_010", "PPE .1 %", ".2f"), ("psnr", "PSNR dB", ".2f"),
        ("ssim", "SSIM", ".4f"), ("psnr_z_buffer", "z-buffer oracle dB", ".2f"),
        ("psnr_fixed_point", "fixed-point oracle dB", ".2f"), ("cpu_s", "CPU s", ".1f"),
    ]  # fmt: skip
    lines = [f"# {document.name}", "", "| " + " | ".join(title for _, title, _ in columns) + " |"]
    lines.append("|---" * len(columns) + "|")
    for row in document.rows:
        if "refused" in row:
            lines.append(f"| {row['target']} | refused: {row['message']} |" + " |" * (len(columns) - 2))
            continue
        cells = [format(row[key], form) if row.get(key) is not None else "" for key, _, form in columns]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def _row(result: LoadedResult, score: ScoreDocument, reference: str) -> dict[str, Any]:
    everywhere, stages = score.disparity["all"], result.report.stages
    row: dict[str, Any] = {
        "target": result.report.target.id,
        "sources": [source.id for source in result.report.sources],
        "reference": reference,
        "bf_px_m": score.bf_px_m,
        **everywhere.model_dump(),
        "mse_aligned": score.disparity["aligned"].mse,
        "wall_s": sum(stage.wall_s for stage in stages),
        "cpu_s": sum(stage.cpu_s for stage in stages),
        "peak_rss_mb": max((stage.peak_rss_mb for stage in stages), default=0.0),
        "warnings": [warning.code for warning in result.report.warnings],
    }
    if score.views is not None:
        row |= {"psnr": score.views.psnr, "ssim": score.views.ssim, "psnr_corners": score.views.psnr_corners}
    row |= {f"psnr_{name}": oracle.psnr for name, oracle in score.oracles.items()}
    return row


def _means(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """The row of means over all targets that were not refused."""
    scored = [row for row in rows if "refused" not in row]
    numbers = [key for key, value in scored[0].items() if isinstance(value, (int, float))]
    means: dict[str, Any] = {
        key: float(np.mean([row[key] for row in scored])) for key in numbers if all(key in row for row in scored)
    }
    references = {row["reference"] for row in scored}
    return {"target": "mean", "reference": references.pop() if len(references) == 1 else "mixed", **means}
