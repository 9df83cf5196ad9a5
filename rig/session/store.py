"""The session folder: ``session.json`` and its captures, which are never rewritten once they are in.

A capture is built in a hidden folder beside its place, renamed, and only then listed in ``session.json``; whatever
goes wrong in between leaves a valid session, at worst with a capture folder that nobody lists.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from lfrig.contracts.capture import CaptureDocument, ViewsSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import CAPTURES, SESSION_FILE, atomic_folder, disk_errors
from lfrig.contracts.progress import Monitor
from lfrig.contracts.session import RigSpec, SessionDocument
from lfrig.processing.model import U8, Image, LightField, Photo, RigPrior
from lfrig.rig.session import capture_folder
from lfrig.rig.session.capture_folder import CAPTURE_FILE
from lfrig.rig.session.convert import to_rig_prior
from lfrig.rig.session.images import write_png
from lfrig.rig.session.views import write_views

Build = Callable[[Path], CaptureDocument]
"""Fills a new capture's folder with pixels and returns its document; the store writes ``capture.json``."""


class SessionStore:
    """A session folder.

    Attributes
    ----------
    path : Path
        The folder.
    document : SessionDocument
        Its ``session.json`` as last read or written.
    """

    def __init__(self, path: Path, document: SessionDocument) -> None:
        self.path = path
        self.document = document

    @classmethod
    def create(cls, path: Path | str, rig: RigSpec | None = None) -> SessionStore:
        """Make a session, or open the one that is there.

        A given ``rig`` goes into a new session, and into one that knows nothing of its rig yet.

        Raises
        ------
        BadInput
            The folder holds something else, or the session knows another rig.
        DiskError
            Writing failed.
        """
        path = Path(path)
        if (path / SESSION_FILE).exists():
            store = cls.open(path)
            if rig is not None:
                store._adopt_rig(rig)
            return store
        _refuse_foreign(path)
        document = SessionDocument(rig=rig or RigSpec())
        document.save(path / SESSION_FILE)
        return cls(path, document)

    @classmethod
    def open(cls, path: Path | str) -> SessionStore:
        """Open a session; raises `BadInput` when ``path`` is none."""
        path = Path(path)
        if not path.exists():
            raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path")
        if not (path / SESSION_FILE).is_file():
            raise BadInput(
                f"is not a session (it has no {SESSION_FILE})", path=path, code="not-a-session",
                remedy="make one with `lfrig capture` or `lfrig ingest`",
            )  # fmt: skip
        return cls(path, SessionDocument.load(path / SESSION_FILE))

    @property
    def truth_path(self) -> Path:
        """SESSION.truth beside the session; exists only when the simulator made it."""
        absolute = Path(os.path.abspath(self.path))  # noqa: PTH100 - resolve() would follow a linked session
        return absolute.with_name(f"{absolute.name}.truth")

    def capture_folder(self, capture_id: str) -> Path:
        """Folder of a capture; raises `BadInput` for an id that the session does not list."""
        if capture_id not in self.document.captures:
            known = ", ".join(self.document.captures) or "none"
            raise BadInput(
                f"has no capture {capture_id!r}", path=self.path, code="unknown-capture",
                remedy=f"its captures: {known}",
            )  # fmt: skip
        return self.path / CAPTURES / capture_id

    def capture(self, capture_id: str) -> CaptureDocument:
        """One capture's document; raises `BadInput`."""
        return CaptureDocument.load(self.capture_folder(capture_id) / CAPTURE_FILE)

    def captures(self) -> dict[str, CaptureDocument]:
        """All captures' documents by id, in order of shooting; raises `BadInput` for a broken one."""
        return {capture_id: self.capture(capture_id) for capture_id in self.document.captures}

    def rig_prior(self) -> RigPrior:
        """What the session knows of its rig."""
        return to_rig_prior(self.document.rig)

    def load_light_field(self, capture_id: str, *, threads: int = 0, monitor: Monitor | None = None) -> LightField:
        """Read a light field; see `capture_folder.load_light_field` for what is done and raised.

        Without a depth range of its own it has the rig's.
        """
        return capture_folder.load_light_field(
            self.capture_folder(capture_id), capture_id, self.capture(capture_id),
            depth_range_m=self.document.rig.depth_range_m, session=self.path, threads=threads, monitor=monitor,
        )  # fmt: skip

    def load_photo(self, capture_id: str) -> Photo:
        """Read a photo, upright; of a light field its centre view. Raises as `load_light_field`."""
        return capture_folder.load_photo(
            self.capture_folder(capture_id), capture_id, self.capture(capture_id), session=self.path
        )

    def add_light_field(
        self, views: U8, document: CaptureDocument, *, time: str | None = None, threads: int = 0
    ) -> str:
        """Store a light field as PNG files.

        Parameters
        ----------
        views : uint8 [rows, cols, H, W, 3]
            RGB.
        document : CaptureDocument
            Kind ``light_field``; its ``views`` are replaced by those that were written.
        time : str, optional
            ISO 8601 time of the shot, when the document has none.

        Returns
        -------
        str
            The new capture's id.

        Raises
        ------
        BadInput
            The array and the document do not belong together.
        DiskError
            Writing failed; the session is as it was.
        """
        _check_kind(document, "light_field", views.ndim == 5)
        spec = ViewsSpec(rows=views.shape[0], cols=views.shape[1])
        stored = document.model_copy(update={"views": spec, "time": document.time or time})
        _check_camera_size(stored, views.shape[3], views.shape[2])

        def build(folder: Path) -> CaptureDocument:
            write_views(folder, views, spec.file, threads=threads)
            return stored

        return self.add_captures([build])[0]

    def add_photo_array(self, image: Image, document: CaptureDocument) -> str:
        """Store a photo, RGB uint8 or uint16 [H, W, 3], as ``photo.png``; as `add_light_field` otherwise."""
        _check_kind(document, "photo", image.ndim == 3)
        stored = document.model_copy(update={"image": "photo.png"})
        _check_camera_size(stored, image.shape[1], image.shape[0])

        def build(folder: Path) -> CaptureDocument:
            write_png(folder / "photo.png", image)
            return stored

        return self.add_captures([build])[0]

    def add_captures(self, builds: Sequence[Build]) -> list[str]:
        """Add several captures, all or none, in order.

        Raises
        ------
        DiskError
            Writing failed; the session is as it was.
        """
        with self._locked():
            ids = self._free_ids(len(builds))
            folders = [self.path / CAPTURES / capture_id for capture_id in ids]
            try:
                with contextlib.ExitStack() as staged:
                    for folder, build in zip(folders, builds, strict=True):
                        staging = staged.enter_context(atomic_folder(folder))
                        build(staging).save(staging / CAPTURE_FILE)
                self._save(self.document.model_copy(update={"captures": [*self.document.captures, *ids]}))
            except BaseException:
                self._remove_unlisted(ids)
                raise
        return ids

    def discard(self, capture_id: str) -> None:
        """Take back a capture that was just added; one that is not listed is no error."""
        with self._locked():
            rest = [name for name in self.document.captures if name != capture_id]
            self._save(self.document.model_copy(update={"captures": rest}))
        shutil.rmtree(self.path / CAPTURES / capture_id, ignore_errors=True)

    def _free_ids(self, count: int) -> list[str]:
        """The next numbers that neither the session nor an abandoned folder uses."""
        folder = self.path / CAPTURES
        present = [entry.name for entry in folder.iterdir()] if folder.is_dir() else []
        used = {*self.document.captures, *present}
        first = max((int(name) for name in used if name.isascii() and name.isdigit()), default=-1) + 1
        return [f"{number:03d}" for number in range(first, first + count)]

    def _remove_unlisted(self, ids: Sequence[str]) -> None:
        """Remove what a failed `add_captures` moved into place, unless session.json got as far as listing it."""
        self.document = SessionDocument.load(self.path / SESSION_FILE)
        for capture_id in set(ids) - set(self.document.captures):
            shutil.rmtree(self.path / CAPTURES / capture_id, ignore_errors=True)

    def _adopt_rig(self, rig: RigSpec) -> None:
        if self.document.rig == rig:
            return
        if self.document.rig != RigSpec():
            raise BadInput(
                "describes another rig than the one given", path=self.path / SESSION_FILE, field="rig",
                code="other-rig", remedy="start a new session for another rig",
            )  # fmt: skip
        with self._locked():
            self._save(self.document.model_copy(update={"rig": rig}))

    def _save(self, document: SessionDocument) -> None:
        document.save(self.path / SESSION_FILE)
        self.document = document

    @contextlib.contextmanager
    def _locked(self) -> Iterator[None]:
        """Keep other writers out, and see what they wrote."""
        with _folder_lock(self.path):
            self.document = SessionDocument.load(self.path / SESSION_FILE)
            yield


@contextlib.contextmanager
def _folder_lock(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock on a folder; gone with the process. No lock where the system has none (Windows)."""
    try:
        import fcntl
    except ImportError:
        yield
        return
    with disk_errors(folder):
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        with contextlib.suppress(OSError):  # some network file systems have none
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _refuse_foreign(path: Path) -> None:
    """Refuse to turn a file, or a folder that holds something else, into a session."""
    if not path.exists():
        return
    if not path.is_dir() or any(not entry.name.startswith(".") for entry in path.iterdir()):
        raise BadInput(
            "holds something that is not a session", path=path, code="not-a-session",
            remedy="name a new folder for the session",
        )  # fmt: skip


def _check_kind(document: CaptureDocument, kind: str, shape_fits: bool) -> None:
    if document.kind != kind or not shape_fits:
        raise ValueError(f"a {document.kind} or an array of another shape was given where a {kind} is stored")


def _check_camera_size(document: CaptureDocument, width: int, height: int) -> None:
    camera = document.camera
    if camera is not None and (camera.width, camera.height) != (width, height):
        raise BadInput(
            f"says {camera.width}×{camera.height} px, but the picture has {width}×{height}",
            field="camera.width", code="camera-size", remedy="correct the camera's size",
        )  # fmt: skip
