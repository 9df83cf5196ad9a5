"""What a raw file says of its camera and its shot: one frozen record, whichever camera wrote it."""

from __future__ import annotations

from dataclasses import dataclass

from lfrig.contracts.lytro import BayerPattern, Packing

ColourValues = tuple[float, float, float, float]
"""One value per Bayer colour in the order r, gr, gb, b (`contracts.lytro.COLOURS`)."""
Matrix3 = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


@dataclass(frozen=True)
class RawMetadata:
    """A shot's metadata, checked; None = the file does not say.

    Lengths in metres, angles in radians. ``white_balance`` are gains, green 1. ``colour_matrix`` takes white-balanced
    linear camera RGB to linear sRGB (rows R, G, B of sRGB). ``mla_rotation_rad`` and ``sensor_offset_m`` (x, y, z) are
    as recorded. References are ``sha1-…`` strings.
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
