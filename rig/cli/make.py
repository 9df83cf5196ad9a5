"""``lfrig demo``, ``depth``, ``process``: the commands that make results."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lfrig.contracts.errors import UsageError
from lfrig.rig.cli import options as parse
from lfrig.rig.cli.run import Run

if TYPE_CHECKING:
    from rich.console import Console

    from lfrig.rig.demo import DemoOutcome

POSES = ("auto", "lf", "colmap", "given")
BACKENDS, LATER_BACKENDS = ("auto", "cpu"), ("openvino", "qnn", "depthai")
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what exists at the output path.")]


def register(app: typer.Typer) -> None:
    """Add the commands to ``app``."""
    app.command("demo")(demo)
    app.command("depth")(depth)
    app.command("process")(process)


def demo(
    context: typer.Context,
    out: Annotated[Path, typer.Option("--out", help="Folder to make.")] = Path("demo"),
    size: Annotated[str, typer.Option("--size", help="tiny | small | medium | full")] = "medium",
    overwrite: Overwrite = False,
) -> None:
    """A simulated rig → captures → result → score → report, in one go."""
    from lfrig.rig.demo import run_demo

    run: Run = context.obj
    outcome = run_demo(out, size=size, overwrite=overwrite, threads=run.threads, monitor=run.monitor)
    run.emit(outcome.as_document(), lambda console: _show_demo(outcome, console))


def depth(
    context: typer.Context,
    light_field: Annotated[Path, typer.Argument(metavar="LIGHTFIELD", help="Capture folder, HCI folder, ESLF, views.")],
    out: Annotated[Path, typer.Option("--out", help="Folder to make.")],
    disparity_range: Annotated[str, typer.Option(metavar="auto|LO:HI", help="Pixels per view step.")] = "auto",
    overwrite: Overwrite = False,
) -> None:
    """Disparity and confidence of one light field alone."""
    bounds = parse.number_range("--disparity-range", disparity_range)
    from lfrig.rig.depth import depth_of_light_field

    run: Run = context.obj
    outcome = depth_of_light_field(
        light_field, out, bounds, overwrite=overwrite, threads=run.threads, monitor=run.monitor
    )
    run.emit({"path": outcome.folder, **outcome.document}, lambda console: _show([f"{out}/report.html"], console))


def process(
    context: typer.Context,
    sessions: Annotated[list[Path], typer.Argument(metavar="SESSION...", help="Session folders.")],
    target: Annotated[
        str | None, typer.Option(metavar="ID", help="Photo (or light field) to raise; default: the only photo.")
    ] = None,
    sources: Annotated[
        str | None, typer.Option(metavar="ID,ID", help="Light fields to use; default: all, nearest 4 of more.")
    ] = None,
    poses: Annotated[str, typer.Option(help="auto | lf | colmap | given")] = "auto",
    preset: Annotated[str, typer.Option(help="fast | preview (balanced, paper: not in this version)")] = "fast",
    backend: Annotated[str, typer.Option(help="auto | cpu")] = "auto",
    target_baseline_m: Annotated[
        float | None, typer.Option(help="Baseline between adjacent views; default: the nearest source's.")
    ] = None,
    target_focus_m: Annotated[
        float | None, typer.Option(help="Distance of zero disparity; default: the nearest source's.")
    ] = None,
    out_views: Annotated[str | None, typer.Option(metavar="ROWSxCOLS", help="Views to make; default 7x7.")] = None,
    bit_depth: Annotated[int, typer.Option(help="8 | 16 bits a channel of the views.")] = 8,
    out: Annotated[Path | None, typer.Option(help="Default: SESSION/results/TARGET-PRESET.")] = None,
    overwrite: Overwrite = False,
    on: Annotated[str | None, typer.Option(metavar="HOST", hidden=True)] = None,
    scheduler: Annotated[str | None, typer.Option(metavar="ADDR", hidden=True)] = None,
) -> None:
    """Raise the photo of each SESSION into a light field."""
    parse.refuse_absent("--on", on)
    parse.refuse_absent("--scheduler", scheduler)
    parse.one_of("--poses", poses, POSES)
    parse.one_of("--backend", backend, BACKENDS, LATER_BACKENDS)
    parse.positive("--target-baseline-m", target_baseline_m)
    parse.positive("--target-focus-m", target_focus_m)
    rows, cols = parse.grid("--out-views", out_views) if out_views is not None else (None, None)
    names = parse.names("--sources", sources)
    if out is not None and len(sessions) > 1:
        raise UsageError("--out names one result, but several sessions were given", remedy="leave --out out")

    from lfrig.processing.options import ProcessOptions, check_options
    from lfrig.rig.process import check_session, process_session

    run: Run = context.obj
    wanted = ProcessOptions(
        preset=preset, poses=poses,  # type: ignore[arg-type]  # one of POSES
        target_baseline_m=target_baseline_m, target_focus_m=target_focus_m,
        rows=rows or 7, cols=cols or 7, threads=run.threads, bit_depth=bit_depth,
    )  # fmt: skip
    check_options(wanted)
    for session in sessions:
        check_session(session, target, names, wanted, out, overwrite)
    folders = [process_session(session, target, names, wanted, out, overwrite, run.monitor) for session in sessions]
    pages = [f"{folder}/report.html" for folder in folders]
    run.emit({"results": [_result_document(folder) for folder in folders]}, lambda console: _show(pages, console))


def _show_demo(outcome: DemoOutcome, console: Console) -> None:
    from lfrig.rig.cli.tables import score_table

    plan, sources = outcome.plan, ", ".join(source.id for source in outcome.report.sources)
    width, height = outcome.size
    console.print(
        f"scene {plan.scene}, {len(plan.angles_deg)} light fields of 7×7 views, {width}×{height}; "
        f"photo at {plan.target_deg:g}°; sources {sources}",
        markup=False,
    )
    console.print(score_table(outcome.score))
    costs = ", ".join(f"{name} {seconds:.1f}" for name, seconds in outcome.cpu_s.items())
    console.print(f"CPU s: {costs}; {outcome.wall_s:.1f} s in all", markup=False)
    console.print(f"look at {outcome.result / 'report.html'}", markup=False, soft_wrap=True)


def _result_document(folder: Path) -> dict[str, Any]:
    from lfrig.contracts.result import ReportDocument

    return {"path": folder, "report": ReportDocument.load(folder / "report.json")}


def _show(paths: list[str], console: Console) -> None:
    for path in paths:
        console.print(path, markup=False, soft_wrap=True)
