"""``lfrig capture``, ``ingest``, ``info``: what is in a session and how it gets there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lfrig.rig.cli import options as parse
from lfrig.rig.cli.run import Run

if TYPE_CHECKING:
    from rich.console import Console

    from lfrig.rig.ingest import IngestedCapture

SIZES = ("tiny", "small", "medium", "full")
KINDS = {"light-field": "light_field", "photo": "photo"}


def register(app: typer.Typer) -> None:
    """Add the commands to ``app``."""
    app.command("capture")(capture)
    app.command("ingest")(ingest)
    app.command("info")(info)


def capture(
    context: typer.Context,
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="Session folder to make or to add to.")],
    rig: Annotated[str, typer.Option("--rig", metavar="sim", help="Which rig; sim is the simulated one.")],
    angles: Annotated[
        str, typer.Option(metavar="FIRST:LAST:STEP", help="Plate angles of the light fields [deg], both ends.")
    ] = "0:60:15",
    target_deg: Annotated[float | None, typer.Option(metavar="φ", help="Plate angle of the photo.")] = None,
    scene: Annotated[str, typer.Option(help="Simulated scene.")] = "tabletop",
    size: Annotated[str, typer.Option(help="small | medium | full")] = "small",
    seed: Annotated[int, typer.Option(help="Of everything that is random.")] = 0,
    record: Annotated[str, typer.Option(help="views (raw: not in this version)")] = "views",
    noise: Annotated[float, typer.Option(metavar="σ", help="Noise of the views [grey levels].")] = 0.0,
    plan: Annotated[Path | None, typer.Option(hidden=True)] = None,
    resume: Annotated[bool, typer.Option("--resume", hidden=True)] = False,
    force: Annotated[bool, typer.Option("--force", hidden=True)] = False,
) -> None:
    """Shoot a session: light fields at plate angles, then the photo."""
    raise NotImplementedError


def ingest(
    context: typer.Context,
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="Session folder; made when it is not there.")],
    sources: Annotated[list[Path], typer.Argument(metavar="SOURCE...", help="Light fields and photos.")],
    kind: Annotated[str | None, typer.Option("--as", metavar="light-field|photo", help="What the sources are.")] = None,
    pattern: Annotated[
        str | None, typer.Option(metavar="NAME_{row:02d}_{col:02d}.png", help="How the views of a folder are named.")
    ] = None,
    calibration: Annotated[Path | None, typer.Option(hidden=True)] = None,
) -> None:
    """Bring light fields (capture, HCI and view folders, ESLF pictures) and photos into a SESSION."""
    parse.refuse_absent("--calibration", calibration)
    if kind is not None:
        parse.one_of("--as", kind, tuple(KINDS))
    from lfrig.rig.ingest import ingest as bring_in

    run: Run = context.obj
    wanted: Any = KINDS[kind] if kind is not None else None
    captures = bring_in(session, sources, kind=wanted, pattern=pattern, monitor=run.monitor)
    rows = [
        {"id": c.id, "source": c.source, "kind": c.kind, "format": c.format, "skipped": c.skipped} for c in captures
    ]
    run.emit({"session": session, "captures": rows}, lambda console: _show_ingested(captures, console))


def info(
    context: typer.Context,
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A file, a session or a result.")],
) -> None:
    """What this file, session or result is."""
    from lfrig.rig.info import describe, text_lines

    run: Run = context.obj
    found = describe(path)
    run.emit(found, lambda console: console.print("\n".join(text_lines(found)), markup=False, soft_wrap=True))


def _show_ingested(captures: list[IngestedCapture], console: Console) -> None:
    for item in captures:
        fate = "there already" if item.skipped else item.format
        console.print(f"{item.id}  {item.kind:<11}  {item.source}  ({fate})", markup=False, soft_wrap=True)
