"""Calibrations: read where they are, hostile ones refused by name, and the rule that chooses the white image."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lfrig.bench.lytro_files import (
    SmallShot,
    calibration_files,
    encoded,
    hot_pixel_list,
    reference,
    tar_bytes,
    white_files,
)
from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import ILLUM
from lfrig.processing.lenslet.archive import ArchiveLimits, open_archive
from lfrig.processing.lenslet.calibration import Calibration, parse_hot_pixels
from lfrig.processing.lenslet.container import parse_container
from lfrig.processing.lenslet.metadata import RawMetadata, read_metadata

SETTINGS = [
    SmallShot(zoom_step=600, focus_step=900, geometry=b"a", seed=1),
    SmallShot(zoom_step=600, focus_step=300, geometry=b"b", seed=2),
    SmallShot(zoom_step=100, focus_step=900, geometry=b"c", seed=3),
]


def shot(**options: object) -> RawMetadata:
    from lfrig.bench.lytro_files import shot_file

    return read_metadata(parse_container(memoryview(shot_file(SmallShot(**options))), "x"))  # type: ignore[arg-type]


def write(path: Path, data: bytes) -> Path:
    path.write_bytes(data)
    return path


@pytest.fixture
def tar(tmp_path: Path) -> Path:
    return write(tmp_path / "caldata.tar", tar_bytes(calibration_files(SETTINGS, [(3, 4), (19, 17)])))


def as_folder(folder: Path, files: dict[str, bytes]) -> Path:
    folder.mkdir()
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


# -- where it is read from ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["tar", "gz", "folder", "nested folder", "pax", "gnu"])
def test_the_same_calibration_in_every_form(tmp_path: Path, kind: str) -> None:
    files = calibration_files(SETTINGS, [(3, 4), (19, 17)])
    if "folder" in kind:
        path = as_folder(tmp_path / "unitdata", files)
        path = tmp_path if kind == "nested folder" else path
    elif kind in ("pax", "gnu"):
        stream = io.BytesIO()
        form = tarfile.PAX_FORMAT if kind == "pax" else tarfile.GNU_FORMAT
        with tarfile.open(fileobj=stream, mode="w", format=form) as archive:
            for name, data in files.items():
                entry = tarfile.TarInfo(f"./{'d' * 120}/{name}")
                entry.size, entry.mtime = len(data), 1.5
                archive.addfile(entry, io.BytesIO(data))
        path = write(tmp_path / "cal.tar", stream.getvalue())
    else:
        path = write(tmp_path / "cal.tar", tar_bytes(files, mode="w:gz" if kind == "gz" else "w"))
    found = Calibration.open(path)
    assert [entry.name for entry in found.entries] == ["MOD_0000", "MOD_0001", "MOD_0002"]
    assert [entry.geometry_ref for entry in found.entries] == [reference(b"a"), reference(b"b"), reference(b"c")]
    assert found.problems == []
    assert found.hot_pixels(shot()).tolist() == [[3, 4], [19, 17]]
    for entry, setting in zip(found.entries, SETTINGS, strict=True):
        white = found.load(entry)
        np.testing.assert_array_equal(white.sensor, setting.values(0.7))
        assert white.name == entry.name
        assert reference(files[f"{entry.name}.RAW"]) == f"sha1-{white.sha1}"


def test_one_white_image_and_its_text(tmp_path: Path) -> None:
    folder = as_folder(tmp_path / "loose", white_files(SETTINGS[1], 7) | {"other.RAW": b"x", "notes.txt": b"?"})
    found = Calibration.open(folder / "MOD_0007.RAW")
    assert [entry.name for entry in found.entries] == ["MOD_0007"]
    assert found.load(found.entries[0]).sensor.shape == (18, 20)
    with pytest.raises(BadInput, match="no white image"):
        Calibration.open(folder / "other.RAW")


def test_the_manifest_is_not_needed_and_its_hash_wins(tmp_path: Path) -> None:
    files = calibration_files(SETTINGS)
    manifest = "cal_file_manifest.json"
    del files[manifest]
    without = Calibration.open(write(tmp_path / "a.tar", tar_bytes(files)))
    assert without.entries[0].geometry_ref == reference(b"a")
    files[manifest] = encoded({"calibrationFiles": [{"name": "MOD_0000.GCT", "hash": "A" * 40}, 3, {"name": 5}]})
    assert Calibration.open(write(tmp_path / "b.tar", tar_bytes(files))).entries[0].geometry_ref == "sha1-" + "a" * 40
    files[manifest] = b"{"
    broken = Calibration.open(write(tmp_path / "c.tar", tar_bytes(files)))
    assert broken.entries[0].geometry_ref == reference(b"a")
    assert [manifest in problem for problem in broken.problems] == [True]


def test_a_broken_text_costs_its_white_image_alone(tmp_path: Path) -> None:
    files = calibration_files(SETTINGS) | {"MOD_0001.TXT": b"{"}
    found = Calibration.open(write(tmp_path / "a.tar", tar_bytes(files)))
    assert [entry.name for entry in found.entries] == ["MOD_0000", "MOD_0002"]
    assert len(found.problems) == 1
    assert "MOD_0001.TXT" in found.problems[0]


# -- what is refused -----------------------------------------------------------------------------------------------
def member(name: str, data: bytes = b"x", kind: bytes = tarfile.REGTYPE) -> Callable[[tarfile.TarFile], None]:
    def add(archive: tarfile.TarFile) -> None:
        entry = tarfile.TarInfo(name)
        entry.type, entry.linkname = kind, "/etc/passwd"
        entry.size = len(data) if kind == tarfile.REGTYPE else 0
        archive.addfile(entry, io.BytesIO(data))

    return add


@pytest.mark.parametrize(
    ("add", "name"),
    [
        (member("../outside.RAW"), "../outside.RAW"), (member("a/../../x"), "a/../../x"),
        (member("/etc/cron"), "/etc/cron"),
        (member("C:\\x.RAW"), "C:\\x.RAW"), (member("..\\x"), "..\\x"), (member("link", kind=tarfile.SYMTYPE), "link"),
        (member("hard", kind=tarfile.LNKTYPE), "hard"), (member("tty", kind=tarfile.CHRTYPE), "tty"),
        (member("disk", kind=tarfile.BLKTYPE), "disk"), (member("pipe", kind=tarfile.FIFOTYPE), "pipe"),
        (member("sparse", kind=tarfile.GNUTYPE_SPARSE), "sparse"),
        (member("b" * 150 + "/../../x"), "b" * 150 + "/../../x"),
    ],
)  # fmt: skip
def test_unsafe_members_are_refused(tmp_path: Path, add: Callable[[tarfile.TarFile], None], name: str) -> None:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        member("MOD_0000.TXT")(archive)
        add(archive)
    path = write(tmp_path / "evil.tar", stream.getvalue())
    with pytest.raises(BadInput) as caught:
        Calibration.open(path)
    assert (caught.value.code, caught.value.path, caught.value.field) == ("unsafe-member", str(path), name)
    assert [entry.name for entry in tmp_path.iterdir()] == ["evil.tar"], "nothing is extracted"


def patched(data: bytes, at: int, field: bytes) -> bytes:
    """A tar whose first header has another field, its checksum made right again."""
    header = bytearray(data[:512])
    header[at : at + len(field)] = field
    header[148:156] = b" " * 8
    header[148:156] = f"{sum(header):06o}\0 ".encode()
    return bytes(header) + data[512:]


def test_sizes_counts_and_damage_are_named(tmp_path: Path) -> None:
    whole = tar_bytes(calibration_files(SETTINGS))
    huge, beyond = b"77777777777\0", b"00000777777\0"
    cases = {
        "empty": (b"", "not-a-calibration"),
        "text": (b"hello" * 300, "not-a-calibration"),
        "zip": (b"PK\x03\x04" + bytes(2000), "not-a-calibration"),
        "oversize": (patched(whole, 124, huge), "too-large"),
        "base256": (patched(whole, 124, b"\x80" + b"\xff" * 11), "too-large"),
        "no number": (patched(whole, 124, b"12x45678901\0"), "garbage"),
        "torn": (patched(whole, 124, beyond), "truncated"),
        "cut": (whole[:700], "truncated"),
        "checksum": (whole[:1024] + b"Q" + whole[1025:], "garbage"),
        "long name": (patched(patched(whole, 156, b"L"), 124, b"00007777777\0"), "too-large"),
        "no images": (tar_bytes({"readme": b"x"}), "no-white-image"),
        "only zeros": (bytes(10240), "no-white-image"),
    }
    for name, (data, code) in cases.items():
        path = write(tmp_path / f"{name}.tar", data)
        with pytest.raises(BadInput) as caught:
            Calibration.open(path)
        assert (name, caught.value.code, caught.value.path) == (name, code, str(path))
        assert caught.value.remedy
    squeezed = write(tmp_path / "torn.tar.gz", tar_bytes(calibration_files(SETTINGS), mode="w:gz")[:-60])
    with pytest.raises(BadInput) as caught:
        Calibration.open(squeezed)
    assert caught.value.code == "truncated"
    with pytest.raises(BadInput) as caught:
        Calibration.open(tmp_path / "gone.tar")
    assert caught.value.code == "missing-file"


def test_limits_hold_for_every_form(tmp_path: Path) -> None:
    files = calibration_files(SETTINGS)
    folder = as_folder(tmp_path / "folder", files)
    tar, squeezed = (
        write(tmp_path / "a.tar", tar_bytes(files)),
        write(tmp_path / "b.tar", tar_bytes(files, mode="w:gz")),
    )
    for path in (folder, tar, squeezed):
        with pytest.raises(BadInput) as caught:
            open_archive(path, ArchiveLimits(members=5))
        assert caught.value.code == "too-many-files"
    for path in (tar, squeezed):
        with pytest.raises(BadInput):
            open_archive(path, ArchiveLimits(archive_bytes=4096))
        with pytest.raises(BadInput) as caught:
            open_archive(path, ArchiveLimits(member_bytes=400))
        assert caught.value.code == "too-large"
    with pytest.raises(BadInput) as caught:
        open_archive(folder, ArchiveLimits(member_bytes=400)).read("MOD_0000.TXT")
    assert caught.value.code == "too-large"


def test_a_gzip_bomb_is_refused_by_its_header(tmp_path: Path) -> None:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w:gz") as archive:
        entry = tarfile.TarInfo("MOD_0000.RAW")
        entry.size = 3 << 20
        archive.addfile(entry, io.BytesIO(bytes(entry.size)))
    assert len(stream.getvalue()) < 8192
    with pytest.raises(BadInput) as caught:
        open_archive(write(tmp_path / "bomb.tar.gz", stream.getvalue()), ArchiveLimits(member_bytes=1 << 20))
    assert caught.value.code == "too-large"


# -- the rule --------------------------------------------------------------------------------------------------------
def best(calibration: Calibration, known: RawMetadata) -> tuple[str, str, int | None, int | None] | None:
    matches = calibration.matches(known)
    found = matches[0] if matches else None
    return (found.entry.name, found.rule, found.zoom_steps, found.focus_steps) if found else None


def test_the_exact_one_then_the_nearest_by_zoom_then_focus(tar: Path) -> None:
    calibration = Calibration.open(tar)
    assert best(calibration, shot(geometry=b"c")) == ("MOD_0002", "exact", -500, 0)
    assert best(calibration, shot(geometry=b"?")) == ("MOD_0000", "nearest", 0, 0)
    assert best(calibration, shot(geometry=None, focus_step=550)) == ("MOD_0001", "nearest", 0, -250)
    assert best(calibration, shot(geometry=None, zoom_step=200, focus_step=300)) == ("MOD_0002", "nearest", -100, 600)
    unknown = replace(shot(geometry=None), zoom_step=None, focus_step=None)
    assert best(calibration, unknown) == ("MOD_0000", "nearest", None, None)


def test_another_camera_or_sensor_does_not_fit(tar: Path) -> None:
    calibration = Calibration.open(tar)
    assert calibration.matches(shot(serial="B514OTHER")) == []
    assert calibration.matches(shot(width=24)) == []
    assert len(calibration.matches(replace(shot(), serial=None))) == 3


def test_of_equal_settings_the_longer_exposure(tmp_path: Path) -> None:
    files = white_files(SETTINGS[0], 0) | white_files(SETTINGS[0], 1)
    files["MOD_0001.TXT"] = files["MOD_0001.TXT"].replace(
        b'"pixelExposureDuration": 0.008', b'"pixelExposureDuration": 0.1'
    )
    calibration = Calibration.open(write(tmp_path / "a.tar", tar_bytes(files)))
    assert best(calibration, shot(geometry=None)) == ("MOD_0001", "nearest", 0, 0)


def test_dark_and_torn_white_images_are_refused(tmp_path: Path) -> None:
    files = white_files(SETTINGS[0], 0, level=0.0) | white_files(SETTINGS[1], 1)
    files["MOD_0001.RAW"] = files["MOD_0001.RAW"][:-5]
    calibration = Calibration.open(write(tmp_path / "a.tar", tar_bytes(files)))
    dark = replace(SETTINGS[0], seed=5)
    assert dark.values(0.0).mean() > ILLUM.black
    files_black = files | {"MOD_0000.RAW": bytes([16, 16, 16, 16, 0]) * 90}
    black = Calibration.open(write(tmp_path / "b.tar", tar_bytes(files_black)))
    with pytest.raises(BadInput, match=r"0\.0 %") as caught:
        black.load(black.entries[0])
    assert caught.value.code == "dark-white-image"
    with pytest.raises(BadInput, match="445 bytes") as caught:
        calibration.load(calibration.entries[1])
    assert caught.value.code == "wrong-size"


# -- hot pixels ----------------------------------------------------------------------------------------------------
def test_lists_of_hot_pixels() -> None:
    known = shot()
    assert parse_hot_pixels(memoryview(hot_pixel_list([])), known, Path("x"), "f").shape == (0, 2)
    places = [(0, 17), (19, 0)]
    found = parse_hot_pixels(memoryview(hot_pixel_list(places)), known, Path("x"), "f")
    assert found.dtype == np.int32
    assert found.tolist() == [list(place) for place in places]
    bad = [b"", b"\1\0\0", b"\1\0\0\0", b"\xff\xff\xff\xff", hot_pixel_list([(20, 0)]), hot_pixel_list([(0, 18)]),
           hot_pixel_list([(-1, 0)]), hot_pixel_list(places)[:-1], hot_pixel_list(places) + b"x"]  # fmt: skip
    for data in bad:
        with pytest.raises(BadInput) as caught:
            parse_hot_pixels(memoryview(data), known, Path("x"), "f")
        assert caught.value.code == "bad-hot-pixels"
