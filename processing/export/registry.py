"""Format names → exporters, and the one function that runs them: whole output or none, nothing replaced unasked."""

from __future__ import annotations

import contextlib
import importlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

from lfrig.contracts.errors import NotInThisVersion, UsageError
from lfrig.contracts.files import atomic_folder, disk_errors, refuse_existing, sync_folder
from lfrig.contracts.progress import Monitor
from lfrig.processing.export.content import Content, content_of_light_field, content_of_result
from lfrig.processing.export.result import load_result
from lfrig.processing.model import LightField

EXPORTS = "exports"
"""Folder inside a result that exports go to when no path is given."""


@dataclass(frozen=True)
class Format:
    """An exporter, ``module.function``, that writes a file with ``suffix`` or (no suffix) fills a folder."""

    module: str
    function: str
    suffix: str
    about: str


class Exporter(Protocol):
    """Writes ``content`` to ``out``: a file that does not exist yet, or an empty folder."""

    def __call__(self, content: Content, out: Path, monitor: Monitor) -> None:
        """Raises `BadInput`, `DiskError`, or what else the format can meet."""


_HERE = "lfrig.processing.export"
FORMATS: dict[str, Format] = {
    "views": Format(f"{_HERE}.views", "export_views", "", "one PNG per view"),
    "pfm": Format(f"{_HERE}.arrays", "export_pfm", "", "disparity, depth and their certainty as PFM"),
    "npy": Format(f"{_HERE}.arrays", "export_npy", "", "views and maps as NumPy arrays"),
    "hci": Format(f"{_HERE}.hci", "export_hci", "", "HCI 4D light field benchmark folder"),
    "gif": Format(f"{_HERE}.gif", "export_gif", ".gif", "parallax loop, plays everywhere"),
    "webm": Format(f"{_HERE}.webm", "export_webm", ".webm", "parallax loop, VP9"),
    "dng": Format(f"{_HERE}.dng", "export_dng", ".dng", "sensor values of a raw light field"),
}
FROM_RAW = frozenset({"dng"})
"""Formats of the camera's own file: `Content.raw` is all they need."""
NOT_YET = (
    "eslf", "gantry", "h5", "quilt", "mp4", "webp", "html", "refocus", "epi", "ply", "colmap", "nerfstudio",
)  # fmt: skip


def export(
    source: Path | LightField | Content,
    format: str,
    out: Path | None = None,
    *,
    overwrite: bool = False,
    monitor: Monitor | None = None,
) -> Path:
    """Write a result folder, or one captured light field, in the given format.

    Parameters
    ----------
    source : Path, LightField or Content
        A folder that `write_result` wrote, a capture of a session, or what was made ready of one.
    format : str
        A key of `FORMATS`.
    out : Path, optional
        File or folder to write; by default ``exports/<name>`` inside the result, or in the working directory.
    overwrite : bool
        Replace ``out`` when it exists. A failure leaves it as it was either way.

    Returns
    -------
    Path
        What was written.

    Raises
    ------
    UsageError
        Unknown format, or ``out`` would replace what is exported; `NotInThisVersion` for a planned format.
    BadInput
        The source cannot be read or lacks what the format needs; ``out`` exists.
    DiskError
        Writing failed.
    """
    chosen = _format(format)
    monitor = monitor or Monitor()
    content = _content(source)
    path = out or _default_path(content, format, chosen)
    _refuse_own_files(path, content)
    write = cast(Exporter, getattr(importlib.import_module(chosen.module), chosen.function))
    staged = atomic_file(path, overwrite=overwrite) if chosen.suffix else atomic_folder(path, overwrite=overwrite)
    with staged as temporary:
        write(content, temporary, monitor)
    return path


@contextlib.contextmanager
def atomic_file(path: Path, *, overwrite: bool) -> Iterator[Path]:
    """Yield the path of a temporary file beside ``path``, with its suffix, and move it there when the block succeeds.

    Raises
    ------
    BadInput
        ``path`` exists and ``overwrite`` is false (checked before any work).
    DiskError
        Writing failed.
    """
    refuse_existing(path, overwrite=overwrite)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}.tmp{path.suffix}")
    with disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            yield temporary
            with temporary.open("rb") as stream:
                os.fsync(stream.fileno())
            temporary.replace(path)
            sync_folder(path.parent)
        finally:
            temporary.unlink(missing_ok=True)


def _format(name: str) -> Format:
    if name in FORMATS:
        return FORMATS[name]
    known = ", ".join(FORMATS)
    if name in NOT_YET:
        raise NotInThisVersion(f"--format {name}", remedy=f"this version writes {known}")
    raise UsageError(f"--format {name}: unknown format", remedy=f"choose one of {known}")


def _content(source: Path | LightField | Content) -> Content:
    if isinstance(source, Content):
        return source
    if isinstance(source, LightField):
        return content_of_light_field(source)
    return content_of_result(load_result(source))


def _default_path(content: Content, name: str, chosen: Format) -> Path:
    folder = content.folder / EXPORTS if content.folder else Path()
    return folder / (f"{content.name}{chosen.suffix}" if chosen.suffix else f"{content.name}-{name}")


def _refuse_own_files(path: Path, content: Content) -> None:
    """An export must never replace the result or the file that it reads, even with ``overwrite``."""
    if content.raw is not None and path.resolve() == content.raw.resolve():
        raise UsageError(f"{path}: would replace the file that is exported", remedy="give another --out")
    if content.folder is None:
        return
    own, target = content.folder.resolve(), path.resolve()
    inside = target.is_relative_to(own) and not target.is_relative_to(own / EXPORTS)
    if own.is_relative_to(target) or (inside and target.exists()):
        raise UsageError(f"{path}: would replace the result that is exported", remedy="give another --out")
