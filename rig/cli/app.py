"""The commands of ``lfrig``, put together."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from lfrig.rig.cli import absent, bench, decode, doctor, export, make, quality, session
from lfrig.rig.cli.run import Run

app = typer.Typer(
    name="lfrig",
    help="A light-field capture rig, and what turns a handful of its shots into a new light field.",
    epilog="The global options may stand anywhere on the line.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
)


def _version(wanted: bool) -> None:
    if wanted:
        from lfrig.rig.cli.version import version

        typer.echo(f"lfrig {version()}")
        raise typer.Exit


@app.callback()
def _global_options(
    context: typer.Context,
    json: Annotated[bool, typer.Option("--json", help="One JSON document on stdout, errors too.")] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show the traceback of a failure.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Neither progress nor warnings nor text.")] = False,
    threads: Annotated[int, typer.Option("--threads", min=0, help="Threads; 0 = all cores.")] = 0,
    log_file: Annotated[Path | None, typer.Option("--log-file", help="Keep a full log here.")] = None,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    run: Run = context.ensure_object(Run)
    run.json, run.debug, run.quiet, run.threads = json, debug, quiet, threads
    if log_file is not None:
        run.open_log(log_file)


for group in (make, session, decode, quality, export, bench, doctor, absent):
    group.register(app)
