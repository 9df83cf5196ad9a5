"""Raw light fields into sessions, and what info says of them: kept as they are, or refused by name."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from lfrig.bench.lytro_files import (
    SERIAL,
    SmallShot,
    calibration_files,
    container,
    encoded,
    section,
    shot_file,
    shot_parts,
    tar_bytes,
)
from lfrig.contracts.errors import BadInput, DiskError, Interrupted, NotInThisVersion, UsageError
from lfrig.contracts.lytro import CONTENT_MAGIC, F01, TOC_MAGIC
from lfrig.contracts.progress import Monitor
from lfrig.processing.lenslet.raw import read_raw
from lfrig.rig.cli import main
from lfrig.rig.info import describe, text_lines
from lfrig.rig.ingest import ingest
from lfrig.rig.session.store import SessionStore
from lfrig.rig.sim_capture import capture_simulated
from tests.rig.session_files import tree, write_view_folder

SHOT = SmallShot(width=120, height=96, geometry=b"a")
NEAR = SmallShot(width=120, height=96, zoom_step=640, geometry=b"b")


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.fixture
def lfr(tmp_path: Path) -> Path:
    return write(tmp_path / "IMG_0001.LFR", shot_file(SHOT))


@pytest.fixture
def tar(tmp_path: Path) -> Path:
    return write(tmp_path / "caldata.tar", tar_bytes(calibration_files([SHOT, NEAR], [(3, 4)])))


# -- ingest ----------------------------------------------------------------------------------------------------------
def test_the_file_is_kept_as_it_is_with_its_priors(tmp_path: Path, lfr: Path, tar: Path) -> None:
    monitor = Monitor()
    [done] = ingest(tmp_path / "s", [lfr], calibration=tar, monitor=monitor)
    assert (done.id, done.kind, done.format, done.skipped) == ("000", "light_field", "lytro", False)
    assert monitor.notices == []
    store = SessionStore.open(tmp_path / "s")
    document = store.capture("000")
    name = hashlib.sha256(tar.read_bytes()).hexdigest()[:16]
    assert document.raw is not None
    assert (document.raw.path, document.raw.calibration) == ("capture.lfr", name)
    assert document.raw.sha256 == hashlib.sha256(lfr.read_bytes()).hexdigest()
    assert document.origin is not None
    assert (document.origin.name, document.origin.format) == ("IMG_0001.LFR", "lytro")
    assert set(tree(tmp_path / "s")) == {
        "session.json", "captures/000/capture.json", "captures/000/capture.lfr", f"calibration/{name}.tar",
    }  # fmt: skip
    assert tree(tmp_path / "s")["captures/000/capture.lfr"] == lfr.read_bytes()
    assert tree(tmp_path / "s")[f"calibration/{name}.tar"] == tar.read_bytes()
    assert document.camera is not None
    assert (document.camera.width, document.camera.height) == (round(120 / (20 / 1.4)), round(96 / (20 / 1.4)))
    assert document.camera.fx == pytest.approx(0.0242 / 2e-5 + 33.9 * 2.2)
    assert document.camera.sigma_f == 0.02
    assert document.optics is not None
    assert document.optics.baseline_m == pytest.approx(0.0242 / 2.2 / (20 / 1.4))
    assert document.optics.focus_distance_m == pytest.approx(0.0242 + 0.0242**2 / (33.9 * 2.2 * 2e-5))
    assert document.optics.sigma_baseline == 0.03
    assert document.exposure is not None
    assert (document.exposure.time_s, document.exposure.iso) == (0.008, 80)
    assert document.exposure.white_balance == (1.31, 1.0, 1.34)
    assert document.time == "2015-05-17T13:31:37.412Z"
    assert document.views is None


def test_a_calibration_is_kept_once(tmp_path: Path, lfr: Path, tar: Path) -> None:
    session = tmp_path / "s"
    other = write(tmp_path / "IMG_0002.lfp", shot_file(SmallShot(width=120, height=96, seed=5, geometry=b"b")))
    ingest(session, [lfr], calibration=tar)
    stamp = next((session / "calibration").iterdir()).stat().st_mtime_ns
    ingest(session, [other], calibration=tar)
    [kept] = (session / "calibration").iterdir()
    assert kept.stat().st_mtime_ns == stamp
    store = SessionStore.open(session)
    assert {store.capture(name).raw.calibration for name in ("000", "001")} == {kept.stem}  # type: ignore[union-attr]


def test_a_folder_becomes_a_tar_of_the_same_name_every_time(tmp_path: Path, lfr: Path) -> None:
    folder = tmp_path / "unitdata"
    folder.mkdir()
    for name, data in (calibration_files([SHOT]) | {"notes.md": b"mine"}).items():
        (folder / name).write_bytes(data)
    for session in ("one", "two"):
        ingest(tmp_path / session, [lfr], calibration=folder)
    assert tree(tmp_path / "one" / "calibration") == tree(tmp_path / "two" / "calibration")
    [kept] = (tmp_path / "one" / "calibration").iterdir()
    found = describe(kept)
    assert found["summary"] == f"calibration of {SERIAL}, 1 white image"
    assert b"mine" not in kept.read_bytes()
    ingest(tmp_path / "three", [lfr], calibration=folder / "MOD_0000.RAW")
    assert len(tree(tmp_path / "three" / "calibration")) == 1


def test_which_white_image_will_serve_is_said_at_once(tmp_path: Path, lfr: Path) -> None:
    near = write(tmp_path / "near.tar", tar_bytes(calibration_files([NEAR])))
    embedded = write(tmp_path / "own.lfr", shot_file(SmallShot(width=120, height=96, embedded_white=True)))
    cases = [
        (lfr, near, "white-image-not-exact", "MOD_0000, zoom +40 steps, focus +0 steps"),
        (lfr, None, "no-white-image", "no calibration was given"),
        (embedded, None, "white-image-not-exact", "own file"),
    ]
    for number, (source, calibration, code, words) in enumerate(cases):
        monitor = Monitor()
        ingest(tmp_path / f"s{number}", [source], calibration=calibration, monitor=monitor)
        [notice] = monitor.notices
        assert notice.code == code
        assert words in notice.message
        assert str(source) in notice.message


def test_the_same_shot_is_kept_once(tmp_path: Path, lfr: Path, tar: Path) -> None:
    copy = write(tmp_path / "copy.lfp", lfr.read_bytes())
    ingest(tmp_path / "s", [lfr])
    monitor = Monitor()
    [again] = ingest(tmp_path / "s", [copy], calibration=tar, monitor=monitor)
    assert (again.id, again.skipped) == ("000", True)
    assert [notice.code for notice in monitor.notices] == ["duplicate-capture"]
    assert not (tmp_path / "s" / "calibration").exists()


def test_a_lytro_file_is_known_by_its_first_bytes(tmp_path: Path) -> None:
    path = write(tmp_path / "picture", shot_file(SmallShot(figures=F01, width=120, height=96)))
    [done] = ingest(tmp_path / "s", [path])
    assert done.format == "lytro"
    with pytest.raises(NotInThisVersion, match="container"):
        ingest(tmp_path / "s", [write(tmp_path / "x.RAW", b"x")])


def test_a_calibration_without_a_raw_light_field(tmp_path: Path, tar: Path) -> None:
    views = write_view_folder(tmp_path / "sai", "{row}_{col}.png")
    with pytest.raises(UsageError, match="--calibration"):
        ingest(tmp_path / "s", [views], calibration=tar)
    assert not (tmp_path / "s").exists()


def test_what_the_simulated_camera_writes_is_read_as_it_was_meant(tmp_path: Path) -> None:
    shot_by_sim = capture_simulated(
        tmp_path / "sim", scene="plaster", size=(24, 16), angles_deg=(0.0,), target_deg=None, record="raw"
    )
    meant = shot_by_sim.capture("000")
    [tar] = (shot_by_sim.path / "calibration").iterdir()
    source = shot_by_sim.capture_folder("000") / "capture.lfr"
    monitor = Monitor()
    ingest(tmp_path / "s", [source], calibration=tar, monitor=monitor)
    found = SessionStore.open(tmp_path / "s").capture("000")
    assert monitor.notices == []
    assert found.camera is not None
    assert meant.camera is not None
    assert (found.camera.width, found.camera.height) == (24, 16)
    assert found.camera.fx == pytest.approx(meant.camera.fx)
    assert found.optics is not None
    assert meant.optics is not None
    assert found.optics.baseline_m == pytest.approx(meant.optics.baseline_m)
    assert found.optics.focus_distance_m == pytest.approx(meant.optics.focus_distance_m)
    assert found.exposure is not None
    assert meant.exposure is not None
    assert (found.exposure.time_s, found.exposure.iso) == (meant.exposure.time_s, meant.exposure.iso)
    raw = read_raw(source, calibration=tar)
    assert (raw.rule, raw.zoom_steps, raw.focus_steps) == ("exact", 0, 0)
    assert raw.white is not None
    assert raw.white.sensor.shape == raw.sensor.shape
    assert len(raw.hot_pixels) >= 3
    rows, cols = raw.hot_pixels[:, 1], raw.hot_pixels[:, 0]
    assert (raw.sensor[rows, cols] > raw.sensor.mean()).all()


# -- bad input ---------------------------------------------------------------------------------------------------------
def without_section(name: str) -> bytes:
    table, parts = shot_parts(SHOT)
    contents = [section(CONTENT_MAGIC, data) for key, data in parts.items() if key != name]
    return container(*contents, *([] if name == "toc" else [section(TOC_MAGIC, encoded(table))]))


def damaged() -> bytes:
    data = bytearray(shot_file(SHOT))
    data[data.index(shot_parts(SHOT)[1]["imageRef"]) + 9] ^= 4
    return bytes(data)


def of_depth(bits: int) -> bytes:
    """A file whose metadata say another bit depth than its payload has."""
    table, parts = shot_parts(SHOT)
    lying = parts["metadataRef"].replace(b'"bitsPerPixel": 10', b'"bitsPerPixel": %d' % bits)
    if bits == 12:
        lying = lying.replace(b'"endianness": "little"', b'"endianness": "big"')
    old, new = (section(CONTENT_MAGIC, data)[16:61] for data in (parts["metadataRef"], lying))
    parts["metadataRef"] = lying
    toc = section(TOC_MAGIC, encoded(table).replace(old, new))
    return container(*(section(CONTENT_MAGIC, data) for data in parts.values()), toc)


BAD_FILES: dict[str, tuple[Callable[[], bytes], str, str]] = {
    "truncated": (lambda: shot_file(SHOT)[:-300], "truncated", "before the end of a section"),
    "empty": (lambda: b"", "not-a-lytro-file", "empty"),
    "garbage": (lambda: bytes(range(1, 251)) * 40, "not-a-lytro-file", "no Lytro file"),
    "jpeg": (lambda: b"\xff\xd8\xff\xe1" + bytes(5000), "not-a-lytro-file", "JPEG picture"),
    "garbage-inside": (lambda: shot_file(SHOT, 0) + b"?" * 200, "garbage", "garbage"),
    "oversized": (lambda: container(section(CONTENT_MAGIC, b"", length=0xFFFFFFFF)), "too-large", "4294967295"),
    "deep-json": (lambda: container(section(TOC_MAGIC, b'{"a":' * 90 + b"1" + b"}" * 90)), "json-too-deep", "64"),
    "wrong-sha1": (damaged, "wrong-sha1", "SHA-1"),
    "no-toc": (lambda: without_section("toc"), "no-table-of-contents", "table of contents"),
    "no-image": (lambda: without_section("imageRef"), "missing-section", "imageRef"),
    "no-metadata": (lambda: without_section("metadataRef"), "missing-section", "metadataRef"),
    "wrong-depth": (lambda: of_depth(12), "wrong-size", "as 10 bits would be"),
    "odd-depth": (lambda: of_depth(11), "unknown-packing", "bitsPerPixel"),
}
TOLD_BY_INFO = {"truncated": 3, "garbage-inside": 0, "wrong-sha1": 0, "no-image": 0, "wrong-depth": 0}
"""Exit code of info where it is not that of a file that cannot be described: it tells what is wrong instead."""


@pytest.mark.parametrize("name", sorted(BAD_FILES))
def test_bad_files_are_one_line_and_exit_3(tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str) -> None:
    make, code, words = BAD_FILES[name]
    path = write(tmp_path / "bad.lfr", make())
    with pytest.raises(BadInput) as caught:
        ingest(tmp_path / "s", [path])
    assert caught.value.code == code
    assert main(["ingest", str(tmp_path / "s"), str(path)]) == 3
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"lfrig: error: {path}: ")
    assert words in line
    assert " — " in line
    assert [entry.name for entry in tmp_path.iterdir()] == ["bad.lfr"]
    expected = TOLD_BY_INFO.get(name, 3)
    assert main(["info", str(path), "--json"]) == expected
    document = json.loads(capsys.readouterr().out)
    if expected == 0:
        assert any(words in problem for problem in document["problems"])
    else:
        assert str(path) in document["error"]["message"]


def test_a_bad_calibration_leaves_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str], lfr: Path) -> None:
    before = sorted(entry.name for entry in tmp_path.iterdir())
    for name, data in {
        "traversal": tar_bytes(calibration_files([SHOT]), folder="../../up"),
        "no-tar": b"no tar",
        "no-white-image": tar_bytes({"readme": b"x"}),
    }.items():
        path = write(tmp_path / f"{name}.tar", data)
        assert main(["ingest", str(tmp_path / "s"), str(lfr), "--calibration", str(path)]) == 3
        [line] = capsys.readouterr().err.splitlines()
        assert line.startswith(f"lfrig: error: {path}")
        assert main(["info", str(path)]) == 3
        [line] = capsys.readouterr().err.splitlines()
        path.unlink()
        assert sorted(entry.name for entry in tmp_path.iterdir()) == before


def test_one_bad_file_among_good_ones_changes_nothing(tmp_path: Path, lfr: Path, tar: Path) -> None:
    bad = write(tmp_path / "bad.lfr", shot_file(SHOT)[:-300])
    ingest(tmp_path / "s", [write(tmp_path / "first.lfr", shot_file(SmallShot(seed=3, width=120, height=96)))])
    before = tree(tmp_path / "s")
    with pytest.raises(BadInput, match=r"bad\.lfr"):
        ingest(tmp_path / "s", [lfr, bad], calibration=tar)
    assert tree(tmp_path / "s") == before


class CancelAt(Monitor):
    """Cancels when so many calls of `advance` were made."""

    def __init__(self, calls: int) -> None:
        super().__init__()
        self._left = calls

    def advance(self, steps: int = 1) -> None:
        self._left -= 1
        if self._left <= 0:
            self.cancel()
        super().advance(steps)


def test_a_cancel_leaves_neither_session_nor_calibration(tmp_path: Path, lfr: Path, tar: Path) -> None:
    reached = 0
    for calls in range(1, 12):
        try:
            ingest(tmp_path / "s", [lfr], calibration=tar, monitor=CancelAt(calls))
        except Interrupted:
            reached += 1
            assert not (tmp_path / "s").exists()
        else:
            break
    assert reached >= 3


def test_a_full_disk_leaves_neither(tmp_path: Path, lfr: Path, tar: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: SessionStore, builds: object) -> list[str]:
        raise DiskError("no space left on the disk", code="disk-full")

    monkeypatch.setattr(SessionStore, "add_captures", full)
    with pytest.raises(DiskError):
        ingest(tmp_path / "s", [lfr], calibration=tar)
    assert not (tmp_path / "s").exists()


# -- info ------------------------------------------------------------------------------------------------------
def test_info_of_a_shot(lfr: Path) -> None:
    found = describe(lfr)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert found["type"] == "raw"
    assert found["summary"] == f"raw light field at 8×7 px, ILLUM {SERIAL}, 120×96 px sensor of 10 bits"
    assert [row["what"] for row in found["sections"]] == [
        "metadata", "private_metadata", "image", "table of contents",
    ]  # fmt: skip
    assert found["sections"][2]["bytes"] == 120 * 96 * 10 // 8
    assert found["metadata"]["zoom_step"] == 600
    assert found["problems"] == []
    assert found["unknown"] == ["turntable_deg", "pose", "depth_range_m"]
    assert any("what image, bytes 14400" in line for line in text_lines(found))


def test_info_of_a_calibration(tar: Path) -> None:
    found = describe(tar)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    assert (found["type"], found["summary"]) == ("calibration", f"calibration of {SERIAL}, 2 white images")
    assert [(row["name"], row["zoom_step"]) for row in found["white_images"]] == [("MOD_0000", 600), ("MOD_0001", 640)]
    assert found["hot_pixels"] == 1
    assert found["problems"] == []


def test_info_of_a_session_with_raw_captures(tmp_path: Path, lfr: Path, tar: Path) -> None:
    ingest(tmp_path / "s", [lfr], calibration=tar)
    found = describe(tmp_path / "s")
    assert found["problems"] == []
    [kept] = (tmp_path / "s" / "calibration").iterdir()
    kept.unlink()
    assert describe(tmp_path / "s")["problems"] == [f"capture 000: calibration {kept.stem} is missing"]
    (tmp_path / "s" / "captures" / "000" / "capture.lfr").unlink()
    assert "1 of 1 files are missing" in describe(tmp_path / "s")["problems"][0]
