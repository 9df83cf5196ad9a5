"""Ingest as a whole: into a session all or none, the same content once, nothing left of a failure."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image as Pillow

from lfrig.contracts.errors import BadInput, DiskError, Interrupted, NotInThisVersion, UsageError
from lfrig.contracts.progress import Monitor
from lfrig.rig.ingest import ingest, open_light_field
from lfrig.rig.session.images import write_png
from lfrig.rig.session.store import SessionStore
from tests.rig.session_files import (
    H,
    W,
    known_document,
    read_only,
    tree,
    view,
    views,
    write_capture_folder,
    write_view_folder,
)


@pytest.fixture
def sai(tmp_path: Path) -> Path:
    return write_view_folder(tmp_path / "in" / "sai", "view_{row:02d}_{col:02d}.png")


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    write_png(tmp_path / "in" / "photo.png", view(5, 5))
    return tmp_path / "in" / "photo.png"


def test_light_fields_and_photos_become_captures_in_the_order_given(tmp_path: Path, sai: Path, photo: Path) -> None:
    before = tree(tmp_path / "in")
    ingested = ingest(tmp_path / "s", [photo, sai])
    assert [(c.id, c.source, c.kind, c.format, c.skipped) for c in ingested] == [
        ("000", photo, "photo", "photo", False),
        ("001", sai, "light_field", "sai", False),
    ]
    store = SessionStore.open(tmp_path / "s")
    assert store.document.captures == ["000", "001"]
    assert np.array_equal(store.load_photo("000").image, view(5, 5))
    assert np.array_equal(store.load_light_field("001").views, views())
    assert tree(tmp_path / "in") == before, "sources are copied, never moved"


def test_files_are_kept_byte_for_byte(tmp_path: Path, sai: Path, photo: Path) -> None:
    ingest(tmp_path / "s", [sai, photo])
    kept = tree(tmp_path / "s")
    assert kept["captures/000/views/02_01.png"] == (sai / "view_02_01.png").read_bytes()
    assert kept["captures/001/photo.png"] == photo.read_bytes()


def test_the_origin_is_recorded(tmp_path: Path, sai: Path) -> None:
    ingest(tmp_path / "s", [sai])
    origin = SessionStore.open(tmp_path / "s").captures()["000"].origin
    assert origin is not None
    assert (origin.name, origin.format) == ("sai", "sai")
    assert len(origin.sha256 or "") == 64


def test_the_same_content_is_noticed_whatever_it_is_called(tmp_path: Path, sai: Path, photo: Path) -> None:
    ingest(tmp_path / "s", [sai, photo])
    before = tree(tmp_path / "s")
    renamed = write_view_folder(tmp_path / "in" / "other", "x{row}y{col}.png", range(4, 7), range(2, 5))
    copied = tmp_path / "in" / "copy.png"
    shutil.copy(photo, copied)
    monitor = Monitor()
    ingested = ingest(tmp_path / "s", [renamed, copied, tmp_path / "s" / "captures" / "000"], monitor=monitor)
    assert [(c.id, c.skipped) for c in ingested] == [("000", True), ("001", True), ("000", True)]
    twins = [notice.message for notice in monitor.notices if notice.code == "duplicate-capture"]
    assert len(twins) == 3
    assert str(renamed) in twins[0]
    assert "000" in twins[0]
    assert tree(tmp_path / "s") == before


def test_the_same_content_twice_in_one_go_is_stored_once(tmp_path: Path, sai: Path, photo: Path) -> None:
    ingested = ingest(tmp_path / "s", [sai, photo, sai])
    assert [(c.id, c.skipped) for c in ingested] == [("000", False), ("001", False), ("000", True)]
    assert SessionStore.open(tmp_path / "s").document.captures == ["000", "001"]


def test_captures_that_were_shot_here_are_noticed_too(tmp_path: Path) -> None:
    store = SessionStore.create(tmp_path / "s")
    store.add_light_field(views(), known_document())
    folder = write_view_folder(tmp_path / "in", "{row}_{col}.png")
    assert ingest(tmp_path / "s", [folder])[0].skipped


def test_a_broken_capture_in_the_session_does_not_stop_others(tmp_path: Path, sai: Path, photo: Path) -> None:
    ingest(tmp_path / "s", [photo])
    (tmp_path / "s" / "captures" / "000" / "capture.json").unlink()
    assert ingest(tmp_path / "s", [sai])[0].id == "001"


def test_a_turned_photo_is_stored_upright_and_noticed_again(tmp_path: Path) -> None:
    picture = Pillow.fromarray(view(0, 0))
    tags = picture.getexif()
    tags[0x0112] = 6
    tags.get_ifd(0x8769)[0xA405] = 36
    tags.get_ifd(0x8769)[0x9003] = "2024:05:06 07:08:09"
    source = tmp_path / "IMG.JPG"
    picture.save(source, exif=tags)
    (ingested,) = ingest(tmp_path / "s", [source])
    store = SessionStore.open(tmp_path / "s")
    document = store.captures()["000"]
    assert document.image == "photo.png"
    assert document.time == "2024-05-06T07:08:09"
    image = store.load_photo(ingested.id).image
    assert image.shape == (W, H, 3)
    with Pillow.open(source) as opened:
        assert np.array_equal(image, np.rot90(np.asarray(opened), -1))
    camera = store.load_photo("000").camera
    assert camera is not None
    assert camera.focal_px == pytest.approx(36 * np.hypot(W, H) / np.hypot(36, 24))
    assert camera.sigma_focal > 0
    assert ingest(tmp_path / "s", [source])[0].skipped


def test_a_jpeg_that_is_upright_is_copied(tmp_path: Path) -> None:
    Pillow.fromarray(view(0, 0)).save(tmp_path / "a.JPEG")
    monitor = Monitor()
    ingest(tmp_path / "s", [tmp_path / "a.JPEG"], monitor=monitor)
    assert tree(tmp_path / "s")["captures/000/photo.jpeg"] == (tmp_path / "a.JPEG").read_bytes()
    assert [notice.code for notice in monitor.notices] == ["no-focal-length"]


def test_sixteen_bits_of_a_photo_are_kept(tmp_path: Path) -> None:
    deep = view(0, 0).astype(np.uint16) * 250 + 3
    write_png(tmp_path / "deep.png", deep)
    ingest(tmp_path / "s", [tmp_path / "deep.png"])
    assert np.array_equal(SessionStore.open(tmp_path / "s").load_photo("000").image, deep)


def test_a_capture_folder_is_taken_as_it_is(tmp_path: Path) -> None:
    document = {
        "kind": "light_field", "views": {"rows": 3, "cols": 3, "pattern": "a/{col}/{row}.png"}, "turntable_deg": 15.0,
        "raw": {"path": "raw/capture.lfr"}, "lens": {"serial": 7},
    }  # fmt: skip
    pictures = {f"a/{c}/{r}.png": view(r, c) for r in range(3) for c in range(3)}
    folder = write_capture_folder(tmp_path / "shot", document, pictures)
    (folder / "raw").mkdir()
    (folder / "raw" / "capture.lfr").write_bytes(b"raw")
    for source, session in ((folder, "s"), (folder / "capture.json", "t")):
        ingest(tmp_path / session, [source])
        store = SessionStore.open(tmp_path / session)
        assert np.array_equal(store.load_light_field("000").views, views())
        stored = store.captures()["000"]
        assert stored.turntable_deg == 15.0
        assert stored.model_extra == {"lens": {"serial": 7}}
        assert tree(tmp_path / session)["captures/000/raw/capture.lfr"] == b"raw"


def test_a_photo_s_capture_folder_is_taken_as_it_is(tmp_path: Path) -> None:
    folder = write_capture_folder(
        tmp_path / "shot", {"kind": "photo", "image": "x/p.png", "turntable_deg": 7}, {"x/p.png": view(0, 0)}
    )
    ingest(tmp_path / "s", [folder])
    photo = SessionStore.open(tmp_path / "s").load_photo("000")
    assert photo.turntable_deg == 7
    assert np.array_equal(photo.image, view(0, 0))


def test_the_origin_survives_a_second_ingest(tmp_path: Path, sai: Path) -> None:
    ingest(tmp_path / "s", [sai])
    ingest(tmp_path / "t", [tmp_path / "s" / "captures" / "000"])
    origins = [SessionStore.open(tmp_path / name).captures()["000"].origin for name in ("s", "t")]
    assert origins[0] == origins[1]


def break_source(sai: Path, how: str) -> None:
    broken = sai / "view_01_01.png"
    if how == "missing view":
        broken.unlink()
    elif how == "text":
        broken.write_text("text")
    elif how == "truncated":
        broken.write_bytes(broken.read_bytes()[:-10])
    else:
        write_png(broken, view(0, 0, H, W + 1))


@pytest.mark.parametrize("session_exists", [True, False])
@pytest.mark.parametrize("how", ["missing view", "text", "truncated", "another size"])
def test_a_broken_source_changes_nothing(
    tmp_path: Path, sai: Path, photo: Path, how: str, session_exists: bool
) -> None:
    """The photo before it, which is fine, is not ingested either."""
    if session_exists:
        ingest(tmp_path / "s", [write_view_folder(tmp_path / "other", "{row}_{col}.png", seed=3)])
    break_source(sai, how)
    before = tree(tmp_path)
    with pytest.raises(BadInput, match="view_01_01"):
        ingest(tmp_path / "s", [photo, sai])
    assert tree(tmp_path) == before
    assert (tmp_path / "s").exists() == session_exists


def test_sources_that_cannot_be_recognised(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "text.txt").write_text("text")
    (tmp_path / "text.png").write_text("text")
    (tmp_path / "mixed").mkdir()
    (tmp_path / "mixed" / "readme.txt").write_text("text")
    SessionStore.create(tmp_path / "session")
    cases = {
        "none": "missing-file", "empty": "empty-folder", "text.txt": "unknown-format", "text.png": "not-an-image",
        "mixed": "unknown-format", "session": "is-a-session",
    }  # fmt: skip
    for name, code in cases.items():
        with pytest.raises(BadInput, match=name) as caught:
            ingest(tmp_path / "s", [tmp_path / name])
        assert (name, caught.value.code) == (name, code)
        assert caught.value.remedy
    assert not (tmp_path / "s").exists()


def test_sensor_values_alone_are_not_in_this_version(tmp_path: Path) -> None:
    (tmp_path / "a.raw").write_bytes(b"raw")
    with pytest.raises(NotInThisVersion, match="not in this version") as caught:
        ingest(tmp_path / "s", [tmp_path / "a.raw"])
    assert caught.value.exit_code == 2
    assert not (tmp_path / "s").exists()


def test_the_kind_that_was_asked_for(tmp_path: Path, sai: Path, photo: Path) -> None:
    with pytest.raises(BadInput, match="as a photo"):
        ingest(tmp_path / "s", [sai], kind="photo")
    with pytest.raises(BadInput, match="14×14"):
        ingest(tmp_path / "s", [photo], kind="light_field")
    capture = write_capture_folder(tmp_path / "c", {"kind": "photo", "image": "p.png"}, {"p.png": view(0, 0)})
    with pytest.raises(BadInput, match="is a photo, not a light field"):
        ingest(tmp_path / "s", [capture], kind="light_field")
    assert ingest(tmp_path / "s", [photo], kind="photo")[0].kind == "photo"


def test_a_folder_that_is_no_session_is_not_made_one(tmp_path: Path, sai: Path, photo: Path) -> None:
    before = tree(tmp_path)
    with pytest.raises(BadInput) as caught:
        ingest(sai, [photo])
    assert caught.value.code == "not-a-session"
    assert tree(tmp_path) == before


class Stops(Monitor):
    """Does something at its n-th step."""

    def __init__(self, after: int, error: type[BaseException] | None) -> None:
        super().__init__()
        self.left, self.error = after, error

    def on_advance(self, steps: int) -> None:
        self.left -= steps
        if self.left == 0:
            if self.error is not None:
                raise self.error
            self.cancel()


@pytest.mark.parametrize("error", [KeyboardInterrupt, None], ids=["Ctrl-C", "cancel"])
@pytest.mark.parametrize("after", [1, 5, 9, 10, 11, 18])
@pytest.mark.parametrize("session_exists", [True, False])
def test_stopping_at_any_step_leaves_everything_as_it_was(
    tmp_path: Path, after: int, error: type[BaseException] | None, session_exists: bool
) -> None:
    sources = [write_view_folder(tmp_path / f"in{n}", "{row}_{col}.png", seed=n) for n in range(3)]
    if session_exists:
        ingest(tmp_path / "s", sources[:1])
    before = tree(tmp_path)
    with pytest.raises(error or Interrupted):
        ingest(tmp_path / "s", sources[1:], monitor=Stops(after, error))
    assert tree(tmp_path) == before
    assert (tmp_path / "s").exists() == session_exists
    assert len(ingest(tmp_path / "s", sources)) == 3


def test_a_real_interrupt_signal_leaves_a_valid_session(tmp_path: Path, sai: Path, photo: Path) -> None:
    ingest(tmp_path / "s", [photo])
    before = tree(tmp_path)
    script = f"""
