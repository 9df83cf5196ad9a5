"""Scores and comparisons as tables for people."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from lfrig.contracts.score import LightFieldScore, ScoreDocument
    from lfrig.rig.compare import Comparison, MapDifference


def score_table(score: ScoreDocument) -> RenderableType:
    """Disparity errors per class of pixels, and the views beside both oracles."""
    head = (
        f"b·F {score.bf_px_m:.4f} px·m, focus {score.focus_distance_m:.3f} m, border of {score.border_px} px left out"
    )
    disparity = _table("disparity", "pixels", "MSE px²", "RMSE px", "RMSE/range", "PPE .05", "PPE .1", "BadPix .07")
    for name, value in score.disparity.items():
        disparity.add_row(
            name, str(value.pixels), f"{value.mse:.5f}", f"{value.rmse:.4f}", f"{value.rmse_over_range:.4f}",
            f"{value.ppe_005:.2f} %", f"{value.ppe_010:.2f} %", f"{value.badpix_007:.2f} %",
        )  # fmt: skip
    views = _table("views", "PSNR dB", "SSIM", "corner PSNR dB", "EPI error")
    made: dict[str, LightFieldScore | None] = {"result": score.views, "result, without noise": score.views_clean}
    oracles = {f"exact geometry, {name.replace('_', '-')}": value for name, value in score.oracles.items()}
    for name, found in {**made, **oracles}.items():
        if found is not None:
            views.add_row(
                name, f"{found.psnr:.2f}", f"{found.ssim:.4f}", f"{found.psnr_corners:.2f}", f"{found.epi_mae:.4f}"
            )
    return Group(Text(head), disparity, Text(), views, *(Text(f"note: {note}") for note in score.notes))


def comparison_table(comparison: Comparison) -> RenderableType:
    """Both results side by side."""
    parts: list[RenderableType] = []
    for title in ("parameters", "costs", "scores"):
        rows = getattr(comparison, title)
        if not rows:
            continue
        table = _table(title, str(comparison.first), str(comparison.second), "")
        for name, first, second in rows:
            table.add_row(name, cell(first), cell(second), "" if first == second else "≠")
        parts += [table, Text()]
    difference = _table("difference", "pixels", "in one only", "mean", "median", "95 %", "max")
    for name, found in (("disparity", comparison.disparity), ("inverse depth", comparison.inverse_depth)):
        if found is not None:
            difference.add_row(f"{name} [{found.unit}]", *_difference_cells(found))
    parts.append(difference)
    parts.append(Text("views: identical" if comparison.views_identical else "views: different"))
    if comparison.note:
        parts.append(Text(f"note: {comparison.note}"))
    return Group(*parts)


def cell(value: Any) -> str:
    """A value as a table shows it."""
    if value is None:
        return "–"
    if isinstance(value, float):
        return f"{value:.5g}"
    return str(value)


def _difference_cells(found: MapDifference) -> list[str]:
    values = (found.mean, found.median, found.p95, found.max)
    return [str(found.pixels), str(found.only_one), *(f"{value:.3g}" for value in values)]


class _Table(Table):
    """A plain table whose cells are never read as markup: ``focus [m]`` is a unit, not a style."""

    def add_row(self, *cells: Any, **style: Any) -> None:
        """Add a row of strings."""
        super().add_row(*map(Text, cells), **style)


def _table(*columns: str) -> Table:
    table = _Table(box=None, pad_edge=False, header_style="bold")
    for number, column in enumerate(columns):
        table.add_column(Text(column), justify="left" if number == 0 else "right")
    return table
