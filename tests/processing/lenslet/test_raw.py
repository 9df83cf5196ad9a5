"""read_raw: sensor values with the white image of the rule, hot pixels, warnings, and what a torn file still gives."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lfrig.bench.lytro_files import (
    SmallShot,
    calibration_files,
    container,
    encoded,
    section,
    shot_file,
    shot_parts,
    tar_bytes,
)
from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import CONTENT_MAGIC, F01, ILLUM, TOC_MAGIC, CameraFigures
from lfrig.contracts.progress import Monitor
from lfrig.processing.lenslet.raw import RawCapture, read_raw

SHOT = SmallShot(geometry=b"a", seed=9)
NEAR = SmallShot(zoom_step=630, focus_step=850, geometry=b"b", seed=1)


def read(tmp_path: Path, shot: SmallShot, files: dict[str, bytes] | None = None) -> tuple[RawCapture, list[str]]:
    """The capture, and code and message of every warning."""
    path = tmp_path / "shot.lfr"
    path.write_bytes(shot_file(shot))
    calibration = None
    if files is not None:
        calibration = tmp_path / "caldata.tar"
        calibration.write_bytes(tar_bytes(files))
    monitor = Monitor()
    capture = read_raw(path, calibration=calibration, monitor=monitor)
    return capture, [f"{notice.code}: {notice.message}" for notice in monitor.notices]


@pytest.mark.parametrize("figures", [ILLUM, F01])
def test_sensor_values_of_both_cameras(tmp_path: Path, figures: CameraFigures) -> None:
    shot = SmallShot(figures=figures, width=17, height=19)
    capture, _ = read(tmp_path, shot)
    np.testing.assert_array_equal(capture.sensor, shot.values())
    assert capture.metadata.model == figures.model
    assert capture.hot_pixels.shape == (0, 2)


def test_the_exact_white_image_is_silent(tmp_path: Path) -> None:
    capture, warnings = read(tmp_path, SHOT, calibration_files([NEAR, SHOT], [(5, 6)]))
    assert (capture.rule, capture.zoom_steps, capture.focus_steps, capture.problems) == ("exact", 0, 0, ())
    assert capture.white is not None
    assert capture.white.name == "MOD_0001"
    np.testing.assert_array_equal(capture.white.sensor, SHOT.values(0.7))
    assert capture.hot_pixels.tolist() == [[5, 6]]
    assert warnings == []


def test_the_nearest_one_says_how_far_it_is(tmp_path: Path) -> None:
    capture, warnings = read(tmp_path, SHOT, calibration_files([NEAR]))
    assert (capture.rule, capture.zoom_steps, capture.focus_steps) == ("nearest", 30, -50)
    [warning] = warnings
    assert warning.startswith("white-image-not-exact: ")
    assert "MOD_0000, zoom +30 steps, focus -50 steps" in warning


def test_the_embedded_one_serves_without_calibration(tmp_path: Path) -> None:
    shot = SmallShot(embedded_white=True, hot_pixels=[(1, 2)])
    capture, [warning] = read(tmp_path, shot)
    assert (capture.rule, capture.zoom_steps) == ("embedded", None)
    assert capture.white is not None
    np.testing.assert_array_equal(capture.white.sensor, shot.values(0.7))
    assert capture.white.metadata == capture.metadata
    assert capture.hot_pixels.tolist() == [[1, 2]]
    assert warning.startswith("white-image-not-exact: ")
    assert "own file" in warning


def test_no_white_image_is_no_dead_end(tmp_path: Path) -> None:
    capture, [warning] = read(tmp_path, SHOT)
    assert (capture.rule, capture.white) == ("none", None)
    assert warning.startswith("no-white-image: ")
    capture, [warning] = read(tmp_path, SHOT, calibration_files([SmallShot(serial="B514OTHER")]))
    assert (capture.rule, capture.white) == ("none", None)
    assert "it is of B514OTHER, the shot of B5140000001" in warning


def test_a_white_image_that_cannot_be_read_is_passed_over(tmp_path: Path) -> None:
    files = calibration_files([SHOT, NEAR], [(99, 99)])
    files["MOD_0000.RAW"] = files["MOD_0000.RAW"][:-1]
    capture, warnings = read(tmp_path, SHOT, files)
    assert capture.rule == "nearest"
    assert [warning.partition(":")[0] for warning in warnings] == [
        "white-image-not-exact", "calibration-ignored", "bad-hot-pixels",
    ]  # fmt: skip
    assert "MOD_0000.RAW" in warnings[1]
    assert len(capture.problems) == 1
    assert capture.hot_pixels.shape == (0, 2)


def test_a_wrong_bit_depth_is_named(tmp_path: Path) -> None:
    path = tmp_path / "shot.lfr"
    table, parts = shot_parts(SHOT)
    lying = parts["metadataRef"].replace(b'"bitsPerPixel": 10', b'"bitsPerPixel": 12').replace(b'"little"', b'"big"')
    text = encoded(table).replace(*(section(CONTENT_MAGIC, data)[16:61] for data in (parts["metadataRef"], lying)))
    parts["metadataRef"] = lying
    path.write_bytes(container(*(section(CONTENT_MAGIC, data) for data in parts.values()), section(TOC_MAGIC, text)))
    with pytest.raises(BadInput) as caught:
        read_raw(path)
    assert (caught.value.code, caught.value.field) == ("wrong-size", "imageRef")
    assert "450 bytes (as 10 bits would be), but 20×18 px of 12 bits are 540" in caught.value.message


def test_a_torn_file_on_request(tmp_path: Path) -> None:
    shot = SmallShot(figures=F01)
    path = tmp_path / "torn.lfp"
    path.write_bytes(shot_file(shot, padding=0)[:-270])
    with pytest.raises(BadInput) as caught:
        read_raw(path)
    assert caught.value.code == "truncated"
    monitor = Monitor()
    capture = read_raw(path, partial=True, monitor=monitor)
    np.testing.assert_array_equal(capture.sensor[:9], shot.values()[:9])
    assert not capture.sensor[9:].any()
    assert any("the last 9 of 18 rows are missing" in problem for problem in capture.problems)
    assert "partial-file" in [notice.code for notice in monitor.notices]
    path.write_bytes(shot_file(shot, padding=0)[:-535])
    with pytest.raises(BadInput, match="holds 2 of 360"):
        read_raw(path, partial=True)


def test_a_damaged_payload(tmp_path: Path) -> None:
    path = tmp_path / "shot.lfr"
    data = bytearray(shot_file(SHOT))
    payload = shot_parts(SHOT)[1]["imageRef"]
    data[data.index(payload)] ^= 0x80
    path.write_bytes(data)
    with pytest.raises(BadInput) as caught:
        read_raw(path)
    assert caught.value.code == "wrong-sha1"
    capture = read_raw(path, partial=True)
    assert (capture.sensor != SHOT.values()).sum() == 1
    assert "SHA-1" in capture.problems[0]
