"""``lfrig export``: results and captures in other people's formats."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfrig.contracts.errors import UsageError
from lfrig.rig.cli.make import Overwrite
from lfrig.rig.cli.run import Run

if TYPE_CHECKING:
    from lfrig.processing.model import LightField


def register(app: typer.Typer) -> None:
    """Add the command to ``app``."""
    app.command("export")(export)


def export(
    context: typer.Context,
    source: Annotated[Path, typer.Argument(metavar="RESULT|SESSION", help="What to export.")],
    format: Annotated[str, typer.Option("--format", help="views | pfm | npy | hci | gif | webm")],
    capture: Annotated[
        str | None, typer.Option(metavar="ID", help="Which light field of a SESSION; default: the only one.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="File or folder to write.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write a result, or a captured light field, in another format."""
    from lfrig.processing.export.registry import export as write

    run: Run = context.obj
    if (source / "session.json").is_file():
        path = write(_light_field(source, capture), format, out, overwrite=overwrite, monitor=run.monitor)
    else:
        if capture is not None:
            raise UsageError(f"--capture: {source} is no session", remedy="leave --capture out")
        path = write(source, format, out, overwrite=overwrite, monitor=run.monitor)
    run.emit({"path": path, "format": format}, lambda console: console.print(str(path), markup=False, soft_wrap=True))


def _light_field(session: Path, capture: str | None) -> LightField:
    from lfrig.rig.session.store import SessionStore

    store = SessionStore.open(session)
    held = [name for name, document in store.captures().items() if document.kind == "light_field"]
    if capture is None and len(held) == 1:
        capture = held[0]
    if capture not in held:
        wrong = "which light field is meant must be said" if capture is None else f"has no light field {capture!r}"
        raise UsageError(f"{session}: {wrong}", remedy=f"give --capture ID, one of {', '.join(held) or 'none'}")
    return store.load_light_field(capture)
