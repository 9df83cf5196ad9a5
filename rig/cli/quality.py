"""``lfrig score``, ``evaluate``, ``compare``: how good results are."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfrig.rig.cli import options as parse
from lfrig.rig.cli.make import Overwrite
from lfrig.rig.cli.run import Run

if TYPE_CHECKING:
    from rich.console import Console

    from lfrig.rig.leave_one_out import Evaluation


def register(app: typer.Typer) -> None:
    """Add the commands to ``app``."""
    app.command("score")(score)
    app.command("evaluate")(evaluate)
    app.command("compare")(compare)


def score(
    context: typer.Context,
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="Result folder.")],
    truth: Annotated[Path | None, typer.Option(metavar="DIR", help="Default: SESSION.truth.")] = None,
) -> None:
    """Score a RESULT against the truth; the only command that reads truth."""
    from lfrig.rig.cli.tables import score_table
    from lfrig.rig.scoring import score_result

    run: Run = context.obj
    document, _ = score_result(result, truth, threads=run.threads, monitor=run.monitor)
    run.emit({"result": result, "score": document}, lambda console: console.print(score_table(document)))


def evaluate(
    context: typer.Context,
    session: Annotated[Path, typer.Argument(metavar="SESSION", help="Session with two light fields or more.")],
    preset: Annotated[str, typer.Option(metavar="P,P", help="Presets to evaluate.")] = "fast",
    poses: Annotated[str, typer.Option(help="auto | lf | colmap | given")] = "auto",
    out: Annotated[Path | None, typer.Option(help="Default: SESSION/results.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Leave one out: each light field in turn is the target, scored on its own views."""
    from lfrig.processing.options import ProcessOptions, check_options
    from lfrig.rig.cli.make import POSES
    from lfrig.rig.leave_one_out import evaluate_session

    run: Run = context.obj
    parse.one_of("--poses", poses, POSES)
    presets = parse.names("--preset", preset) or []
    wanted = [ProcessOptions(preset=name, poses=poses, threads=run.threads) for name in presets]  # type: ignore[arg-type]
    for options in wanted:
        check_options(options)
    evaluations = evaluate_session(session, presets, wanted[0], run.monitor, out=out, overwrite=overwrite)
    document = {"evaluations": [{"path": e.folder, "preset": e.preset, **_body(e)} for e in evaluations]}
    run.emit(document, lambda console: _show_evaluations(evaluations, console))


def compare(
    context: typer.Context,
    first: Annotated[Path, typer.Argument(metavar="RESULT")],
    second: Annotated[Path, typer.Argument(metavar="RESULT")],
) -> None:
    """Two results side by side: parameters, costs, scores, and how far their disparities differ."""
    from lfrig.rig.cli.tables import comparison_table
    from lfrig.rig.compare import compare_results

    run: Run = context.obj
    comparison = compare_results(first, second)
    run.emit(comparison.as_document(), lambda console: console.print(comparison_table(comparison)))


def _body(evaluation: Evaluation) -> dict[str, object]:
    return {"rows": evaluation.document.rows}


def _show_evaluations(evaluations: list[Evaluation], console: Console) -> None:
    for evaluation in evaluations:
        table = (evaluation.folder / "evaluate.md").read_text(encoding="utf-8")
        console.print(table, markup=False, soft_wrap=True)
        console.print(f"{evaluation.folder}", markup=False, soft_wrap=True)
