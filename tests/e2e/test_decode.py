"""Raw light fields through the command line: shot, decoded, looked at."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def raw_session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from lfrig.rig.sim_capture import capture_simulated

    path = tmp_path_factory.mktemp("raw") / "session"
    capture_simulated(path, scene="plaster", size=(48, 32), angles_deg=(0.0,), target_deg=None, record="raw")
    return path


def test_decode_makes_a_capture_that_other_commands_read(lfrig, raw_session: Path, tmp_path: Path) -> None:
    raw = raw_session / "captures" / "000" / "capture.lfr"
    [tar] = (raw_session / "calibration").iterdir()
    outcome = lfrig("decode", raw, "--calibration", tar, "--out", tmp_path / "views", "--json")
    assert outcome.code == 0, outcome
    document = outcome.json
    assert document["views"] == {"rows": 7, "cols": 7, "height": 32, "width": 48, "centre": [3, 3]}
    assert document["white_image"]["rule"] == "exact"
    assert document["lattice"]["residual_rms_px"] < 0.3
    assert lfrig("ingest", tmp_path / "s", tmp_path / "views").code == 0
    again = lfrig("decode", raw, "--calibration", tar, "--out", tmp_path / "views")
    assert again.code == 3 and "--overwrite" in again.error_line
    assert lfrig("decode", raw, "--calibration", tar, "--out", tmp_path / "views", "--overwrite").code == 0


def test_decode_says_what_it_found(lfrig, raw_session: Path, tmp_path: Path) -> None:
    [tar] = (raw_session / "calibration").iterdir()
    outcome = lfrig("decode", raw_session / "captures/000/capture.lfr", "--calibration", tar, "--out", tmp_path / "v")
    assert outcome.code == 0 and outcome.err == ""
    assert "7×7 views of 48×32 px" in outcome.out and "white image: exact" in outcome.out


def test_decode_finds_the_calibration_of_a_session_s_capture(lfrig, raw_session: Path, tmp_path: Path) -> None:
    raw = raw_session / "captures" / "000" / "capture.lfr"
    outcome = lfrig("decode", raw, "--out", tmp_path / "views", "--json")
    assert outcome.code == 0 and outcome.err == ""
    assert outcome.json["white_image"]["rule"] == "exact"
    before = raw.read_bytes()
    for command in ("decode", "depth"):
        again = lfrig(command, raw, "--out", raw, "--overwrite")
        assert again.code == 3
        assert again.error_line
    assert raw.read_bytes() == before


def test_depth_of_a_raw_capture(lfrig, raw_session: Path, tmp_path: Path) -> None:
    outcome = lfrig("depth", raw_session / "captures" / "000", "--out", tmp_path / "depth")
    assert outcome.code == 0 and outcome.err == ""
    assert (tmp_path / "depth" / "disparity.pfm").is_file()


def test_more_views_than_the_lenses_have(lfrig, raw_session: Path, tmp_path: Path) -> None:
    [tar] = (raw_session / "calibration").iterdir()
    raw = raw_session / "captures" / "000" / "capture.lfr"
    outcome = lfrig("decode", raw, "--calibration", tar, "--out", tmp_path / "v", "--views", "15")
    assert outcome.code == 2 and "choose 7 views" in outcome.error_line
    assert not (tmp_path / "v").exists()


@pytest.mark.parametrize("content", [b"", b"no container", b"\xff\xd8\xff\xe0 a photo"])
def test_what_is_no_raw_file(lfrig, tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "shot.lfr"
    path.write_bytes(content)
    outcome = lfrig("decode", path, "--out", tmp_path / "v")
    assert outcome.code == 3 and "shot.lfr" in outcome.error_line
    assert not (tmp_path / "v").exists()
