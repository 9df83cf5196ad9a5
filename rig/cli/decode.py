"""``lfrig decode``: a raw plenoptic file to views."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfrig.rig.cli import options as parse
from lfrig.rig.cli.make import Overwrite
from lfrig.rig.cli.run import Run

if TYPE_CHECKING:
    from rich.console import Console

    from lfrig.rig.decode import DecodeOutcome

VIEWS = ("7", "14", "15")


def register(app: typer.Typer) -> None:
    """Add the command to ``app``."""
    app.command("decode")(decode)


def decode(
    context: typer.Context,
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Raw light field: .lfr or .lfp.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder to make.")],
    calibration: Annotated[
        Path | None,
        typer.Option(metavar="C", help="The camera's calibration: caldata-….tar, a folder, or one white image."),
    ] = None,
    views: Annotated[str, typer.Option(metavar="7|14|15", help="Views per side.")] = "7",
    partial: Annotated[bool, typer.Option("--partial", help="Take what is whole of a torn file.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Decode a raw plenoptic FILE to views: a folder that is a capture."""
    from lfrig.rig.decode import decode_file

    run: Run = context.obj
    count = int(parse.one_of("--views", views, VIEWS))
    outcome = decode_file(
        file, out, calibration=calibration, views=count,  # type: ignore[arg-type]  # one of VIEWS
        partial=partial, overwrite=overwrite, threads=run.threads, monitor=run.monitor,
    )  # fmt: skip
    run.emit({"path": outcome.folder, **outcome.facts}, lambda console: _show(outcome, console))


def _show(outcome: DecodeOutcome, console: Console) -> None:
    views, lattice, white = (outcome.facts[name] for name in ("views", "lattice", "white_image"))
    size = f"{views['rows']}×{views['cols']} views of {views['width']}×{views['height']} px"
    fit = f"{lattice['lenses']} lenses {lattice['pitch_px']:.4f} px apart, residual {lattice['residual_rms_px']:.3f} px"
    console.print(f"{size}; {fit}; white image: {white['rule']}", markup=False, soft_wrap=True)
    console.print(str(outcome.folder), markup=False, soft_wrap=True)
