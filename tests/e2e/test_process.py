"""From a session written by hand to a result, through the command line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

ARRAYS = ("disparity.pfm", "disparity_sigma.npy", "confidence.npy", "inverse_depth.npy")


def exact_files(result: Path) -> dict[str, bytes]:
    """The files of a result that must be the same in every run."""
    views = {path.name: path.read_bytes() for path in (result / "views").iterdir()}
    return views | {name: (result / name).read_bytes() for name in ARRAYS}


def same_pixels(first: Path, second: Path) -> bool:
    with Image.open(first) as a, Image.open(second) as b:
        return np.array_equal(np.asarray(a), np.asarray(b))


def report_of(result: Path) -> dict:
    return json.loads((result / "report.json").read_text(encoding="utf-8"))


def test_a_session_written_by_hand(lfrig, session: Path) -> None:
    outcome = lfrig("process", session)
    result = session / "results" / "002-fast"
    assert outcome.code == 0, outcome.err
    assert outcome.out.strip() == str(result / "report.html")
    names = {path.name for path in result.iterdir()}
    assert names == {*ARRAYS, "views", "report.json", "report.html"}
    assert len(list((result / "views").glob("??_??.png"))) == 49
    assert same_pixels(result / "views" / "03_03.png", session / "captures" / "002" / "photo.png")
    report = report_of(result)
    assert report["schema"] == "lfrig.result/1"
    assert report["session"] == "session"
    assert [source["id"] for source in report["sources"]] == ["000", "001"]
    assert report["poses"] == "given"
    stages = [stage["name"] for stage in report["stages"]]
    assert stages == ["evidence", "poses", "scale-fit", "fusion", "surface", "refine", "synthesis"]
    assert all(f"[{warning['code']}]" in outcome.err for warning in report["warnings"])


def test_the_json_of_a_result(lfrig, session: Path) -> None:
    outcome = lfrig("process", session, "--json")
    assert outcome.code == 0
    [made] = outcome.json["results"]
    assert made["path"] == str(session / "results" / "002-fast")
    assert made["report"] == report_of(Path(made["path"]))


def test_an_existing_result_stays(lfrig, session: Path, content) -> None:
    assert lfrig("process", session).code == 0
    before = content(session)
    outcome = lfrig("process", session)
    assert outcome.code == 3
    assert "--overwrite" in outcome.error_line
    assert content(session) == before


def test_another_run_takes_the_evidence_that_is_there(lfrig, session: Path) -> None:
    def unchanged(*arguments: str) -> tuple[float, float]:
        outcome = lfrig("process", session, "--json", *arguments)
        assert outcome.code == 0, outcome.err
        evidence = outcome.json["results"][0]["report"]["stages"][0]
        [counts] = [skip for skip in evidence["skips"] if skip["name"] == "unchanged"]
        return counts["done"], counts["skipped"]

    assert unchanged() == (2, 0)
    first = exact_files(session / "results" / "002-fast")
    assert unchanged("--overwrite") == (0, 2)
    assert exact_files(session / "results" / "002-fast") == first
    shutil.rmtree(session / "cache")
    assert unchanged("--overwrite") == (2, 0)


def test_the_preview_preset(lfrig, session: Path) -> None:
    outcome = lfrig("process", session, "--preset", "preview")
    assert outcome.code == 0, outcome.err
    result = session / "results" / "002-preview"
    assert report_of(result)["options"]["resolution"] == 0.5
    assert same_pixels(result / "views" / "03_03.png", session / "captures" / "002" / "photo.png")


def test_overwrite_replaces_the_whole_result(lfrig, session: Path) -> None:
    assert lfrig("process", session).code == 0
    result = session / "results" / "002-fast"
    first = exact_files(result)
    (result / "left-over.txt").write_text("old", encoding="utf-8")
    assert lfrig("process", session, "--overwrite").code == 0
    assert not (result / "left-over.txt").exists()
    assert exact_files(result) == first
    assert [path.name for path in (session / "results").iterdir()] == ["002-fast"]


def test_a_failed_overwrite_keeps_the_old_result(lfrig, session: Path, content) -> None:
    assert lfrig("process", session).code == 0
    (session / "captures" / "000" / "views" / "00_00.png").write_bytes(b"broken meanwhile")
    before = content(session)
    assert lfrig("process", session, "--overwrite").code == 3
    assert content(session) == before


def test_threads_change_no_byte(lfrig, session: Path, tmp_path: Path) -> None:
    for count in ("1", "2"):
        assert lfrig("process", session, "--threads", count, "--out", tmp_path / count).code == 0
    assert exact_files(tmp_path / "1") == exact_files(tmp_path / "2")


def test_truth_changes_no_byte(lfrig, session: Path, tmp_path: Path) -> None:
    truth = session.with_name("session.truth")
    truth.mkdir()
    (truth / "truth.json").write_text("what is here does not matter", encoding="utf-8")
    assert lfrig("process", session, "--out", tmp_path / "with").code == 0
    shutil.rmtree(truth)
    assert lfrig("process", session, "--out", tmp_path / "without").code == 0
    assert exact_files(tmp_path / "with") == exact_files(tmp_path / "without")


def test_one_source_works_with_a_warning(lfrig, session: Path) -> None:
    outcome = lfrig("process", session, "--sources", "001")
    assert outcome.code == 0, outcome.err
    assert "[one-source]" in outcome.err
    report = report_of(session / "results" / "002-fast")
    assert [source["id"] for source in report["sources"]] == ["001"]
    assert "one-source" in [warning["code"] for warning in report["warnings"]]


def test_a_light_field_as_target(lfrig, session: Path) -> None:
    outcome = lfrig("process", session, "--target", "000")
    assert outcome.code == 0, outcome.err
    report = report_of(session / "results" / "000-fast")
    captured = json.loads((session / "captures" / "000" / "capture.json").read_text(encoding="utf-8"))
    assert [source["id"] for source in report["sources"]] == ["001"]
    assert report["target"]["baseline_m"] == captured["optics"]["baseline_m"]
    assert report["target"]["focus_distance_m"] == captured["optics"]["focus_distance_m"]
    views = session / "captures" / "000" / "views", session / "results" / "000-fast" / "views"
    assert same_pixels(views[0] / "03_03.png", views[1] / "03_03.png")


def test_the_request(lfrig, session: Path, tmp_path: Path) -> None:
    outcome = lfrig(
        "process", session, "--target-baseline-m", "0.0005", "--target-focus-m", "0.46", "--out-views", "5x3",
        "--bit-depth", "16", "--out", tmp_path / "made",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    target = report_of(tmp_path / "made")["target"]
    assert (target["baseline_m"], target["focus_distance_m"]) == (0.0005, 0.46)
    assert (target["rows"], target["cols"]) == (5, 3)
    assert len(list((tmp_path / "made" / "views").iterdir())) == 15
    assert not (session / "results").exists()


def test_several_sessions(lfrig, session: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    shutil.copytree(session, other)
    outcome = lfrig("process", session, other, "--json")
    assert outcome.code == 0, outcome.err
    assert [made["report"]["session"] for made in outcome.json["results"]] == ["session", "other"]
    # Each report tells its own warnings, also the second one.
    first, second = (made["report"]["warnings"] for made in outcome.json["results"])
    assert first == second


def test_several_sessions_are_checked_before_any_work(lfrig, session: Path, tmp_path: Path) -> None:
    assert lfrig("process", session, tmp_path / "missing").code == 3
    assert not (session / "results").exists()


def test_quiet_prints_nothing(lfrig, session: Path) -> None:
    outcome = lfrig("--quiet", "process", session, "--sources", "000")
    assert (outcome.code, outcome.out, outcome.err) == (0, "", "")


def test_the_log_file(lfrig, session: Path, tmp_path: Path) -> None:
    log = tmp_path / "run.log"
    assert lfrig("process", session, "--log-file", log).code == 0
    text = log.read_text(encoding="utf-8")
    assert "START" in text
    assert "synthesis" in text
    (session / "captures" / "000" / "capture.json").write_text("{", encoding="utf-8")
    assert lfrig("process", session, "--overwrite", f"--log-file={log}").code == 3
    assert "Traceback" in log.read_text(encoding="utf-8")


@pytest.fixture
def five_sources(session: Path, edit_json: Callable[..., None]) -> Path:
    """Sources at −15, 15, −90, 40 and 350 (= −10) degrees; the photo at 0. Pixels do not matter here."""
    names = ["000", "001", "010", "011", "012", "002"]
    for name, angle in (("010", -90.0), ("011", 40.0), ("012", 350.0)):
        shutil.copytree(session / "captures" / "000", session / "captures" / name)
        edit_json(session / "captures" / name / "capture.json", turntable_deg=angle)
    edit_json(session / "session.json", captures=names)
    return session


def test_of_many_sources_the_nearest_four_serve(five_sources: Path) -> None:
    from lfrig.rig.process import select
    from lfrig.rig.session.store import SessionStore

    captures = SessionStore.open(five_sources).captures()
    chosen = select(captures, None, None, path=five_sources)
    assert chosen.target == "002"
    assert chosen.sources == ("000", "001", "011", "012")
    assert select(captures, None, ["010"], path=five_sources).sources == ("010",)
    assert select(captures, "010", None, path=five_sources).sources == ("000", "001", "011", "012")
