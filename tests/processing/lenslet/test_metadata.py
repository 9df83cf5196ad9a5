"""Metadata of both cameras become one record; what cannot be is refused by file and field."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from lfrig.bench.lytro_files import SERIAL, SmallShot, metadata, reference, shot_file
from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import F01, ILLUM, CameraFigures
from lfrig.processing.lenslet.container import parse_container
from lfrig.processing.lenslet.metadata import RawMetadata, parse_metadata, read_metadata
from lfrig.processing.lenslet.priors import camera_and_optics, view_size

Json = dict[str, Any]


def edited(document: Json, place: str, value: Any) -> Json:
    """A copy with a value (None removes it) at a dotted place."""
    changed = copy.deepcopy(document)
    *parents, last = place.split(".")
    holder = changed
    for name in parents:
        holder = holder[name]
    if value is None:
        del holder[last]
    else:
        holder[last] = value
    return changed


def read(figures: CameraFigures = ILLUM, **options: Any) -> RawMetadata:
    shot = SmallShot(figures=figures, **options)
    return read_metadata(parse_container(memoryview(shot_file(shot)), "shot.lfr"))


@pytest.mark.parametrize("figures", [ILLUM, F01])
def test_both_layouts_give_one_record(figures: CameraFigures) -> None:
    found = read(figures, embedded_white=True)
    assert (found.model, found.serial, found.width, found.height) == (figures.model, SERIAL, 20, 18)
    assert (found.bits, found.packing, found.bayer) == (figures.bits, figures.packing, figures.bayer)
    assert found.black == (float(figures.black),) * 4
    assert found.white == (float(figures.white),) * 4
    assert found.white_balance == (1.31, 1.0, 1.0, 1.34)
    assert found.colour_matrix == ((1.5, -0.4, -0.1), (-0.3, 1.5, -0.2), (0.0, -0.5, 1.5))
    assert found.gamma == (0.41666 if figures is F01 else None)
    assert found.iso == (207 if figures is F01 else 80)
    assert (found.exposure_s, found.time) == (0.008, "2015-05-17T13:31:37.412Z")
    assert (found.zoom_step, found.focus_step) == (600, 900)
    assert (found.focal_length_m, found.f_number, found.infinity_lambda) == (0.0242, 2.2, 33.9)
    assert found.mla_scale == (1.0, 1.0003)
    assert found.mla_aspect == pytest.approx(1.0003)
    assert found.mla_rotation_rad == -0.00054
    assert found.sensor_offset_m == (8.4e-06, -9.5e-07, 3.7e-05)
    assert found.lens_pitch_px == pytest.approx(figures.lens_pitch_m / 1.4e-6)
    assert found.geometry_correction_ref == reference(SmallShot().geometry or b"")
    assert found.modulation_ref is not None
    assert hash(found) == hash(replace(found))


def test_colours_keep_their_order() -> None:
    levels = {"r": 1, "gr": 2, "gb": 3, "b": 4}
    document = edited(metadata(SmallShot()), "image.pixelFormat.black", levels)
    document["image"]["color"]["whiteBalanceGain"] = {"b": 1.4, "gb": 1.3, "gr": 1.2, "r": 1.1}
    found = parse_metadata(document, {}, "shot.lfr")
    assert found.black == (1, 2, 3, 4)
    assert found.white_balance == (1.1, 1.2, 1.3, 1.4)


def test_what_is_not_said_is_the_models_or_unknown() -> None:
    bare: Json = {"camera": {"model": "B01"}, "image": {"width": 7728, "height": 5368}}
    found = parse_metadata(bare, {}, "mod.txt")
    assert (found.bits, found.packing, found.bayer) == (10, "little", "GRBG")
    assert (found.black[0], found.white[0], found.lens_pitch_m) == (64, 1023, 2e-5)
    unknown = ("white_balance", "colour_matrix", "serial", "iso", "exposure_s", "focal_length_m", "zoom_step", "time")
    assert [name for name in unknown if getattr(found, name) is not None] == []
    assert camera_and_optics(found)[0] is None
    nulls = edited(metadata(SmallShot()), "image.iso", 0)
    nulls["devices"]["lens"]["zoomStep"] = None
    nulls["image"]["color"] = None
    found = parse_metadata(nulls, {}, "x")
    assert (found.iso, found.zoom_step, found.white_balance) == (None, None, None)


def test_the_white_balance_may_be_the_algorithms() -> None:
    document = edited(metadata(SmallShot()), "image.color", {})
    document["algorithms"] = {"awb": {"computed": {"gain": {"r": 2, "gr": 1, "gb": 1, "b": 3}}}}
    assert parse_metadata(document, {}, "x").white_balance == (2, 1, 1, 3)


def test_text_is_made_safe_to_show() -> None:
    document = edited(metadata(SmallShot()), "camera.firmware", "1.0\x1b[31m\ud800" + "x" * 900)
    found = parse_metadata(document, {"camera": {"serialNumber": "B1\n2"}}, "x")
    assert found.serial == "B1?2"
    assert found.firmware is not None
    assert found.firmware.startswith("1.0?[31m?xxx")
    assert len(found.firmware) == 200


@pytest.mark.parametrize(
    ("place", "value", "field"),
    [
        ("image.width", None, "image.width"), ("image.width", 4, "image.width"), ("image.height", 1e9, "image.height"),
        ("image.width", "wide", "image.width"), ("image.width", True, "image.width"), ("image", [], "image"),
        ("image.pixelPacking.bitsPerPixel", 7, "image.pixelPacking.bitsPerPixel"),
        ("image.pixelPacking.bitsPerPixel", 14, "image.pixelPacking.bitsPerPixel"),
        ("image.pixelPacking.endianness", "big", "image.pixelPacking.bitsPerPixel"),
        ("image.pixelPacking.endianness", "middle", "image.pixelPacking.endianness"),
        ("image.pixelFormat.white.gr", 64, "image.pixelFormat.white.gr"),
        ("image.pixelFormat.white.b", 1024, "image.pixelFormat.white.b"),
        ("image.pixelFormat.black.r", -1, "image.pixelFormat.black.r"),
        ("image.mosaic.upperLeftPixel", "green", "image.mosaic.upperLeftPixel"),
        ("image.orientation", 9, "image.orientation"),
        ("image.color.ccm", [1.0] * 8, "image.color.ccm"), ("image.color.ccm", [float("nan")] * 9, "image.color.ccm.0"),
        ("image.color.whiteBalanceGain.r", 0, "image.color.whiteBalanceGain.r"),
        ("devices.lens.focalLength", float("inf"), "devices.lens.focalLength"),
        ("devices.lens.focalLength", 10**400, "devices.lens.focalLength"),
        ("devices.lens.fNumber", 0, "devices.lens.fNumber"),
        ("devices.mla.lensPitch", 5e-6, "devices.mla.lensPitch"),
        ("devices.mla.lensPitch", 1e-3, "devices.mla.lensPitch"),
        ("devices.mla.rotation", 3, "devices.mla.rotation"),
        ("devices.mla.scaleFactor.x", 0, "devices.mla.scaleFactor.x"),
        ("devices.mla.tiling", "square", "devices.mla.tiling"),
        ("devices.sensor.pixelPitch", -1, "devices.sensor.pixelPitch"),
        ("devices.shutter.pixelExposureDuration", -1, "devices.shutter.pixelExposureDuration"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_by_file_and_field(place: str, value: Any, field: str) -> None:
    with pytest.raises(BadInput) as caught:
        parse_metadata(edited(metadata(SmallShot()), place, value), {}, Path("IMG_1.LFR"))
    assert (caught.value.path, caught.value.field) == ("IMG_1.LFR", field)
    assert caught.value.remedy
    assert "\n" not in caught.value.message


def test_a_sensor_of_too_many_pixels_is_refused() -> None:
    document = edited(metadata(SmallShot(width=16384, height=16384)), "image.iso", 80)
    with pytest.raises(BadInput, match="64000000") as caught:
        parse_metadata(document, {}, "x")
    assert caught.value.code == "too-large"


def test_an_unknown_model_must_say_everything() -> None:
    document = edited(metadata(SmallShot()), "camera.model", "ILLUM 2")
    assert parse_metadata(document, {}, "x").model == "ILLUM 2"
    for place in ("image.mosaic.upperLeftPixel", "devices.sensor.pixelPitch", "devices.mla.lensPitch"):
        with pytest.raises(BadInput, match="model is not known") as caught:
            parse_metadata(edited(document, place, None), {}, "x")
        assert caught.value.field == place


def real_size(figures: CameraFigures, **known: Any) -> RawMetadata:
    found = replace(read(figures), width=figures.width, height=figures.height, mla_scale=(1.0, 1.0))
    return replace(found, **known)


def test_views_of_the_real_cameras() -> None:
    assert view_size(real_size(ILLUM)) == (541, 376)
    assert view_size(real_size(F01)) == (328, 328)


def test_priors_follow_the_geometry_of_the_design() -> None:
    metadata = real_size(ILLUM)
    camera, optics = camera_and_optics(metadata)
    assert camera is not None
    assert optics.baseline_m is not None
    assert optics.focus_distance_m is not None
    pitch, f = metadata.lens_pitch_px, 0.0242
    assert optics.baseline_m == pytest.approx(f / (2.2 * pitch))
    v = 1 / (1 / f - 1 / optics.focus_distance_m)  # thin lens
    assert camera.focal_px == pytest.approx(v / (pitch * 1.4e-6))
    assert (camera.cx, camera.cy) == (270.0, 187.5)
    # A point at infinity spreads over λ∞ lenses across the pupil, which is p view steps wide.
    assert -optics.baseline_m * camera.focal_px / optics.focus_distance_m == pytest.approx(-33.9 / pitch)
    assert (camera.sigma_focal, optics.sigma_baseline) == (0.02, 0.03)


@pytest.mark.parametrize("infinity", [None, 0.0, -3.0, 1e-300])
def test_focused_at_infinity(infinity: float | None) -> None:
    camera, optics = camera_and_optics(real_size(ILLUM, infinity_lambda=infinity))
    assert camera is not None
    assert optics.focus_distance_m is None
    assert optics.baseline_m is not None
    assert camera.focal_px == pytest.approx(0.0242 / 2e-5)
