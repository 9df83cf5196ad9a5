"""EXIF: orientation, focal length, exposure, time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image as Pillow
from PIL import ImageOps
from PIL.TiffImagePlugin import IFDRational

from lfrig.contracts.errors import BadInput
from lfrig.rig.session import exif
from lfrig.rig.session.exif import Exif, camera_spec, exposure_spec, read_exif, read_photo, time_taken, upright
from tests.rig.session_files import H, W, view

FOCAL, FILM, PIXELS_X, PLANE_X, UNIT = 0x920A, 0xA405, 0xA002, 0xA20E, 0xA210


def photo(path: Path, orientation: int | None = None, **ifd: Any) -> Path:
    """Save a picture with an orientation and Exif tags given by hexadecimal name (``x920A=...``)."""
    picture = Pillow.fromarray(view(0, 0))
    tags = picture.getexif()
    if orientation is not None:
        tags[0x0112] = orientation
    for name, value in ifd.items():
        tags.get_ifd(0x8769)[int(name[1:], 16)] = value
    picture.save(path, exif=tags)
    return path


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientations_are_those_of_pillow(orientation: int) -> None:
    picture = Pillow.fromarray(view(0, 0))
    picture.getexif()[0x0112] = orientation
    assert np.array_equal(upright(view(0, 0), orientation), np.asarray(ImageOps.exif_transpose(picture)))


def test_orientation_six_turns_a_quarter_clockwise() -> None:
    """The row on top of the stored picture is the right side of the scene (Exif 2.32, tag 274, value 6)."""
    stored = view(0, 0)
    assert np.array_equal(upright(stored, 6)[:, -1], stored[0])


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
@pytest.mark.parametrize("orientation", [1, 3, 6])
def test_photos_are_read_upright(tmp_path: Path, suffix: str, orientation: int) -> None:
    path = photo(tmp_path / f"p.{suffix}", orientation)
    image, found = read_photo(path)
    assert found.orientation == orientation
    assert image.shape == ((W, H, 3) if orientation == 6 else (H, W, 3))
    with Pillow.open(path) as opened:
        expected = np.asarray(ImageOps.exif_transpose(opened).convert("RGB"))
    assert np.array_equal(image, expected)


def test_focal_length_from_the_sensor_s_resolution(tmp_path: Path) -> None:
    tags = {f"x{FOCAL:X}": IFDRational(50, 1), f"x{PLANE_X:X}": IFDRational(1000, 1), f"x{UNIT:X}": 3}
    camera = camera_spec(read_exif(photo(tmp_path / "p.jpg", **tags, **{f"x{PIXELS_X:X}": 6000})), 600, 400)
    # 50 mm · 100 px/mm = 5000 px in the 6000 px picture as taken, of which this one is a tenth.
    assert camera.fx == camera.fy == pytest.approx(500.0)
    assert camera.sigma_f == exif.SIGMA_FROM_PLANE_RESOLUTION


@pytest.mark.parametrize(("unit", "per_mm"), [(2, 1 / 25.4), (3, 0.1), (4, 1.0), (5, 1000.0)])
def test_units_of_the_sensor_s_resolution(unit: int, per_mm: float) -> None:
    found = Exif(tags={FOCAL: 50.0, PLANE_X: 20.0 / per_mm, UNIT: unit})
    assert camera_spec(found, 900, 600).fx == pytest.approx(1000.0)


def test_focal_length_from_the_35_mm_equivalent() -> None:
    camera = camera_spec(Exif(tags={FILM: 50}), 3600, 2400)
    assert camera.fx == pytest.approx(5000.0)
    assert camera.sigma_f == exif.SIGMA_FROM_35MM
    portrait = camera_spec(Exif(tags={FILM: 50}), 2400, 3600)
    assert portrait.fx == pytest.approx(5000.0)


def test_an_implausible_resolution_falls_back_to_the_35_mm_equivalent() -> None:
    found = Exif(tags={FOCAL: 4.2, PLANE_X: 72.0, UNIT: 2, FILM: 28})
    assert camera_spec(found, 3600, 2400).fx == pytest.approx(2800.0)


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {FOCAL: 50.0},
        {FILM: 0},
        {FILM: "fifty"},
        {FILM: math.nan},
        {FILM: 60000},
        {FOCAL: 50.0, PLANE_X: 100.0, UNIT: 9},
        {FOCAL: IFDRational(1, 0), PLANE_X: 100.0},
    ],
)
def test_without_a_plausible_focal_length_only_the_size_is_known(tags: dict[int, Any]) -> None:
    camera = camera_spec(Exif(tags=tags), 640, 480)
    assert (camera.width, camera.height, camera.fx, camera.sigma_f) == (640, 480, None, None)


def test_exposure_and_time(tmp_path: Path) -> None:
    path = photo(tmp_path / "p.jpg", x829A=IFDRational(1, 50), x8827=200, x9003="2024:05:06 07:08:09")
    found = read_exif(path)
    exposure = exposure_spec(found)
    assert exposure is not None
    assert (exposure.time_s, exposure.iso) == (pytest.approx(0.02), 200)
    assert time_taken(found) == "2024-05-06T07:08:09"


@pytest.mark.parametrize("value", ["", "yesterday", "2024-05-06 07:08:09", None])
def test_other_times_are_unknown(value: Any) -> None:
    assert time_taken(Exif(tags={0x9003: value})) is None


def test_a_picture_without_exif(tmp_path: Path) -> None:
    Pillow.fromarray(view(0, 0)).save(tmp_path / "p.png")
    found = read_exif(tmp_path / "p.png")
    assert found.orientation == 1
    assert exposure_spec(found) is None


@pytest.mark.parametrize("orientation", [0, 9, 300])
def test_orientations_that_do_not_exist_are_ignored(tmp_path: Path, orientation: int) -> None:
    assert read_exif(photo(tmp_path / "p.jpg", orientation)).orientation == 1


def test_damaged_exif_costs_the_metadata_only(tmp_path: Path) -> None:
    path = photo(tmp_path / "p.jpg", 6, xA405=50)
    data = path.read_bytes()
    at = data.index(b"Exif\0\0") + 6
    path.write_bytes(data[: at + 4] + b"\xff" * 16 + data[at + 20 :])
    image, found = read_photo(path)
    assert found.orientation == 1
    assert image.shape == (H, W, 3)


def test_no_picture_has_no_exif(tmp_path: Path) -> None:
    (tmp_path / "p.jpg").write_text("text")
    with pytest.raises(BadInput, match="not an image"):
        read_exif(tmp_path / "p.jpg")
