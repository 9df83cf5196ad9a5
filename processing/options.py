"""What can be asked of the pipeline: presets, the knobs of every stage, the request."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from lfrig.contracts.errors import NotInThisVersion, UsageError
from lfrig.processing.continuation import ContinuationSettings
from lfrig.processing.dpv import DpvSettings
from lfrig.processing.edges import EdgeSettings
from lfrig.processing.fusion import FusionSettings
from lfrig.processing.poses import PoseMethod
from lfrig.processing.refine import RefineSettings
from lfrig.processing.regularise import RegulariseSettings
from lfrig.processing.scale_fit import ScaleFitSettings
from lfrig.processing.skipping import SKIP_ALL, Skips
from lfrig.processing.synthesis import SynthesisSettings
from lfrig.processing.wide_baseline import WideBaselineSettings


@dataclass(frozen=True)
class Settings:
    """The knobs of every stage."""

    dpv: DpvSettings = field(default_factory=DpvSettings)
    scale_fit: ScaleFitSettings = field(default_factory=ScaleFitSettings)
    fusion: FusionSettings = field(default_factory=FusionSettings)
    regularise: RegulariseSettings = field(default_factory=RegulariseSettings)
    refine: RefineSettings = field(default_factory=RefineSettings)
    wide_baseline: WideBaselineSettings = field(default_factory=WideBaselineSettings)
    continuation: ContinuationSettings = field(default_factory=ContinuationSettings)
    edges: EdgeSettings = field(default_factory=EdgeSettings)
    synthesis: SynthesisSettings = field(default_factory=SynthesisSettings)
    skips: Skips = SKIP_ALL


def without_wide_baseline(settings: Settings) -> Settings:
    """The same settings without the wide-baseline refinement, and what rests on it."""
    return replace(
        settings, wide_baseline=replace(settings.wide_baseline, enabled=False),
        continuation=replace(settings.continuation, enabled=False),
    )  # fmt: skip


@dataclass(frozen=True)
class Preset:
    """One way through the pipeline: the fraction of full size at which geometry is computed, and all knobs."""

    resolution: float
    settings: Settings


PRESETS: Mapping[str, Preset] = MappingProxyType(
    {
        "preview": Preset(
            0.5,
            without_wide_baseline(Settings(fusion=FusionSettings(planes=48))),
        ),
        "fast": Preset(1.0, Settings()),
    }
)
LATER_PRESETS = ("balanced", "paper")


@dataclass(frozen=True)
class ProcessOptions:
    """A request. ``target_baseline_m`` and ``target_focus_m`` default to the fitted ones of the nearest source;
    ``resolution`` below 1 computes the geometry at that fraction of full size; it and ``settings`` default to the
    preset's; ``threads`` 0 = all cores.
    """

    preset: str = "fast"
    poses: PoseMethod = "auto"
    target_baseline_m: float | None = None
    target_focus_m: float | None = None
    rows: int = 7
    cols: int = 7
    threads: int = 0
    resolution: float | None = None
    bit_depth: int = 8
    settings: Settings | None = None

    @property
    def geometry_resolution(self) -> float:
        """The asked or the preset's resolution."""
        return PRESETS[self.preset].resolution if self.resolution is None else self.resolution

    @property
    def knobs(self) -> Settings:
        """The asked or the preset's settings."""
        return PRESETS[self.preset].settings if self.settings is None else self.settings


def check_options(options: ProcessOptions) -> None:
    """Raise `UsageError` for options that make no sense."""
    if options.preset in LATER_PRESETS:
        raise NotInThisVersion(f"preset '{options.preset}'", remedy="use --preset fast")
    if options.preset not in PRESETS:
        raise UsageError(f"unknown preset '{options.preset}'", remedy=f"one of {', '.join(PRESETS)}")
    resolution = options.geometry_resolution
    if not 0.05 <= resolution <= 1.0:
        raise UsageError(f"resolution {resolution:g} is not in 0.05..1", remedy="1 is full size")
    if options.rows < 1 or options.cols < 1 or options.rows * options.cols > 1024:
        raise UsageError(f"{options.rows}x{options.cols} views cannot be made", remedy="7x7 is usual")
    if options.bit_depth not in (8, 16):
        raise UsageError(f"bit depth {options.bit_depth} is not 8 or 16", remedy="give 8 or 16")
    for name, value in (("baseline", options.target_baseline_m), ("focus", options.target_focus_m)):
        if value is not None and not (np.isfinite(value) and value > 0):
            raise UsageError(f"target {name} {value} m is not a positive length", remedy="give it in metres")
