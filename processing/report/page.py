"""report.html of a result: put together once, completed when a score exists."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import atomic_write_text
from lfrig.contracts.result import ReportDocument
from lfrig.contracts.score import ScoreDocument
from lfrig.processing.model import F32
from lfrig.processing.report import score as score_part
from lfrig.processing.report import sections
from lfrig.processing.report.html import el, page, section
from lfrig.processing.report.sources import sources
from lfrig.processing.report.viewer import viewer

if TYPE_CHECKING:
    from lfrig.processing.pipeline import ProcessResult

FILE = "report.html"


def write_report(folder: Path, result: ProcessResult, report: ReportDocument) -> None:
    """Write ``folder/report.html``: self-contained, no request leaves it.

    Raises
    ------
    DiskError
        Writing failed.
    """
    light_field, target = result.light_field, report.target
    title = f"{target.id} · lfrig"
    live = section(
        "The light field",
        viewer(
            light_field.views,
            light_field.disparity,
            bf_px_m=target.baseline_m * target.fx,
            focus_distance_m=target.focus_distance_m,
            metric=target.metric,
        ),
        id="light-field-section",
    )
    text = page(
        title,
        el(
            "main",
            sections.header(result, report),
            live,
            score_part.placeholder(),
            sections.maps(result, report),
            sections.epis(light_field.views, light_field.disparity, light_field.surface.confidence),
            sources(result),
            sections.cameras(result),
            sections.cost(report),
            sections.details(report),
        ),
    )
    atomic_write_text(folder / FILE, text)


def add_score(folder: Path, score: ScoreDocument, error_map: F32) -> None:
    """Fill the score section of an existing ``folder/report.html``; a second score replaces the first.

    A result without a report.html has nothing to be filled in, which is no error.

    Parameters
    ----------
    error_map : float32 [H, W]
        Signed error of the disparity, px per view step; NaN = unknown.

    Raises
    ------
    BadInput
        The page cannot be read or has no place for a score.
    DiskError
        Writing failed; the old page stays.
    """
    path = folder / FILE
    if not path.exists():
        return
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise BadInput("cannot be read", path=path, remedy="process again, or delete it") from None
    atomic_write_text(path, score_part.insert(text, score_part.score_section(score, error_map), str(path)))