import os, signal
from lfrig.contracts.progress import Monitor
from lfrig.rig.ingest import ingest
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job inherits it ignored
class Signals(Monitor):
    def on_advance(self, steps):
        os.kill(os.getpid(), signal.SIGINT)
ingest({str(tmp_path / "s")!r}, [{str(sai)!r}], monitor=Signals())
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == -signal.SIGINT
    assert "KeyboardInterrupt" in done.stderr
    assert tree(tmp_path) == before


def test_a_read_only_session_is_a_disk_error(tmp_path: Path, sai: Path, photo: Path) -> None:
    ingest(tmp_path / "s", [photo])
    before = tree(tmp_path / "s")
    with read_only(tmp_path / "s"), pytest.raises(DiskError) as caught:
        ingest(tmp_path / "s", [sai])
    assert caught.value.exit_code == 6
    assert tree(tmp_path / "s") == before


def test_a_disk_that_fills_up_is_a_disk_error(
    tmp_path: Path, sai: Path, photo: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ingest(tmp_path / "s", [photo])
    before = tree(tmp_path / "s")
    real, copies = shutil.copyfile, iter(range(100))

    def copyfile(source: Path, target: Path) -> Path:
        if next(copies) == 4:
            raise OSError(28, "No space left on device", os.fspath(target))
        return real(source, target)

    monkeypatch.setattr(shutil, "copyfile", copyfile)
    with pytest.raises(DiskError) as caught:
        ingest(tmp_path / "s", [sai])
    monkeypatch.undo()
    assert caught.value.code == "disk-full"
    assert str(tmp_path / "s" / "captures" / "001") in caught.value.message
    assert tree(tmp_path / "s") == before


def test_a_session_that_was_empty_stays(tmp_path: Path, sai: Path) -> None:
    SessionStore.create(tmp_path / "s")
    with pytest.raises(KeyboardInterrupt):
        ingest(tmp_path / "s", [sai], monitor=Stops(3, KeyboardInterrupt))
    assert SessionStore.open(tmp_path / "s").document.captures == []


def test_progress_counts_every_view_and_every_source(tmp_path: Path, sai: Path, photo: Path) -> None:
    class Counter(Monitor):
        steps = 0

        def on_advance(self, steps: int) -> None:
            Counter.steps += steps

    ingest(tmp_path / "s", [sai, photo], monitor=Counter())
    assert Counter.steps == 9 + 2


def test_a_bad_pattern_is_a_usage_error(tmp_path: Path, sai: Path) -> None:
    for pattern in ("view.png", "../{row}{col}.png", "{row}_{column}.png"):
        with pytest.raises(UsageError, match="--pattern"):
            ingest(tmp_path / "s", [sai], pattern=pattern)


def test_opening_without_a_session(tmp_path: Path, sai: Path, photo: Path) -> None:
    light_field = open_light_field(sai)
    assert np.array_equal(light_field.views, views())
    assert light_field.id == "sai"
    store = SessionStore.create(tmp_path / "s")
    store.add_light_field(views(), known_document())
    opened, loaded = open_light_field(store.capture_folder("000")), store.load_light_field("000")
    assert np.array_equal(opened.views, loaded.views)
    assert opened.camera == loaded.camera
    assert opened.optics == loaded.optics
    with pytest.raises(BadInput) as caught:
        open_light_field(photo)
    assert caught.value.code == "not-a-light-field"
    with pytest.raises(BadInput, match="is a session"):
        open_light_field(tmp_path / "s")


def test_opening_can_be_cancelled(sai: Path) -> None:
    monitor = Monitor()
    monitor.cancel()
    with pytest.raises(Interrupted):
        open_light_field(sai, monitor=monitor)
