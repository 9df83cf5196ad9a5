"""Commands that are documented and not in this version: each says so and exits 2."""

from __future__ import annotations

from collections.abc import Callable

import typer

from lfrig.contracts.errors import NotInThisVersion

PANEL = "Not in this version"
COMMANDS = {
    "console": "The operator's console in a browser.",
    "serve": "Processing for other machines.",
    "calibrate": "Calibrate the rig.",
    "calibration": "Keep calibrations.",
    "models": "Networks: list, verify, export, compile.",
    "cache": "Derived data of a session: show, prune.",
}


def register(app: typer.Typer) -> None:
    """Add the commands to ``app``; they take any arguments."""
    for name, help_text in COMMANDS.items():
        settings = {"allow_extra_args": True, "ignore_unknown_options": True}
        app.command(name, help=help_text, rich_help_panel=PANEL, context_settings=settings)(_refusal(name))


def _refusal(name: str) -> Callable[[], None]:
    def refuse() -> None:
        raise NotInThisVersion(f"lfrig {name}", remedy="see `lfrig --help` for what there is")

    return refuse
