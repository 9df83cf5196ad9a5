"""The other commands, each through the command line on something small."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image


@pytest.fixture
def result(lfrig, session: Path) -> Path:
    assert lfrig("process", session).code == 0
    return session / "results" / "002-fast"


def test_version(lfrig) -> None:
    assert lfrig("--version").out.startswith("lfrig ")


def test_depth(lfrig, session: Path, tmp_path: Path) -> None:
    source, out = session / "captures" / "000", tmp_path / "depth"
    outcome = lfrig("depth", source, "--out", out, "--json")
    assert outcome.code == 0, outcome.err
    assert outcome.json["light_field"] == "000"
    names = {path.name for path in out.iterdir()}
    assert names >= {"disparity.pfm", "confidence.npy", "inverse_depth.npy", "disparity.png", "depth.json"}
    assert "report.html" in names
    assert np.load(out / "confidence.npy").shape == (64, 96)
    with Image.open(out / "disparity.png") as picture:
        assert picture.size == (96, 64)
    assert json.loads((out / "depth.json").read_text(encoding="utf-8"))["rows"] == 7
    assert lfrig("depth", source, "--out", out).code == 3
    assert lfrig("depth", source, "--out", out, "--overwrite", "--disparity-range", "-2:2").code == 0


def test_depth_agrees_with_the_recorded_geometry(lfrig, session: Path, tmp_path: Path) -> None:
    """The depths found lie where the rig can see at all."""
    assert lfrig("depth", session / "captures" / "000", "--out", tmp_path / "d").code == 0
    confident = np.load(tmp_path / "d" / "confidence.npy") > 0.8
    depth_m = 1 / np.load(tmp_path / "d" / "inverse_depth.npy")[confident]
    assert confident.mean() > 0.3
    assert np.mean((depth_m > 0.25) & (depth_m < 0.9)) > 0.95


def test_ingest_and_process(lfrig, session: Path, tmp_path: Path) -> None:
    made = tmp_path / "made"
    sources = [session / "captures" / name for name in ("000", "001", "002")]
    outcome = lfrig("ingest", made, *sources, "--json")
    assert outcome.code == 0, outcome.err
    assert [item["kind"] for item in outcome.json["captures"]] == ["light_field", "light_field", "photo"]
    again = lfrig("ingest", made, sources[0])
    assert again.code == 0
    assert "[duplicate-capture]" in again.err
    assert lfrig("process", made).code == 0
    assert (made / "results" / "002-fast" / "report.html").is_file()


def test_ingest_of_nothing_readable_leaves_no_session(lfrig, tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("hello", encoding="utf-8")
    outcome = lfrig("ingest", tmp_path / "made", tmp_path / "notes.txt")
    assert outcome.code == 3
    assert "notes.txt" in outcome.error_line
    assert not (tmp_path / "made").exists()


def test_info(lfrig, session: Path, result: Path) -> None:
    for path in (session, result, session / "captures" / "000", session / "captures" / "002" / "photo.png",
                 result / "disparity.pfm", session / "session.json"):  # fmt: skip
        outcome = lfrig("info", path)
        assert outcome.code == 0, outcome.err
        assert str(path) in outcome.out
        assert lfrig("info", path, "--json").json["path"] == str(path)
    assert lfrig("info", session / "nowhere").code == 3


def test_compare_a_result_with_itself_and_with_another(lfrig, session: Path, result: Path, tmp_path: Path) -> None:
    same = lfrig("compare", result, result, "--json").json
    assert same["views_identical"] is True
    assert same["disparity"]["max"] == 0
    other = tmp_path / "other"
    assert lfrig("process", session, "--sources", "000", "--out", other, "--target-focus-m", "0.5").code == 0
    found = lfrig("compare", result, other, "--json").json
    assert found["views_identical"] is False
    assert found["disparity"]["max"] > 0
    assert "optics" in found["note"]
    rows = {row["name"]: row for row in found["parameters"]}
    assert rows["focus [m]"]["second"] == 0.5
    assert rows["sources"] == {"name": "sources", "first": "000, 001", "second": "000"}
    assert "focus [m]" in lfrig("compare", result, other).out
    assert lfrig("compare", result, session).code == 3


def test_comparison_in_a_common_unit(lfrig, session: Path, result: Path, tmp_path: Path) -> None:
    """Twice the baseline doubles every disparity and changes no depth: in common units nothing differs."""
    report = json.loads((result / "report.json").read_text(encoding="utf-8"))["target"]
    other = tmp_path / "twice"
    twice = [
        "--target-baseline-m",
        repr(2 * report["baseline_m"]),
        "--target-focus-m",
        repr(report["focus_distance_m"]),
    ]
    assert lfrig("process", session, "--out", other, *twice).code == 0
    found = lfrig("compare", result, other, "--json").json
    assert found["disparity"]["median"] < 0.02


def test_export(lfrig, session: Path, result: Path, tmp_path: Path) -> None:
    assert lfrig("export", result, "--format", "hci", "--out", tmp_path / "hci").code == 0
    assert len(list((tmp_path / "hci").glob("input_Cam*.png"))) == 49
    outcome = lfrig("export", result, "--format", "gif", "--json")
    assert outcome.code == 0
    assert Path(outcome.json["path"]).stat().st_size > 1000
    assert lfrig("export", result, "--format", "hci", "--out", tmp_path / "hci").code == 3
    assert lfrig("export", session, "--format", "npy", "--out", tmp_path / "npy").code == 2
    assert lfrig("export", session, "--format", "npy", "--out", tmp_path / "npy", "--capture", "001").code == 0
    assert lfrig("export", result, "--format", "npy", "--capture", "001").code == 2


def test_doctor(lfrig) -> None:
    outcome = lfrig("doctor", "--json")
    assert outcome.code == 0
    assert outcome.json["ok"] is True
    states = {finding["name"]: finding for finding in outcome.json["findings"]}
    assert states["opencv"]["state"] == "ok"
    assert all(finding["remedy"] for finding in states.values() if finding["state"] != "ok")
    assert "native core" in lfrig("doctor").out


def test_doctor_says_when_the_native_core_is_off(lfrig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LFRIG_NATIVE", "0")
    outcome = lfrig("doctor", "--json")
    assert outcome.code == 0
    states = {finding["name"]: finding["state"] for finding in outcome.json["findings"]}
    assert states["native core"] == "missing"


def test_doctor_fails_when_a_library_is_broken(lfrig, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pycolmap", None)
    outcome = lfrig("doctor")
    assert outcome.code == 1
    assert "pycolmap" in outcome.err
