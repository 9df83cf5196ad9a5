"""A light field that is one file per view: kept as it is, byte for byte."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from lfrig.contracts.capture import CameraSpec, CaptureDocument
from lfrig.contracts.progress import Monitor
from lfrig.processing.model import LightField
from lfrig.rig.ingest.candidate import Candidate, copy_files
from lfrig.rig.session.convert import rectification_for, to_light_field
from lfrig.rig.session.images import image_size
from lfrig.rig.session.views import read_views, taken_range


@dataclass(frozen=True)
class ViewFiles(Candidate):
    """``grid`` [rows][cols] files, ``also`` further files to keep as (from, name in the capture's folder)."""

    grid: tuple[tuple[Path, ...], ...]
    also: tuple[tuple[Path, str], ...] = ()

    def write(self, folder: Path, monitor: Monitor) -> None:
        """Check that every view can be read, then copy the files."""
        views = self.document.views
        assert views is not None
        volume = read_views(self.grid, monitor=monitor)
        rectification_for(self.document, volume.shape[3], volume.shape[2], self.source)
        copies = [
            (path, folder / views.file(row, col)) for row, line in enumerate(self.grid) for col, path in enumerate(line)
        ]
        copy_files([*copies, *((path, folder / name) for path, name in self.also)], monitor)

    def light_field(self, monitor: Monitor, threads: int = 0) -> LightField:
        """Read the views that are used, rectified."""
        rows, cols = taken_range(len(self.grid), len(self.grid[0]))
        files = [[self.grid[row][col] for col in cols] for row in rows]
        rectified = rectification_for(self.document, *image_size(files[0][0]), self.source)
        transform = rectified.apply if rectified else None
        views = read_views(files, threads=threads, monitor=monitor, transform=transform)
        return to_light_field(self.source.name, views, self.document)


def size_only(first: Path) -> CameraSpec:
    """Camera of which only the size is known."""
    width, height = image_size(first)
    return CameraSpec(width=width, height=height)


def light_field_document(**known: object) -> CaptureDocument:
    """A light field's document from what is known; None is left out."""
    return CaptureDocument.model_validate({"kind": "light_field", **known})
