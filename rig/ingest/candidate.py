"""What a detector found: a light field or a photo in a foreign format, not yet read as a whole."""

from __future__ import annotations

import shutil
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Literal

from lfrig.contracts.capture import MAX_VIEWS_PER_SIDE, CaptureDocument, OriginSpec, ViewsSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.files import sha256_files
from lfrig.contracts.paths import expand
from lfrig.contracts.progress import Monitor, Notice
from lfrig.processing.model import LightField
from lfrig.rig.ingest.calibration import SessionCalibration

Kind = Literal["light_field", "photo"]


def in_words(kind: Kind) -> str:
    """The kind as a person would write it."""
    return kind.replace("_", " ")


@dataclass(frozen=True)
class Request:
    """What the user said about a source; None = find out. ``calibration`` is for raw light fields."""

    kind: Kind | None = None
    pattern: str | None = None
    calibration: SessionCalibration | None = None


@dataclass(frozen=True)
class Candidate(ABC):
    """A source that was recognised.

    ``document`` says what is known, with names as they will be in the capture's folder; ``content`` are the files
    whose bytes tell it apart from others, in the order of the views.
    """

    source: Path
    format: str
    document: CaptureDocument
    content: tuple[Path, ...]

    @cached_property
    def content_hash(self) -> str:
        """Hex SHA-256 of the content, whatever the files are called; raises `BadInput`."""
        kept = self.document.origin.sha256 if self.document.origin else None
        return kept or sha256_files(list(self.content))

    def stored_document(self) -> CaptureDocument:
        """The document to store, with its origin."""
        if self.document.origin is not None:
            return self.document
        origin = OriginSpec(name=self.source.name, format=self.format, sha256=self.content_hash)
        return self.document.model_copy(update={"origin": origin})

    def notes(self) -> list[Notice]:
        """What the user should know about how it was read."""
        return []

    @abstractmethod
    def write(self, folder: Path, monitor: Monitor) -> None:
        """Put the pixels into a capture's folder, after reading all of them once.

        Raises
        ------
        BadInput
            Something is missing, damaged or of another size.
        DiskError
            Writing failed.
        """

    @abstractmethod
    def light_field(self, monitor: Monitor, threads: int = 0) -> LightField:
        """Read it as a light field; raises as `write`, and `BadInput` for a photo."""


def copy_files(pairs: Sequence[tuple[Path, Path]], monitor: Monitor) -> None:
    """Copy files (from, to), making folders as needed; contents only, so that nothing arrives read-only."""
    for source, target in pairs:
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)
        monitor.advance(0)


def full_grid(
    files: dict[tuple[int, int], Path], source: Path, pattern: str | None
) -> tuple[ViewsSpec, tuple[tuple[Path, ...], ...]]:
    """Renumber views found at (row, col) from zero, in a suffix-keeping pattern.

    Rows and columns may start anywhere and have any even spacing.

    Raises
    ------
    BadInput
        Fewer than 3×3, holes in the grid (the first one is named, by ``pattern`` when there is one).
    """
    rows, cols = (_axis({key[axis] for key in files}, source) for axis in (0, 1))
    for row in rows:
        for col in cols:
            if (row, col) not in files:
                missing = len(rows) * len(cols) - len(files)
                name = expand(pattern, row, col) if pattern else f"view ({row}, {col})"
                raise BadInput(
                    f"is missing ({missing} of {len(rows)}×{len(cols)} views are)",
                    path=source / name, code="missing-views",
                    remedy="copy the whole light field again, or name the views with --pattern",
                )  # fmt: skip
    if min(len(rows), len(cols)) < 3:
        raise BadInput(
            f"holds {len(rows)}×{len(cols)} views, at least 3×3 are needed", path=source, code="too-few-views",
            remedy="give all views, or name them with --pattern",
        )  # fmt: skip
    grid = tuple(tuple(files[row, col] for col in cols) for row in rows)
    suffix = grid[0][0].suffix.lower()
    return ViewsSpec(rows=len(rows), cols=len(cols), pattern="views/{row:02d}_{col:02d}" + suffix), grid


def _axis(numbers: set[int], source: Path) -> range:
    """The numbers of all rows (or columns), holes filled in: from the first to the last by the smallest step."""
    ordered = sorted(numbers)
    step = min((b - a for a, b in pairwise(ordered)), default=1)
    axis = range(ordered[0], ordered[-1] + 1, step)
    if len(axis) > MAX_VIEWS_PER_SIDE or not numbers <= set(axis):
        raise BadInput(
            f"numbers {ordered[0]}..{ordered[-1]} in its names are no evenly spaced rows or columns", path=source,
            code="no-view-grid", remedy='say how views are named: --pattern "name_{row:02d}_{col:02d}.png"',
        )  # fmt: skip
    return axis
