"""ESLF: one picture with a tile per lenslet, as Lytro Power Tools writes it for the Illum.

Pixel (14 y + r, 14 x + c) is pixel (x, y) of view (r, c). Rows and columns 3..9 of the 14×14 views are taken
(centre 6): 14 has no true centre, and the outer views are vignetted. A microlens and the main lens both invert, so
the views are in this project's order and sign.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lfrig.contracts.capture import CameraSpec, ViewsSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor, Notice
from lfrig.processing.model import U8, LightField
from lfrig.rig.ingest.candidate import Candidate, Request
from lfrig.rig.ingest.view_files import light_field_document
from lfrig.rig.session.convert import to_light_field
from lfrig.rig.session.images import IMAGE_SUFFIXES, image_size, read_image8
from lfrig.rig.session.views import taken_range, write_views

FORMAT = "eslf"
TILE = 14
POWER_TOOLS_SIZE = (7574, 5264)
"""(width, height) [px] of an Illum's ESLF: 541×376 lenslets."""


@dataclass(frozen=True)
class EslfFile(Candidate):
    """One ESLF picture."""

    def views(self) -> U8:
        """Decode: uint8 [7, 7, H, W, 3]."""
        lenslets = read_image8(self.source)
        height, width = lenslets.shape[0] // TILE, lenslets.shape[1] // TILE
        rows, cols = taken_range(TILE, TILE)
        tiles = lenslets.reshape(height, TILE, width, TILE, 3)[:, rows.start : rows.stop, :, cols.start : cols.stop]
        return np.ascontiguousarray(tiles.transpose(1, 3, 0, 2, 4))

    def notes(self) -> list[Notice]:
        """Which views were taken."""
        rows, _ = taken_range(TILE, TILE)
        message = f"of {TILE}×{TILE} views, rows and columns {rows[0]}..{rows[-1]} are taken (centre {rows[3]})"
        return [Notice("eslf-views", message)]

    def write(self, folder: Path, monitor: Monitor) -> None:
        """Write the views as PNG files."""
        assert self.document.views is not None
        monitor.advance(0)
        write_views(folder, self.views(), self.document.views.file)

    def light_field(self, monitor: Monitor, threads: int = 0) -> LightField:
        """Decode it."""
        monitor.advance(0)
        return to_light_field(self.source.stem, self.views(), self.document)


def recognise(path: Path, request: Request) -> Candidate | None:
    """A picture of the Power Tools' size, one named ``…eslf…``, or any when a light field is asked for.

    Raises
    ------
    BadInput
        Its sides are no multiples of 14.
    """
    if not path.is_file() or request.kind == "photo" or path.suffix.lower() not in IMAGE_SUFFIXES:
        return None
    width, height = image_size(path)
    named = "eslf" in path.stem.lower() or request.kind == "light_field"
    if not named and (width, height) != POWER_TOOLS_SIZE:
        return None
    if width % TILE or height % TILE:
        raise BadInput(
            f"is {width}×{height} px, which {TILE}×{TILE} tiles do not fill", path=path, code="not-an-eslf",
            remedy="give it with --as photo if it is one",
        )  # fmt: skip
    camera = CameraSpec(width=width // TILE, height=height // TILE)
    rows, cols = taken_range(TILE, TILE)
    views = ViewsSpec(rows=len(rows), cols=len(cols))
    return EslfFile(path, FORMAT, light_field_document(views=views, camera=camera), (path,))
