"""Info: what each thing is called, what is said of it, and what is said to be missing."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.contracts.bench import BenchDocument, Check
from lfrig.contracts.capture import CameraSpec, CaptureDocument, OpticsSpec, PoseSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.result import ReportDocument, SourceReport, StageReport, TargetReport, WarningReport
from lfrig.contracts.score import DisparityScore, LightFieldScore, ScoreDocument
from lfrig.contracts.session import RigSpec
from lfrig.contracts.truth import TruthCapture, TruthDocument
from lfrig.processing.export.pfm import write_pfm
from lfrig.rig.info import describe, text_lines
from lfrig.rig.session.images import write_png
from lfrig.rig.session.store import SessionStore
from tests.rig.session_files import IDENTITY, H, W, known_document, view, views, write_view_folder

REPORT = ReportDocument(
    preset="fast",
    version="0.1.0",
    target=TargetReport(id="003", baseline_m=0.001, focus_distance_m=0.5, fx=700, width=4, height=3, rows=3, cols=3),
    sources=[SourceReport(id="000", a=1.4, c=2.0, residual=0.01, inliers=0.9, anchors=321)],
    stages=[
        StageReport(name="dpv", wall_s=1, cpu_s=1.5, peak_rss_mb=10),
        StageReport(name="fuse", wall_s=1, cpu_s=0.5, peak_rss_mb=10),
    ],
    warnings=[WarningReport(code="one-source", message="only one source")],
)
SCORE = ScoreDocument(
    bf_px_m=0.7,
    focus_distance_m=0.46,
    disparity={
        "all": DisparityScore(
            pixels=9, mse=0.002, rmse=0.045, ppe_005=91.0, ppe_010=95.0, badpix_007=7.0, badpix_003=20.0,
            badpix_001=60.0, q25=0.004, rmse_over_range=0.03,
        )
    },
    views=LightFieldScore(
        psnr=33.0, ssim=0.95, psnr_with_centre=33.2, ssim_with_centre=0.951, psnr_corners=31.0, ssim_corners=0.93,
        epi_mae=0.5,
    ),
)  # fmt: skip


def described(path: Path) -> dict[str, Any]:
    """The description, after checking what all have in common."""
    description = describe(path)
    assert json.loads(json.dumps(description, allow_nan=False)) == description
    assert {"path", "type", "summary", "unknown", "problems"} <= set(description)
    lines = text_lines(description)
    assert lines[0] == f"{path}: {description['summary']}"
    for words in (*description["unknown"], *description["problems"]):
        assert any(words in line for line in lines)
    return description


@pytest.fixture
def session(tmp_path: Path) -> Path:
    store = SessionStore.create(tmp_path / "s", RigSpec(turntable_sigma_deg=0.2))
    store.add_light_field(views(), known_document())
    store.add_photo_array(view(0, 0), CaptureDocument(kind="photo", image="p.png", turntable_deg=7.0))
    return tmp_path / "s"


def test_a_session(session: Path) -> None:
    found = described(session)
    assert found["type"] == "session"
    assert found["summary"] == "session, 1 light field, 1 photo"
    assert found["captures"][0] == {
        "id": "000", "kind": "light_field", "views": "3×3", "size": f"{W}×{H} px", "fx": 30.0, "turntable_deg": 15.0,
        "pose": "given",
    }  # fmt: skip
    assert found["captures"][1]["turntable_deg"] == 7.0
    assert found["rig"] == {"turntable_sigma_deg": 0.2}
    assert "rig.turntable_sigma_deg" not in found["unknown"]
    assert "rig.cameras.target.camera_from_plate" in found["unknown"]
    assert (found["truth"], found["results"], found["problems"]) == (None, [], [])
    assert described(session / "session.json") | {"path": ""} == found | {"path": ""}


def test_what_is_beside_a_session(session: Path) -> None:
    (session.parent / "s.truth").mkdir()
    (session / "results" / "001-fast").mkdir(parents=True)
    REPORT.save(session / "results" / "001-fast" / "report.json")
    (session / "results" / ".half").mkdir()
    found = described(session)
    assert found["results"] == ["001-fast"]
    assert found["truth"] == str(session.parent / "s.truth")


def test_what_is_wrong_with_a_session(session: Path) -> None:
    (session / "captures" / "000" / "views" / "01_01.png").unlink()
    (session / "captures" / "001" / "capture.json").write_text("{")
    (session / "captures" / "002").mkdir()
    (session / "captures" / ".003.123-0.tmp").mkdir()
    problems = described(session)["problems"]
    assert len(problems) == 4
    assert "capture 000: 1 of 9 files are missing, the first is views/01_01.png" in problems
    assert any(problem.startswith("capture 001: ") and "not valid JSON" in problem for problem in problems)
    assert "captures/002 is not listed in session.json (ignored)" in problems
    assert any(".003.123-0.tmp" in problem and "can be deleted" in problem for problem in problems)


def test_a_capture(session: Path) -> None:
    for path in (session / "captures" / "000", session / "captures" / "000" / "capture.json"):
        found = described(path)
        assert found["type"] == "capture"
        assert found["summary"] == "light field of 3×3, at 16×12 px"
        assert (found["unknown"], found["problems"]) == ([], [])
        assert found["document"]["pose"]["t"] == [0, 0, 0.5]
    assert described(session / "captures" / "001")["unknown"] == ["camera.fx", "pose"]


def test_foreign_light_fields_and_pictures(tmp_path: Path) -> None:
    folder = write_view_folder(tmp_path / "sai", "{row}_{col}.png")
    found = described(folder)
    assert (found["type"], found["format"]) == ("light_field", "sai")
    assert {"camera.fx", "optics.baseline_m", "pose", "depth_range_m"} <= set(found["unknown"])
    found = described(folder / "0_0.png")
    assert (found["type"], found["format"], found["summary"]) == ("photo", "photo", f"photo at {W}×{H} px")
    assert "camera.fx" in found["unknown"]
    write_png(tmp_path / "x_eslf.png", np.zeros((28, 42, 3), np.uint8))
    found = described(tmp_path / "x_eslf.png")
    assert found["format"] == "eslf"
    assert "3..9" in found["notes"][0]


def test_sensor_values_alone_are_named_and_nothing_more(tmp_path: Path) -> None:
    (tmp_path / "a.raw").write_bytes(b"raw")
    found = described(tmp_path / "a.raw")
    assert found["type"] == "raw"
    assert "not in this version" in found["problems"][0]


def test_a_result(tmp_path: Path) -> None:
    REPORT.save(tmp_path / "r" / "report.json")
    found = described(tmp_path / "r")
    assert found["type"] == "result"
    assert found["summary"] == "result, preset fast, 3×3 views of 4×3 px from 1 source"
    assert found["cpu_s"] == 2.0
    assert found["sources"] == [{"id": "000", "anchors": 321, "inliers": 0.9}]
    assert found["warnings"] == ["only one source"]
    assert found["unknown"] == ["score"]
    assert len(found["problems"]) == 5 + 9
    for name in ("disparity.pfm", "disparity_sigma.npy", "confidence.npy", "inverse_depth.npy", "report.html"):
        assert f"{name} is missing" in found["problems"]
        (tmp_path / "r" / name).touch()
    SCORE.save(tmp_path / "r" / "score.json")
    found = described(tmp_path / "r")
    assert found["score"] == {
        "bf_px_m": 0.7, "mse_px2": 0.002, "ppe_005": 91.0, "ppe_010": 95.0, "psnr_db": 33.0, "ssim": 0.95,
    }  # fmt: skip
    assert found["unknown"] == []
    assert len(found["problems"]) == 9
    assert described(tmp_path / "r" / "report.json")["type"] == "report"
    assert described(tmp_path / "r" / "score.json")["mse_px2"] == 0.002


def test_a_benchmark(tmp_path: Path) -> None:
    checks = [Check.of("fast enough", 3.0, "<=", 2.0, "why"), Check.of("good", 1.0, ">=", 0.5, "why")]
    BenchDocument(name="pareto", rows=[{"x": 1}], checks=checks).save(tmp_path / "pareto.json")
    found = described(tmp_path / "pareto.json")
    assert found["summary"] == "benchmark 'pareto', 1 row, 2 checks"
    assert found["problems"] == ["check 'fast enough' failed: 3 <= 2 does not hold"]


def test_truth(tmp_path: Path) -> None:
    capture = TruthCapture(
        kind="photo", camera=CameraSpec(width=4, height=3), optics=OpticsSpec(), pose=PoseSpec(R=IDENTITY, t=(0, 0, 0)),
        turntable_deg=0.0,
    )  # fmt: skip
    TruthDocument(scene="shelf", seed=3, captures={"000": capture}).save(tmp_path / "s.truth" / "truth.json")
    for path in (tmp_path / "s.truth", tmp_path / "s.truth" / "truth.json"):
        found = described(path)
        assert found["summary"] == "truth of the simulated scene 'shelf', seed 3"
        assert found["captures"] == [{"id": "000", "kind": "photo"}]


def test_float_maps_and_arrays(tmp_path: Path) -> None:
    values = np.array([[1.5, np.nan, -2.0], [np.inf, 0.0, 3.0]], np.float32)
    write_pfm(tmp_path / "d.pfm", values)
    np.save(tmp_path / "d.npy", values)
    for name, kind in (("d.pfm", "pfm"), ("d.npy", "npy")):
        found = described(tmp_path / name)
        assert (found["type"], found["shape"], found["dtype"]) == (kind, [2, 3], "float32")
        assert (found["min"], found["max"], found["not_finite"]) == (-2.0, 3.0, 2)
    np.save(tmp_path / "empty.npy", np.zeros((0, 3)))
    assert described(tmp_path / "empty.npy")["min"] is None


def test_what_cannot_be_described(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.txt").write_text("text")
    (tmp_path / "bad.json").write_text("{")
    (tmp_path / "list.json").write_text("[1]")
    (tmp_path / "other.json").write_text('{"schema": "other/1"}')
    (tmp_path / "newer.json").write_text('{"schema": "lfrig.score/9"}')
    (tmp_path / "bad.pfm").write_text("Pf no")
    (tmp_path / "bad.npy").write_text("text")
    np.save(tmp_path / "objects.npy", np.array([{}], dtype=object), allow_pickle=True)
    (tmp_path / "text.png").write_text("text")
    cases = {
        "none": "missing-file", "empty": "empty-folder", "text.txt": "unknown-format", "bad.json": "not-json",
        "list.json": "unknown-schema", "other.json": "unknown-schema", "newer.json": "newer-schema",
        "bad.pfm": "not-pfm", "bad.npy": "not-npy", "objects.npy": "not-npy", "text.png": "not-an-image",
    }  # fmt: skip
    for name, code in cases.items():
        with pytest.raises(BadInput, match=name) as caught:
            describe(tmp_path / name)
        assert (name, caught.value.code) == (name, code)
        assert caught.value.remedy


def test_real_data(shared_data: Path) -> None:
    found = described(shared_data / "hci_cotton")
    assert found["format"] == "hci"
    assert found["document"]["optics"]["baseline_m"] == 0.025
    assert found["unknown"] == ["turntable_deg", "pose"]
    assert described(shared_data / "hci_cotton" / "gt_disp_lowres.pfm")["shape"] == [512, 512]
    assert described(shared_data / "lytro_illum_2067")["summary"] == "light field of 7×7, at 552×383 px"
