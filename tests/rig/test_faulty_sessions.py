"""Bad input end to end: refused or warned of by name, never a silent wrong geometry.

Every case is a session on disk through ``lfrig process``: exit code 4 with one line that names the capture and says
what to do, or a warning in report.json that names it, and depths as good as without the fault.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from lfrig.bench.poses_faults import blur
from lfrig.rig.cli import main
from tests.rig.faulty_sessions import (
    PHOTO,
    angles,
    depth_error,
    documents,
    photo_of,
    shot,
    still_wall,
    with_photo,
    write,
)

GEOMETRY = 4
GOOD_DEPTH = 0.045
"""Median relative error of depth that a session without a fault keeps at this small size."""

AS_GOOD = 1.1
"""How many times that of the session without the fault it may be with a fault that was corrected."""

DEFOCUSED = 1.25
"""The same of a capture that is out of focus: its light field is used, and worse."""

FOCAL_CORRECTED = 0.006
"""A focal length that was 15 % off comes back to about 0.3 %: its depths are less sure than recorded ones."""

BEFORE_WALL = 1.75
"""The same before a wall that does not turn: what is seen of it has no depth in the plate's world."""


@pytest.fixture
def refusal(capsys: pytest.CaptureFixture[str]):
    """Process a session and see it refused; returns the line on stderr."""

    def run(session: Path) -> str:
        capsys.readouterr()
        assert main(["process", str(session), "--threads", "1"]) == GEOMETRY
        out, err = capsys.readouterr()
        lines = [line for line in err.splitlines() if not line.startswith("lfrig: warning: ")]
        assert out == "" and len(lines) == 1, err
        assert lines[0].startswith("lfrig: error: ") and " — " in lines[0], "no remedy"
        assert not list((session / "results").glob("*")), "nothing half-made is left"
        return lines[0]

    return run


def processed(session: Path) -> tuple[Path, dict[str, str]]:
    """Process a session; the result folder and the warnings of its report by code."""
    assert main(["--quiet", "process", str(session), "--threads", "1"]) == 0
    (result,) = (session / "results").iterdir()
    report = json.loads((result / "report.json").read_text(encoding="utf-8"))
    return result, {w["code"]: w["message"] for w in report["warnings"]}


def test_nothing_is_said_of_a_good_session(tmp_path: Path, good: dict[str, float]) -> None:
    _, warnings = processed(write(tmp_path / "session", shot()))
    assert set(warnings) <= {"few-anchors"}
    assert max(good.values()) < GOOD_DEPTH


@pytest.fixture(scope="module")
def good(tmp_path_factory: pytest.TempPathFactory) -> dict[str, float]:
    """Depth error of the sessions without a fault, by scene."""
    found = {}
    for scene in ("tabletop", "blocks"):
        result, _ = processed(write(tmp_path_factory.mktemp("good") / "session", shot(scene)))
        found[scene] = depth_error(result, shot(scene))
    return found


@pytest.mark.parametrize("error_deg", [3.0, 6.0, 12.0])
def test_a_wrong_angle_is_corrected_and_reported(tmp_path: Path, good: dict[str, float], error_deg: float) -> None:
    result, warnings = processed(write(tmp_path / "session", shot(), angles(shot(), {"001": 15.0 + error_deg})))
    assert "capture 001" in warnings["angle-corrected"] and f"{15 + error_deg:.2f}°" in warnings["angle-corrected"]
    assert depth_error(result, shot()) < AS_GOOD * good["tabletop"]


def test_swapped_neighbours_are_named(tmp_path: Path, refusal) -> None:
    line = refusal(write(tmp_path / "session", shot(), angles(shot(), {"000": 15.0, "001": 0.0})))
    assert "capture 000" in line or "capture 001" in line


def test_swapped_ends_are_refused(tmp_path: Path, refusal) -> None:
    line = refusal(write(tmp_path / "session", shot(), angles(shot(), {"000": 30.0, "002": 0.0})))
    assert "angles" in line and "opposite sign" in line


def test_a_turntable_that_turns_the_other_way(tmp_path: Path, refusal) -> None:
    line = refusal(write(tmp_path / "session", shot(), angles(shot(), {"001": -15.0, "002": -30.0, PHOTO: -20.0})))
    assert "opposite sign" in line


def test_a_duplicate_capture_is_named(tmp_path: Path, refusal) -> None:
    line = refusal(write(tmp_path / "session", shot(), pixels={"002": shot().captures["001"].pixels}))
    assert "001" in line and "002" in line and "same view" in line


@pytest.mark.parametrize("factor", [1.15, 0.85])
def test_a_wrong_focal_length_is_corrected_and_reported(tmp_path: Path, factor: float) -> None:
    camera = shot().captures["001"].document.camera
    assert camera is not None and camera.fx is not None and camera.fy is not None
    wrong = camera.model_copy(update={"fx": factor * camera.fx, "fy": factor * camera.fy})
    result, warnings = processed(write(tmp_path / "session", shot(), documents(shot(), c001={"camera": wrong})))
    assert "capture 001" in warnings["focal-corrected"]
    assert depth_error(result, shot()) < FOCAL_CORRECTED


def test_a_defocused_capture_is_named(tmp_path: Path, good: dict[str, float]) -> None:
    soft = blur(shot().captures["001"].pixels, 1.5)
    result, warnings = processed(write(tmp_path / "session", shot(), pixels={"001": soft}))
    assert "capture 001" in warnings["out-of-focus"] and "again" in warnings["out-of-focus"]
    assert depth_error(result, shot()) < DEFOCUSED * good["tabletop"]


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(("scene", "plate_deg"), [("plaster", 20.0), ("tabletop", 120.0), ("tabletop", 200.0)])
def test_a_photo_that_the_sources_do_not_share(
    tmp_path: Path, refusal, scene: str, plate_deg: float, known: bool
) -> None:
    """Of another scene, or from outside of all views; with its plate angle recorded, or without."""
    photo = photo_of(scene, plate_deg)
    session = with_photo(shot(), photo)
    said = documents(session) if known else documents(session, c003={"turntable_deg": None})
    line = refusal(write(tmp_path / "session", session, said))
    assert f"photo {PHOTO}" in line and "between the sources" in line


def test_a_photo_from_the_side_that_finds_matches(tmp_path: Path, refusal) -> None:
    """Enough false matches for a pose: only the patches tell."""
    session = with_photo(shot("blocks"), photo_of("blocks", 90.0))
    line = refusal(write(tmp_path / "session", session, documents(session, c003={"turntable_deg": None})))
    assert f"photo {PHOTO}" in line and "between the sources" in line


def test_a_wall_that_does_not_turn_is_reported(tmp_path: Path, good: dict[str, float]) -> None:
    session = shot("blocks")
    result, warnings = processed(write(tmp_path / "session", session, pixels=still_wall("blocks")))
    assert "stand still" in warnings["still-background"] and "captures 00" in warnings["still-background"]
    assert depth_error(result, session) < BEFORE_WALL * good["blocks"]
