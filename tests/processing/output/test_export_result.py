from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from lfrig.contracts.errors import BadInput
from lfrig.contracts.result import ReportDocument
from lfrig.processing.export.pfm import read_pfm
from lfrig.processing.export.png import read_png, to_8_bit, write_png
from lfrig.processing.export.result import load_result, write_result
from lfrig.processing.pipeline import ProcessResult


def test_arrays_and_views_come_back(result: ProcessResult, result_folder: Path) -> None:
    loaded, light_field = load_result(result_folder), result.light_field
    np.testing.assert_array_equal(loaded.disparity, light_field.disparity)
    np.testing.assert_array_equal(loaded.confidence, light_field.surface.confidence)
    np.testing.assert_array_equal(loaded.inverse_depth, light_field.surface.inverse_depth)
    np.testing.assert_array_equal(loaded.views, light_field.views)
    assert loaded.request == light_field.request


def test_sigma_is_in_pixels_of_the_request(result: ProcessResult, result_folder: Path) -> None:
    light_field = result.light_field
    # A step of one sigma in inverse depth is a step of the written sigma in disparity.
    moved = light_field.request.disparity(
        light_field.surface.inverse_depth + light_field.surface.sigma, light_field.camera.focal_px
    )
    written = np.load(result_folder / "disparity_sigma.npy")
    assert written.dtype == np.float32
    known = np.isfinite(moved)
    np.testing.assert_allclose(written[known], (moved - light_field.disparity)[known], atol=1e-5)


def test_unknown_disparity_is_nan_on_disk(result: ProcessResult, result_folder: Path) -> None:
    unknown = np.isnan(read_pfm(result_folder / "disparity.pfm"))
    np.testing.assert_array_equal(unknown, np.isnan(result.light_field.surface.inverse_depth))
    assert unknown.any()


def test_centre_view_is_the_photo_bit_for_bit(result: ProcessResult, result_folder: Path) -> None:
    centre = cv2.imread(str(result_folder / "views" / "03_03.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(centre[..., ::-1], result.target.image)
    assert len(list((result_folder / "views").iterdir())) == 49


def test_sixteen_bit_views_keep_the_photo(build: Callable[..., ProcessResult], tmp_path: Path) -> None:
    result = build(48, 32, dtype=np.uint16)
    write_result(tmp_path, result, session=None)
    centre = cv2.imread(str(tmp_path / "views" / "03_03.png"), cv2.IMREAD_UNCHANGED)
    assert centre.dtype == np.uint16
    np.testing.assert_array_equal(centre[..., ::-1], result.target.image)
    np.testing.assert_array_equal(load_result(tmp_path).views, result.light_field.views)


def test_report_says_how_it_was_made(result: ProcessResult, result_folder: Path) -> None:
    report = ReportDocument.load(result_folder / "report.json")
    assert (report.preset, report.session, report.poses) == ("fast", "bench", "given")
    assert [stage.name for stage in report.stages] == ["evidence", "poses", "fusion", "synthesis"]
    first = report.sources[0]
    assert (first.a, first.c, first.anchors) == (1.4, 2.15, 120)
    assert first.pose is not None
    np.testing.assert_allclose(first.pose.R, result.sources[0].source.pose.rotation)
    assert report.warnings[0].code == "narrow-range"
    assert report.options == {"resolution": 1.0, "limit": "inf"}


@pytest.mark.parametrize("name", ["disparity.pfm", "disparity_sigma.npy", "confidence.npy", "inverse_depth.npy"])
@pytest.mark.parametrize("damage", ["missing", "truncated", "other size"])
def test_damaged_arrays_are_named(name: str, damage: str, result_folder: Path) -> None:
    path = result_folder / name
    if damage == "missing":
        path.unlink()
    elif damage == "truncated":
        path.write_bytes(path.read_bytes()[:-5])
    else:
        report = (result_folder / "report.json").read_text()
        (result_folder / "report.json").write_text(report.replace('"width": 96', '"width": 95'))
        name = "disparity.pfm"  # the first one that disagrees
    with pytest.raises(BadInput, match=name.replace(".", r"\.")) as error:
        load_result(result_folder)
    assert error.value.remedy


@pytest.mark.parametrize("damage", ["missing", "not an image", "other size", "other depth"])
def test_damaged_views_are_named(damage: str, result_folder: Path) -> None:
    path = result_folder / "views" / "06_02.png"
    if damage == "missing":
        path.unlink()
    elif damage == "not an image":
        path.write_bytes(b"not a picture")
    else:
        small = (slice(None, -1), slice(None))
        image = read_png(path)
        write_png(path, image[small] if damage == "other size" else image.astype(np.uint16))
    with pytest.raises(BadInput, match=r"06_02\.png"):
        _ = load_result(result_folder).views


def test_a_folder_without_report_is_no_result(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="not a result folder"):
        load_result(tmp_path)


def test_eight_bits_of_sixteen_are_the_high_byte() -> None:
    np.testing.assert_array_equal(to_8_bit(np.array([[[0, 255, 65535]]], np.uint16)), [[[0, 0, 255]]])
