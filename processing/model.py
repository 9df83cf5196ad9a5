"""The nouns of the pipeline: frozen, validated, with shapes and units written down.

Conventions (docs/conventions.md): pixel centres are integers; camera axes x right, y down, z forward;
``X_c = R X + t`` with the world in metres; views row-major and zero-based; disparity δ in px per view step,
``δ = b F (1/z − 1/z_f)``, positive in front of the focal plane; the point at (x, y) of the centre view is at
``(x − (c − c0) δ, y − (r − r0) δ)`` in view (r, c). Colours are RGB.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
Image = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True)
class Camera:
    """Square-pixel pinhole intrinsics [px]; (cx, cy) = ((W−1)/2, (H−1)/2) for a centred camera."""

    width: int
    height: int
    focal_px: float
    cx: float
    cy: float
    sigma_focal: float = 0.0
    """Relative standard deviation of the focal length; 0 = trusted."""

    def __post_init__(self) -> None:
        for name in ("focal_px", "cx", "cy", "sigma_focal"):
            if not np.isfinite(getattr(self, name)):
                raise BadInput(f"{name} is not finite", field="camera", remedy="correct the intrinsics")
        if self.focal_px <= 0:
            raise BadInput(f"focal_px {self.focal_px:g} is not positive", field="camera", remedy="give it in pixels")

    @classmethod
    def centred(cls, width: int, height: int, focal_px: float, sigma_focal: float = 0.0) -> Camera:
        """A camera whose principal point is the image centre."""
        return cls(width, height, float(focal_px), (width - 1) / 2, (height - 1) / 2, sigma_focal)

    @cached_property
    def matrix(self) -> F64:
        """K, float64 [3, 3]."""
        return np.array([[self.focal_px, 0, self.cx], [0, self.focal_px, self.cy], [0, 0, 1]], np.float64)

    def resized(self, width: int, height: int) -> Camera:
        """The camera of the same image resampled to another size of the same shape (integer pixel centres)."""
        s = width / self.width
        return Camera(
            width, height, self.focal_px * s, (self.cx + 0.5) * s - 0.5, (self.cy + 0.5) * s - 0.5, self.sigma_focal
        )


@dataclass(frozen=True)
class Pose:
    """Rigid transform ``X_c = rotation @ X + translation``; float64 [3, 3] and [3] in metres."""

    rotation: F64
    translation: F64
    sigma_deg: float = 0.0
    sigma_m: float = 0.0

    def __post_init__(self) -> None:
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,):
            raise BadInput("a pose needs R [3, 3] and t [3]", field="pose", remedy="correct its shape")
        if not (np.isfinite(self.rotation).all() and np.isfinite(self.translation).all()):
            raise BadInput("holds NaN or infinity", field="pose", code="pose-not-finite", remedy="correct the pose")

    @property
    def centre(self) -> F64:
        """The camera's centre of projection in the world, −Rᵀt [3]."""
        return np.asarray(-self.rotation.T @ self.translation, np.float64)

    @property
    def direction(self) -> F64:
        """The optical axis in the world, unit vector [3]."""
        return np.asarray(self.rotation[2], np.float64)


@dataclass(frozen=True)
class Optics:
    """Baseline between adjacent views and focus distance [m]; None = unknown. ``sigma_baseline`` is relative."""

    baseline_m: float | None = None
    focus_distance_m: float | None = None
    sigma_baseline: float = 0.03


