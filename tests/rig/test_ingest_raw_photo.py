"""Raw photos: developed as defined, kept as they are, refused by name; 16 bits from the sensor to the result."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from lfrig.bench.lytro_files import SmallShot, shot_file
from lfrig.contracts.capture import CaptureDocument
from lfrig.contracts.errors import BadInput, LfrigError, ProcessingError
from lfrig.contracts.progress import Monitor
from lfrig.rig.cli import main
from lfrig.rig.info import describe
from lfrig.rig.ingest import ingest
from lfrig.rig.session import raw_photo
from lfrig.rig.session.exif import SIGMA_FROM_35MM, SIGMA_FROM_PLANE_RESOLUTION, upright
from lfrig.rig.session.raw_photo import develop, read_header
from lfrig.rig.session.store import SessionStore
from lfrig.rig.session.tiff_blocks import fault_of_blocks
from lfrig.sim.shoot import shoot
from tests.rig.raw_photos import (
    ACTIVE_AREA,
    DEFAULT_SCALE,
    IMAGE_LENGTH,
    IMAGE_WIDTH,
    NEUTRAL,
    ORIENTATION,
    STRIP_OFFSETS,
    compressed_dng,
    exif_dng,
    lossless_jpeg,
    mosaic,
    patched,
    rational,
    scene_dng,
    smooth_scene,
    srgb16,
    write_dng,
)
from tests.rig.session_files import tree

H, W = 48, 64
LINEAR_RAW = 34892
FOCAL, FILM, PLANE_X, UNIT, EXPOSURE, ISO, TIME = 0x920A, 0xA405, 0xA20E, 0xA210, 0x829A, 0x8827, 0x9003


def short(value: int) -> tuple[int, bytes]:
    return 3, struct.pack("<H", value)


def ratio(numerator: int, denominator: int = 1) -> tuple[int, bytes]:
    return 5, struct.pack("<II", numerator, denominator)


@pytest.fixture
def dng(tmp_path: Path) -> Path:
    return scene_dng(tmp_path / "photo.dng")


class TestDeveloping:
    def test_colours_are_those_of_the_scene(self, dng: Path) -> None:
        """White balance, colour matrix and curve undo what the sensor did, to a few of 65535 steps."""
        image = develop(dng)
        assert (image.dtype, image.shape) == (np.uint16, (H, W, 3))
        error = np.abs(image - srgb16(smooth_scene(H, W)))
        assert error[2:-2, 2:-2].max() < 12
        assert error.max() < 1000  # at the border there is less to interpolate from

    def test_more_than_8_bits_are_real(self, dng: Path) -> None:
        low = develop(dng) & 0xFF
        assert len(np.unique(low)) > 200

    def test_brightness_does_not_depend_on_the_content(self, tmp_path: Path) -> None:
        """Half the light is half the light: nothing is stretched to white."""
        dark = develop(write_dng(tmp_path / "dark.dng", mosaic(0.5 * smooth_scene(H, W))))
        assert np.abs(dark - srgb16(0.5 * smooth_scene(H, W)))[2:-2, 2:-2].max() < 12

    def test_what_is_brighter_than_white_is_white(self, tmp_path: Path) -> None:
        """The channel that saturates first must not leave a tint."""
        image = develop(write_dng(tmp_path / "p.dng", np.full((H, W), 15000, np.uint16)))
        assert (image == 65535).all()

    def test_the_same_file_gives_the_same_bytes(self, dng: Path) -> None:
        assert develop(dng).tobytes() == develop(dng).tobytes()

    @pytest.mark.parametrize("orientation", range(1, 9))
    def test_orientation_is_applied(self, tmp_path: Path, dng: Path, orientation: int) -> None:
        path = scene_dng(tmp_path / "turned.dng", extra=((ORIENTATION, "H", 1, orientation, True),))
        image, header = develop(path), read_header(path)
        assert np.array_equal(image, upright(develop(dng), orientation))
        assert (header.width, header.height) == image.shape[1::-1]

    @pytest.mark.parametrize("scale", [(1, 2), (2, 1)])
    def test_pixels_become_square(self, tmp_path: Path, scale: tuple[int, int]) -> None:
        tags = ((ORIENTATION, "H", 1, 6, True), (DEFAULT_SCALE, "2I", 2, rational(scale), True))
        path = scene_dng(tmp_path / "p.dng", extra=tags)
        header = read_header(path)
        assert develop(path).shape == (header.height, header.width, 3)
        assert (header.width, header.height) == (H * scale[1], W * scale[0])

    def test_masked_pixels_at_the_border_are_left_out(self, tmp_path: Path, dng: Path) -> None:
        path = scene_dng(tmp_path / "p.dng", extra=((ACTIVE_AREA, "I", 4, (2, 4, H - 6, W - 8), True),))
        inside, whole = develop(path)[4:-4, 4:-4].astype(int), develop(dng)[6:-10, 8:-12]
        assert np.abs(inside - whole).max() <= 4  # the directions of the demosaic are chosen anew

    def test_lossless_compression_loses_nothing(self, tmp_path: Path, dng: Path) -> None:
        values = mosaic(smooth_scene(H, W))
        path = compressed_dng(tmp_path / "p.dng", values, lossless_jpeg(values))
        assert path.stat().st_size > dng.stat().st_size
        assert np.array_equal(develop(path), develop(dng))

    def test_pixels_that_have_all_colours(self, tmp_path: Path) -> None:
        camera = np.rint(200 + 14800 * smooth_scene(H, W) * NEUTRAL).astype(np.uint16)
        image = develop(write_dng(tmp_path / "p.dng", camera, photometric=LINEAR_RAW))
        assert np.abs(image - srgb16(smooth_scene(H, W))).max() < 12

    def test_without_recorded_white_balance_the_scene_is_taken_for_grey(self, tmp_path: Path) -> None:
        image = develop(scene_dng(tmp_path / "p.dng", neutral=None))
        means = image.reshape(-1, 3).mean(0)
        assert np.ptp(means) < 0.02 * means.mean()


class TestIngest:
    def test_the_file_is_kept_and_read_where_photos_are(self, tmp_path: Path, dng: Path) -> None:
        monitor = Monitor()
        [done] = ingest(tmp_path / "s", [dng], monitor=monitor)
        assert (done.kind, done.format) == ("photo", "photo")
        assert [notice.code for notice in monitor.notices] == ["no-focal-length"]
        store = SessionStore.open(tmp_path / "s")
        assert (store.capture_folder("000") / "photo.dng").read_bytes() == dng.read_bytes()
        photo = store.load_photo("000")
        assert photo.image.dtype == np.uint16
        assert np.array_equal(photo.image, develop(dng))
        assert photo.camera is None

    def test_suffixes_in_capitals_and_turned_photos(self, tmp_path: Path) -> None:
        path = scene_dng(tmp_path / "P.DNG", extra=((ORIENTATION, "H", 1, 6, True),))
        ingest(tmp_path / "s", [path])
        store = SessionStore.open(tmp_path / "s")
        document = store.capture("000")
        assert document.image == "photo.dng"
        assert document.camera is not None
        assert (document.camera.width, document.camera.height) == (H, W)
        assert store.load_photo("000").image.shape == (W, H, 3)

    def test_focal_length_from_the_resolution_of_the_sensor(self, tmp_path: Path) -> None:
        tags = {FOCAL: ratio(50), PLANE_X: ratio(20, 1), UNIT: short(3), EXPOSURE: ratio(1, 50), ISO: short(200)}
        tags[TIME] = (2, b"2024:05:06 07:08:09\0")
        ingest(tmp_path / "s", [exif_dng(tmp_path / "p.dng", tags)])
        store = SessionStore.open(tmp_path / "s")
        document, camera = store.capture("000"), store.load_photo("000").camera
        assert camera is not None
        assert (camera.focal_px, camera.sigma_focal) == (pytest.approx(100.0), SIGMA_FROM_PLANE_RESOLUTION)
        assert document.time == "2024-05-06T07:08:09"
        assert document.exposure is not None
        assert (document.exposure.time_s, document.exposure.iso) == (pytest.approx(0.02), 200)

    def test_focal_length_from_the_35_mm_equivalent(self, tmp_path: Path) -> None:
        ingest(tmp_path / "s", [exif_dng(tmp_path / "p.dng", {FILM: short(50)}, height=40, width=60)])
        camera = SessionStore.open(tmp_path / "s").load_photo("000").camera
        assert camera is not None
        assert (camera.focal_px, camera.sigma_focal) == (pytest.approx(50 / 36 * 60), SIGMA_FROM_35MM)

    def test_a_capture_written_by_hand(self, tmp_path: Path) -> None:
        """Without a camera in capture.json the focal length is the file's."""
        folder = tmp_path / "s" / "captures" / "a"
        folder.mkdir(parents=True)
        exif_dng(folder / "p.dng", {FILM: short(50)}, height=40, width=60)
        CaptureDocument(kind="photo", image="p.dng").save(folder / "capture.json")
        (tmp_path / "s" / "session.json").write_text('{"schema": "lfrig.session/1", "captures": ["a"]}')
        photo = SessionStore.open(tmp_path / "s").load_photo("a")
        assert photo.image.dtype == np.uint16
        assert photo.camera is not None
        assert photo.camera.focal_px == pytest.approx(50 / 36 * 60)

    def test_damaged_exif_costs_the_metadata_only(self, tmp_path: Path) -> None:
        path = exif_dng(tmp_path / "p.dng", {FILM: short(50)})
        data = bytearray(path.read_bytes())
        data[-14:-12] = b"\xff\x7f"  # a type that TIFF does not have
        path.write_bytes(data)
        ingest(tmp_path / "s", [path])
        document = SessionStore.open(tmp_path / "s").capture("000")
        assert document.camera is not None
        assert (document.camera.width, document.camera.fx) == (W, None)

    def test_info_says_what_it_is(self, dng: Path) -> None:
        found = describe(dng)
        assert (found["type"], found["summary"]) == ("photo", f"photo at {W}×{H} px")


