"""Raw light fields from a camera into a session: as they came, with the calibration that decodes them."""

from __future__ import annotations

import hashlib
import tarfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lfrig.contracts.capture import CaptureDocument, RawSpec, ViewsSpec
from lfrig.contracts.errors import CaptureError
from lfrig.drivers.protocols import Frame
from lfrig.rig.plan import CapturePlan
from lfrig.rig.session.store import SessionStore
from lfrig.rig.sim_capture import capture_simulated
from lfrig.rig.truth import load_capture_truth
from lfrig.sim.rig import SimulatedRig
from tests.rig.test_controller import Rig

SCENE, SIZE = "plaster", (24, 16)
RAW = b"\x89LFP and so on"
SHA256 = hashlib.sha256(RAW).hexdigest()


def capture(path: Path, **options: Any) -> SessionStore:
    wanted: dict[str, Any] = {"scene": SCENE, "size": SIZE, "angles_deg": (0.0,), "target_deg": None, "record": "raw"}
    return capture_simulated(path, **(wanted | options))


def white_images(session: Path) -> list[str]:
    [path] = (session / "calibration").iterdir()
    with tarfile.open(path) as archive:
        return [name for name in archive.getnames() if name.endswith(".RAW")]


def test_session_holds_the_files_as_they_came(tmp_path: Path) -> None:
    store = capture(tmp_path / "s", angles_deg=(0.0, 15.0), target_deg=8.0)
    documents = store.captures()
    assert [d.kind for d in documents.values()] == ["light_field", "light_field", "photo"]
    rig = SimulatedRig(SCENE, *SIZE)
    for index, (name, angle) in enumerate((("000", 0.0), ("001", 15.0))):
        shot = rig.shoot_raw(index, angle)
        assert documents[name] == shot.document
        spec = documents[name].raw
        assert spec is not None
        data = (store.capture_folder(name) / spec.path).read_bytes()
        assert data == shot.raw
        assert (store.path / "calibration" / f"{spec.calibration}.tar").is_file()
        truth = load_capture_truth(store.truth_path, name)
        assert truth.views is not None
        assert shot.truth.views is not None
        np.testing.assert_array_equal(truth.views, shot.truth.views)


def test_calibration_has_a_white_image_for_every_shot_of_the_session(tmp_path: Path) -> None:
    capture(tmp_path / "s")
    assert len(white_images(tmp_path / "s")) == 2  # and one of no shot
    before = [p.stat().st_mtime_ns for p in (tmp_path / "s" / "calibration").iterdir()]
    capture(tmp_path / "s")
    assert [p.stat().st_mtime_ns for p in (tmp_path / "s" / "calibration").iterdir()] == before
    capture(tmp_path / "s", angles_deg=(0.0, 15.0, 30.0))
    assert len(white_images(tmp_path / "s")) == 4


def test_views_are_recorded_when_they_are_asked_for(tmp_path: Path) -> None:
    store = capture(tmp_path / "s", record="views")
    assert not (store.path / "calibration").exists()
    assert store.capture("000").raw is None


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def deliver(rig: Rig, monkeypatch: pytest.MonkeyPatch, document: CaptureDocument, raw: bytes | None) -> None:
    def fetch(frame_id: str, *, timeout_s: float) -> Frame:
        return Frame(frame_id, document, raw=raw)

    monkeypatch.setattr(rig.light_field, "fetch", fetch)


@pytest.mark.parametrize("sha256", [SHA256, None])
def test_any_camera_may_deliver_raw_files(rig: Rig, monkeypatch: pytest.MonkeyPatch, sha256: str | None) -> None:
    document = CaptureDocument(kind="light_field", raw=RawSpec(path="IMG_0001.lfr", sha256=sha256))
    deliver(rig, monkeypatch, document, RAW)
    [name] = rig.run(CapturePlan(angles_deg=(5.0,)))
    assert (rig.store.capture_folder(name) / "IMG_0001.lfr").read_bytes() == RAW
    assert rig.store.capture(name) == document.model_copy(update={"turntable_deg": 5.0})


@pytest.mark.parametrize(
    ("document", "raw", "message"),
    [
        (CaptureDocument(kind="light_field", raw=RawSpec(path="a.lfr", sha256=SHA256)), RAW[:-1], "damaged"),
        (CaptureDocument(kind="light_field", views=ViewsSpec(rows=3, cols=3)), RAW, "does not name"),
        (CaptureDocument(kind="light_field", raw=RawSpec(path="a.lfr")), None, "no picture"),
    ],
)
def test_broken_deliveries_are_refused(
    rig: Rig, monkeypatch: pytest.MonkeyPatch, document: CaptureDocument, raw: bytes | None, message: str
) -> None:
    deliver(rig, monkeypatch, document, raw)
    with pytest.raises(CaptureError, match=message):
        rig.run(CapturePlan(angles_deg=(5.0,)))
    assert rig.listed() == []
