"""Picture files: what is decoded, and each way in which one can be broken."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image as Pillow

from lfrig.contracts.errors import BadInput, DiskError
from lfrig.rig.session import images
from lfrig.rig.session.images import encode_png, image_size, read_image, read_image8, write_png
from tests.rig.session_files import read_only, view

DEEP = np.random.default_rng(1).integers(0, 65536, (5, 7, 3)).astype(np.uint16)


def refused(path: Path, code: str) -> BadInput:
    with pytest.raises(BadInput) as caught:
        read_image(path)
    assert caught.value.code == code
    assert str(path) in caught.value.message
    assert caught.value.remedy
    return caught.value


@pytest.mark.parametrize("picture", [view(1, 2), DEEP], ids=["8 bit", "16 bit"])
def test_png_round_trip(tmp_path: Path, picture: np.ndarray) -> None:
    write_png(tmp_path / "sub" / "p.png", picture)
    read = read_image(tmp_path / "sub" / "p.png")
    assert read.dtype == picture.dtype
    assert np.array_equal(read, picture)
    assert image_size(tmp_path / "sub" / "p.png") == (picture.shape[1], picture.shape[0])
    assert encode_png(picture) == (tmp_path / "sub" / "p.png").read_bytes()


def test_sixteen_bits_become_eight_by_their_upper_half(tmp_path: Path) -> None:
    write_png(tmp_path / "p.png", DEEP)
    assert np.array_equal(read_image8(tmp_path / "p.png"), DEEP >> 8)


@pytest.mark.parametrize(("mode", "suffix"), [("L", "png"), ("P", "png"), ("RGBA", "png"), ("L", "jpg"), ("1", "png")])
def test_other_kinds_of_pixels_become_rgb(tmp_path: Path, mode: str, suffix: str) -> None:
    flat = Pillow.new("RGB", (8, 4), (200, 200, 200))
    picture = flat.convert(mode)
    picture.save(tmp_path / f"p.{suffix}")
    read = read_image(tmp_path / f"p.{suffix}")
    assert (read.shape, read.dtype) == ((4, 8, 3), np.uint8)
    assert np.array_equal(read, np.asarray(picture.convert("RGB")))


@pytest.mark.parametrize("suffix", ["jpg", "bmp", "ppm", "tif", "webp"])
def test_other_formats_are_read(tmp_path: Path, suffix: str) -> None:
    Pillow.fromarray(view(0, 0)).save(tmp_path / f"p.{suffix}", **({"lossless": True} if suffix == "webp" else {}))
    read = read_image(tmp_path / f"p.{suffix}")
    assert np.abs(read.astype(int) - view(0, 0)).mean() < (40 if suffix == "jpg" else 1e-9)
    assert image_size(tmp_path / f"p.{suffix}") == (16, 12)


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_sixteen_bit_tiff_is_kept(tmp_path: Path, planar: str) -> None:
    pixels = DEEP if planar == "contig" else np.moveaxis(DEEP, -1, 0)
    tifffile.imwrite(tmp_path / "p.tif", pixels, photometric="rgb", planarconfig=planar)
    assert np.array_equal(read_image(tmp_path / "p.tif"), DEEP)


def test_sixteen_bit_grey_tiff_becomes_rgb(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "p.tif", DEEP[..., 0])
    assert np.array_equal(read_image(tmp_path / "p.tif"), np.repeat(DEEP[..., :1], 3, -1))


def test_float_tiff_is_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "p.tif", DEEP[..., 0].astype(np.float32))
    refused(tmp_path / "p.tif", "not-8-or-16-bit")


def test_text_named_png_is_refused(tmp_path: Path) -> None:
    (tmp_path / "p.png").write_text("this is no picture")
    assert "not an image" in refused(tmp_path / "p.png", "not-an-image").message


def test_an_empty_file_and_a_missing_one_are_refused(tmp_path: Path) -> None:
    (tmp_path / "p.png").touch()
    refused(tmp_path / "p.png", "not-an-image")
    refused(tmp_path / "none.png", "missing-file")
    with pytest.raises(BadInput, match="cannot be read"):
        read_image(tmp_path)


@given(st.data())
def test_a_png_cut_off_anywhere_is_refused(data: st.DataObject) -> None:
    whole = encode_png(view(0, 0))
    cut = data.draw(st.integers(9, len(whole) - 1))
    with pytest.raises(BadInput) as caught:
        images.check_png(whole[:cut], Path("p.png"))
    assert caught.value.code == "truncated-image"


@given(st.data())
def test_a_flipped_byte_in_a_png_is_noticed(data: st.DataObject) -> None:
    whole = bytearray(encode_png(view(0, 0)))
    at = data.draw(st.integers(8, len(whole) - 1))
    whole[at] ^= data.draw(st.integers(1, 255))
    with pytest.raises(BadInput):
        images.check_png(bytes(whole), Path("p.png"))


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "bmp"])
def test_truncated_pictures_are_refused_and_nothing_is_printed(
    tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"p.{suffix}"
    Pillow.fromarray(view(0, 0, 64, 64)).save(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(BadInput, match=str(path)):
        read_image(path)
    assert capfd.readouterr() == ("", "")


def bomb(width: int, height: int) -> bytes:
    """A PNG whose header claims a size that its few bytes do not have."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = chunk(b"IDAT", zlib.compress(b"\0" * 1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + pixels + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(100_000, 100_000), (2**31 - 1, 2**31 - 1), (90_000_000, 1)])
def test_huge_headers_are_refused_before_decoding(
    tmp_path: Path, size: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "p.png").write_bytes(bomb(*size))
    monkeypatch.setattr(images, "_decode_png", lambda *_: pytest.fail("must not be decoded"))
    assert str(size[0]) in refused(tmp_path / "p.png", "image-too-large").message


@pytest.mark.parametrize("size", [(10_000, 9_000), (60_000, 60_000)])
def test_huge_headers_of_other_formats_are_refused(tmp_path: Path, size: tuple[int, int]) -> None:
    header = struct.pack("<2sIHHIIiiHHIIiiII", b"BM", 54, 0, 0, 54, 40, *size, 1, 24, 0, 0, 0, 0, 0, 0)
    (tmp_path / "p.bmp").write_bytes(header)
    refused(tmp_path / "p.bmp", "image-too-large")


def test_a_zero_size_is_refused(tmp_path: Path) -> None:
    (tmp_path / "p.png").write_bytes(bomb(0, 5))
    refused(tmp_path / "p.png", "not-an-image")


def test_a_png_with_too_few_rows_is_refused(tmp_path: Path) -> None:
    (tmp_path / "p.png").write_bytes(bomb(500, 500))
    refused(tmp_path / "p.png", "damaged-image")


def test_a_file_beyond_all_bounds_is_not_read(tmp_path: Path) -> None:
    with (tmp_path / "p.png").open("wb") as stream:
        stream.truncate(images.MAX_FILE_BYTES + 1)  # sparse
    refused(tmp_path / "p.png", "too-large")


def test_writing_to_a_read_only_folder_is_a_disk_error(tmp_path: Path) -> None:
    encode_png(view(0, 0))  # imports what it needs while it may
    folder = tmp_path / "folder"
    folder.mkdir()
    with read_only(folder), pytest.raises(DiskError) as caught:
        write_png(folder / "p.png", view(0, 0))
    assert caught.value.code == "read-only"
