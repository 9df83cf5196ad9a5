"""Command lines that make no sense, and what is not in this version: exit 2, one line, a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

NOT_YET = "not in this version"


@pytest.mark.parametrize("arguments", [
    ["frobnicate"],
    ["process"],
    ["process", "S", "--no-such-option"],
    ["process", "S", "--bit-depth", "twelve"],
    ["process", "S", "--bit-depth", "12"],
    ["process", "S", "--preset", "best"],
    ["process", "S", "--poses", "guessed"],
    ["process", "S", "--backend", "abacus"],
    ["process", "S", "--out-views", "7"],
    ["process", "S", "--out-views", "6x6"],
    ["process", "S", "--sources", "000,,001"],
    ["process", "S", "--target-focus-m", "-1"],
    ["process", "S", "--target-baseline-m", "nan"],
    ["process", "S", "T", "--out", "X"],
    ["process", "S", "--threads", "-2"],
    ["depth", "L"],
    ["depth", "L", "--out", "D", "--disparity-range", "1"],
    ["depth", "L", "--out", "D", "--disparity-range", "2:1"],
    ["export", "R"],
    ["export", "R", "--format", "daguerreotype"],
    ["ingest", "S"],
    ["ingest", "S", "X", "--as", "hologram"],
    ["capture", "S"],
    ["capture", "S", "--rig", "sim", "--angles", "0:60"],
    ["bench", "guesses"], ["bench", "pareto", "--size", "full"], ["bench", "decode", "--size", "huge"],
    ["bench", "accuracy", "--inputs", "views,film"], ["bench", "stress", "--inputs", "raw"],
    ["decode", "x.lfr"], ["decode", "x.lfr", "--out", "y", "--views", "9"],
    ["score"],
])  # fmt: skip
def test_nonsense(lfrig, arguments: list[str]) -> None:
    outcome = lfrig(*arguments)
    assert outcome.code == 2, outcome
    assert outcome.out == ""
    assert NOT_YET not in outcome.error_line


@pytest.mark.parametrize("arguments", [
    ["console"], ["serve", "--port", "1"], ["calibrate"], ["calibration", "list"],
    ["models", "verify"], ["cache", "prune"],
    ["process", "S", "--preset", "balanced"], ["process", "S", "--preset", "paper"],
    ["process", "S", "--backend", "openvino"], ["process", "S", "--on", "host"],
    ["process", "S", "--scheduler", "tcp://h:1"],
    ["evaluate", "S", "--preset", "fast,balanced"],
    ["export", "R", "--format", "ply"], ["export", "R", "--format", "mp4"],
    ["capture", "S", "--rig", "rig.toml"],
    ["capture", "S", "--rig", "sim", "--resume"],
    ["bench", "models"], ["bench", "ablation"],
])  # fmt: skip
def test_not_in_this_version(lfrig, arguments: list[str]) -> None:
    outcome = lfrig(*arguments)
    assert outcome.code == 2, outcome
    assert NOT_YET in outcome.error_line


def test_usage_errors_as_json(lfrig) -> None:
    for arguments in (["frobnicate", "--json"], ["process", "--json"], ["console", "--json"]):
        outcome = lfrig(*arguments)
        assert outcome.code == 2
        assert set(outcome.json["error"]) == {"code", "message", "remedy"}
        assert outcome.err == ""


def test_a_target_must_be_named_without_a_photo(lfrig, session: Path, edit_json) -> None:
    edit_json(session / "session.json", captures=["000", "001"])
    outcome = lfrig("process", session)
    assert outcome.code == 2
    assert "--target" in outcome.error_line
    assert "000, 001" in outcome.error_line


@pytest.mark.parametrize("arguments, named", [
    (["--target", "009"], "009"),
    (["--sources", "000,009"], "009"),
    (["--sources", "002"], "002"),
    (["--sources", "000,000"], "twice"),
    (["--sources", "000,001", "--target", "001"], "001"),
])  # fmt: skip
def test_captures_that_cannot_serve(lfrig, session: Path, arguments: list[str], named: str) -> None:
    outcome = lfrig("process", session, *arguments)
    assert outcome.code == 2
    assert named in outcome.error_line
    assert not (session / "results").exists()


def test_help_of_every_command(lfrig) -> None:
    from lfrig.rig.cli.app import app

    assert "lfrig" in lfrig("--help").out
    for command in app.registered_commands:
        outcome = lfrig(command.name, "--help")
        assert outcome.code == 0
        assert outcome.err == ""
