"""capture.json: one shot of the light-field camera or of the target camera. Lengths in metres, angles in degrees."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from lfrig.contracts.schema import Document, Finite, Model, NonNegative, Positive, PositiveInt

Vector3 = tuple[Finite, Finite, Finite]
Matrix3 = tuple[Vector3, Vector3, Vector3]
ROTATION_TOLERANCE = 1e-3


class ViewsSpec(Model):
    """Where the sub-aperture images are: ``pattern`` with ``{row}`` and ``{col}``, zero-based, row-major."""

    rows: Annotated[int, Field(ge=3)]
    cols: Annotated[int, Field(ge=3)]
    pattern: str = "views/{row:02d}_{col:02d}.png"


class RawSpec(Model):
    """A raw plenoptic file and the calibration that decodes it."""

    path: str
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
    distortion: list[Finite] | None = None
    sigma_f: NonNegative | None = None
    """Relative standard deviation of fx."""


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
        rows = self.R
        for i in range(3):
            for j in range(3):
                dot = sum(rows[i][k] * rows[j][k] for k in range(3))
                if abs(dot - (i == j)) > ROTATION_TOLERANCE:
                    raise ValueError("R is not a rotation matrix (rows not orthonormal)")
        determinant = sum(
            rows[0][k] * (rows[1][(k + 1) % 3] * rows[2][(k + 2) % 3] - rows[1][(k + 2) % 3] * rows[2][(k + 1) % 3])
            for k in range(3)
        )
        if determinant < 0:
            raise ValueError("R is a reflection, not a rotation (determinant -1)")
        return self


class CaptureDocument(Document):
    """One capture. ``pose`` overrides structure from motion; None means unknown."""

    NAME: ClassVar[str] = "lfrig.capture"

    kind: Literal["light_field", "photo"]
    time: str | None = None
    views: ViewsSpec | None = None
    image: str | None = None
    raw: RawSpec | None = None
    camera: CameraSpec | None = None
    optics: OpticsSpec | None = None
    exposure: ExposureSpec | None = None
    depth_range_m: tuple[Positive, Positive] | None = None
    turntable_deg: Finite | None = None
    pose: PoseSpec | None = None

    @model_validator(mode="after")
    def _has_pixels(self) -> CaptureDocument:
        if self.kind == "photo" and self.image is None:
            raise ValueError("a photo needs the field 'image'")
        if self.kind == "light_field" and self.views is None and self.raw is None:
            raise ValueError("a light field needs the field 'views' or 'raw'")
        if self.depth_range_m is not None and self.depth_range_m[0] >= self.depth_range_m[1]:
            raise ValueError("depth_range_m must be [near, far] with near < far")
        return self
