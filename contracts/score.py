"""score.json: a result against the truth, each number beside what exact geometry would reach."""

from __future__ import annotations

from typing import ClassVar

from pydantic import Field

from lfrig.contracts.schema import Count, Document, Finite, Model, NonNegative


class DisparityScore(Model):
    """Disparity error over one class of pixels, in px per view step of the synthesized light field.

    MSE [px²], RMSE [px], PPE(τ) = % of pixels with |error| < τ, BadPix(τ) = % with |error| > τ, Q25 = first
    quartile of |error| [px]. Unknown (NaN) pixels count as bad and with the error of the median disparity.
    """

    pixels: Count
    mse: NonNegative
    rmse: NonNegative
    ppe_005: Finite
    ppe_010: Finite
    badpix_007: Finite
    badpix_003: Finite
    badpix_001: Finite
    q25: NonNegative
    rmse_over_range: NonNegative
    unknown: Count = 0


class LightFieldScore(Model):
    """PSNR [dB], SSIM over the views without the centre, with it, and over the corner views; EPI error."""

    psnr: Finite
    ssim: Finite
    psnr_with_centre: Finite
    ssim_with_centre: Finite
    psnr_corners: Finite
    ssim_corners: Finite
    epi_mae: NonNegative


class ScoreDocument(Document):
    """score.json. ``oracles`` hold the same synthesis fed exact geometry."""

    NAME: ClassVar[str] = "lfrig.score"

    bf_px_m: Finite
    focus_distance_m: Finite
    border_px: Count = 15
    disparity: dict[str, DisparityScore] = Field(default_factory=dict)
    """By pixel class: ``all``, ``edge``, ``textureless``, and ``aligned`` (after a linear alignment)."""
    views: LightFieldScore | None = None
    views_clean: LightFieldScore | None = None
    """Against the noise-free truth, with a noise-free photo warped by the same disparity."""
    oracles: dict[str, LightFieldScore] = Field(default_factory=dict)
    """``z_buffer`` (the stronger one) and ``fixed_point``."""
    psnr_below_z_buffer_db: Finite | None = None
    notes: list[str] = Field(default_factory=list)
