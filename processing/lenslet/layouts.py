"""The metadata JSON of both cameras as pydantic models: names, types and ranges as the files have them.

Fields are named in snake case here and in camel case in the files; what this program does not use is not listed and
not looked at. The F01 keeps under ``image.rawDetails`` what the Illum has under ``image``.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, PlainValidator, model_validator
from pydantic.alias_generators import to_camel

MAX_SIDE_PX = 16384
MAX_TEXT = 200


def _finite(value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("is not a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ValueError("is not a finite number")
    return value


def _text(value: Any) -> str:
    """At most `MAX_TEXT` printable characters: what is shown on terminals and stored again."""
    if not isinstance(value, str):
        raise ValueError("is not text")
    return "".join(letter if letter.isprintable() else "?" for letter in value[:MAX_TEXT]).strip()


Number = BeforeValidator(_finite)
Coordinate = Annotated[float, Number, Field(ge=-1e3, le=1e3)]
Level = Annotated[float, Number, Field(ge=0, le=65535)]
Gain = Annotated[float, Number, Field(gt=0, le=100)]
Step = Annotated[int, Number, Field(ge=-1_000_000, le=1_000_000)]
Metres = Annotated[float, Number, Field(gt=0, le=10)]
Side = Annotated[int, Number, Field(ge=16, le=MAX_SIDE_PX)]
NotNegative = Annotated[float, Number, Field(ge=0, le=1e6)]
Text = Annotated[str, PlainValidator(_text)]
Matrix = Annotated[list[Coordinate], Field(min_length=9, max_length=9)]


class Part(BaseModel):
    """An object of the metadata; unknown fields are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", alias_generator=to_camel)

    @model_validator(mode="before")
    @classmethod
    def _null_is_absent(cls, value: Any) -> Any:
        if isinstance(value, dict):
            return {key: item for key, item in value.items() if item is not None}
        return value


class Levels(Part):
    """A black or white level per Bayer colour."""

    r: Level
    gr: Level
    gb: Level
    b: Level


class Gains(Part):
    """A white-balance gain per Bayer colour."""

    r: Gain
    gr: Gain
    gb: Gain
    b: Gain


class PixelPacking(Part):
    """How sensor values are packed."""

    bits_per_pixel: Annotated[int, Number, Field(ge=8, le=16)] | None = None
    endianness: Literal["big", "little"] | None = None


class PixelFormat(Part):
    """The range of sensor values."""

    black: Levels | None = None
    white: Levels | None = None


class Mosaic(Part):
    """The Bayer pattern."""

    upper_left_pixel: Literal["r", "gr", "gb", "b"] | None = None


class RawDetails(Part):
    """What describes the sensor values."""

    pixel_packing: PixelPacking = PixelPacking()
    pixel_format: PixelFormat = PixelFormat()
    mosaic: Mosaic = Mosaic()


class Colour(Part):
    """White balance, colour matrix (row-major) and the exponent of the camera's own tone curve."""

    white_balance_gain: Gains | None = None
    ccm: Matrix | None = None
    ccm_rgb_to_srgb_array: Matrix | None = None
    gamma: Annotated[float, Number, Field(gt=0, le=10)] | None = None


class ImagePart(RawDetails):
    """The picture."""

    width: Side
    height: Side
    orientation: Annotated[int, Number, Field(ge=1, le=8)] = 1
    iso: NotNegative | None = None
    color: Colour = Colour()
    raw_details: RawDetails = RawDetails()


class CameraPart(Part):
    """The camera body."""

    make: Text | None = None
    model: Text | None = None
    firmware: Text | None = None
    serial_number: Text | None = None


class Vector(Part):
    """x, y and, where it has one, z."""

    x: Coordinate = 0.0
    y: Coordinate = 0.0
    z: Coordinate = 0.0


class Scale(Part):
    """Scale factors of the lens array."""

    x: Annotated[float, Number, Field(ge=0.5, le=2)] = 1.0
    y: Annotated[float, Number, Field(ge=0.5, le=2)] = 1.0


class Lens(Part):
    """The main lens."""

    focal_length: Metres | None = None
    f_number: Annotated[float, Number, Field(ge=0.1, le=1000)] | None = None
    infinity_lambda: Annotated[float, Number, Field(ge=-1e5, le=1e5)] | None = None
    zoom_step: Step | None = None
    focus_step: Step | None = None


class MicrolensArray(Part):
    """The lens array in front of the sensor."""

    tiling: Literal["hexUniformRowMajor"] | None = None
    lens_pitch: Annotated[float, Number, Field(ge=1e-7, le=1e-2)] | None = None
    rotation: Annotated[float, Number, Field(ge=-0.5, le=0.5)] = 0.0
    scale_factor: Scale = Scale()
    sensor_offset: Vector = Vector()


class Sensor(Part):
    """The sensor."""

    pixel_pitch: Annotated[float, Number, Field(ge=1e-8, le=1e-3)] | None = None
    bits_per_pixel: Annotated[int, Number, Field(ge=8, le=16)] | None = None
    iso: NotNegative | None = None
    mosaic: Mosaic = Mosaic()


class Shutter(Part):
    """Exposure times [s]."""

    frame_exposure_duration: NotNegative | None = None
    pixel_exposure_duration: NotNegative | None = None


class Clock(Part):
    """Time of the shot."""

    zulu_time: Text | None = None


class Devices(Part):
    """The camera's parts."""

    lens: Lens = Lens()
    mla: MicrolensArray = MicrolensArray()
    sensor: Sensor = Sensor()
    shutter: Shutter = Shutter()
    clock: Clock = Clock()


class AutoWhiteBalanceResult(Part):
    """What the camera's white balance came to."""

    gain: Gains | None = None


class AutoWhiteBalance(Part):
    """The camera's white balance."""

    computed: AutoWhiteBalanceResult = AutoWhiteBalanceResult()


class Algorithms(Part):
    """What the camera computed."""

    awb: AutoWhiteBalance = AutoWhiteBalance()


class Metadata(Part):
    """``metadata.json`` of a frame."""

    camera: CameraPart = CameraPart()
    image: ImagePart
    devices: Devices = Devices()
    algorithms: Algorithms = Algorithms()


class PrivateMetadata(Part):
    """``privateMetadata.json`` of a frame."""

    camera: CameraPart = CameraPart()
