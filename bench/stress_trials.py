"""The trials of `lfrig bench stress`, by group: scale fit, identity, gauge, focus, images, geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lfrig.bench.cases import MEDIUM, NEAR_DEG, Case, shoot_case
from lfrig.bench.stress_inputs import exact_anchors, one_plane, rigid, transformed
from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor, Muted
from lfrig.processing.model import F32, Evidence, Optics, Photo, Pose
from lfrig.processing.options import ProcessOptions
from lfrig.processing.pipeline import ProcessResult, process
from lfrig.processing.scale_fit import ScaleFitSettings, fit_scale

if TYPE_CHECKING:
    from lfrig.bench.stress import Trial

SCENE = "tabletop"
"""Of the tuning half: nothing is reported from it, things are broken in it."""

SAME_DEPTH = 1e-5
"""Relative change of depth that a change of gauge may cause."""

FLIPS = 0.999
"""Share of the pixels that must keep `SAME_DEPTH`. Decisions between two surfaces at a depth edge can rest on a
margin smaller than rounding, so a few pixels may choose otherwise."""


@dataclass
class Base:
    """The undisturbed case, processed once when it is first needed."""

    case: Case
    threads: int
    monitor: Monitor
    known: ProcessResult | None = None

    def result(self) -> ProcessResult:
        """What comes out undisturbed."""
        if self.known is None:
            self.known = self.process(self.case)
        return self.known

    def evidence(self) -> list[Evidence]:
        """The sources' evidence: no trial that keeps the views computes it again."""
        return [found.source.evidence for found in self.result().sources]

    def process(self, case: Case, evidence: list[Evidence] | None = None, **changes: object) -> ProcessResult:
        """Process a case, asking for what ``changes`` say."""
        options = case.options(threads=self.threads, **changes)
        return process(case.sources, case.target, case.prior, options, Muted(self.monitor), evidence=evidence)


def all_trials(size: tuple[int, int] | None, threads: int, cache_dir: Path | None, monitor: Monitor) -> list[Trial]:
    """Every trial, in order of the groups."""
    case = shoot_case(
        SCENE, size or MEDIUM, poses="given", angles_deg=NEAR_DEG, truth_views=False, threads=threads,
        cache_dir=cache_dir, monitor=Muted(monitor),
    )  # fmt: skip
    base = Base(case, threads, monitor)
    groups = [identity_trials, gauge_trials, focus_trials, image_trials, geometry_trials]
    return [*scale_fit_trials(), *(trial for group in groups for trial in group(base))]


def scale_fit_trials() -> list[Trial]:
    """Too few anchors, outliers, a focal plane among the anchors, one depth only."""
    from lfrig.bench.stress import Trial

    few = "fewer than 8 anchors carry no line that can be checked"
    trials = [
        Trial("scale fit", f"{count} anchors", _fit(count), few, refusal=("too-few-anchors",))
        for count in (0, 1, 2, 3, 7)
    ]
    return [
        *trials,
        Trial("scale fit", "8 anchors", _fit(8), "median relative depth error; the fewest that are taken", 0.01),
        Trial("scale fit", "800 anchors, 30 % outliers", _fit(800, outliers=0.3),
              "median relative depth error across the focal plane", 0.005),
        Trial("scale fit", "anchors on one plane", _fit(800, one_depth=True),
              "one depth has no slope", refusal=("narrow-anchors", "flat-anchors")),
        Trial("scale fit", "views ordered the other way round", _fit(800, mirrored=True),
              "nearer anchors with smaller disparities", refusal=("wrong-sign",)),
        Trial("scale fit", "anchors without any relation", _fit(800, outliers=1.0),
              "noise has no scale", refusal=("scattered-anchors", "wrong-sign")),
    ]  # fmt: skip


