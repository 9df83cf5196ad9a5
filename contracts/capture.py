"""capture.json: one shot of the light-field or of the target camera. Lengths in metres, angles in degrees."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, field_validator, model_validator

from lfrig.contracts.paths import InsidePath, ViewPattern, expand
from lfrig.contracts.schema import DepthRange, Document, Finite, Model, NonNegative, Positive, PositiveInt

Vector3 = tuple[Finite, Finite, Finite]
Matrix3 = tuple[Vector3, Vector3, Vector3]
MAX_VIEWS_PER_SIDE = 256
ROTATION_TOLERANCE = 1e-3
DISTORTION_LENGTHS = {0, 4, 5, 8}


def _dot(a: Vector3, b: Vector3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: Vector3, b: Vector3) -> Vector3:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


class ViewsSpec(Model):
    """Where the sub-aperture images are: ``pattern`` with ``{row}`` and ``{col}``, zero-based, row-major."""

    rows: Annotated[int, Field(ge=3, le=MAX_VIEWS_PER_SIDE)]
    cols: Annotated[int, Field(ge=3, le=MAX_VIEWS_PER_SIDE)]
    pattern: ViewPattern = "views/{row:02d}_{col:02d}.png"

    def file(self, row: int, col: int) -> str:
        """Name of view (row, col) in the capture's folder."""
        return expand(self.pattern, row, col)


class RawSpec(Model):
    """A raw plenoptic file and the calibration that decodes it."""

    path: InsidePath
    sha256: str | None = None
    calibration: str | None = None


class CameraSpec(Model):
    """Pinhole intrinsics of the centre view [px]; pixel centres are integers."""

    width: PositiveInt
    height: PositiveInt
    fx: Positive | None = None
    fy: Positive | None = None
    cx: Finite | None = None
    cy: Finite | None = None
    distortion: tuple[Finite, ...] | None = None
    """Brown–Conrady coefficients (k1, k2, p1, p2[, k3[, k4, k5, k6]]), as OpenCV orders them."""
    sigma_f: NonNegative | None = None
    """Relative standard deviation of fx."""

    @field_validator("distortion")
    @classmethod
    def _known_model(cls, value: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if value is not None and len(value) not in DISTORTION_LENGTHS:
            raise ValueError(f"must have 0, 4, 5 or 8 coefficients, got {len(value)}")
        return value


class OpticsSpec(Model):
    """Baseline between adjacent views [m], focus distance [m]; ``sigma_baseline`` is relative."""

    baseline_m: Positive | None = None
    focus_distance_m: Positive | None = None
    sigma_baseline: NonNegative | None = None


class ExposureSpec(Model):
    """Exposure settings as recorded."""

    time_s: Positive | None = None
    iso: Positive | None = None
    white_balance: Vector3 | None = None


class PoseSpec(Model):
    """A rigid transform X_c = R X + t [m], with standard deviations."""

    R: Matrix3
    t: Vector3
    sigma_deg: NonNegative = 0.0
    sigma_m: NonNegative = 0.0

    @model_validator(mode="after")
    def _is_rotation(self) -> PoseSpec:
        x, y, z = self.R
        for i, a in enumerate(self.R):
            for j, b in enumerate(self.R):
                if abs(_dot(a, b) - (i == j)) > ROTATION_TOLERANCE:
                    raise ValueError("R is not a rotation matrix (rows not orthonormal)")
        if _dot(_cross(x, y), z) < 0:
            raise ValueError("R is a reflection, not a rotation (determinant -1)")
        return self


class OriginSpec(Model):
    """What an ingested capture was made from: its name, its format, and a hash of its content."""

    name: str
    format: str | None = None
    sha256: str | None = None


class CaptureDocument(Document):
    """One capture. ``pose`` overrides structure from motion; None means unknown."""

    NAME: ClassVar[str] = "lfrig.capture"

    kind: Literal["light_field", "photo"]
    time: str | None = None
    views: ViewsSpec | None = None
    image: InsidePath | None = None
    raw: RawSpec | None = None
    camera: CameraSpec | None = None
    optics: OpticsSpec | None = None
    exposure: ExposureSpec | None = None
    depth_range_m: DepthRange | None = None
    turntable_deg: Finite | None = None
    pose: PoseSpec | None = None
    origin: OriginSpec | None = None

    @model_validator(mode="after")
    def _has_pixels(self) -> CaptureDocument:
        if self.kind == "photo" and self.image is None:
            raise ValueError("a photo needs the field 'image'")
        if self.kind == "light_field" and self.views is None and self.raw is None:
            raise ValueError("a light field needs the field 'views' or 'raw'")
        return self