def broken(name: str, path: Path) -> Path:
    """A file that is no whole raw photo."""
    whole = scene_dng(path).read_bytes()
    pixels = mosaic(smooth_scene(H, W))
    data: dict[str, Callable[[], bytes]] = {
        "empty": lambda: b"",
        "text": lambda: b"this is a text\n" * 50,
        "jpeg": lambda: bytes(cv2.imencode(".jpg", np.zeros((H, W, 3), np.uint8))[1]),
        "half": lambda: whole[: len(whole) // 2],
        "last-bytes": lambda: whole[:-10],
        "header-only": lambda: whole[:200],
        "light-field": lambda: shot_file(SmallShot(width=120, height=96)),
        "claims-gigapixels": lambda: patched(whole, {IMAGE_WIDTH: 60000, IMAGE_LENGTH: 60000}),
        "claims-more": lambda: patched(whole, {IMAGE_WIDTH: 9000, IMAGE_LENGTH: 9000}),
        "no-pixels": lambda: patched(whole, {IMAGE_WIDTH: 0}),
        "compressed-half": lambda: compressed_dng(path, pixels, lossless_jpeg(pixels)).read_bytes()[: len(whole) + 99],
        "compressed-gone": lambda: compressed_dng(path, pixels, lossless_jpeg(pixels)).read_bytes()[: len(whole)],
        "compressed-empty": lambda: compressed_dng(path, pixels, bytes(2000)).read_bytes(),
    }
    path.write_bytes(data[name]())
    return path


BROKEN = {
    "empty": "empty-file", "text": "not-a-raw-photo", "jpeg": "not-a-raw-photo", "half": "truncated-image",
    "last-bytes": "truncated-image", "header-only": "truncated-image", "claims-gigapixels": "image-too-large",
    "claims-more": "truncated-image", "no-pixels": "not-a-raw-photo", "compressed-half": "truncated-image",
    "compressed-gone": "truncated-image", "compressed-empty": "damaged-image",
}  # fmt: skip


class TestBadInput:
    @pytest.mark.parametrize("name", BROKEN)
    def test_ingest_refuses_by_name_and_changes_nothing(
        self, tmp_path: Path, capfd: pytest.CaptureFixture[str], name: str
    ) -> None:
        path = broken(name, tmp_path / "photo.dng")
        assert main(["ingest", str(tmp_path / "s"), str(path)]) == 3
        out, err = capfd.readouterr()
        assert out == ""
        assert len(err.splitlines()) == 1, err  # LibRaw's own words are not shown
        assert err.startswith(f"lfrig: error: {path}: ")
        assert " — " in err
        assert not (tmp_path / "s").exists()
        with pytest.raises(BadInput) as caught:
            ingest(tmp_path / "s", [path])
        assert caught.value.code == BROKEN[name]

    def test_a_light_field_is_no_photo(self, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        for path in (broken("light-field", tmp_path / "a.dng"), broken("light-field", tmp_path / "a.lfr")):
            assert main(["ingest", str(tmp_path / "s"), str(path), "--as", "photo"]) == 3
            assert "is a raw light field, not a photo — " in capfd.readouterr().err
        assert not (tmp_path / "s").exists()

    def test_a_raw_photo_is_no_light_field(self, tmp_path: Path, dng: Path, capfd: pytest.CaptureFixture[str]) -> None:
        assert main(["ingest", str(tmp_path / "s"), str(dng), "--as", "light-field"]) == 3
        assert "light field" in capfd.readouterr().err
        assert not (tmp_path / "s").exists()

    @pytest.mark.parametrize("name", ["half", "light-field", "empty"])
    def test_a_capture_that_names_a_broken_one(self, tmp_path: Path, dng: Path, name: str) -> None:
        ingest(tmp_path / "s", [dng])
        store = SessionStore.open(tmp_path / "s")
        broken(name, store.capture_folder("000") / "photo.dng")
        with pytest.raises(BadInput, match=r"photo\.dng: is "):
            store.load_photo("000")

    def test_a_missing_file(self, tmp_path: Path) -> None:
        with pytest.raises(BadInput, match="does not exist"):
            develop(tmp_path / "photo.dng")

    def test_bad_codes_in_compressed_pixels(self, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
        """Where they lead out of the range of values; lossless JPEG has no checksum that would tell the others."""
        values = mosaic(smooth_scene(H, W))
        data = bytearray(lossless_jpeg(values, 14))
        path = compressed_dng(tmp_path / "p.dng", values, bytes(data))
        assert np.array_equal(develop(path), develop(scene_dng(tmp_path / "whole.dng")))
        data[3301] ^= 0x55
        compressed_dng(path, values, bytes(data))
        with pytest.raises(BadInput) as caught:
            develop(path)
        assert caught.value.code == "damaged-image"
        assert capfd.readouterr() == ("", "")

    def test_without_the_library(self, dng: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        import sys

        monkeypatch.setitem(sys.modules, "rawpy", None)
        with pytest.raises(ProcessingError, match="need the package rawpy") as caught:
            develop(dng)
        assert "pip install rawpy" in caught.value.remedy

    def test_other_failures_of_the_library_are_named(self, dng: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        import rawpy

        monkeypatch.setattr(raw_photo, "fault_of_blocks", lambda path: None)
        for error, code in (
            (rawpy.LibRawDataError, "damaged-image"),
            (rawpy.LibRawTooBigError, "image-too-large"),
            (rawpy.LibRawUnspecifiedError, "not-a-raw-photo"),
        ):

            def fail(path: str, error: type[Exception] = error) -> Any:
                raise error(b"words")

            monkeypatch.setattr(rawpy, "imread", fail)
            with pytest.raises(BadInput) as caught:
                read_header(dng)
            assert caught.value.code == code


class TestBlocks:
    """Where a TIFF file keeps its pixels."""

    def test_a_whole_file_lacks_nothing(self, dng: Path) -> None:
        assert fault_of_blocks(dng) is None

    def test_blocks_beyond_the_end(self, dng: Path) -> None:
        data = dng.read_bytes()
        dng.write_bytes(patched(data, {STRIP_OFFSETS: len(data)}))
        assert fault_of_blocks(dng) == "torn"

    def test_of_other_formats_only_where_blocks_begin(self, tmp_path: Path) -> None:
        """Byte counts of makers' own formats are not always right, and LibRaw itself sees a file end in a block."""
        values = mosaic(smooth_scene(H, W))
        path = tmp_path / "p.nef"
        data = write_dng(path, values).read_bytes()
        renamed = patched(data, {50706: 0}, renamed={50706: 50000})
        path.write_bytes(renamed[:-10])
        assert fault_of_blocks(path) is None
        path.write_bytes(renamed[: -values.nbytes])
        assert fault_of_blocks(path) == "torn"

    @pytest.mark.parametrize("seed", range(8))
    def test_damaged_directories_never_fail(self, dng: Path, seed: int) -> None:
        rng = np.random.default_rng(seed)
        data = bytearray(dng.read_bytes())
        for _ in range(40):
            changed = data.copy()
            for at in rng.integers(4, 470, 6):
                changed[at] = rng.integers(256)
            dng.write_bytes(changed[: rng.integers(8, len(changed))])
            assert fault_of_blocks(dng) in (None, "torn", "damaged")
            try:
                read_header(dng)
            except LfrigError as error:
                assert error.remedy


def test_16_bits_from_the_sensor_to_the_result(tmp_path: Path) -> None:
    """A session whose photo is a DNG: the centre view of the result is what was developed, bit for bit."""
    height, width = 64, 96
    shot = shoot("tabletop", width, height, (-10.0, 10.0), 0.0, poses="given", truth_views=False)
    store = SessionStore.create(tmp_path / "s", shot.rig)
    for capture in shot.captures.values():
        if capture.pixels.ndim == 5:
            store.add_light_field(capture.pixels, capture.document)
            continue
        linear = (capture.pixels / 255.0) ** 2.2
        path = write_dng(tmp_path / "photo.dng", mosaic(linear))
        ingest(store.path, [path])
        folder = tmp_path / "s" / "captures" / "002"
        CaptureDocument.model_validate({**capture.document.model_dump(), "image": "photo.dng"}).save(
            folder / "capture.json"
        )
    before = tree(tmp_path / "s")
    out = tmp_path / "result"
    assert main(["process", str(tmp_path / "s"), "--bit-depth", "16", "--out", str(out)]) == 0
    centre = cv2.imread(str(out / "views" / "03_03.png"), cv2.IMREAD_UNCHANGED)
    assert centre is not None
    assert centre.dtype == np.uint16
    assert np.array_equal(centre[..., ::-1], develop(path))
    side = cv2.imread(str(out / "views" / "00_00.png"), cv2.IMREAD_UNCHANGED)
    assert side is not None
    assert len(np.unique(side & 0xFF)) > 200
    assert {name: data for name, data in tree(tmp_path / "s").items() if name in before} == before
