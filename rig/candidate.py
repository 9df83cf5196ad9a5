"""Score arrays against what is true. Only this, `lfrig.rig.scoring`, leave-one-out and the benchmarks see
truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor
from lfrig.contracts.score import LightFieldScore, ScoreDocument
from lfrig.processing.metrics import BORDER_PX, disparity_scores, light_field_score
from lfrig.processing.model import F32, U8, Image, LightFieldRequest, SynthesizedLightField
from lfrig.rig.truth import CaptureTruth

Method = Literal["z_buffer", "fixed_point"]

SAME_PICTURE_MSE = 100.0
"""A result's photo and the truth's picture of it differ by less than this mean square [grey levels²] beyond
the noise, averaged over blocks: 10 grey levels, far above compression, rounding, noise and the aliasing of a
decoded view, far below what two captures of one scene differ by."""

SAME_PICTURE_BLOCK_PX = 4


@dataclass(frozen=True)
class Candidate:
    """What is scored: ``disparity`` float32 [H, W] px per view step, and the ``views`` uint8 or uint16
    [rows, cols, H, W, 3] that were made from it (None: only the disparity is scored).

    ``request`` holds the optics that both were made for; ``metric`` false means that its lengths are in units
    of the gauge.
    """

    disparity: F32
    views: Image | None
    request: LightFieldRequest
    metric: bool = True

    @classmethod
    def of(cls, light_field: SynthesizedLightField, *, metric: bool = True) -> Candidate:
        """What the pipeline returned."""
        return cls(light_field.disparity, light_field.views, light_field.request, metric)


def score_candidate(
    candidate: Candidate,
    truth: CaptureTruth,
    *,
    recorded_views: U8 | None = None,
    oracles: dict[str, LightFieldScore] | None = None,
    border_px: int = BORDER_PX,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> tuple[ScoreDocument, F32]:
    """Score arrays against the truth of their target; writes nothing.

    The true disparity is that of the candidate's own optics and of the target's true focal length, so a focal
    length that was estimated wrongly counts as the error that it causes.

    Parameters
    ----------
    recorded_views : uint8 [rows, cols, H, W, 3], optional
        The target's own recorded views, when it is a light field: the candidate's are meant to be the same. Without
        them the views of ``truth`` count, when they are of the candidate's optics.
    oracles : dict, optional
        What `score_oracles` returned for the same photo, truth, request and size, to save computing it again.

    Returns
    -------
    (ScoreDocument, float32 [H, W])
        The score, and the signed error of the disparity [px per view step], NaN where it is unknown.

    Raises
    ------
    BadInput
        The truth is not that of this result: another size, or another picture.
    """
    monitor = monitor or Monitor()
    _check_same_picture(candidate, truth)
    notes = [f"{border_px} px at the border of every picture are not scored"]
    request = candidate.request
    if not candidate.metric:
        request, note = _metric_request(candidate, truth)
        notes.append(note)
    true_disparity = truth.disparity(request.baseline_m, request.focus_distance_m)
    with monitor.task("score the disparity"):
        disparity = disparity_scores(
            candidate.disparity, true_disparity, inverse_depth=truth.inverse_depth, photo=truth.photo,
            border_px=border_px,
        )  # fmt: skip
    fields: dict[str, object] = {}
    if candidate.views is not None:
        reference = truth.views if recorded_views is None else recorded_views
        mismatch = truth.shows(request, reference, candidate.views.shape, any_optics=recorded_views is not None)
        if mismatch or reference is None:
            notes.append(f"the views are not scored: {mismatch}")
        else:
            with monitor.task("score the views"):
                if oracles is None:
                    oracles = score_oracles(
                        _centre(candidate.views), truth, true_disparity, reference,
                        border_px=border_px, threads=threads, monitor=monitor,
                    )  # fmt: skip
                fields = _view_scores(candidate, truth, reference, oracles, border_px, threads, monitor)
    if fields.get("views_clean") is not None:
        notes.append(
            "the photo is noisy: views_clean warps the photo without its noise, and the distance to the "
            "oracle is that of views_clean to z_buffer_clean"
        )
    document = ScoreDocument(
        bf_px_m=request.baseline_m * truth.focal_px,
        focus_distance_m=request.focus_distance_m,
        border_px=border_px,
        disparity=disparity,
        notes=notes,
    ).model_copy(update=fields)
    return document, np.asarray(candidate.disparity - true_disparity, np.float32)


def score_oracles(
    photo: Image,
    truth: CaptureTruth,
    true_disparity: F32,
    reference: U8,
    *,
    border_px: int = BORDER_PX,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> dict[str, LightFieldScore]:
    """Our synthesis fed the exact geometry: what remains is not the geometry's fault.

    Parameters
    ----------
    photo : uint8 or uint16 [H, W, 3]
        The photo that the result was made from.
    reference : uint8 [rows, cols, H, W, 3]
        The views that the result is scored against.

    Returns
    -------
    dict
        ``z_buffer`` (the stronger one) and ``fixed_point``; of a noisy photo also ``z_buffer_clean``, made
        from the photo without its noise and scored against the true views.
    """
    angular = reference.shape[:2]

    def score(picture: Image, method: Method, against: U8) -> LightFieldScore:
        views = _render(picture, true_disparity, angular, method, threads, monitor)
        return light_field_score(views, against, border_px=border_px)

    scores = {
        "z_buffer": score(photo, "z_buffer", reference),
        "fixed_point": score(photo, "fixed_point", reference),
    }
    if truth.noise_sigma > 0 and truth.views is not None and truth.photo is not None:
        scores["z_buffer_clean"] = score(truth.photo, "z_buffer", truth.views)
    return scores


def _view_scores(
    candidate: Candidate,
    truth: CaptureTruth,
    reference: U8,
    oracles: dict[str, LightFieldScore],
    border_px: int,
    threads: int,
    monitor: Monitor,
) -> dict[str, object]:
    """The fields of a `ScoreDocument` that need views."""
    assert candidate.views is not None
    views = light_field_score(_to8(candidate.views), reference, border_px=border_px)
    fields: dict[str, object] = {"views": views, "oracles": oracles}
    if "z_buffer" in oracles:
        fields["psnr_below_z_buffer_db"] = oracles["z_buffer"].psnr - views.psnr
    if "z_buffer_clean" in oracles and truth.views is not None and truth.photo is not None:
        again = _render(truth.photo, candidate.disparity, truth.views.shape[:2], "z_buffer", threads, monitor)
        clean = light_field_score(again, truth.views, border_px=border_px)
        # The noise of the photo is common to a result and to its oracle, and hides what geometry costs.
        fields |= {
            "views_clean": clean,
            "psnr_below_z_buffer_db": oracles["z_buffer_clean"].psnr - clean.psnr,
        }
    return fields


def _check_same_picture(candidate: Candidate, truth: CaptureTruth) -> None:
    """Raise `BadInput` when the truth is that of another session: a score against it would look like a bad
    result.
    """
    remedy = "score a result against the truth of its own session"
    if candidate.disparity.shape != truth.inverse_depth.shape:
        raise BadInput(
            f"the result is {list(candidate.disparity.shape)} px, the truth of capture {truth.id} "
            f"{list(truth.inverse_depth.shape)}",
            field="disparity", code="wrong-truth", remedy=remedy,
        )  # fmt: skip
    if candidate.views is None or truth.photo is None:
        return
    difference = _to8(_centre(candidate.views)).astype(np.float32) - truth.photo
    block = SAME_PICTURE_BLOCK_PX
    height, width = (block * (size // block) for size in difference.shape[:2])
    means = difference[:height, :width].reshape(height // block, block, width // block, block, 3).mean((1, 3))
    mean_square = float(np.mean(np.square(means), dtype=np.float64))
    if mean_square > SAME_PICTURE_MSE + 4 * truth.noise_sigma**2:
        raise BadInput(
            f"the photo of the result is not the picture that the truth of {truth.id} shows",
            field="views", code="wrong-truth", remedy=remedy,
        )  # fmt: skip


def _metric_request(candidate: Candidate, truth: CaptureTruth) -> tuple[LightFieldRequest, str]:
    """The request in metres, when the result is in units of its gauge.

    The disparity of a light field does not depend on the unit of length, so the gauge's is read off the
    truth.
    """
    request = candidate.request
    inverse_depth = request.inverse_depth(candidate.disparity, truth.focal_px)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = inverse_depth / truth.inverse_depth
    ratio = ratio[np.isfinite(ratio) & (ratio > 0)]
    if ratio.size == 0:
        raise BadInput("has no pixel to find the unit of length from", field="disparity", remedy="check the result")
    unit_m = float(np.median(ratio))
    metric = LightFieldRequest(
        request.baseline_m * unit_m, request.focus_distance_m * unit_m, request.rows, request.cols
    )
    return metric, f"the result has no metric scale: its unit of {unit_m:.6g} m was taken from the truth"


def _render(
    photo: Image,
    disparity: F32,
    angular: tuple[int, ...],
    method: Method,
    threads: int,
    monitor: Monitor | None,
) -> U8:
    from lfrig.processing.synthesis import fill_nan, render_views

    rows, cols = angular
    return _to8(render_views(photo, fill_nan(disparity), rows, cols, method=method, threads=threads, monitor=monitor))


def _centre(views: Image) -> Image:
    centre: Image = views[(views.shape[0] - 1) // 2, (views.shape[1] - 1) // 2]
    return centre


def _to8(image: Image) -> U8:
    return np.asarray(image if image.dtype == np.uint8 else image >> 8, np.uint8)
