"""Plots of the benchmarks, as PNG. Matplotlib is loaded when the first one is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from lfrig.contracts.files import disk_errors
from lfrig.processing.metrics import Reliability
from lfrig.processing.model import F32, U8

DPI = 110


def bars(path: Path, groups: Mapping[str, Mapping[str, float]], *, title: str, unit: str) -> None:
    """Grouped bars on a logarithmic axis: ``groups[group][bar]``."""
    figure, axes = _figure(9, 4)
    names = list(dict.fromkeys(name for group in groups.values() for name in group))
    width = 0.8 / max(len(names), 1)
    for i, name in enumerate(names):
        values = [group.get(name, np.nan) for group in groups.values()]
        axes.bar(np.arange(len(groups)) + (i - (len(names) - 1) / 2) * width, values, width, label=name)
    axes.set_xticks(np.arange(len(groups)), list(groups), fontsize=8)
    axes.set_yscale("log")
    axes.set_ylabel(unit)
    axes.set_title(title)
    axes.grid(axis="y", alpha=0.3)
    axes.legend(fontsize=8)
    _save(figure, path)


def front(path: Path, series: Mapping[str, Sequence[tuple[float, float]]], *, title: str, x: str, y: str) -> None:
    """Points (x, y) of each series on two logarithmic axes, joined in order of x."""
    figure, axes = _figure(7, 4.5)
    for name, points in series.items():
        ordered = sorted(points)
        axes.plot([p[0] for p in ordered], [p[1] for p in ordered], "o-", label=name)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.set_title(title)
    axes.grid(which="both", alpha=0.3)
    axes.legend(fontsize=8)
    _save(figure, path)


def reliability_curves(path: Path, curves: Mapping[str, Reliability]) -> None:
    """Observed over predicted frequency of errors below the tolerance; the size of a point is the share of pixels."""
    figure, axes = _figure(5.5, 5)
    axes.plot([0, 1], [0, 1], color="grey", linewidth=1)
    for name, curve in curves.items():
        (line,) = axes.plot(curve.predicted, curve.observed, label=f"{name}, ECE {curve.ece:.3f}")
        size = 4 + 200 * np.sqrt(curve.pixels / max(int(curve.pixels.sum()), 1))
        axes.scatter(curve.predicted, curve.observed, size, color=line.get_color(), alpha=0.5)
    axes.set_xlabel("confidence")
    axes.set_ylabel("share of pixels with |error| < 0.1 px")
    axes.set_title("Reliability")
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    _save(figure, path)


def error_picture(path: Path, photo: U8, truth: F32, estimate: F32, *, title: str, limit_px: float = 0.1) -> None:
    """The photo, the true and the estimated disparity in one scale, and the error up to ±``limit_px``."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7), layout="constrained")
    lo, hi = (float(v) for v in np.nanquantile(truth, [0.005, 0.995]))
    panels: list[tuple[str, Any, dict[str, Any]]] = [
        ("photo", photo, {}),
        ("true disparity [px per view step]", truth, {"cmap": "turbo", "vmin": lo, "vmax": hi}),
        ("estimate", estimate, {"cmap": "turbo", "vmin": lo, "vmax": hi}),
        ("estimate − truth [px]", estimate - truth, {"cmap": "RdBu", "vmin": -limit_px, "vmax": limit_px}),
    ]
    for axes, (name, picture, style) in zip(figure.subplots(2, 2).ravel(), panels, strict=True):
        shown = axes.imshow(picture, interpolation="nearest", **style)
        axes.set_title(name, fontsize=9)
        axes.set_axis_off()
        if style:
            figure.colorbar(shown, ax=axes, shrink=0.8)
    figure.suptitle(title)
    _save(figure, path)


def _figure(width: float, height: float) -> tuple[Any, Any]:
    # A Figure of its own instead of pyplot: no global state, no window system.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


def _save(figure: Any, path: Path) -> None:
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=DPI, metadata={"Software": None})
