"""What the simulated camera writes about itself and a shot, in the cameras' own JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from lfrig.contracts.lytro import COLOURS, UPPER_LEFT_PIXEL
from lfrig.sim.plenoptic.body import Body
from lfrig.sim.plenoptic.lattice import Lattice

Json = dict[str, Any]
CALIBRATION_MODEL = {"ILLUM": "B01", "F01": "F01"}
FIRMWARE = {"ILLUM": "2.0.0 (42)", "F01": "v1.0a208"}
IDENTITY = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
SRGB_GAMMA = 0.41666


@dataclass(frozen=True)
class LensSetting:
    """The main lens as the camera reports it; ``infinity_lambda`` in lens pitches per f-number."""

    focal_length_m: float
    f_number: float
    infinity_lambda: float
    zoom_step: int
    focus_step: int


def lens_setting(
    view_focal_px: float, baseline_m: float, focus_m: float, body: Body, lattice: Lattice, steps: tuple[int, int]
) -> LensSetting:
    """The setting that docs/lenslet.md reads as these view intrinsics and optics; ``steps`` are zoom's and focus'."""
    pixel_m, pitch = body.figures.pixel_pitch_m, lattice.pitch_px
    image_distance = view_focal_px * pitch * pixel_m
    focal = 1 / (1 / image_distance + 1 / focus_m)
    disparity_at_infinity = baseline_m * focal / ((focus_m - focal) * pitch * pixel_m)
    return LensSetting(focal, focal / (baseline_m * pitch), disparity_at_infinity * pitch, *steps)


def shot_metadata(
    body: Body, lattice: Lattice, lens: LensSetting, *, gains: Sequence[float], exposure_s: float, iso: float,
    time: str, gravity: Sequence[float],
) -> Json:  # fmt: skip
    """The metadata section of a shot; ``gains`` R, G, B; ``gravity`` x, y, z in the camera's axes [g]."""
    f = body.figures
    packing = {"endianness": f.packing, "bitsPerPixel": f.bits}
    levels = {"rightShift": 0, "black": dict.fromkeys(COLOURS, f.black), "white": dict.fromkeys(COLOURS, f.white)}
    upper_left = next(key for key, pattern in UPPER_LEFT_PIXEL.items() if pattern == f.bayer)
    mosaic = {"tile": "r,gr:gb,b", "upperLeftPixel": upper_left}
    red, green, blue = (float(g) for g in gains)
    gain = {"r": red, "gr": green, "gb": green, "b": blue}
    image: Json = {"width": f.width, "height": f.height, "orientation": 1, "representation": "rawPacked",
                   "modulationExposureBias": 0.0, "iso": iso}  # fmt: skip
    colour: Json = {"whiteBalanceGain": gain, "gamma": SRGB_GAMMA}
    if body.model == "ILLUM":
        image |= {"pixelPacking": packing, "pixelFormat": levels, "mosaic": mosaic, "color": colour | {"ccm": IDENTITY}}
    else:
        details = {"pixelPacking": packing, "pixelFormat": levels, "mosaic": mosaic}
        image |= {"rawDetails": details, "color": colour | {"ccmRgbToSrgbArray": IDENTITY}}
    shutter = {"frameExposureDuration": exposure_s, "pixelExposureDuration": exposure_s}
    sample = dict(zip("xyz", (float(g) for g in gravity), strict=True)) | {"time": 0.0}
    devices = _optics(body, lattice, lens) | {
        "shutter": shutter,
        "clock": {"zuluTime": time},
        "accelerometer": {"samples": [sample]} if body.model == "ILLUM" else {"sampleArray": [sample]},
    }
    document: Json = {"type": "lightField", "camera": camera_metadata(body), "image": image, "devices": devices}
    if body.model == "ILLUM":
        document["algorithms"] = {"awb": {"computed": {"gain": gain}}}
    return document


def white_metadata(body: Body, lattice: Lattice, lens: LensSetting) -> Json:
    """``MOD_nnnn.TXT``: the metadata of a white image, wrapped as the cameras' calibration wraps it."""
    f = body.figures
    levels = {"rightShift": 0, "black": dict.fromkeys(COLOURS, f.black), "white": dict.fromkeys(COLOURS, f.white)}
    upper_left = next(key for key, pattern in UPPER_LEFT_PIXEL.items() if pattern == f.bayer)
    details = {
        "pixelPacking": {"endianness": f.packing, "bitsPerPixel": f.bits},
        "pixelFormat": levels,
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": upper_left},
    }
    image = {"width": f.width, "height": f.height, "orientation": 1, "rawDetails": details,
             "color": {"ccmRgbToSrgbArray": IDENTITY, "gamma": SRGB_GAMMA}}  # fmt: skip
    camera = camera_metadata(body) | {"model": CALIBRATION_MODEL[body.model]}
    metadata = {"type": "lightField", "camera": camera, "image": image, "devices": _optics(body, lattice, lens)}
    frame = {"metadata": metadata, "privateMetadata": private_metadata(body)}
    return {"master": {"picture": {"frameArray": [{"frame": frame}]}}}


def private_metadata(body: Body) -> Json:
    """The section that names the specimen."""
    return {"camera": {"serialNumber": body.serial}}


def camera_metadata(body: Body) -> Json:
    """Make, model and firmware."""
    return {"make": "Lytro, Inc.", "model": body.model, "firmware": FIRMWARE[body.model]}


def _optics(body: Body, lattice: Lattice, lens: LensSetting) -> Json:
    f = body.figures
    scale = lattice.pitch_px / body.nominal_pitch_px
    red, green, blue = body.responses
    return {
        "lens": {
            "focalLength": lens.focal_length_m, "fNumber": lens.f_number, "infinityLambda": lens.infinity_lambda,
            "zoomStep": lens.zoom_step, "focusStep": lens.focus_step, "exitPupilOffset": {"z": 0.1},
            "opticalCenterOffset": {"x": 0.0, "y": 0.0},
        },
        "mla": {
            "tiling": "hexUniformRowMajor", "lensPitch": f.lens_pitch_m,
            # Clockwise as one sees who looks into the camera, where the picture's x runs the other way.
            "rotation": -lattice.rotation_rad,
            "scaleFactor": {"x": scale, "y": scale * lattice.stretch},
            "sensorOffset": {"x": 0.0, "y": 0.0, "z": 3.7e-5},
        },
        "sensor": {
            "pixelPitch": f.pixel_pitch_m, "bitsPerPixel": f.bits,
            "normalizedResponses": [{"r": red, "gr": green, "gb": green, "b": blue, "cct": 5100}],
            "analogGain": dict.fromkeys(COLOURS, 1.0), "baseIso": 80,
        },
    }  # fmt: skip
