"""report.json: what a result was made from, how, how long it took, and what to be warned of."""

from __future__ import annotations

from typing import Any, ClassVar

from pydantic import Field

from lfrig.contracts.capture import PoseSpec
from lfrig.contracts.schema import Count, Document, Finite, Model, NonNegative, Positive


class TargetReport(Model):
    """The synthesized light field's optics: baseline [m] between adjacent views, focus [m], fx [px]."""

    id: str
    baseline_m: Positive
    focus_distance_m: Positive
    fx: Positive
    width: Count
    height: Count
    rows: Count
    cols: Count
    pose: PoseSpec | None = None
    metric: bool = True
    """False: lengths are in gauge units, because nothing gave the scale."""
    scale_source: str = ""
    """What gave it: ``poses``, ``mount``, ``recorded optics`` or ``gauge`` (nothing); empty in older reports."""


class SkipReport(Model):
    """Work of one kind that a stage did and left out, in ``unit``, and the CPU milliseconds that this saved (at the
    price of the work that was done).
    """

    name: str
    done: NonNegative
    skipped: NonNegative
    unit: str = ""
    saved_ms: NonNegative = 0


class StageReport(Model):
    """Cost of one stage, and how much of its work was done and skipped (units named in ``unit``)."""

    name: str
    wall_s: NonNegative
    cpu_s: NonNegative
    peak_rss_mb: NonNegative
    work_done: NonNegative = 0
    work_skipped: NonNegative = 0
    unit: str = ""
    note: str = ""
    skips: list[SkipReport] = Field(default_factory=list)
    """What was left out, by switch; empty in older reports."""


class SourceReport(Model):
    """One source: its scale fit 1/z = a δ + c, its anchors, its pose."""

    id: str
    a: Finite
    c: Finite
    residual: NonNegative
    inliers: Finite
    anchors: Count
    angle_residual_deg: Finite | None = None
    pose: PoseSpec | None = None


class WarningReport(Model):
    """A warning: ``code`` for machines, ``message`` for people."""

    code: str
    message: str


class ReportDocument(Document):
    """report.json of a result."""

    NAME: ClassVar[str] = "lfrig.result"

    preset: str
    backend: str = "cpu"
    native: bool = False
    version: str
    threads: Count = 0
    session: str | None = None
    target: TargetReport
    poses: str = "given"
    stages: list[StageReport] = Field(default_factory=list)
    sources: list[SourceReport] = Field(default_factory=list)
    warnings: list[WarningReport] = Field(default_factory=list)
    options: dict[str, Any] = Field(default_factory=dict)