def gauge_trials(base: Base) -> list[Trial]:
    """Rotating, moving and scaling the world changes depth by the scale alone."""
    from lfrig.bench.stress import Trial

    why = f"relative change of depth, {100 * FLIPS:g} % of the pixels"

    def trial(name: str, scale: float, rotation_deg: float, offset_m: float) -> Trial:
        return Trial("gauge", name, lambda: _gauge_change(base, scale, rotation_deg, offset_m), why, SAME_DEPTH)

    trials = [trial("world turned by 137°", 1.0, 137.0, 0.0), trial("world moved by 1 m", 1.0, 0.0, 1.0)]
    trials += [trial(f"world scaled by {scale:g}", scale, 0.0, 0.0) for scale in (1e-3, 1e-1, 1e1, 1e3)]
    trials += [trial(f"world moved by {offset:g} m", 1.0, 0.0, offset) for offset in (1e3, 1e5, 1e7)]
    return [*trials, trial("all three at once", 7.3, 61.0, 1e3)]


def identity_trials(base: Base) -> list[Trial]:
    """The same inputs give the same bytes, however often and on however many threads."""
    from lfrig.bench.stress import Trial

    def differing(threads: int) -> float:
        known = base.result().light_field
        options = base.case.options(threads=threads)
        again = process(base.case.sources, base.case.target, base.case.prior, options, Muted(base.monitor)).light_field
        pairs = [
            (again.disparity, known.disparity), (again.surface.inverse_depth, known.surface.inverse_depth),
            (again.surface.confidence, known.surface.confidence), (again.surface.sigma, known.surface.sigma),
            (again.views, known.views),
        ]  # fmt: skip
        return float(sum(np.count_nonzero(a != b) for a, b in pairs))

    return [
        Trial("identity", "the same again", lambda: differing(base.threads), "values that differ", 0.0),
        Trial("identity", "on one thread", lambda: differing(1), "values that differ", 0.0),
        Trial("identity", "on three threads", lambda: differing(3), "values that differ", 0.0),
    ]


def focus_trials(base: Base) -> list[Trial]:
    """Disparity zero inside the scene, for the sources and for the target."""
    from lfrig.bench.stress import Trial

    def median_error() -> float:
        surface = base.result().light_field.surface.inverse_depth
        return float(np.median(np.abs(surface / base.case.truth.inverse_depth - 1)))

    def depth_change(focus_m: float) -> float:
        moved = base.process(base.case, base.evidence(), target_focus_m=focus_m).light_field.surface.inverse_depth
        return _change(moved, base.result().light_field.surface.inverse_depth)

    return [
        Trial("focus", "focal planes inside the scene", median_error,
              "median relative depth error; a fit in depth has its pole there (12–50 %)", 0.02),
        Trial("focus", "target focused at 0.2 m", lambda: depth_change(0.2),
              "the requested focus must not move the surface", SAME_DEPTH),
        Trial("focus", "target focused at infinity", lambda: depth_change(1e6),
              "the requested focus must not move the surface", SAME_DEPTH),
    ]  # fmt: skip


def image_trials(base: Base) -> list[Trial]:
    """Pictures with nothing in them, and pictures of nothing but one plane."""
    from lfrig.bench.stress import Trial

    def constant_source() -> float:
        first, *others = base.case.sources
        flat = replace(first, views=np.full_like(first.views, 90))
        return _accepted(base.process(replace(base.case, sources=[flat, *others])))

    def constant_photo() -> float:
        # The poses are given, so the photo has only colours to add: the geometry must stand without it.
        photo = replace(base.case.target, image=np.full_like(base.case.target.image, 90))
        result = base.process(replace(base.case, target=photo), base.evidence())
        return float(np.median(np.abs(result.light_field.surface.inverse_depth / base.case.truth.inverse_depth - 1)))

    def constant_photo_unposed() -> float:
        photo = Photo("blank", np.full_like(base.case.target.image, 90), base.case.target.camera)
        return _accepted(base.process(replace(base.case, target=photo), base.evidence()))

    def plane(known_optics: bool) -> float:
        sources, photo, prior, depth_m = one_plane()
        if not known_optics:
            sources = [replace(source, optics=Optics()) for source in sources]
        options = ProcessOptions(threads=base.threads, target_baseline_m=0.0036, target_focus_m=0.5)
        result = process(sources, photo, prior, options, Muted(base.monitor))
        return float(np.median(np.abs(1 / result.light_field.surface.inverse_depth / depth_m - 1)))

    return [
        Trial("images", "a constant light field", constant_source, "nothing to match", refusal=("constant-image",)),
        Trial("images", "a constant photo, pose given", constant_photo,
              "median relative depth error; only the edges of the photo are missing", 0.05),
        Trial("images", "a constant photo, pose unknown", constant_photo_unposed, "nothing says where it was taken",
              refusal=("photo-no-overlap", "not-registered", "too-few-matches")),
        Trial("images", "one plane, optics known", lambda: plane(True), "median relative depth error", 0.02),
        Trial("images", "one plane, optics unknown", lambda: plane(False), "one depth has no scale",
              refusal=("narrow-anchors", "flat-anchors", "too-few-anchors")),
    ]  # fmt: skip


