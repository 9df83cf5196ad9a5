"""Bad input: one line that names the file and a remedy, the right exit code, and nothing changed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

BAD_INPUT, GEOMETRY = 3, 4
Refused = Callable[..., str]


@pytest.fixture
def refused(lfrig, content) -> Refused:
    """Process a session, see it refused with the given exit code, and everything as it was; returns the line."""

    def check(session: Path, code: int, *arguments: str) -> str:
        before = content(session.parent)
        outcome = lfrig("process", session, *arguments)
        assert outcome.code == code, outcome.err
        assert outcome.out == ""
        assert content(session.parent) == before
        assert [path.name for path in session.iterdir() if path.name.startswith((".", "results"))] == []
        return outcome.error_line

    return check


def view(session: Path, capture: str = "000", name: str = "03_03.png") -> Path:
    return session / "captures" / capture / "views" / name


def document(session: Path, capture: str) -> Path:
    return session / "captures" / capture / "capture.json"


def every_view(session: Path, capture: str) -> list[Path]:
    return sorted((session / "captures" / capture / "views").iterdir())


def test_missing_view(session: Path, refused: Refused) -> None:
    view(session).unlink()
    assert "03_03.png" in refused(session, BAD_INPUT)


def test_views_of_mixed_sizes(session: Path, refused: Refused) -> None:
    Image.new("RGB", (80, 64)).save(view(session))
    assert "03_03.png" in refused(session, BAD_INPUT)


@pytest.mark.parametrize("data", [b"", b"not a picture at all", b"\x89PNG\r\n\x1a\n" + bytes(40)])
def test_not_an_image(session: Path, refused: Refused, data: bytes) -> None:
    view(session).write_bytes(data)
    assert "03_03.png" in refused(session, BAD_INPUT)


def test_a_photo_that_is_no_image(session: Path, refused: Refused) -> None:
    (session / "captures" / "002" / "photo.png").write_bytes(b"no")
    assert "photo.png" in refused(session, BAD_INPUT)


def test_a_photo_that_is_not_there(session: Path, refused: Refused) -> None:
    (session / "captures" / "002" / "photo.png").unlink()
    assert "photo.png" in refused(session, BAD_INPUT)


def test_a_photo_that_looks_elsewhere(session: Path, refused: Refused) -> None:
    path = document(session, "002")
    body = json.loads(path.read_text(encoding="utf-8"))
    flip = np.diag([-1.0, 1.0, -1.0])  # half a turn about the camera's own vertical axis
    body["pose"]["R"] = (flip @ body["pose"]["R"]).tolist()
    body["pose"]["t"] = (flip @ body["pose"]["t"]).tolist()
    path.write_text(json.dumps(body), encoding="utf-8")
    assert "target photo's view" in refused(session, GEOMETRY)


def test_a_photo_of_something_else(session: Path, refused: Refused, edit_json) -> None:
    noise = np.random.default_rng(0).integers(0, 256, (16, 24, 3), np.uint8)
    path = session / "captures" / "002" / "photo.png"
    with Image.open(path) as photo:
        size = photo.size
    Image.fromarray(noise).resize(size).save(path)
    edit_json(document(session, "002"), pose=None, turntable_deg=None)
    edit_json(session / "session.json", rig=None)
    assert "002" in refused(session, GEOMETRY)


def test_no_source(session: Path, refused: Refused, edit_json) -> None:
    edit_json(session / "session.json", captures=["002"])
    line = refused(session, BAD_INPUT)
    assert "no light field" in line
    assert "ingest" in line


def test_two_identical_poses(session: Path, refused: Refused, edit_json) -> None:
    pose = json.loads(document(session, "000").read_text(encoding="utf-8"))["pose"]
    edit_json(document(session, "001"), pose=pose)
    assert "000" in refused(session, GEOMETRY)


def test_constant_views(session: Path, refused: Refused) -> None:
    for path in every_view(session, "000"):
        Image.new("RGB", (96, 64), (90, 90, 90)).save(path)
    assert "000" in refused(session, BAD_INPUT)


@pytest.fixture
def smooth(session: Path) -> Path:
    """Sources with ramps of grey: not constant, and without a feature to triangulate."""
    ramp = np.linspace(20, 220, 96, dtype=np.float32)[None, :, None] + np.zeros((64, 96, 3), np.float32)
    for name in ("000", "001"):
        for path in every_view(session, name):
            Image.fromarray(ramp.astype(np.uint8)).save(path)
    return session


def test_fewer_than_eight_anchors(smooth: Path, refused: Refused, edit_json) -> None:
    for name in ("000", "001"):
        edit_json(document(smooth, name), optics=None)
    assert "anchors" in refused(smooth, GEOMETRY)


def test_recorded_optics_replace_the_anchors(smooth: Path, lfrig) -> None:
    outcome = lfrig("process", smooth)
    assert outcome.code == 0
    assert "[scale-from-optics]" in outcome.err


@pytest.mark.parametrize("value", ["NaN", "Infinity"])
def test_a_pose_that_is_not_finite(session: Path, refused: Refused, value: str) -> None:
    path = document(session, "001")
    body = json.loads(path.read_text(encoding="utf-8"))
    body["pose"]["t"][0] = float(value)
    path.write_text(json.dumps(body), encoding="utf-8")
    line = refused(session, BAD_INPUT)
    assert "001" in line
    assert "pose.t" in line


def test_a_pose_that_is_no_rotation(session: Path, refused: Refused, edit_json) -> None:
    edit_json(document(session, "001"), pose={"R": [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "t": [0, 0, 0]})
    assert "pose" in refused(session, BAD_INPUT)


def test_poses_given_but_not_there(session: Path, refused: Refused, edit_json) -> None:
    edit_json(document(session, "001"), pose=None)
    assert "001" in refused(session, BAD_INPUT, "--poses", "given")


@pytest.mark.parametrize("schema", ["lfrig.capture/2", "lfrig.capture/99.1"])
def test_a_newer_schema(session: Path, refused: Refused, edit_json, schema: str) -> None:
    edit_json(document(session, "001"), schema=schema)
    line = refused(session, BAD_INPUT)
    assert "schema" in line
    assert "update lfrig" in line


@pytest.mark.parametrize("schema", ["lfrig.session/1", "something/1", "lfrig.capture", "", None])
def test_an_unknown_schema(session: Path, refused: Refused, edit_json, schema: str | None) -> None:
    edit_json(document(session, "001"), schema=schema)
    assert "schema" in refused(session, BAD_INPUT)


@pytest.mark.parametrize("text", ["", "{", "[]", '{"schema": "lfrig.capture/1", "kind": "hologram"}'])
def test_a_broken_document(session: Path, refused: Refused, text: str) -> None:
    document(session, "001").write_text(text, encoding="utf-8")
    assert str(document(session, "001")) in refused(session, BAD_INPUT)


def test_a_capture_that_is_not_there(session: Path, refused: Refused, edit_json) -> None:
    edit_json(session / "session.json", captures=["000", "001", "002", "003"])
    assert "003" in refused(session, BAD_INPUT)


def test_a_folder_that_is_no_session(tmp_path: Path, lfrig) -> None:
    outcome = lfrig("process", tmp_path)
    assert outcome.code == BAD_INPUT
    assert "not a session" in outcome.error_line


def test_a_raw_capture_without_its_file(session: Path, refused: Refused, edit_json) -> None:
    edit_json(document(session, "001"), views=None, raw={"path": "capture.lfr"})
    assert "capture.lfr: cannot be read" in refused(session, BAD_INPUT)


def test_a_raw_capture_that_is_no_raw_file(session: Path, refused: Refused, edit_json) -> None:
    edit_json(document(session, "001"), views=None, raw={"path": "capture.lfr"})
    (session / "captures" / "001" / "capture.lfr").write_bytes(b"\xff\xd8\xff" + bytes(99))
    assert "capture.lfr: is a JPEG picture" in refused(session, BAD_INPUT)


def test_the_error_as_json(session: Path, lfrig) -> None:
    view(session).unlink()
    outcome = lfrig("--json", "process", session)
    assert outcome.code == BAD_INPUT
    assert outcome.err == ""
    assert set(outcome.json) == {"error"}
    assert set(outcome.json["error"]) == {"code", "message", "remedy"}
    assert outcome.json["error"]["code"] == "missing-views"
    assert "03_03.png" in outcome.json["error"]["message"]
