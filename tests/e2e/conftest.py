"""Small sessions written by hand, and the command line called in this process."""

from __future__ import annotations

import functools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lfrig.rig.cli import main
from lfrig.sim.shoot import SimulatedSession, shoot

WIDTH, HEIGHT = 96, 64
ANGLES_DEG = (-15.0, 15.0)


@dataclass(frozen=True)
class Outcome:
    """What a command said."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)

    @property
    def error_line(self) -> str:
        """The one line of a failure."""
        lines = [line for line in self.err.splitlines() if not line.startswith("lfrig: warning: ")]
        assert len(lines) == 1, self.err
        assert lines[0].startswith("lfrig: error: ")
        assert " — " in lines[0], "no remedy"
        return lines[0]


@pytest.fixture
def lfrig(capsys: pytest.CaptureFixture[str]) -> Callable[..., Outcome]:
    """Run one command in this process."""

    def run(*arguments: str | Path) -> Outcome:
        capsys.readouterr()
        code = main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return Outcome(code, out, err)

    return run


@functools.cache
def shot(
    angles_deg: Sequence[float] = ANGLES_DEG, lf_as_target: bool = False, scene: str = "tabletop"
) -> SimulatedSession:
    """A simulated session in memory, shot once per test run; poses are recorded as they are."""
    return shoot(
        scene, WIDTH, HEIGHT, tuple(angles_deg), 0.0, poses="given", lf_as_target=lf_as_target, truth_views=False
    )


def write_by_hand(session: SimulatedSession, folder: Path) -> Path:
    """Write a session as a person with a script would: JSON and PNG files, none of lfrig's writers."""
    for name, capture in session.captures.items():
        home = folder / "captures" / name
        (home / "views").mkdir(parents=True)
        body = capture.document.model_dump(mode="json", exclude_none=True)
        (home / "capture.json").write_text(json.dumps({"schema": "lfrig.capture/1", **body}), encoding="utf-8")
        if capture.pixels.ndim == 3:
            Image.fromarray(capture.pixels).save(home / "photo.png", compress_level=1)
            (home / "views").rmdir()
        else:
            for row, col in np.ndindex(capture.pixels.shape[:2]):
                path = home / "views" / f"{row:02d}_{col:02d}.png"
                Image.fromarray(capture.pixels[row, col]).save(path, compress_level=1)
    rig = session.rig.model_dump(mode="json", exclude_none=True)
    document = {"schema": "lfrig.session/1", "captures": list(session.captures), "rig": rig}
    (folder / "session.json").write_text(json.dumps(document), encoding="utf-8")
    return folder


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """Two light fields at ±15° and a photo between them, 96×64, poses given: captures 000, 001, 002."""
    return write_by_hand(shot(), tmp_path / "session")


@pytest.fixture
def edit_json() -> Callable[..., None]:
    """Change fields of a JSON file; a path of keys is joined by dots, the value None removes the field."""

    def edit(path: Path, **changes: Any) -> None:
        body = json.loads(path.read_text(encoding="utf-8"))
        for key, value in changes.items():
            *parents, last = key.split("__")
            part = body
            for parent in parents:
                part = part[parent]
            if value is None:
                part.pop(last, None)
            else:
                part[last] = value
        path.write_text(json.dumps(body), encoding="utf-8")

    return edit


def tree(folder: Path) -> dict[str, bytes]:
    """Every file below a folder with its content."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


@pytest.fixture
def content() -> Callable[[Path], dict[str, bytes]]:
    """Files and bytes below a folder, to see that nothing changed."""
    return tree