@dataclass(frozen=True)
class LightField:
    """A light-field capture.

    ``views`` is uint8 [rows, cols, H, W, 3] RGB; ``camera`` the centre view's intrinsics, or None when unknown.
    """

    id: str
    views: U8
    camera: Camera | None = None
    optics: Optics = field(default_factory=Optics)
    pose: Pose | None = None
    turntable_deg: float | None = None
    depth_range_m: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        v = self.views
        if v.ndim != 5 or v.shape[4] != 3 or v.dtype != np.uint8 or min(v.shape[:2]) < 3:
            raise BadInput(
                f"views must be uint8 [rows ≥ 3, cols ≥ 3, H, W, 3], got {v.dtype} {list(v.shape)}",
                path=self.id, field="views", remedy="check how the light field was loaded",
            )  # fmt: skip

    @property
    def angular(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.views.shape[0], self.views.shape[1]

    @property
    def height(self) -> int:
        """Height of a view [px]."""
        return int(self.views.shape[2])

    @property
    def width(self) -> int:
        """Width of a view [px]."""
        return int(self.views.shape[3])

    @property
    def centre_index(self) -> tuple[int, int]:
        """(row, col) of the view that is nearest to the centre of projection (0, 0)."""
        return (self.views.shape[0] - 1) // 2, (self.views.shape[1] - 1) // 2

    @property
    def centre_view(self) -> U8:
        """uint8 [H, W, 3]."""
        r, c = self.centre_index
        return np.asarray(self.views[r, c])

    def offsets(self) -> F64:
        """Angular offset (r − r0, c − c0) of every view from the centre *view*, float64 [rows, cols, 2]."""
        r0, c0 = self.centre_index
        rows, cols = self.angular
        return np.stack(np.meshgrid(np.arange(rows) - r0, np.arange(cols) - c0, indexing="ij"), -1).astype(np.float64)


@dataclass(frozen=True)
class Photo:
    """The target: ``image`` uint8 or uint16 [H, W, 3] RGB; ``camera.focal_px`` may come from EXIF (sigma_focal)."""

    id: str
    image: Image
    camera: Camera | None = None
    pose: Pose | None = None
    turntable_deg: float | None = None

    @property
    def image8(self) -> U8:
        """The photo as uint8 [H, W, 3], what matching and synthesis see."""
        return (
            self.image.astype(np.uint8, copy=False) if self.image.itemsize == 1 else (self.image >> 8).astype(np.uint8)
        )


@dataclass(frozen=True)
class Plate:
    """How far the turntable's load reaches: a cylinder about the axis (+z of the plate), from the plate up [m]."""

    radius_m: float
    height_m: float


@dataclass(frozen=True)
class RigPrior:
    """What the rig knows before any image is looked at: camera poses to the plate at angle 0, and their sigmas;
    ``plate`` where only what stands on it matters.
    """

    light_field_from_plate: Pose | None = None
    target_from_plate: Pose | None = None
    turntable_sigma_deg: float = 0.3
    depth_range_m: tuple[float, float] | None = None
    plate: Plate | None = None


@dataclass(frozen=True)
class Evidence:
    """Disparity evidence of one light field, on the grid of its centre view (the DPV and what is read from it).

    ``probability`` uint16 [H, W, D], 65535 = certain, sums to about 65535 along D; ``planes_px`` = (first, step) in px
    per view step; ``disparity`` float32 [H, W] px per view step; ``confidence`` float32 [H, W] in 0..1, the mass at
    the peak; ``noise_sigma`` in grey levels (0..255).
    """

    probability: NDArray[np.uint16]
    planes_px: tuple[float, float]
    disparity: F32
    confidence: F32
    noise_sigma: float = 0.0
    views_used: int = 0
    occlusion_tested: float = 0.0
    """Share of the pixels that needed the half-aperture test."""

    @property
    def planes(self) -> int:
        """Number of disparity planes D."""
        return int(self.probability.shape[2])


@dataclass(frozen=True)
class Anchors:
    """Triangulated points seen by one capture: ``xy`` float64 [N, 2] px in its centre view, ``depth_m`` [N] along
    its optical axis, ``world`` [N, 3] m.
    """

    xy: F64
    depth_m: F64
    world: F64

    def __len__(self) -> int:
        return len(self.depth_m)


@dataclass(frozen=True)
class ScaleFit:
    """SCVR of one capture: ``1/z = a δ + c`` (a in 1/(px·m), c in 1/m); ``residual`` is the robust standard
    deviation [1/m], ``inliers`` a fraction, ``anchors`` how many points carried it.
    """

    a: float
    c: float
    residual: float = 0.0
    inliers: float = 1.0
    anchors: int = 0
    form: str = "affine"

    def inverse_depth(self, disparity: F32) -> F32:
        """1/z [1/m] of a disparity [px per view step]."""
        return np.asarray(self.a * disparity + self.c, np.float32)

    def disparity(self, inverse_depth: F32) -> F32:
        """δ [px per view step] of an inverse depth [1/m]."""
        return np.asarray((inverse_depth - self.c) / self.a, np.float32)


@dataclass(frozen=True)
class Source:
    """A light field that is ready to be fused: its evidence, scale and pose."""

    light_field: LightField
    camera: Camera
    pose: Pose
    evidence: Evidence
    scale: ScaleFit


@dataclass(frozen=True)
class Surface:
    """What the target sees: ``inverse_depth`` float32 [H, W] 1/m (NaN = unknown), ``confidence`` float32 [H, W] =
    P(|disparity error| < 0.1 px), ``sigma`` float32 [H, W] 1/m, what 68.3 % of such pixels' errors stay below,
    ``seen`` float32 [H, W] sources that support it.
    """

    inverse_depth: F32
    confidence: F32
    sigma: F32
    seen: F32


@dataclass(frozen=True)
class LightFieldRequest:
    """The light field to be made: baseline between adjacent views [m], focus distance [m], views."""

    baseline_m: float
    focus_distance_m: float
    rows: int = 7
    cols: int = 7

    def disparity(self, inverse_depth: F32, focal_px: float) -> F32:
        """δ [px per view step] of an inverse depth [1/m] seen by a camera of focal length ``focal_px``."""
        return np.asarray(self.baseline_m * focal_px * (inverse_depth - 1.0 / self.focus_distance_m), np.float32)

    def inverse_depth(self, disparity: F32, focal_px: float) -> F32:
        """The inverse of `disparity`."""
        return np.asarray(disparity / (self.baseline_m * focal_px) + 1.0 / self.focus_distance_m, np.float32)


@dataclass(frozen=True)
class SynthesizedLightField:
    """The result: ``views`` uint8 or uint16 [rows, cols, H, W, 3]; ``disparity`` float32 [H, W] of the centre view."""

    views: Image
    disparity: F32
    surface: Surface
    request: LightFieldRequest
    camera: Camera

    def with_views(self, views: Image) -> SynthesizedLightField:
        """The same geometry with other pixels."""
        return replace(self, views=views)
