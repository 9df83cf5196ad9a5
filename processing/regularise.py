"""Fused evidence → surface: semi-global matching on the volume, then a windowed mean around the best plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lfrig.contracts.progress import Monitor
from lfrig.processing.fusion import FusedVolume
from lfrig.processing.kernels.sgm import PATHS, U16, finest_unit
from lfrig.processing.kernels.surface import PeakMean, evidence_cost, mean_of_scores, sgm_surface
from lfrig.processing.model import F32, U8


@dataclass(frozen=True)
class RegulariseSettings:
    """Knobs of the regularisation, in units of log evidence; chosen on the tuning scenes."""

    method: str = "sgm"
    """``sgm`` or ``none``."""
    regression: str = "window"
    """``window`` (±window planes around the peak) or ``soft-argmax`` (all planes, as printed in the paper)."""
    window: int = 3
    cap: float = 20.0
    p1: float = 4.2
    step_px: float = 0.01
    """``p1`` is for a change of so much [px per view step of the sources]: a slope costs the same on any planes."""
    p2: float = 50.0
    edge_grey: float = 30.0
    sharpness: float = 2.0
    """Log evidence per unit of the paths' mean."""


DEFAULT_REGULARISE = RegulariseSettings()


def regularise(
    volume: FusedVolume,
    photo: U8,
    settings: RegulariseSettings = DEFAULT_REGULARISE,
    *,
    threads: int = 0,
    monitor: Monitor | None = None,
) -> tuple[F32, F32]:
    """Surface from the fused volume.

    Parameters
    ----------
    photo : uint8 [H, W, 3]
        The target; its edges allow depth steps.

    Returns
    -------
    inverse_depth : float32 [H, W], 1/m
    peak : float32 [H, W], 0..1
        Share of the evidence within the window around the best plane.
    """
    if settings.method == "none":
        index, peak = mean_of_scores(volume.evidence, _peak_mean(settings, 1.0))
    else:
        index, peak = _semi_global(volume, photo, settings, threads)
    if monitor:
        monitor.advance(0)
    w0, dw = volume.planes
    return np.asarray(w0 + dw * index, np.float32), peak


def _peak_mean(settings: RegulariseSettings, sharpness: float) -> PeakMean:
    return PeakMean(sharpness, settings.window, settings.regression == "soft-argmax")


def _costs(volume: FusedVolume, p1: float, settings: RegulariseSettings, threads: int) -> tuple[U16, float]:
    """Costs uint16 [H, W, N] and their steps per unit of log evidence: the volume's own where these fit, else the
    finest that do.
    """
    finest = finest_unit(settings.cap, p1, settings.p2)
    if volume.cap <= settings.cap and volume.unit * finest >= 1 - 1e-6:
        return volume.cost, 1 / volume.unit
    return evidence_cost(volume.evidence, finest, settings.cap, threads=threads), finest


def _semi_global(volume: FusedVolume, photo: U8, settings: RegulariseSettings, threads: int) -> tuple[F32, F32]:
    """Mean plane index and peak mass after semi-global matching, float32 [H, W] each."""
    p1 = settings.p1 if volume.plane_px is None else settings.p1 * volume.plane_px / settings.step_px
    p1 = min(p1, settings.p2 / 1.5)
    cost, unit = _costs(volume, p1, settings, threads)
    mean = _peak_mean(settings, settings.sharpness / (PATHS * unit))
    return sgm_surface(cost, photo, unit * p1, unit * settings.p2, settings.edge_grey, mean, threads=threads)
