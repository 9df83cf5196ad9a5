"""Which format a source has: the detectors in order, the most specific first."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from lfrig.contracts.errors import BadInput, NotInThisVersion
from lfrig.contracts.files import SESSION_FILE
from lfrig.rig.ingest import capture_json, eslf, hci, photo, raw, sai
from lfrig.rig.ingest.candidate import Candidate, Request, in_words

_READABLE = (
    "a raw light field, a folder with capture.json, an HCI folder, a folder of views, an ESLF picture or a photo"
)

DETECTORS: tuple[Callable[[Path, Request], Candidate | None], ...] = (
    capture_json.recognise,
    hci.recognise,
    sai.recognise,
    raw.recognise,
    eslf.recognise,
    photo.recognise,
)


def recognise(path: Path, request: Request) -> Candidate:
    """Find out what ``path`` is.

    Raises
    ------
    BadInput
        It does not exist, is empty, or has a format that is not known; or a known one that is broken.
    NotInThisVersion
        A camera's sensor values without metadata.
    """
    if not path.exists():
        raise BadInput("does not exist", path=path, code="missing-file", remedy="check the path")
    if path.is_file() and path.suffix.lower() == ".raw":
        raise NotInThisVersion(f"{path}: sensor values without their container", remedy="give the .lfr or .lfp file")
    if (path / SESSION_FILE).is_file():
        raise BadInput(
            "is a session itself", path=path, code="is-a-session",
            remedy=f"give its captures: {path / 'captures'}/*",
        )  # fmt: skip
    for detect in DETECTORS:
        found = detect(path, request)
        if found is not None:
            return found
    empty = path.is_dir() and next(path.iterdir(), None) is None
    raise BadInput(
        "is an empty folder" if empty else f"is nothing that can be read{_as(request)}", path=path,
        code="empty-folder" if empty else "unknown-format", remedy=f"give {_READABLE}",
    )  # fmt: skip


def _as(request: Request) -> str:
    return f" as a {in_words(request.kind)}" if request.kind else ""
