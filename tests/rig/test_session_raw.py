"""Raw captures of a session: decoded when loaded, kept in its cache, processed like any other."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from lfrig.contracts.capture import CameraSpec, CaptureDocument, OpticsSpec, RawSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.progress import Monitor
from lfrig.contracts.session import SessionDocument
from lfrig.processing.dpv import light_field_evidence
from lfrig.rig.decode import WEIGHT_FILE, decode_file
from lfrig.rig.session import decoded
from lfrig.rig.session.capture_folder import load_light_field
from lfrig.rig.session.store import SessionStore
from lfrig.rig.sim_capture import capture_simulated
from lfrig.rig.truth import CaptureTruth, load_capture_truth

SIZE = (96, 64)


@pytest.fixture(scope="module")
def shot(tmp_path_factory: pytest.TempPathFactory) -> SessionStore:
    """Two raw light fields and a photo of the simulated rig; tests that change it take a copy."""
    folder = tmp_path_factory.mktemp("raw")
    return capture_simulated(
        folder / "session", scene="plaster", size=SIZE, angles_deg=(0.0, 15.0), target_deg=7.0, poses="given",
        record="raw", cache_dir=folder / "renders",
    )  # fmt: skip


@pytest.fixture
def session(shot: SessionStore, tmp_path: Path) -> Iterator[SessionStore]:
    shutil.copytree(shot.path, tmp_path / "session", ignore=shutil.ignore_patterns("cache"))
    yield SessionStore.open(tmp_path / "session")


def truth_of(shot: SessionStore, capture_id: str = "000") -> CaptureTruth:
    return load_capture_truth(shot.truth_path, capture_id)


def refuse_decoding(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(decoded, "_decode", lambda *_: pytest.fail("decoded again"))


def test_decoded_views_are_the_rendered_ones(shot: SessionStore) -> None:
    field, truth = shot.load_light_field("000"), truth_of(shot)
    assert truth.views is not None and field.views.shape == truth.views.shape
    inner = np.s_[6:-6, 6:-6]
    for r, c in np.ndindex(7, 7):
        error = field.views[r, c][inner].astype(float) - truth.views[r, c][inner]
        # Corner views of this size's small lenses look past their rim; the textures are finer than the lenses.
        assert -20 * np.log10(np.sqrt((error**2).mean()) / 255) > (26 if np.hypot(r - 3, c - 3) < 3.3 else 23)
        assert np.abs(error.mean((0, 1))).max() < 3
    # Noise and aliasing included, a view is most like itself and not like its neighbour or its mirror image.
    column = [np.mean((field.views[3, 6].astype(float) - truth.views[3, c]) ** 2) for c in range(7)]
    row = [np.mean((field.views[0, 3].astype(float) - truth.views[r, 3]) ** 2) for r in range(7)]
    assert np.argmin(column) >= 5 and np.argmin(row) <= 1


def test_disparity_of_decoded_views_has_the_truths_sign_and_size(shot: SessionStore) -> None:
    field, truth = shot.load_light_field("000"), truth_of(shot)
    expected = truth.disparity(truth.baseline_m, truth.focus_distance_m)  # type: ignore[arg-type]
    low, high = float(np.nanmin(expected)) - 0.3, float(np.nanmax(expected)) + 0.3
    found = light_field_evidence(field, (low, high)).disparity
    inner = np.s_[6:-6, 6:-6]
    error = (found - expected)[inner]
    assert abs(np.nanmedian(error)) < 0.01 and np.nanmedian(np.abs(error)) < 0.02
    # The truth spans 0.17 px here: it is followed, not just small.
    assert np.corrcoef(found[inner].ravel(), expected[inner].ravel())[0, 1] > 0.8


def test_the_document_says_more_than_the_file(session: SessionStore) -> None:
    field, document = session.load_light_field("000"), session.capture("000")
    assert document.camera is not None and document.optics is not None and field.camera is not None
    assert field.camera.focal_px == document.camera.fx
    assert field.optics.baseline_m == document.optics.baseline_m
    # Without it, the file's own metadata serve: here they say the same.
    folder = session.capture_folder("000")
    bare = CaptureDocument(kind="light_field", raw=document.raw)
    told = load_light_field(folder, "000", bare, session=session.path)
    assert told.camera is not None
    assert told.camera.focal_px == pytest.approx(field.camera.focal_px, rel=1e-3)
    assert told.optics.baseline_m == pytest.approx(field.optics.baseline_m, rel=1e-3)
    assert told.optics.focus_distance_m == pytest.approx(field.optics.focus_distance_m, rel=1e-2)
    half = bare.model_copy(update={"optics": OpticsSpec(baseline_m=0.001)})
    mixed = load_light_field(folder, "000", half, session=session.path).optics
    assert mixed.baseline_m == 0.001 and mixed.focus_distance_m == told.optics.focus_distance_m


def test_views_are_decoded_once(session: SessionStore, monkeypatch: pytest.MonkeyPatch) -> None:
    first = session.load_light_field("000")
    [place] = (session.path / "cache" / "decode").iterdir()
    assert sorted(entry.name for entry in place.iterdir()) == ["decoded.json", "views.npy"]
    with monkeypatch.context() as patch:
        refuse_decoding(patch)
        again = SessionStore.open(session.path).load_light_field("000")
        photo = session.load_photo("000")
    assert (again.views == first.views).all()
    assert (again.camera, again.optics) == (first.camera, first.optics)
    assert (photo.image == first.centre_view).all() and photo.camera == first.camera
    shutil.rmtree(session.path / "cache")  # safe at any time
    assert (session.load_light_field("000").views == first.views).all()


@pytest.mark.parametrize("name", ["views.npy", "decoded.json"])
@pytest.mark.parametrize("damage", ["empty", "half", "gone", "other"])
def test_a_damaged_cache_is_decoded_again(session: SessionStore, name: str, damage: str) -> None:
    first = session.load_light_field("000")
    [place] = (session.path / "cache" / "decode").iterdir()
    path = place / name
    data = path.read_bytes()
    if damage == "gone":
        path.unlink()
    else:
        path.write_bytes({"empty": b"", "half": data[: len(data) // 2], "other": b"[1, 2]"}[damage])
    assert (session.load_light_field("000").views == first.views).all()
    assert path.read_bytes() == data


def test_a_new_calibration_is_a_new_decode(session: SessionStore) -> None:
    session.load_light_field("000")
    [tar] = (session.path / "calibration").iterdir()
    stamp = tar.stat().st_mtime_ns + 10**9
    os.utime(tar, ns=(stamp, stamp))
    session.load_light_field("000")
    assert len(list((session.path / "cache" / "decode").iterdir())) == 2


def test_warnings_are_told_again_with_the_cached_views(session: SessionStore) -> None:
    shutil.rmtree(session.path / "calibration")
    told = []
    for _ in range(2):
        monitor = Monitor()
        session.load_light_field("001", monitor=monitor)
        told.append([notice.code for notice in monitor.notices])
    assert told[0] == told[1] == ["calibration-missing", "no-white-image", "lattice-from-shot"]


def test_a_session_that_cannot_be_written_to_is_read(session: SessionStore, monkeypatch: pytest.MonkeyPatch) -> None:
    (session.path / "cache").write_text("in the way")
    monitor = Monitor()
    field = session.load_light_field("000", monitor=monitor)
    assert field.views.shape[2:4] == SIZE[::-1]
    assert "cache-not-written" in [notice.code for notice in monitor.notices]


def test_a_file_that_was_changed_is_refused(session: SessionStore) -> None:
    path = session.capture_folder("000") / "capture.lfr"
    data = bytearray(path.read_bytes())
    data[-1] ^= 1
    path.write_bytes(data)
    with pytest.raises(BadInput) as refusal:
        session.load_light_field("000")
    assert refusal.value.code == "changed-file" and refusal.value.path == str(path)


def test_a_missing_file_is_named(session: SessionStore) -> None:
    path = session.capture_folder("000") / "capture.lfr"
    path.unlink()
    with pytest.raises(BadInput) as refusal:
        session.load_light_field("000")
    assert refusal.value.path == str(path)


@pytest.mark.parametrize("name", ["../calibration/x", "/etc/passwd", "..", ""])
def test_calibrations_lie_in_the_session(session: SessionStore, name: str) -> None:
    with pytest.raises(BadInput) as refusal:
        decoded.find_calibration(session.capture_folder("000"), name, session.path)
    assert refusal.value.field == "raw.calibration"


def test_where_calibrations_are_looked_for(session: SessionStore) -> None:
    folder = session.capture_folder("000")
    [tar] = (session.path / "calibration").iterdir()
    assert decoded.find_calibration(folder, tar.stem, session.path) == tar
    assert decoded.find_calibration(folder, tar.name, session.path) == tar
    assert decoded.find_calibration(folder, tar.stem, None) is None
    assert decoded.find_calibration(folder, None, session.path) is None
    shutil.copy(tar, folder)
    assert decoded.find_calibration(folder, tar.stem, None) == folder / tar.name


def test_distortion_of_a_raw_capture_is_taken_out(session: SessionStore) -> None:
    document = session.capture("000")
    width, height = SIZE
    camera = CameraSpec(width=width, height=height, fx=200.0, fy=200.0, distortion=(0.05, 0.0, 0.0, 0.0))
    plain = session.load_light_field("000")
    bent = load_light_field(
        session.capture_folder("000"), "000", document.model_copy(update={"camera": camera}), session=session.path
    )
    assert bent.views.shape == plain.views.shape and (bent.views != plain.views).any()


def test_a_session_of_raw_captures_is_processed(session: SessionStore) -> None:
    from lfrig.processing.options import ProcessOptions
    from lfrig.rig.process import process_session

    folder = process_session(session.path, options=ProcessOptions(poses="given"))
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert len(report["sources"]) == 2 and (folder / "views" / "06_06.png").is_file()


def test_a_missing_calibration_is_in_the_report(session: SessionStore) -> None:
    from lfrig.processing.options import ProcessOptions
    from lfrig.rig.process import process_session

    shutil.rmtree(session.path / "calibration")
    monitor = Monitor()
    folder = process_session(session.path, options=ProcessOptions(poses="given"), monitor=monitor)
    told = {warning["code"] for warning in json.loads((folder / "report.json").read_text())["warnings"]}
    assert told >= {"calibration-missing", "no-white-image", "lattice-from-shot"}
    assert told <= {notice.code for notice in monitor.notices}


def test_a_raw_capture_folder_is_opened_with_its_session_s_calibration(session: SessionStore, tmp_path: Path) -> None:
    from lfrig.rig.ingest import ingest, open_light_field

    monitor = Monitor()
    field = open_light_field(session.capture_folder("000"), monitor=monitor)
    assert np.array_equal(field.views, session.load_light_field("000").views)
    assert not monitor.notices
    [taken] = ingest(tmp_path / "other", [session.capture_folder("000")], monitor=monitor)
    assert [notice.code for notice in monitor.notices] == ["calibration-not-copied"]
    other = SessionStore.open(tmp_path / "other")
    assert (other.capture_folder(taken.id) / "capture.lfr").is_file()
    [tar] = (session.path / "calibration").iterdir()
    [whole] = ingest(tmp_path / "third", [session.capture_folder("000")], calibration=tar, monitor=monitor)
    third = SessionStore.open(tmp_path / "third")
    assert np.array_equal(third.load_light_field(whole.id).views, field.views)


def test_decoding_a_file_makes_a_capture(session: SessionStore, tmp_path: Path) -> None:
    [tar] = (session.path / "calibration").iterdir()
    path = session.capture_folder("000") / "capture.lfr"
    outcome = decode_file(path, tmp_path / "out", calibration=tar)
    document = CaptureDocument.load(tmp_path / "out" / "capture.json")
    assert document.origin is not None and document.origin.name == "capture.lfr"
    field = load_light_field(tmp_path / "out", "out", document)
    assert (field.views == session.load_light_field("000").views).all()
    weight = np.load(tmp_path / "out" / WEIGHT_FILE)
    assert weight.shape == field.views.shape[:4] and weight.dtype == np.uint8
    assert outcome.facts["white_image"]["rule"] == "exact" and outcome.facts["lattice"]["lenses"] > 3000
    json.dumps(outcome.facts)
    with pytest.raises(BadInput) as refusal:
        decode_file(path, tmp_path / "out", calibration=tar)
    assert refusal.value.code == "exists"
    with pytest.raises(BadInput):
        decode_file(tmp_path, tmp_path / "other")
    assert not (tmp_path / "other").exists()


def test_a_raw_capture_outside_a_session_is_decoded_and_nothing_is_kept(session: SessionStore, tmp_path: Path) -> None:
    [tar] = (session.path / "calibration").iterdir()
    folder = tmp_path / "alone"
    shutil.copytree(session.capture_folder("000"), folder)
    shutil.copy(tar, folder)
    document = CaptureDocument.load(folder / "capture.json")
    assert document.raw is not None and document.raw == RawSpec.model_validate(document.raw.model_dump())
    field = load_light_field(folder, "alone", document)
    assert (field.views == session.load_light_field("000").views).all()
    assert sorted(p.name for p in folder.iterdir()) == sorted(["capture.json", "capture.lfr", tar.name])
    assert SessionDocument.load(session.path / "session.json").captures == ["000", "001", "002"]
