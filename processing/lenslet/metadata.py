"""What a raw file says of its camera and its shot: one frozen record, whichever camera wrote it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from lfrig.contracts.errors import BadInput
from lfrig.contracts.lytro import (
    CAMERAS,
    COLOURS,
    PACKED_GROUPS,
    UPPER_LEFT_PIXEL,
    BayerPattern,
    CameraFigures,
    Packing,
)
from lfrig.processing.lenslet import layouts
from lfrig.processing.lenslet.container import Container
from lfrig.processing.lenslet.contents import Frame, json_part, raw_frame

ColourValues = tuple[float, float, float, float]
"""One value per Bayer colour in the order r, gr, gb, b (`contracts.lytro.COLOURS`)."""
Matrix3 = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]
MAX_PIXELS = 64_000_000
"""Largest sensor that is read: 128 MB of values. The Illum has 41.5 million pixels."""
LENS_PITCH_PX = (4.0, 64.0)
_RESTORE = "is it the camera's own file?"
PartType = TypeVar("PartType", bound=layouts.Part)


@dataclass(frozen=True)
class RawMetadata:
    """A shot's metadata, checked; None = the file does not say.

    Lengths in metres, angles in radians. ``black`` and ``white`` are sensor values, ``white_balance`` gains (green 1 in
    practice). ``colour_matrix`` takes white-balanced linear camera RGB to linear sRGB, row by row.
    ``mla_rotation_rad`` and ``sensor_offset_m`` (x, y, z) are as recorded. References are ``sha1-…`` strings.
    """

    model: str
    width: int
    height: int
    bits: int
    packing: Packing
    bayer: BayerPattern
    black: ColourValues
    white: ColourValues
    pixel_pitch_m: float
    lens_pitch_m: float
    mla_scale: tuple[float, float] = (1.0, 1.0)
    mla_rotation_rad: float = 0.0
    sensor_offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    white_balance: ColourValues | None = None
    colour_matrix: Matrix3 | None = None
    gamma: float | None = None
    serial: str | None = None
    make: str | None = None
    firmware: str | None = None
    time: str | None = None
    orientation: int = 1
    iso: float | None = None
    exposure_s: float | None = None
    focal_length_m: float | None = None
    f_number: float | None = None
    infinity_lambda: float | None = None
    zoom_step: int | None = None
    focus_step: int | None = None
    geometry_correction_ref: str | None = None
    modulation_ref: str | None = None

    @property
    def lens_pitch_px(self) -> float:
        """Pitch of the lenses along a row [px]."""
        return self.lens_pitch_m * self.mla_scale[0] / self.pixel_pitch_m

    @property
    def mla_aspect(self) -> float:
        """Ratio of the lattice's vertical to its horizontal scale; 1 = regular hexagons."""
        return self.mla_scale[1] / self.mla_scale[0]


def read_metadata(container: Container, frame: Frame | None = None) -> RawMetadata:
    """What a container says of its shot; ``frame`` is `contents.raw_frame`'s, for who has it already.

    Raises
    ------
    BadInput
        No raw frame, no metadata, or a field that cannot be; names the file and the field.
    """
    frame = frame or raw_frame(container)
    metadata = frame.metadata or json_part(container, frame.metadata_ref, "metadataRef")
    private = frame.private_metadata
    if not private and container.find(frame.private_metadata_ref) is not None:
        private = json_part(container, frame.private_metadata_ref, "privateMetadataRef")
    return parse_metadata(metadata, private, container.path, frame)


def parse_metadata(
    metadata: dict[str, Any], private: dict[str, Any], path: Path | str, frame: Frame | None = None
) -> RawMetadata:
    """Normalise decoded metadata of either camera; what it lacks is taken from the model's nominal figures.

    Raises
    ------
    BadInput
        A field is missing or cannot be: not finite, out of range, a bit depth that no camera has.
    """
    found = _validated(layouts.Metadata, metadata, path)
    serial = found.camera.serial_number or _validated(layouts.PrivateMetadata, private, path).camera.serial_number
    model = found.camera.model or ""
    nominal = CAMERAS.get(model.upper())
    bits, packing = _packing(found, nominal, path)
    black, white = _levels(found, nominal, bits, path)
    devices, image = found.devices, found.image
    lens, mla, sensor, shutter = devices.lens, devices.mla, devices.sensor, devices.shutter
    offset = mla.sensor_offset
    raw = RawMetadata(
        model=model,
        width=image.width,
        height=image.height,
        bits=bits,
        packing=packing,
        bayer=_bayer(found, nominal, path),
        black=black,
        white=white,
        pixel_pitch_m=_known(
            sensor.pixel_pitch, nominal.pixel_pitch_m if nominal else None, "devices.sensor.pixelPitch", path
        ),
        lens_pitch_m=_known(mla.lens_pitch, nominal.lens_pitch_m if nominal else None, "devices.mla.lensPitch", path),
        mla_scale=(mla.scale_factor.x, mla.scale_factor.y),
        mla_rotation_rad=mla.rotation,
        sensor_offset_m=(offset.x, offset.y, offset.z),
        white_balance=_white_balance(found),
        colour_matrix=_colour_matrix(image.color),
        gamma=image.color.gamma,
        serial=serial or None,
        make=found.camera.make,
        firmware=found.camera.firmware,
        time=devices.clock.zulu_time,
        orientation=image.orientation,
        iso=image.iso or sensor.iso or None,
        exposure_s=shutter.pixel_exposure_duration or shutter.frame_exposure_duration or None,
        focal_length_m=lens.focal_length,
        f_number=lens.f_number,
        infinity_lambda=lens.infinity_lambda,
        zoom_step=lens.zoom_step,
        focus_step=lens.focus_step,
        geometry_correction_ref=frame.geometry_correction_ref if frame else None,
        modulation_ref=frame.modulation_ref if frame else None,
    )
    _check_size(raw, path)
    return raw


