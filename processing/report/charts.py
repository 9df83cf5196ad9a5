"""Charts as inline SVG; colours come from the page's style sheet, so they follow light and dark mode."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from lfrig.contracts.result import StageReport
from lfrig.processing.model import F32
from lfrig.processing.report import words
from lfrig.processing.report.html import Html, el
from lfrig.processing.report.pictures import Scale, lookup_table

BAR_WIDTH = 480
_UNIT_WIDTH = 56
_STOPS = 12


def colour_bar(
    scale: Scale, unit: str = "", second: Callable[[float], float] | None = None, second_unit: str = ""
) -> Html:
    """The colours of ``scale`` with ticks below, and above them the same places in another quantity.

    ``second`` maps a value of the scale to that quantity (px → m); its ticks are round values of its own.
    """
    length, top = BAR_WIDTH - _UNIT_WIDTH - 8, 18 if second else 2
    identifier = f"scale-{scale.name}-{scale.low:.5g}-{scale.high:.5g}".replace(".", "_").replace("+", "")

    def place(value: float) -> float:
        return 8 + length * (value - scale.low) / (scale.high - scale.low)

    colours = lookup_table(scale.name)
    stops = [
        el("stop", offset=f"{100 * i / _STOPS:.1f}%", stop_color=f"#{colours[i * 255 // _STOPS].tobytes().hex()}")
        for i in range(_STOPS + 1)
    ]
    values = words.nice_ticks(scale.low, scale.high, 6)
    ticks = [
        part
        for value, label in zip(values, words.tick_labels(values), strict=True)
        for part in _tick(place(value), top + 12, 4, top + 28, label)
    ]
    if second:
        ticks += _second_ticks(scale, second, place, top)
    x = BAR_WIDTH - _UNIT_WIDTH + 22
    return el(
        "svg",
        el("defs", el("linearGradient", *stops, id=identifier)),
        el("rect", x=8, y=top, width=length, height=12, fill=f"url(#{identifier})", rx=2),
        *ticks,
        el("text", unit, x=x, y=top + 28, class_="unit"),
        el("text", second_unit, x=x, y=top - 6, class_="unit") if second else None,
        viewBox=f"0 0 {BAR_WIDTH} {top + 34}",
        class_="colour-bar",
        role="img",
        aria_label=f"colour scale from {words.number(scale.low)} to {words.number(scale.high)} {unit}",
    )


def _second_ticks(
    scale: Scale, second: Callable[[float], float], place: Callable[[float], float], top: int
) -> list[Html]:
    """Ticks above the bar: at round values of the second quantity, which need not be evenly spaced."""
    grid = np.linspace(scale.low, scale.high, 400)
    found = np.array([second(float(value)) for value in grid])
    if not np.isfinite(found).all():
        return []
    order = np.argsort(found)
    values = words.nice_ticks(float(found.min()), float(found.max()), 6)
    ticks: list[Html] = []
    last = -np.inf
    at = [place(float(np.interp(value, found[order], grid[order]))) for value in values]
    for x, label in sorted(zip(at, words.tick_labels(values), strict=True)):
        if x - last > 34:  # labels that would touch are left out
            ticks += _tick(x, top, -3, top - 6, label)
            last = x
    return ticks


def _tick(x: float, y: float, length: float, text_y: float, label: str) -> list[Html]:
    return [
        el("line", x1=x, x2=x, y1=y, y2=y + length, class_="tick"),
        el("text", label, x=x, y=text_y, text_anchor="middle"),
    ]


def stage_chart(stages: Sequence[StageReport]) -> Html:
    """One pair of bars per stage: wall seconds over CPU seconds of the whole process, peak memory beside them."""
    row, left, right, width = 34, 110, 190, 760
    longest = max([max(stage.wall_s, stage.cpu_s) for stage in stages] + [1e-9])
    parts: list[Html] = []
    for index, stage in enumerate(stages):
        y = index * row + 4
        for offset, value, kind in ((2, stage.wall_s, "wall"), (13, stage.cpu_s, "cpu")):
            length = max(1.0, (width - left - right) * value / longest)
            parts.append(el("rect", x=left, y=y + offset, width=length, height=9, rx=2, class_=kind))
        end = left + max(1.0, (width - left - right) * max(stage.wall_s, stage.cpu_s) / longest)
        cost = f"{words.seconds(stage.wall_s)} · {words.seconds(stage.cpu_s)} CPU · {words.memory(stage.peak_rss_mb)}"
        parts += [
            el("text", stage.name, x=left - 10, y=y + 16, text_anchor="end", class_="name"),
            el("text", cost, x=end + 8, y=y + 16),
        ]
    height = len(stages) * row + 6
    label = "cost of each stage: " + "; ".join(f"{s.name} {words.seconds(s.wall_s)}" for s in stages)
    return el("svg", *parts, viewBox=f"0 0 {width} {height}", class_="stages", role="img", aria_label=label)


class _CurveAxes:
    """A logarithmic axis of thresholds [px] below a linear one of shares."""

    width, height, left, right, top, bottom = 480, 268, 46, 14, 10, 46
    low, high = 1e-3, 1.0

    def x(self, threshold: float) -> float:
        unit = np.log10(threshold / self.low) / np.log10(self.high / self.low)
        return self.left + (self.width - self.left - self.right) * float(unit)

    def y(self, share: float) -> float:
        return self.top + (self.height - self.top - self.bottom) * (1 - share)

    def grid(self) -> list[Html]:
        parts: list[Html] = []
        for share in (0.0, 0.25, 0.5, 0.75, 1.0):
            y = self.y(share)
            parts.append(el("line", x1=self.left, x2=self.width - self.right, y1=y, y2=y, class_="grid"))
            parts.append(el("text", f"{100 * share:.0f} %", x=self.left - 8, y=y + 4, text_anchor="end"))
        for threshold in (0.001, 0.01, 0.1, 1.0):
            label = words.number(threshold, 1)
            parts.append(el("text", label, x=self.x(threshold), y=self.y(0) + 18, text_anchor="middle"))
        return parts


def error_curve(error_px: F32, marks: Sequence[float] = (0.01, 0.05, 0.1)) -> Html:
    """The share of the known pixels whose absolute error is below a threshold; the thresholds on a log axis."""
    known = np.sort(np.abs(error_px[np.isfinite(error_px)]))

    def share(threshold: float) -> float:
        return float(np.searchsorted(known, threshold)) / max(1, len(known))

    axes = _CurveAxes()
    parts = axes.grid()
    for mark in marks:
        x, y = axes.x(mark), axes.y(share(mark))
        # 0.05 and 0.1 are close together: their labels stand on either side.
        before = mark < 0.1
        parts += [
            el("line", x1=x, x2=x, y1=axes.y(0), y2=y, class_="mark"),
            el("circle", cx=x, cy=y, r=3.5, class_="dot"),
            el("text", f"{100 * share(mark):.1f} %", x=x + (-6 if before else 6), y=axes.y(0) - 8,
               text_anchor="end" if before else "start", class_="strong"),
        ]  # fmt: skip
    thresholds = np.geomspace(axes.low, axes.high, 120)
    path = " ".join(f"{axes.x(t):.1f},{axes.y(share(t)):.1f}" for t in thresholds)
    return el(
        "svg",
        *parts,
        el("polyline", points=path, class_="curve"),
        el("text", "absolute error below … px", x=axes.width - axes.right, y=axes.height - 6, text_anchor="end",
           class_="unit"),
        viewBox=f"0 0 {axes.width} {axes.height}",
        class_="curve-chart",
        role="img",
        aria_label="share of pixels whose disparity error is below a threshold",
    )  # fmt: skip
