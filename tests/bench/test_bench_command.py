"""``lfrig bench``: what it takes, before anything is rendered."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from lfrig.bench import poses
from lfrig.contracts.bench import BenchDocument, Check
from lfrig.rig.cli import main

USAGE, BAD_INPUT = 2, 3


@pytest.mark.parametrize(
    ("arguments", "code", "said"),
    [
        (["stress", "--scenes", "desk"], USAGE, "--scenes"),
        (["poses", "--scenes", " , "], USAGE, "names no scene"),
        (["poses", "--scenes", "desk,atlantis"], BAD_INPUT, "atlantis"),
        (["poses", "--size", "full"], USAGE, "--size"),
    ],
)
def test_what_makes_no_sense(
    arguments: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["bench", *arguments, "--out", str(tmp_path / "out")]) == code
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("check", "code"), [(True, 1), (False, 0)])
def test_scenes_are_handed_on_and_checks_decide(
    check: bool, code: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    asked: dict[str, Any] = {}

    def run(out: Path, **options: Any) -> BenchDocument:
        asked.update(options)
        out.mkdir()
        (out / "poses.md").write_text("# poses", encoding="utf-8")
        return BenchDocument(name="poses", checks=[Check.of("rotation", 2.0, "<=", 1.0, "too far")])

    monkeypatch.setattr(poses, "run", run)
    arguments = ["bench", "poses", "--scenes", "desk, fence", "--out", str(tmp_path / "out"), "--threads", "1"]
    assert main([*arguments, *(["--check"] if check else [])]) == code
    assert asked["scenes"] == ["desk", "fence"] and asked["threads"] == 1