def _validated(part: type[PartType], value: dict[str, Any], path: Path | str) -> PartType:
    try:
        return part.model_validate(value)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        message = first["msg"].removeprefix("Value error, ").removeprefix("Input ")
        name = ".".join(str(step) for step in first["loc"])
        raise _bad(message[:1].lower() + message[1:], name, path) from None


def _bad(message: str, name: str, path: Path | str, code: str = "invalid-metadata") -> BadInput:
    return BadInput(message, path=path, field=name, code=code, remedy=_RESTORE)


def _known(value: float | None, nominal: float | None, name: str, path: Path | str) -> float:
    found = value if value is not None else nominal
    if found is None:
        raise _bad("is missing, and the camera's model is not known", name, path)
    return found


def _packing(found: layouts.Metadata, nominal: CameraFigures | None, path: Path | str) -> tuple[int, Packing]:
    places = (found.image.pixel_packing, found.image.raw_details.pixel_packing)
    bits = next((place.bits_per_pixel for place in places if place.bits_per_pixel), found.devices.sensor.bits_per_pixel)
    bits = int(_known(bits, nominal.bits if nominal else None, "image.pixelPacking.bitsPerPixel", path))
    recorded = next((place.endianness for place in places if place.endianness), None)
    usual = next((packing for depth, packing in PACKED_GROUPS if depth == bits), None)
    packing = recorded or usual
    if packing is None or (bits, packing) not in PACKED_GROUPS:
        order = f" ({packing} endian)" if packing else ""
        raise _bad(
            f"{bits} bits{order} is no packing of a Lytro camera", "image.pixelPacking.bitsPerPixel", path,
            "unknown-packing",
        )  # fmt: skip
    return bits, packing


def _levels(
    found: layouts.Metadata, nominal: CameraFigures | None, bits: int, path: Path | str
) -> tuple[ColourValues, ColourValues]:
    """Black and white levels, from the file, else of the model (at its own bit depth), else the whole range."""
    top = 2**bits - 1
    usual = (nominal.black, nominal.white) if nominal and nominal.bits == bits else (0, top)
    formats = (found.image.pixel_format, found.image.raw_details.pixel_format)
    black = next((_values(place.black) for place in formats if place.black), (float(usual[0]),) * 4)
    white = next((_values(place.white) for place in formats if place.white), (float(usual[1]),) * 4)
    for name, low, high in zip(COLOURS, black, white, strict=True):
        if not low < high <= top:
            raise _bad(
                f"black {low:g}, white {high:g} of {bits} bits cannot be", f"image.pixelFormat.white.{name}", path
            )
    return black, white


def _values(value: layouts.Levels | layouts.Gains) -> ColourValues:
    return value.r, value.gr, value.gb, value.b


def _bayer(found: layouts.Metadata, nominal: CameraFigures | None, path: Path | str) -> BayerPattern:
    places = (found.image.mosaic, found.image.raw_details.mosaic, found.devices.sensor.mosaic)
    corner = next((place.upper_left_pixel for place in places if place.upper_left_pixel), None)
    if corner is not None:
        return UPPER_LEFT_PIXEL[corner]
    if nominal is None:
        raise _bad("is missing, and the camera's model is not known", "image.mosaic.upperLeftPixel", path)
    return nominal.bayer


def _white_balance(found: layouts.Metadata) -> ColourValues | None:
    gains = found.image.color.white_balance_gain or found.algorithms.awb.computed.gain
    return _values(gains) if gains else None


def _colour_matrix(colour: layouts.Colour) -> Matrix3 | None:
    values = colour.ccm or colour.ccm_rgb_to_srgb_array
    if values is None:
        return None
    (a, b, c, d, e, f, g, h, i) = values
    return (a, b, c), (d, e, f), (g, h, i)


def _check_size(raw: RawMetadata, path: Path | str) -> None:
    if raw.width * raw.height > MAX_PIXELS:
        raise _bad(f"{raw.width}×{raw.height} px are more than {MAX_PIXELS}", "image.width", path, "too-large")
    low, high = LENS_PITCH_PX
    if not low <= raw.lens_pitch_px <= high:
        message = f"a lens is {raw.lens_pitch_px:.3g} px wide, not {low:g} to {high:g}"
        raise _bad(message, "devices.mla.lensPitch", path)
