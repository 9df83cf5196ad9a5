"""Files of the simulated camera, read here by a few lines that know the format and nothing of the code."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import tarfile
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lfrig.sim.plenoptic.body import Model
from lfrig.sim.plenoptic.camera import PlenopticCamera
from lfrig.sim.plenoptic.packing import pack
from lfrig.sim.rig import SimulatedRig
from tests.sim.lytro_files import frame_of, sections, unpacked
from tests.sim.small import backdrop, flat, scene

W, H = 18, 12


def camera(model: Model = "ILLUM", *, poses: str = "prior", **options: bool) -> PlenopticCamera:
    rig = SimulatedRig(scene(backdrop(0.25, flat(0.5))), W, H, poses=poses)  # type: ignore[arg-type]
    return PlenopticCamera(rig, model=model, **options)


@given(st.lists(st.integers(0, 1023), min_size=4, max_size=40).filter(lambda v: len(v) % 4 == 0))
def test_ten_bits_are_packed_as_the_illum_packs_them(values: list[int]) -> None:
    packed = pack(np.array(values, np.uint16), 10, "little")
    assert len(packed) == len(values) * 5 // 4
    assert unpacked(packed, 10) == values


@given(st.lists(st.integers(0, 4095), min_size=2, max_size=40).filter(lambda v: len(v) % 2 == 0))
def test_twelve_bits_are_packed_as_the_f01_packs_them(values: list[int]) -> None:
    packed = pack(np.array(values, np.uint16), 12, "big")
    assert len(packed) == len(values) * 3 // 2
    assert unpacked(packed, 12) == values


@pytest.mark.parametrize(("count", "bits"), [(6, 10), (3, 12), (4, 14)])
def test_packing_that_no_camera_has_is_refused(count: int, bits: int) -> None:
    with pytest.raises(ValueError, match="packed"):
        pack(np.zeros(count, np.uint16), bits, "little" if bits == 10 else "big")


@pytest.mark.parametrize("model", ["ILLUM", "F01"])
def test_a_shot_is_a_whole_lytro_file(model: Model) -> None:
    c = camera(model)
    shot = c.shoot(0, 10.0, truth_views=False)
    found = sections(shot.raw)
    assert [kind for kind, _, _ in found].index(b"LFM") == (0 if model == "F01" else 3)
    frame, contents = frame_of(found)
    assert set(contents) == {frame[k] for k in ("imageRef", "metadataRef", "privateMetadataRef")}
    image = json.loads(contents[frame["metadataRef"]])["image"]
    details = image if model == "ILLUM" else image["rawDetails"]
    bits = {"ILLUM": 10, "F01": 12}[model]
    assert details["pixelPacking"] == {"bitsPerPixel": bits, "endianness": {10: "little", 12: "big"}[bits]}
    assert details["mosaic"]["upperLeftPixel"] == {"ILLUM": "gr", "F01": "b"}[model]
    values = np.array(unpacked(contents[frame["imageRef"]], bits))
    assert values.size == image["width"] * image["height"]
    black, white = details["pixelFormat"]["black"]["gr"], details["pixelFormat"]["white"]["gr"]
    assert (black, white) == {"ILLUM": (64, 1023), "F01": (168, 4095)}[model]
    assert values.max() <= white
    assert black < np.median(values) < white
    assert json.loads(contents[frame["privateMetadataRef"]]) == {"camera": {"serialNumber": c.body.serial}}
    assert shot.document.raw is not None
    assert shot.document.raw.sha256 == hashlib.sha256(shot.raw).hexdigest()


def devices(raw: bytes) -> dict[str, Any]:
    frame, contents = frame_of(sections(raw))
    found: dict[str, Any] = json.loads(contents[frame["metadataRef"]])["devices"]
    return found


@pytest.mark.parametrize("model", ["ILLUM", "F01"])
@pytest.mark.parametrize("poses", ["prior", "given"])
def test_metadata_say_what_the_document_records(model: Model, poses: str) -> None:
    """By the formulas of docs/lenslet.md."""
    shot = camera(model, poses=poses).shoot(2, 10.0, truth_views=False)
    d = devices(shot.raw)
    lens, pixel = d["lens"], d["sensor"]["pixelPitch"]
    f, n, infinity = lens["focalLength"], lens["fNumber"], lens["infinityLambda"]
    p = d["mla"]["lensPitch"] * d["mla"]["scaleFactor"]["x"] / pixel
    assert p == pytest.approx(shot.lattice.pitch_px, rel=1e-12)
    assert d["mla"]["scaleFactor"]["y"] / d["mla"]["scaleFactor"]["x"] == pytest.approx(shot.lattice.stretch)
    assert abs(d["mla"]["rotation"]) == abs(shot.lattice.rotation_rad)
    baseline = f / (n * p)
    focus = f + baseline * f / (pixel * p * (infinity / p))
    focal_px = f * focus / (focus - f) / (p * pixel)
    recorded, true = shot.document, shot.truth.record
    assert recorded.camera is not None
    assert recorded.optics is not None
    assert focal_px == pytest.approx(recorded.camera.fx, rel=1e-9)
    assert baseline == pytest.approx(recorded.optics.baseline_m, rel=1e-9)
    assert focus == pytest.approx(recorded.optics.focus_distance_m, rel=1e-9)
    assert (focal_px == pytest.approx(true.camera.fx, rel=1e-9)) == (poses == "given")
    assert 0.01 < f < 0.03
    assert d["shutter"]["frameExposureDuration"] == recorded.exposure.time_s  # type: ignore[union-attr]
    assert np.linalg.norm(list(d["accelerometer"][min(d["accelerometer"])][0].values())[:3]) == pytest.approx(
        1, abs=0.1
    )


@pytest.mark.parametrize("model", ["ILLUM", "F01"])
def test_archive_finds_the_white_image_of_every_shot_and_has_one_beside(model: Model) -> None:
    c = camera(model)
    stream = io.BytesIO()
    c.write_calibration(stream, 2)
    stream.seek(0)
    with tarfile.open(fileobj=stream) as archive:
        files = {m.name: archive.extractfile(m).read() for m in archive.getmembers()}  # type: ignore[union-attr]
    assert {name.split("/")[0] for name in files} == {c.body.serial}
    files = {name.split("/")[1]: content for name, content in files.items()}
    assert len(files) == 3 * 3 + 2
    manifest = {e["hash"]: e["name"] for e in json.loads(files["cal_file_manifest.json"])["calibrationFiles"]}
    settings = set()
    for index in range(3):
        name = f"MOD_{index:04d}"
        reference = "sha1-" + hashlib.sha1(files[f"{name}.GCT"]).hexdigest()
        assert manifest[reference] == f"{name}.GCT"
        text = json.loads(files[f"{name}.TXT"])["master"]["picture"]["frameArray"][0]["frame"]
        assert text["privateMetadata"]["camera"]["serialNumber"] == c.body.serial
        lens = text["metadata"]["devices"]["lens"]
        settings.add((lens["zoomStep"], lens["focusStep"]))
        if index < 2:
            shot = c.shoot(index, 0.0, truth_views=False)
            assert frame_of(sections(shot.raw))[0]["geometryCorrectionRef"] == reference
            there = devices(shot.raw)["lens"]
            assert (there["zoomStep"], there["focusStep"]) == (lens["zoomStep"], lens["focusStep"])
        values = np.array(unpacked(files[f"{name}.RAW"], c.body.figures.bits))
        assert values.size == c.body.figures.width * c.body.figures.height
    assert len(settings) == 3
    hot = files["HOTPIXEL.BIN"]
    (count,) = struct.unpack("<I", hot[:4])
    xs, ys = np.frombuffer(hot[4:], "<i2").reshape(2, count)
    assert list(zip(xs, ys, strict=True)) == list(map(tuple, c.body.hot_pixels.tolist()))


def test_archive_is_the_same_every_time() -> None:
    streams = io.BytesIO(), io.BytesIO()
    for stream in streams:
        camera().write_calibration(stream, 1)
    assert streams[0].getvalue() == streams[1].getvalue()


def test_white_image_can_be_embedded() -> None:
    c = camera(embed_white=True)
    frame, contents = frame_of(sections(c.shoot(0, 0.0, truth_views=False).raw))
    stream = io.BytesIO()
    c.write_calibration(stream, 1)
    stream.seek(0)
    with tarfile.open(fileobj=stream) as archive:
        white = archive.extractfile(f"{c.body.serial}/MOD_0000.RAW")
        assert white is not None
        assert contents[frame["modulationDataRef"]] == white.read()
