"""``lfrig bench``: numbers with their cost. The only place from which the benchmarks are loaded."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lfrig.contracts.errors import CheckFailed, UsageError
from lfrig.rig.cli import options as parse
from lfrig.rig.cli.run import Run

if TYPE_CHECKING:
    from rich.console import Console

    from lfrig.contracts.bench import BenchDocument

WITH_SCENES = ("accuracy", "poses", "speed", "skip")
LATER = ("rig", "models", "ablation")


def register(app: typer.Typer) -> None:
    """Add the command to ``app``."""
    app.command("bench")(bench)


def bench(
    context: typer.Context,
    name: Annotated[
        str,
        typer.Argument(
            metavar="accuracy|pareto|stress|decode|poses|speed|kernels|skip|regression", help="Which benchmark."
        ),
    ],
    out: Annotated[Path, typer.Option(help="Folder for the JSON, the Markdown and the plots.")] = Path("out/bench"),
    size: Annotated[
        str | None, typer.Option(metavar="crop|full", help="Of the sensor, for decode; the full one has more bounds.")
    ] = None,
    inputs: Annotated[
        str | None,
        typer.Option(metavar="views,noisy,raw", help="What the sources come as, for accuracy; all by default."),
    ] = None,
    scenes: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,NAME", help="Other scenes, for accuracy, poses, speed and skip; bounds are not checked."
        ),
    ] = None,
    check: Annotated[bool, typer.Option("--check", help="Exit 1 when a check fails.")] = False,
) -> None:
    """Run a benchmark: rows of numbers with their cost, and checks against bounds."""
    from lfrig.bench import BENCHES, load

    run: Run = context.obj
    parse.one_of("bench", name, tuple(BENCHES), LATER)
    if size is not None and name != "decode":
        raise UsageError(f"--size: bench {name} has one size", remedy="leave --size out")
    if scenes is not None and name not in WITH_SCENES:
        raise UsageError(f"--scenes: bench {name} has its own", remedy="leave --scenes out")
    given: dict[str, object] = {} if size is None else {"size": size}
    if inputs is not None:
        given["inputs"] = _inputs(name, inputs, load("accuracy").INPUTS)
    if scenes is not None:
        given["scenes"] = _scene_names(scenes)
    document: BenchDocument = load(name).run(out, monitor=run.monitor, threads=run.threads, **given)
    run.emit(document, lambda console: _show(document, out, console))
    failed = [item.name for item in document.checks if not item.ok]
    if check and failed:
        if run.json:
            raise typer.Exit(CheckFailed.exit_code)
        raise CheckFailed(f"{len(failed)} of {len(document.checks)} checks failed: {', '.join(failed)}",
                          remedy=f"see {out}/{name}.md")  # fmt: skip


def _inputs(name: str, text: str, known: tuple[str, ...]) -> list[str]:
    """What ``--inputs`` names, of those that are known, each once."""
    if name != "accuracy":
        raise UsageError(f"--inputs: bench {name} has one kind of input", remedy="leave --inputs out")
    found = list(dict.fromkeys(part.strip() for part in text.split(",")))
    for part in found:
        parse.one_of("--inputs", part, known)
    return found


def _scene_names(said: str) -> list[str]:
    """The scenes of a comma-separated list; an unknown one is refused before anything is rendered."""
    from lfrig.sim.scenes import check_scene_name

    names = [name.strip() for name in said.split(",") if name.strip()]
    if not names:
        raise UsageError("--scenes names no scene", remedy="give names of the library, such as --scenes desk,fence")
    for name in names:
        check_scene_name(name)
    return names


def _show(document: BenchDocument, out: Path, console: Console) -> None:
    text = (out / f"{document.name}.md").read_text(encoding="utf-8")
    console.print(text, markup=False, soft_wrap=True)
