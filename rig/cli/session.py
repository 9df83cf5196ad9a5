"""``lfrig capture``, ``ingest``, ``info``: what is in a session and how it gets there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from lfrig.contracts.errors import NotInThisVersion, UsageError
from lfrig.rig.cli import options as parse
from lfrig.rig.cli.run import Run

if TYPE_CHECKING:
    from rich.console import Console

    from lfrig.rig.ingest import IngestedCapture
    from lfrig.rig.plan import CapturePlan
    from lfrig.sim.devices import Record

DEFAULT_ANGLES = "0:60:15"
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
        str | None, typer.Option(metavar="0:60:15", help="Plate angles of the light fields [deg], both ends included.")
    ] = None,
    target_deg: Annotated[
        float | None, typer.Option(metavar="φ", help="Plate angle of the photo; default: between the middle two.")
    ] = None,
    plan: Annotated[Path | None, typer.Option(metavar="PLAN.toml", help="Angles from a file instead.")] = None,
    scene: Annotated[str, typer.Option(help="Simulated scene; a wrong name lists them.")] = "figurines",
    size: Annotated[str, typer.Option(help="tiny | small | medium | full")] = "small",
    seed: Annotated[int, typer.Option(min=0, help="Of everything that is random.")] = 0,
    record: Annotated[
        str | None, typer.Option(metavar="raw|views", help="Light fields as raw files or as views; default: raw.")
    ] = None,
    noise: Annotated[
        float, typer.Option(metavar="σ", min=0, help="Noise of photo and views [grey levels]; raw has its own.")
    ] = 0.0,
    resume: Annotated[bool, typer.Option("--resume", hidden=True)] = False,
    force: Annotated[bool, typer.Option("--force", help="Shoot steps above 30° too.")] = False,
) -> None:
    """Shoot a session: light fields at plate angles, then the photo."""
    parse.refuse_absent("--resume", resume)
    if record is not None:
        parse.one_of("--record", record, ("raw", "views"))
    if rig != "sim":
        raise NotInThisVersion(f"--rig {rig}", remedy="use --rig sim")
    if plan is not None and (angles is not None or target_deg is not None):
        raise UsageError("--plan says the angles already", remedy="leave out --plan, or --angles and --target-deg")
    from lfrig.rig.sim_capture import capture_simulated

    run: Run = context.obj
    wanted = _plan(plan, angles, target_deg)
    wanted.check_steps(run.monitor, force=force)
    store = capture_simulated(
        session, scene=scene, size=size, angles_deg=wanted.angles_deg, target_deg=wanted.target_deg, seed=seed,
        noise_sigma=noise, record=cast("Record | None", record), threads=run.threads, monitor=run.monitor,
    )  # fmt: skip
    document = {"session": store.path, "truth": store.truth_path, "captures": list(store.captures())}
    run.emit(document, lambda console: console.print(f"{store.path}", markup=False, soft_wrap=True))


def _plan(path: Path | None, angles: str | None, target_deg: float | None) -> CapturePlan:
    from lfrig.rig.plan import CapturePlan, middle_gap_deg, parse_angles

    if path is not None:
        return CapturePlan.load(path)
    light_fields = parse_angles(angles if angles is not None else DEFAULT_ANGLES)
    return CapturePlan(
        angles_deg=light_fields, target_deg=middle_gap_deg(light_fields) if target_deg is None else target_deg
    )


def ingest(
    context: typer.Context,
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="Session folder; made when it is not there.")],
    sources: Annotated[list[Path], typer.Argument(metavar="SOURCE...", help="Light fields and photos.")],
    kind: Annotated[str | None, typer.Option("--as", metavar="light-field|photo", help="What the sources are.")] = None,
    pattern: Annotated[
        str | None, typer.Option(metavar="NAME_{row:02d}_{col:02d}.png", help="How the views of a folder are named.")
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(metavar="caldata.tar", help="White images of the camera that took the raw files.")
    ] = None,
) -> None:
    """Bring light fields (raw files, capture, HCI and view folders, ESLF pictures) and photos into a SESSION."""
    if kind is not None:
        parse.one_of("--as", kind, tuple(KINDS))
    from lfrig.rig.ingest import ingest as bring_in

    run: Run = context.obj
    wanted: Any = KINDS[kind] if kind is not None else None
    captures = bring_in(session, sources, kind=wanted, pattern=pattern, calibration=calibration, monitor=run.monitor)
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