def geometry_trials(base: Base) -> list[Trial]:
    """Poses that cannot be, and views that do not meet."""
    from lfrig.bench.stress import Trial

    def source_pose(change: Callable[[Pose], Pose]) -> Case:
        first, *others = base.case.sources
        assert first.pose is not None
        return replace(base.case, sources=[replace(first, pose=change(first.pose)), *others])

    def nan_pose() -> float:
        return _accepted(base.process(source_pose(lambda p: Pose(p.rotation, np.array([0, np.nan, 0.4])))))

    def twins() -> float:
        second = base.case.sources[1].pose
        assert second is not None
        return _accepted(base.process(source_pose(lambda _: second), base.evidence()))

    def away() -> float:
        pose = base.case.target.pose
        assert pose is not None
        turned = Pose(np.diag([-1.0, 1.0, -1.0]) @ pose.rotation, np.diag([-1.0, 1.0, -1.0]) @ pose.translation)
        case = replace(base.case, target=replace(base.case.target, pose=turned))
        return _accepted(base.process(case, base.evidence()))

    def nothing() -> float:
        return _accepted(base.process(replace(base.case, sources=[])))

    return [
        Trial("geometry", "NaN in a pose", nan_pose, "a number that is none", refusal=("pose-not-finite",)),
        Trial("geometry", "two identical poses", twins, "no baseline between two sources", refusal=TWINS),
        Trial("geometry", "a photo that looks away", away, "no source sees what it shows", refusal=APART),
        Trial("geometry", "no source at all", nothing, "nothing to start from", refusal=("no-source",)),
    ]  # fmt: skip


TWINS = ("identical-poses", "too-few-anchors")
APART = ("no-overlap", "photo-no-overlap")


def _fit(count: int, *, outliers: float = 0.0, one_depth: bool = False, mirrored: bool = False) -> Callable[[], float]:
    """A scale fit on exact anchors with disparity noise; returns the median relative depth error over the range."""

    def run() -> float:
        light_field, camera, anchors, evidence, truth = exact_anchors(
            count, outliers=outliers, one_depth=one_depth, mirrored=mirrored
        )
        fit = fit_scale(light_field, camera, anchors, evidence, ScaleFitSettings(), Monitor())
        inverse_depth = np.linspace(1 / 0.8, 1 / 0.3, 200).astype(np.float32)
        found = fit.inverse_depth(truth.disparity(inverse_depth))
        return float(np.median(np.abs(inverse_depth / found - 1)))

    return run


def _gauge_change(base: Base, scale: float, rotation_deg: float, offset_m: float) -> float:
    moved = transformed(base.case, scale, *rigid(rotation_deg, offset_m))
    result = base.process(moved, base.evidence())
    return _change(
        result.light_field.surface.inverse_depth * np.float32(scale), base.result().light_field.surface.inverse_depth
    )


def _change(surface: F32, reference: F32) -> float:
    """Relative change that all but a few pixels keep (`FLIPS`)."""
    return float(np.quantile(np.abs(surface.astype(np.float64) / reference - 1), FLIPS))


def _accepted(result: ProcessResult) -> float:
    """For inputs that should have been refused: the share of pixels that got a depth all the same."""
    surface = result.light_field.surface.inverse_depth
    if not isinstance(surface, np.ndarray):
        raise BadInput("no surface")
    return float(np.isfinite(surface).mean())
