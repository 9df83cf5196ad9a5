"""``lfrig export``: results and captures in other people's formats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfrig.contracts.errors import UsageError
from lfrig.contracts.files import SESSION_FILE
from lfrig.rig.cli.make import Overwrite
from lfrig.rig.cli.run import Run

if TYPE_CHECKING:
    from lfrig.contracts.progress import Monitor
    from lfrig.processing.export.content import Content
    from lfrig.processing.model import LightField
    from lfrig.rig.session.store import SessionStore

CAPTURE_FILE = "capture.json"


def register(app: typer.Typer) -> None:
    """Add the command to ``app``."""
    app.command("export")(export)


def export(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="RESULT|SESSION|CAPTURE|FILE.lfr", help="What to export.")],
    format: Annotated[str, typer.Option("--format", help="views | pfm | npy | hci | gif | webm | dng")],
    capture: Annotated[
        str | None, typer.Option(metavar="ID", help="Which light field of a SESSION; default: the only one.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File or folder to write.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a result, a captured light field, or (dng) its raw file, in another format."""
    from lfrig.processing.export.registry import FROM_RAW
    from lfrig.processing.export.registry import export as write

    run: Run = context.obj
    found = _found(source, capture, raw=format in FROM_RAW, monitor=run.monitor)
    path = write(found, format, out, overwrite=overwrite, monitor=run.monitor)
    run.emit({"path": path, "format": format}, lambda console: console.print(str(path), markup=False, soft_wrap=True))


def _found(source: Path, capture: str | None, *, raw: bool, monitor: Monitor) -> Path | LightField | Content:
    """What ``source`` is: a light field of a session, or its raw file; a capture or a file alone; else a result."""
    from lfrig.processing.export.content import content_of_raw
    from lfrig.rig.info.raw import is_raw

    session = _session_of(source)
    if session is not None and capture is None and session != source:
        capture = source.resolve().name
    if session is not None:
        return _of_session(session, capture, raw=raw, monitor=monitor)
    if capture is not None:
        raise UsageError(f"--capture: {source} is no session", remedy="leave --capture out")
    if source.is_file() and (raw or is_raw(source)):
        return content_of_raw(source.stem, source)
    if (source / CAPTURE_FILE).is_file():
        return _of_folder(source, raw=raw, monitor=monitor)
    return source


def _session_of(source: Path) -> Path | None:
    """The session that ``source`` is, or whose captures it is one of."""
    from lfrig.rig.session.capture_folder import session_of

    if (source / SESSION_FILE).is_file():
        return source
    return session_of(source) if (source / CAPTURE_FILE).is_file() else None


def _of_session(session: Path, capture: str | None, *, raw: bool, monitor: Monitor) -> LightField | Content:
    from lfrig.rig.session.store import SessionStore

    store = SessionStore.open(session)
    chosen = _chosen(store, capture, raw=raw)
    if raw:
        return _raw_content(store.capture_folder(chosen), chosen)
    return store.load_light_field(chosen, monitor=monitor)


def _chosen(store: SessionStore, capture: str | None, *, raw: bool) -> str:
    """The capture that is meant, or the only one that it can be; a photo, or one that is not there, is refused."""
    documents = store.captures()
    held = [name for name, document in documents.items() if document.kind == "light_field"]
    if capture is None:
        # With none that has a raw file, any will do: its refusal says why.
        held = [name for name in held if raw and documents[name].raw is not None] or held
        if len(held) == 1:
            return held[0]
    elif capture in held:
        return capture
    wrong = "which light field is meant must be said" if capture is None else f"has no light field {capture!r}"
    raise UsageError(f"{store.path}: {wrong}", remedy=f"give --capture ID, one of {', '.join(held) or 'none'}")


def _of_folder(folder: Path, *, raw: bool, monitor: Monitor) -> LightField | Content:
    """A capture's folder that belongs to no session."""
    if raw:
        return _raw_content(folder, folder.resolve().name)
    from lfrig.rig.ingest import open_light_field

    return open_light_field(folder, monitor=monitor)


def _raw_content(folder: Path, name: str) -> Content:
    from lfrig.contracts.capture import CaptureDocument
    from lfrig.contracts.errors import BadInput
    from lfrig.processing.export.content import content_of_raw

    document = CaptureDocument.load(folder / CAPTURE_FILE)
    if document.raw is None:
        raise BadInput(
            f"has no raw file: it is a {'photo' if document.kind == 'photo' else 'light field kept as views'}",
            path=folder, code="no-raw-file", remedy="export a capture that was ingested from a .lfr or .lfp file",
        )  # fmt: skip
    return content_of_raw(name, folder / document.raw.path)
