"""The pipeline kept between shots: what a capture changed is computed again, nothing else.

    add_source ──▶ evidence of that source ─┐
    set_target ─────────────────────────────┴─▶ poses → scale fit → fusion → surface → views
    show ──▶ views of another frame of the same camera: synthesis alone

Everything is kept at the working resolution of the options; views have that size too, as a screen wants them. Every
call either completes or leaves what was known before as it was, also after a cancel or a refusal.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping
from dataclasses import dataclass

from lfrig.contracts.errors import BadInput, GeometryRefused
from lfrig.contracts.progress import Monitor, Notice
from lfrig.contracts.result import StageReport
from lfrig.processing.geometry import turn_deg
from lfrig.processing.model import Evidence, Image, LightField, Photo, Pose, RigPrior, Source, SynthesizedLightField
from lfrig.processing.options import ProcessOptions, check_options
from lfrig.processing.pipeline import find_geometry, synthesize
from lfrig.processing.plate import crop_to_plate, photo_box
from lfrig.processing.poses import PoseWork
from lfrig.processing.prepare import find_evidence
from lfrig.processing.resolution import scale_light_field, scale_photo
from lfrig.processing.reuse import size_bytes
from lfrig.processing.stages import StageClock

MOST_SOURCES = 8
"""Bounds the memory: the source farthest from the target gives way to a new one."""


@dataclass(frozen=True)
class LiveView:
    """The target light field as it is now, at the working resolution.

    ``sources`` are what it was made from; ``stages`` say what the last call computed and what that cost.
    """

    light_field: SynthesizedLightField
    target_pose: Pose
    sources: tuple[Source, ...]
    stages: tuple[StageReport, ...]
    notices: tuple[Notice, ...]


@dataclass(frozen=True)
class _Shot:
    """A source at the working resolution, with its evidence."""

    light_field: LightField
    evidence: Evidence


class LiveFusion:
    """Sources and a target that change one at a time; safe to call from several threads, one call at a time works.

    Parameters
    ----------
    prior : RigPrior
        What the rig knows of its cameras and its turntable.
    options : ProcessOptions, optional
        ``preview`` (half size) by default; ``resolution=0.25`` for weak machines.

    Raises
    ------
    UsageError
        Options that make no sense.
    """

    def __init__(self, prior: RigPrior, options: ProcessOptions | None = None) -> None:
        self.prior = prior
        self.options = options or ProcessOptions(preset="preview")
        check_options(self.options)
        self._lock = threading.Lock()
        self._work = PoseWork()
        self._shots: dict[str, _Shot] = {}
        self._target: Photo | None = None
        self._view: LiveView | None = None

    @property
    def sources(self) -> tuple[str, ...]:
        """Ids of the sources, in the order in which they came."""
        return tuple(self._shots)

    @property
    def view(self) -> LiveView | None:
        """What the last complete call made; None before there are a source and a target."""
        return self._view

    @property
    def held_bytes(self) -> int:
        """Size of the light fields, their evidence and the views that are kept."""
        held = sum(shot.light_field.views.nbytes + size_bytes(shot.evidence) for shot in self._shots.values())
        return held + (0 if self._view is None else self._view.light_field.views.nbytes)

    def add_source(self, light_field: LightField, monitor: Monitor | None = None) -> LiveView | None:
        """Add a light field, or replace the one of the same id (a retake).

        Returns
        -------
        LiveView or None
            None while there is no target.

        Raises
        ------
        BadInput, GeometryRefused
            As `lfrig.processing.pipeline.process`; the light field is then not among the sources. The first source
            is not refused: alone it may be too little to tell.
        Interrupted
            Cancelled.
        """
        with self._lock:
            clock = self._clock(monitor)
            small = scale_light_field(light_field, self.options.geometry_resolution)
            with clock.stage("evidence", 1) as note:
                if self.options.knobs.skips.plate:
                    (small,) = crop_to_plate([small], self.prior, note.tally)
                (evidence,) = find_evidence(
                    [small], self.prior, self.options.knobs, threads=self.options.threads, monitor=clock.monitor,
                    tally=note.tally,
                )  # fmt: skip
                note.done(1, "light fields")
                note.skipped(len(self._shots), "light fields")
            shots = self._bounded({**self._shots, light_field.id: _Shot(small, evidence)}, light_field.id)
            try:
                return self._commit(shots, self._target, clock)
            except GeometryRefused:
                if len(shots) > 1:
                    raise
                self._shots, self._view = shots, None  # alone it may be too little; the next one decides
                return None

    def remove_source(self, capture_id: str, monitor: Monitor | None = None) -> LiveView | None:
        """Take a source out.

        Raises
        ------
        BadInput
            There is no such source.
        """
        with self._lock:
            if capture_id not in self._shots:
                raise BadInput(
                    f"no source {capture_id!r}", code="unknown-capture", remedy=f"there are {', '.join(self._shots)}"
                )
            shots = {name: shot for name, shot in self._shots.items() if name != capture_id}
            return self._commit(shots, self._target, self._clock(monitor))

    def set_target(self, photo: Photo, monitor: Monitor | None = None) -> LiveView | None:
        """Take another photo as the target: from another pose, or of another camera.

        Returns and raises as `add_source`; after a refusal the target is the one of before.
        """
        with self._lock:
            target = scale_photo(photo, self.options.geometry_resolution)
            return self._commit(self._shots, target, self._clock(monitor))

    def show(self, image: Image, monitor: Monitor | None = None) -> LiveView:
        """Views of another frame of the target camera from where it stands: the geometry stays, synthesis alone runs.

        Parameters
        ----------
        image : uint8 or uint16 [H, W, 3]
            Of the size of the target photo or of the working size.

        Raises
        ------
        BadInput
            There is no geometry yet, or the frame has another shape than the target photo.
        """
        with self._lock:
            if self._view is None or self._target is None:
                raise BadInput(
                    "there is no geometry yet", code="no-geometry", remedy="add a source and set a target first"
                )
            before = self._view
            frame = image
            if image.shape != self._target.image.shape:
                frame = scale_photo(Photo(self._target.id, image), self.options.geometry_resolution).image
            if frame.shape != self._target.image.shape:
                raise BadInput(
                    f"the frame is {image.shape[1]}×{image.shape[0]}, the target is of another shape",
                    field="image", remedy="set it as the target instead",
                )  # fmt: skip
            clock = self._clock(monitor)
            made = before.light_field
            shown = synthesize(frame, made.surface, made.camera, made.request, self.options, clock)
            self._view = LiveView(shown, before.target_pose, before.sources, tuple(clock.reports), ())
            return self._view

    def _clock(self, monitor: Monitor | None) -> StageClock:
        return StageClock(monitor or Monitor(), self.options.threads)

    def _commit(self, shots: dict[str, _Shot], target: Photo | None, clock: StageClock) -> LiveView | None:
        """Compute what there is to see, and only then let it be known."""
        view = None if target is None or not shots else self._compute(shots, target, clock)
        self._shots, self._target, self._view = shots, target, view
        return view

    def _compute(self, shots: Mapping[str, _Shot], target: Photo, clock: StageClock) -> LiveView:
        options, light_fields = self.options, [shot.light_field for shot in shots.values()]
        evidence = [shot.evidence for shot in shots.values()]
        box = photo_box(target, self.prior) if options.knobs.skips.plate else None
        found = find_geometry(light_fields, target, evidence, self.prior, options, clock, box=box, work=self._work)
        image = target.image if options.bit_depth == 16 else target.image8
        made = synthesize(image, found.surface, found.camera, found.request, options, clock)
        pose, notices = found.solution.target_pose, tuple(clock.monitor.notices)
        return LiveView(made, pose, tuple(found.sources), tuple(clock.reports), notices)

    def _bounded(self, shots: dict[str, _Shot], newest: str) -> dict[str, _Shot]:
        """At most `MOST_SOURCES`, those nearest to the target by turntable angle; the oldest go where none is known."""
        while len(shots) > MOST_SOURCES:
            angle = None if self._target is None else self._target.turntable_deg
            shots.pop(max((name for name in shots if name != newest), key=lambda name: _turn(shots[name], angle)))
        return shots


def _turn(shot: _Shot, angle_deg: float | None) -> float:
    turn = turn_deg(shot.light_field.turntable_deg, angle_deg)
    return turn if math.isfinite(turn) else 0.0  # max() takes the first of equals: the oldest
