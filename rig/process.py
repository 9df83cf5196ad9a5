"""From a session folder to a result folder: which captures serve, what is asked for, and where it goes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import BadInput, UsageError
from lfrig.contracts.files import atomic_folder, refuse_existing, refuse_replacing
from lfrig.contracts.progress import Monitor, Notice
from lfrig.contracts.result import ReportDocument
from lfrig.processing.geometry import turn_deg
from lfrig.processing.model import LightField, Photo, RigPrior
from lfrig.processing.options import ProcessOptions, check_options
from lfrig.processing.pipeline import process
from lfrig.rig.session.decoded import CACHE
from lfrig.rig.session.evidence_cache import EvidenceCache, Pending
from lfrig.rig.session.store import SessionStore

DEFAULT_SOURCES = 4
"""How many light fields serve when more were taken and none were named: coverage is full, cost still
bounded."""


@dataclass(frozen=True)
class Selection:
    """Which captures of a session serve: the target's id and the sources' ids in session order."""

    target: str
    sources: tuple[str, ...]
    target_is_light_field: bool


@dataclass(frozen=True)
class Inputs:
    """What the pipeline gets."""

    sources: list[LightField]
    target: Photo
    prior: RigPrior
    options: ProcessOptions


class OwnNotices(Monitor):
    """Passes everything on to another monitor, and keeps apart the warnings of one piece of work.

    A report then tells the warnings of its own result, also when one monitor follows several.
    """

    def __init__(self, outer: Monitor) -> None:
        super().__init__()
        self._outer = outer

    def cancel(self) -> None:
        """Cancel the outer work."""
        self._outer.cancel()

    @contextlib.contextmanager
    def task(self, name: str, total: int | None = None) -> Iterator[None]:
        """A task of the outer monitor."""
        with self._outer.task(name, total):
            yield

    def advance(self, steps: int = 1) -> None:
        """Progress of the outer monitor; raises `Interrupted` after a cancel."""
        self._outer.advance(steps)

    def on_warn(self, notice: Notice) -> None:
        """Pass the warning on."""
        self._outer.warn(notice.code, notice.message)


class OnlyNotices(OwnNotices):
    """Passes on warnings and hears of a cancel; the progress of a part is not that of the whole."""

    @contextlib.contextmanager
    def task(self, name: str, total: int | None = None) -> Iterator[None]:
        """No task to be seen."""
        self.advance(0)
        yield

    def advance(self, steps: int = 1) -> None:
        """Raise `Interrupted` after a cancel."""
        self._outer.advance(0)


def process_session(
    session: Path,
    target: str | None = None,
    sources: Sequence[str] | None = None,
    options: ProcessOptions | None = None,
    out: Path | None = None,
    overwrite: bool = False,
    monitor: Monitor | None = None,
) -> Path:
    """Process one session into one result folder, which appears whole or not at all.

    Parameters
    ----------
    session : Path
        The session folder.
    target : str, optional
        Capture id of the photo, or of a light field, which then is left out of the sources; the only photo by
        default.
    sources : sequence of str, optional
        Capture ids; by default all light fields, the nearest four by turntable angle when there are more.
    options : ProcessOptions, optional
        Preset, request and precision.
    out : Path, optional
        The result folder; ``SESSION/results/<target>-<preset>`` by default.
    overwrite : bool
        Replace an existing result.
    monitor : Monitor, optional
        Progress, warnings and cancel.

    Returns
    -------
    Path
        The result folder.

    Raises
    ------
    UsageError
        No target named and not exactly one photo, or an id that the session does not have.
    BadInput
        The session, a capture or the result folder's name cannot be used; checked before any work.
    GeometryRefused
        Poses or scale fits that cannot be trusted.
    DiskError
        The result cannot be written; noticed before any work where the folder is not writable.
    Interrupted
        Cancelled.
    """
    from lfrig.processing.export.result import write_result
    from lfrig.processing.report.page import write_report

    options = options or ProcessOptions()
    monitor = OwnNotices(monitor or Monitor())
    store, selection, folder = check_session(session, target, sources, options, out, overwrite)
    inputs = load_inputs(store, selection, options, monitor)
    found = Pending(EvidenceCache(store.path / CACHE / "evidence", monitor))
    with atomic_folder(folder, overwrite=overwrite) as temporary:
        result = process(inputs.sources, inputs.target, inputs.prior, inputs.options, monitor, store=found)
        with monitor.task("write"):
            write_result(temporary, result, session=store.path.name)
            write_report(temporary, result, ReportDocument.load(temporary / "report.json"))
    found.write()
    return folder


def check_session(
    session: Path,
    target: str | None,
    sources: Sequence[str] | None,
    options: ProcessOptions,
    out: Path | None,
    overwrite: bool,
) -> tuple[SessionStore, Selection, Path]:
    """What `process_session` would do and where its result would go, or the errors that need no pixel to be seen."""
    check_options(options)
    store = SessionStore.open(session)
    selection = select(store.captures(), target, sources, path=store.path)
    folder = result_folder(store.path, selection.target, options.preset, out)
    refuse_existing(folder, overwrite=overwrite)
    refuse_replacing(folder, store.path)
    return store, selection, folder


def result_folder(session: Path, target: str, preset: str, out: Path | None = None) -> Path:
    """Where the result goes."""
    return out if out is not None else session / "results" / f"{target}-{preset}"


def select(
    captures: Mapping[str, CaptureDocument],
    target: str | None,
    sources: Sequence[str] | None,
    *,
    path: Path,
) -> Selection:
    """Decide the target and the sources; see `process_session` for the defaults and the errors."""
    for name in [target, *(sources or [])]:
        if name is not None and name not in captures:
            raise UsageError(
                f"{path} has no capture {name!r}", code="unknown-capture", remedy=f"it has {_listed(captures)}"
            )
    target = target if target is not None else _only_photo(captures, path)
    light_fields = [name for name, capture in captures.items() if capture.kind == "light_field" and name != target]
    if sources is not None:
        chosen = _named_sources(captures, target, sources)
    else:
        chosen = nearest_sources(captures, target, light_fields)
    if not chosen:
        raise BadInput(
            f"has no light field to serve as a source for {target!r}",
            path=path, code="no-source", remedy="capture or ingest at least one light field",
        )  # fmt: skip
    return Selection(target, tuple(chosen), captures[target].kind == "light_field")


def nearest_sources(captures: Mapping[str, CaptureDocument], target: str, light_fields: Sequence[str]) -> list[str]:
    """The light fields nearest to the target by turntable angle, at most `DEFAULT_SOURCES`, in session order.

    Captures of unknown angle come last; ties go to the earlier capture.
    """
    order = list(light_fields)
    if len(order) <= DEFAULT_SOURCES:
        return order
    angle = captures[target].turntable_deg
    nearest = sorted(order, key=lambda name: (turn_deg(captures[name].turntable_deg, angle), order.index(name)))
    return sorted(nearest[:DEFAULT_SOURCES], key=order.index)


def load_inputs(store: SessionStore, selection: Selection, options: ProcessOptions, monitor: Monitor) -> Inputs:
    """Read the pixels and complete the request.

    A light field as target stands where the light-field camera stood, and is asked for with its own optics
    unless the options say otherwise.
    """
    prior = store.rig_prior()
    if selection.target_is_light_field:
        prior = replace(prior, target_from_plate=prior.light_field_from_plate)
        optics = store.captures()[selection.target].optics
        if optics is not None:
            options = replace(
                options,
                target_baseline_m=options.target_baseline_m or optics.baseline_m,
                target_focus_m=options.target_focus_m or optics.focus_distance_m,
            )
    with monitor.task("read", total=len(selection.sources) + 1):
        photo = store.load_photo(selection.target)
        monitor.advance()
        light_fields = []
        for name in selection.sources:
            light_fields.append(store.load_light_field(name, threads=options.threads, monitor=OnlyNotices(monitor)))
            monitor.advance()
    return Inputs(light_fields, photo, prior, options)


def _only_photo(captures: Mapping[str, CaptureDocument], path: Path) -> str:
    photos = [name for name, capture in captures.items() if capture.kind == "photo"]
    if len(photos) == 1:
        return photos[0]
    found = f"{len(photos)} photos ({', '.join(photos)})" if photos else "no photo"
    raise UsageError(
        f"{path} has {found}, so the target must be named", code="no-target",
        remedy=f"give --target ID, one of {_listed(captures)}",
    )  # fmt: skip


def _named_sources(captures: Mapping[str, CaptureDocument], target: str, sources: Sequence[str]) -> list[str]:
    for name in sources:
        if captures[name].kind != "light_field":
            raise UsageError(f"--sources: {name!r} is a photo", remedy="name light fields only")
        if name == target:
            raise UsageError(f"--sources: {name!r} is the target", remedy="a target cannot be its own source")
    if len(set(sources)) != len(sources):
        raise UsageError("--sources names a capture twice", remedy="name each once")
    return list(sources)


def _listed(captures: Mapping[str, CaptureDocument]) -> str:
    return ", ".join(captures) or "no captures"
