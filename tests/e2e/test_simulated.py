"""The simulated rig through the command line: capture, process, score, evaluate, demo."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

CAPTURE = ("--rig", "sim", "--size", "tiny", "--scene", "figurines", "--angles", "0:15:15")


@pytest.fixture(scope="module")
def shot_once(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from lfrig.rig.cli import main

    session = tmp_path_factory.mktemp("simulated") / "session"
    assert main(["--quiet", "capture", str(session), *CAPTURE]) == 0
    return session


@pytest.fixture
def simulated(shot_once: Path, tmp_path: Path) -> Path:
    """Two light fields 15° apart, a photo between them, and the truth beside."""
    session = tmp_path / "session"
    shutil.copytree(shot_once, session)
    shutil.copytree(shot_once.with_name("session.truth"), tmp_path / "session.truth")
    return session


def true_optics(session: Path) -> dict[str, float]:
    """Of the light field that the truth holds views of."""
    path = session.with_name("session.truth") / "truth.json"
    return json.loads(path.read_text(encoding="utf-8"))["captures"]["002"]["optics"]


@pytest.fixture
def posed(simulated: Path) -> Path:
    """The same, from a rig that knows its poses exactly."""
    truth = json.loads((simulated.with_name("session.truth") / "truth.json").read_text(encoding="utf-8"))
    for name, known in truth["captures"].items():
        path = simulated / "captures" / name / "capture.json"
        body = json.loads(path.read_text(encoding="utf-8"))
        path.write_text(json.dumps(body | {"pose": known["pose"], "camera": known["camera"]}), encoding="utf-8")
    return simulated


def exact_files(result: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(result)): path.read_bytes()
        for path in sorted(result.rglob("*"))
        if path.suffix in {".pfm", ".npy", ".png"}
    }


def test_capture_is_the_same_every_time(lfrig, shot_once: Path, tmp_path: Path, content) -> None:
    again = tmp_path / "session"
    outcome = lfrig("capture", again, *CAPTURE, "--json")
    assert outcome.code == 0, outcome.err
    assert outcome.json["captures"] == ["000", "001", "002"]
    first, second = content(shot_once / "captures"), content(again / "captures")
    assert {n: b for n, b in first.items() if n.endswith(".png")} == {
        n: b for n, b in second.items() if n.endswith(".png")
    }


def test_process_and_score(lfrig, simulated: Path) -> None:
    optics = true_optics(simulated)
    request = [f"--target-baseline-m={optics['baseline_m']}", f"--target-focus-m={optics['focus_distance_m']}"]
    assert lfrig("process", simulated, *request).code == 0
    result = simulated / "results" / "002-fast"
    outcome = lfrig("score", result, "--json")
    assert outcome.code == 0, outcome.err
    score = outcome.json["score"]
    assert score == json.loads((result / "score.json").read_text(encoding="utf-8"))
    assert set(score["oracles"]) == {"z_buffer", "fixed_point"}
    assert score["disparity"]["all"]["rmse_over_range"] < 0.5
    shown = lfrig("score", result, "--truth", simulated.with_name("session.truth"))
    assert shown.code == 0
    assert "z-buffer" in shown.out


def test_results_do_not_know_the_truth(lfrig, simulated: Path) -> None:
    assert lfrig("process", simulated).code == 0
    with_truth = exact_files(simulated / "results" / "002-fast")
    shutil.rmtree(simulated.with_name("session.truth"))
    assert lfrig("process", simulated, "--overwrite").code == 0
    assert exact_files(simulated / "results" / "002-fast") == with_truth
    outcome = lfrig("score", simulated / "results" / "002-fast")
    assert outcome.code == 3
    assert "--truth" in outcome.error_line
    assert not (simulated / "results" / "002-fast" / "score.json").exists()


def test_evaluate(lfrig, posed: Path) -> None:
    outcome = lfrig("evaluate", posed, "--json")
    assert outcome.code == 0, outcome.err
    [evaluation] = outcome.json["evaluations"]
    assert [row["target"] for row in evaluation["rows"]] == ["000", "001", "mean"]
    assert evaluation["rows"][0]["sources"] == ["001"]
    assert evaluation["rows"][0]["reference"] == "truth"
    again = lfrig("evaluate", posed)
    assert again.code == 3
    assert "--overwrite" in again.error_line


def test_evaluate_needs_two_light_fields(lfrig, session: Path, edit_json) -> None:
    edit_json(session / "session.json", captures=["000", "002"])
    assert lfrig("evaluate", session).code == 3


def test_another_scene_is_not_mixed_in(lfrig, simulated: Path, content) -> None:
    before = content(simulated.parent)
    outcome = lfrig("capture", simulated, *CAPTURE, "--seed", "5")
    assert outcome.code == 3
    outcome.error_line  # noqa: B018 - asserts that it is one line
    assert content(simulated.parent) == before


@pytest.mark.parametrize("arguments, code", [
    (("--scene", "atlantis"), 3), (("--size", "huge"), 2), (("--angles", "0:90:45"), 2),
    (("--plan", "nowhere.toml"), 3), (("--plan", "plan.toml", "--angles", "0:15:15"), 2),
])  # fmt: skip
def test_captures_that_make_no_sense(lfrig, tmp_path: Path, arguments: tuple[str, ...], code: int) -> None:
    outcome = lfrig("capture", tmp_path / "session", "--rig", "sim", "--size", "tiny", *arguments)
    assert outcome.code == code, outcome.err
    assert outcome.error_line
    assert list(tmp_path.iterdir()) == []


def test_a_plan_from_a_file(lfrig, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text('angles_deg = "10:10:5"\n', encoding="utf-8")
    outcome = lfrig("capture", tmp_path / "session", "--rig", "sim", "--size", "tiny", "--plan", plan, "--json")
    assert outcome.code == 0, outcome.err
    assert outcome.json["captures"] == ["000"]


def test_demo(lfrig, tmp_path: Path) -> None:
    out = tmp_path / "demo"
    outcome = lfrig("demo", "--size", "tiny", "--out", out, "--json")
    assert outcome.code == 0, outcome.err
    result = Path(outcome.json["result"])
    assert {"report.html", "score.json", "report.json", "views"} <= {path.name for path in result.iterdir()}
    assert set(outcome.json["cpu_s"]) == {"capture", "process", "score"}
    assert outcome.json["score"]["oracles"]["z_buffer"]["psnr"] > 25
    assert {path.name for path in out.iterdir()} == {"session", "session.truth"}
    again = lfrig("demo", "--size", "tiny", "--out", out)
    assert again.code == 3
    assert "--overwrite" in again.error_line
    assert lfrig("demo", "--size", "enormous").code == 2
