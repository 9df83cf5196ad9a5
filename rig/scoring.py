"""Score a result folder against the truth of its session: `lfrig score`."""

from __future__ import annotations

from pathlib import Path

from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor
from lfrig.contracts.score import ScoreDocument
from lfrig.processing.model import F32, LightFieldRequest
from lfrig.rig.candidate import Candidate, score_candidate
from lfrig.rig.truth import ONLY_SIMULATED, load_capture_truth, truth_beside


def score_result(
    result: Path, truth: Path | None = None, *, threads: int = 0, monitor: Monitor | None = None
) -> tuple[ScoreDocument, F32]:
    """Score a result folder, write RESULT/score.json and complete RESULT/report.html.

    Parameters
    ----------
    result : Path
        A folder that `lfrig.processing.export.result.write_result` wrote.
    truth : Path, optional
        The truth of its session; by default SESSION.truth beside the session that report.json names, or
        beside the session that the result lies in.
    threads : int
        0 = all processors.

    Returns
    -------
    (ScoreDocument, float32 [H, W])
        The score, and the signed error of the disparity [px per view step], NaN where it is unknown.

    Raises
    ------
    BadInput
        The folder is no result, or no truth of its target is there.
    DiskError
        score.json cannot be written.
    """
    from lfrig.processing.export.result import load_result
    from lfrig.processing.report.page import add_score

    monitor = monitor or Monitor()
    loaded = load_result(result)
    target = loaded.report.target
    folder = truth if truth is not None else find_truth(result, loaded.report.session)
    request = LightFieldRequest(target.baseline_m, target.focus_distance_m, target.rows, target.cols)
    score, error_px = score_candidate(
        Candidate(loaded.disparity, loaded.views, request, target.metric),
        load_capture_truth(folder, target.id),
        threads=threads,
        monitor=monitor,
    )
    score.save(result / "score.json")
    add_score(result, score, error_px)
    return score, error_px


def find_truth(result: Path, session: str | None) -> Path:
    """The truth folder of a result: beside the session that it lies in, else beside the one that report.json
    names.

    Parameters
    ----------
    result : Path
        By default SESSION/results/NAME; with ``--out`` anywhere.
    session : str, optional
        What report.json says: the name of the session's folder, or its path.

    Raises
    ------
    BadInput
        There is none.
    """
    result = result.resolve()
    candidates = [truth_beside(result.parent.parent)]
    if session:
        # A result that was written elsewhere: beside it, above it, or where the command runs.
        candidates += [truth_beside(folder / session) for folder in (*result.parents[:2], Path())]
    for candidate in candidates:
        if (candidate / "truth.json").is_file():
            return candidate
    raise BadInput(
        f"no truth of its session found (there is no {candidates[0]})", path=result, code="no-truth",
        remedy=ONLY_SIMULATED,
    )  # fmt: skip
