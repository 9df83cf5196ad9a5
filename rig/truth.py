"""What really was: the truth beside a simulated session. Scoring and leave-one-out alone read it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lfrig.contracts.capture import ViewsSpec
from lfrig.contracts.errors import BadInput
from lfrig.contracts.truth import TruthCapture, TruthDocument
from lfrig.processing.model import F32, U8, LightFieldRequest

OPTICS_TOLERANCE = 1e-6
"""Views are compared when their baseline and focus distance agree to this fraction."""

ONLY_SIMULATED = "only simulated sessions have a truth; give another with --truth DIR"


@dataclass(frozen=True)
class CaptureTruth:
    """The truth of one capture.

    ``inverse_depth`` float32 [H, W] 1/m along the optical axis of the centre view (NaN = unknown);
    ``focal_px`` its focal length; ``baseline_m`` and ``focus_distance_m`` of the light field ``views``, uint8
    [rows, cols, H, W, 3] RGB without noise, or None when the truth holds none; ``noise_sigma`` the noise on
    the recorded pixels [grey levels].
    """

    id: str
    inverse_depth: F32
    focal_px: float
    baseline_m: float | None
    focus_distance_m: float | None
    views: U8 | None
    noise_sigma: float

    @property
    def photo(self) -> U8 | None:
        """The centre view without noise, uint8 [H, W, 3], or None."""
        if self.views is None:
            return None
        return np.asarray(self.views[(self.views.shape[0] - 1) // 2, (self.views.shape[1] - 1) // 2])

    def disparity(self, baseline_m: float, focus_distance_m: float) -> F32:
        """True disparity [px per view step] of a light field with these optics, float32 [H, W]."""
        bf = baseline_m * self.focal_px
        return np.asarray(bf * (self.inverse_depth.astype(np.float64) - 1.0 / focus_distance_m), np.float32)

    def shows(
        self, request: LightFieldRequest, reference: U8 | None, shape: tuple[int, ...], *, any_optics: bool = False
    ) -> str | None:
        """None when ``reference`` are views of this shape and (unless ``any_optics``) of these optics; else why
        not.
        """
        if reference is None:
            return "the truth holds no views"
        if reference.shape != shape:
            return f"the true ones are {_size(reference.shape)}, the result's {_size(shape)}"
        if any_optics:
            return None
        for name, mine, asked in (
            ("baseline", self.baseline_m, request.baseline_m),
            ("focus distance", self.focus_distance_m, request.focus_distance_m),
        ):
            if mine is None or abs(asked / mine - 1.0) > OPTICS_TOLERANCE:
                shown = "unknown" if mine is None else f"{mine:.7g} m"
                return f"the {name} of the true ones is {shown}, the result's {asked:.7g} m"
        return None


def truth_beside(session: Path) -> Path:
    """Where the truth of a session is, whether it exists or not: SESSION.truth."""
    session = session.resolve()
    return session.with_name(session.name + ".truth")


def load_capture_truth(truth: Path, capture_id: str) -> CaptureTruth:
    """Read the truth of one capture.

    Raises
    ------
    BadInput
        There is no truth, it does not know the capture, or a file of it cannot be read.
    """
    if not (truth / "truth.json").is_file():
        raise BadInput("holds no truth.json", path=truth, code="no-truth", remedy=ONLY_SIMULATED)
    captures = TruthDocument.load(truth / "truth.json").captures
    if capture_id not in captures:
        raise BadInput(
            f"knows no capture {capture_id!r}", path=truth / "truth.json", field="captures", code="no-truth",
            remedy="score a result of the session that the truth belongs to",
        )  # fmt: skip
    capture = captures[capture_id]
    folder = truth / "captures" / capture_id
    depth_m = _load_depth(folder / "depth.npy")
    if depth_m.shape != (capture.camera.height, capture.camera.width):
        raise BadInput(
            f"is {list(depth_m.shape)}, the camera {capture.camera.width}×{capture.camera.height}",
            path=folder / "depth.npy", remedy="restore the truth of this session",
        )  # fmt: skip
    with np.errstate(divide="ignore"):
        inverse_depth = (1.0 / depth_m.astype(np.float64)).astype(np.float32)
    return CaptureTruth(
        id=capture_id,
        inverse_depth=inverse_depth,
        focal_px=_focal(capture, truth),
        baseline_m=capture.optics.baseline_m,
        focus_distance_m=capture.optics.focus_distance_m,
        views=None if capture.views is None else _load_views(folder, capture.views),
        noise_sigma=capture.noise_sigma,
    )


def _focal(capture: TruthCapture, truth: Path) -> float:
    if capture.camera.fx is None:
        raise BadInput("is missing", path=truth / "truth.json", field="camera.fx", remedy="restore the truth")
    return capture.camera.fx


def _load_depth(path: Path) -> F32:
    try:
        depth = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise BadInput(f"cannot be read: {error}", path=path, remedy="restore the truth of this session") from None
    if depth.ndim != 2 or not np.issubdtype(depth.dtype, np.floating):
        raise BadInput("is no [H, W] map of depths", path=path, remedy="restore the truth of this session")
    return np.asarray(depth, np.float32)


def _load_views(folder: Path, spec: ViewsSpec) -> U8:
    from lfrig.processing.export.png import read_png

    views = [
        read_png(folder / spec.pattern.format(row=row, col=col)) for row in range(spec.rows) for col in range(spec.cols)
    ]
    if {(v.shape, v.dtype) for v in views} != {(views[0].shape, np.dtype(np.uint8))}:
        raise BadInput("holds views of several sizes or depths", path=folder, remedy="restore the truth")
    return np.stack(views).astype(np.uint8, copy=False).reshape(spec.rows, spec.cols, *views[0].shape)


def _size(shape: tuple[int, ...]) -> str:
    return f"{shape[0]}×{shape[1]} × {shape[3]}×{shape[2]}"
