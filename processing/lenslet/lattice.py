"""The hexagonal lattice of lens images on the sensor: one global least-squares fit of all lens centres.

The centre of lens (i, j) is ``o + R(θ) · ((i + ½ (j mod 2)) p, j (√3/2) p q)`` (docs/lenslet.md, Geometry).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import BadInput
from lfrig.processing.model import F32, F64

ROW_RISE = float(np.sqrt(3) / 2)
"""Distance of two rows of a regular hexagonal lattice, in pitches."""
MAX_RESIDUAL_PITCHES = 0.04
"""Largest residual RMS that is accepted; centres found at random leave 0.15."""
MAX_RESIDUAL_PITCHES_ON_CAPTURE = 0.1
"""The same on a shot, whose scene moves the maxima to and fro; their mean is still good to 0.1 px."""
MIN_LENSES = 200
MIN_SHARE = 0.6
"""Least share of the lenses that the sensor holds that must have been found on a white image."""
MIN_SHARE_ON_CAPTURE = 0.5
"""The same on a shot; noise alone gives a third."""
MAX_PITCH_CHANGE = 0.03
"""Largest relative departure of the fitted pitch from the expected one."""
GATE_PITCHES = 0.25
"""A maximum farther than this from every lens centre is none."""
FIRST_RADIUS_LENSES = 6.0
OUTLIER_SIGMAS = 3.5


@dataclass(frozen=True)
class HexLattice:
    """The lattice of lens images.

    ``origin`` (x, y) [px] is the centre of the lens nearest the sensor's centre, ``pitch_px`` the distance of lenses
    along a row, ``rotation_rad`` the direction of the rows from +x towards +y, ``vertical`` the ratio q of the vertical
    to the horizontal scale. ``residual_rms_px`` and ``lenses`` tell of the fit that it came from.
    """

    origin: tuple[float, float]
    pitch_px: float
    rotation_rad: float = 0.0
    vertical: float = 1.0
    residual_rms_px: float = 0.0
    lenses: int = 0

    @property
    def axes(self) -> F64:
        """Columns: the unit vectors of the lattice's x and y axes in the sensor, float64 [2, 2]."""
        c, s = np.cos(self.rotation_rad), np.sin(self.rotation_rad)
        return np.array([[c, -s], [s, c]])

    @property
    def row_rise_px(self) -> float:
        """Distance of two rows [px]."""
        return self.pitch_px * ROW_RISE * self.vertical

    @property
    def basis(self) -> F64:
        """Columns: the steps from a lens to its right and to its lower right neighbour, float64 [2, 2] px."""
        return np.asarray(self.axes @ np.array([[self.pitch_px, self.pitch_px / 2], [0.0, self.row_rise_px]]))

    def centres(self, i: NDArray[np.integer[Any]], j: NDArray[np.integer[Any]]) -> F64:
        """Centres (x, y) of lenses [px], float64 [..., 2]; any integers, negative ones too."""
        along, up = np.broadcast_arrays((i + 0.5 * np.mod(j, 2)) * self.pitch_px, j * self.row_rise_px)
        local = np.stack([along, up], -1)
        return np.asarray(local @ self.axes.T + np.asarray(self.origin))

    def as_dict(self) -> dict[str, Any]:
        """JSON-able; `from_dict` is the inverse."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> HexLattice:
        """The inverse of `as_dict`; raises KeyError, TypeError or ValueError for anything else."""
        x, y = values["origin"]
        names = ("pitch_px", "rotation_rad", "vertical", "residual_rms_px")
        numbers = {name: float(values[name]) for name in names}
        found = cls((float(x), float(y)), **numbers, lenses=int(values["lenses"]))
        if not np.isfinite([*found.origin, *numbers.values()]).all() or found.pitch_px <= 0 or found.vertical <= 0:
            raise ValueError("a lattice needs finite figures and a positive pitch")
        return found


def fit_lattice(
    white: F32 | NDArray[np.uint16], pitch_px: float, rotation_rad: float = 0.0, vertical: float = 1.0
) -> HexLattice:
    """Fit the lattice to a white image.

    Local maxima of the image, smoothed and divided by its local mean so that shading does not move them, are refined
    to sub-pixels, given lens indices outwards from the middle, and fitted all at once, outliers rejected.

    Parameters
    ----------
    white : float32 or uint16 [Hs, Ws]
        Black level subtracted, the Bayer colours brought to one level.
    pitch_px, rotation_rad, vertical : float
        What the metadata say; a rotation of the wrong sign is near enough to start from.

    Returns
    -------
    HexLattice

    Raises
    ------
    BadInput
        ``lattice-residual``: too few lenses, a residual above 4 % of the pitch, or a pitch more than 3 % from the
        expected one.
    """
    start = _start(white.shape, pitch_px, rotation_rad, vertical)
    cells = bayer_cells(white)
    return _fit(lens_maxima(cells, pitch_px), white.shape, start, MIN_SHARE, MAX_RESIDUAL_PITCHES)


def fit_lattice_on_capture(
    picture: F32 | NDArray[np.uint16], pitch_px: float, rotation_rad: float = 0.0, vertical: float = 1.0
) -> HexLattice:
    """Fit the lattice to a shot itself, where there is no white image; as `fit_lattice`, and callers should warn.

    The shot is vignetting times scene, so its logarithm is a periodic part plus the scene: averaged over the lenses
    around each, the scene all but vanishes. There is nothing to divide the vignetting by, which is why a white image
    is better.
    """
    start = _start(picture.shape, pitch_px, rotation_rad, vertical)
    cells = bayer_cells(picture)
    cells = np.log(np.maximum(cells, 0.02 * float(cells.mean()) + 1e-6))
    cells -= cells.min()
    points = lens_maxima(_mean_over_lenses(cells, start), pitch_px)
    return _fit(points, picture.shape, start, MIN_SHARE_ON_CAPTURE, MAX_RESIDUAL_PITCHES_ON_CAPTURE)


def bayer_cells(image: F32 | NDArray[np.uint16]) -> F32:
    """Mean of each 2×2 Bayer cell, float32 [Hs // 2, Ws // 2]: half the size, and no residue of the colours."""
    import cv2

    height, width = (n - n % 2 for n in image.shape)
    cells = cv2.resize(image[:height, :width], (width // 2, height // 2), interpolation=cv2.INTER_AREA)
    return np.asarray(cells, np.float32)


def lens_maxima(cells: F32, pitch_px: float) -> F64:
    """Sub-pixel maxima of the lens images in `bayer_cells`, smoothed by σ = pitch/5; float64 [N, 2] (x, y) sensor px.

    Divided by a moving mean over about two lenses first: shading has a slope, which would pull every maximum inwards
    and with them the pitch.
    """
    import cv2

    smooth = cv2.GaussianBlur(cells, (0, 0), pitch_px / 10)
    mean = cv2.GaussianBlur(cv2.blur(cells, (2 * int(pitch_px / 2) + 1,) * 2), (0, 0), pitch_px / 2)
    lit = mean > 0.02 * float(mean.max(initial=0.0))
    smooth = np.where(lit, smooth / np.maximum(mean, 1e-6), 0).astype(np.float32)
    window = max(3, 2 * int(0.35 * pitch_px / 2) + 1)
    highest = cv2.dilate(smooth, np.ones((window, window), np.uint8))
    border = max(2, round(0.3 * pitch_px))  # a lens cut by the sensor's border has its maximum elsewhere
    inner = np.zeros(smooth.shape, bool)
    inner[border:-border, border:-border] = True
    y, x = np.nonzero((smooth == highest) & lit & inner)
    dx, dy = _quadratic_peak(smooth, x, y)
    return np.stack([2 * (x + dx) + 0.5, 2 * (y + dy) + 0.5], -1)


def _mean_over_lenses(cells: F32, start: HexLattice, reach: int = 8) -> F32:
    """Mean over the same point of the lenses up to ``reach`` lenses away, by the expected lattice."""
    import cv2

    size = int(reach * start.pitch_px / 2) + 2
    kernel = np.zeros((2 * size + 1, 2 * size + 1), np.float32)
    for a in range(-reach, reach + 1):
        for b in range(max(-reach, -reach - a), min(reach, reach - a) + 1):
            x, y = start.basis @ (a, b) / 2 + size
            x0, y0 = int(x), int(y)
            share = np.outer([1 - (y - y0), y - y0], [1 - (x - x0), x - x0])
            kernel[y0 : y0 + 2, x0 : x0 + 2] += share
    return np.asarray(cv2.filter2D(cells, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REFLECT), np.float32)


def _start(shape: tuple[int, ...], pitch_px: float, rotation_rad: float, vertical: float) -> HexLattice:
    if not 4 <= pitch_px <= min(shape) / 4:
        raise _refusal(f"a lens pitch of {pitch_px:g} px does not suit a sensor of {shape[1]}×{shape[0]} px")
    return HexLattice((0.0, 0.0), pitch_px, rotation_rad, vertical)


def _fit(points: F64, shape: tuple[int, ...], start: HexLattice, min_share: float, max_residual: float) -> HexLattice:
    expected = shape[0] * shape[1] / (start.pitch_px * start.row_rise_px)
    least = max(MIN_LENSES, min_share * expected)
    index, kept = _grow_indices(points, start, ((shape[1] - 1) / 2, (shape[0] - 1) / 2))
    if len(kept) < least:
        raise _refusal(f"only {len(kept)} of about {expected:.0f} lenses were found")
    found = _robust_fit(points[kept], index, start)
    _check(found, start.pitch_px, least, max_residual)
    return _recentred(found, shape)


def _quadratic_peak(image: F32, x: NDArray[np.intp], y: NDArray[np.intp]) -> tuple[F64, F64]:
    """Offset of the maximum of the quadratic that fits the 3×3 logarithms around each pixel best, within ±1."""
    logs = {
        (i, j): np.log(np.maximum(image[y + j, x + i], 1e-6), dtype=np.float64) for i in (-1, 0, 1) for j in (-1, 0, 1)
    }
    gx = sum(logs[1, j] - logs[-1, j] for j in (-1, 0, 1)) / 6
    gy = sum(logs[i, 1] - logs[i, -1] for i in (-1, 0, 1)) / 6
    hxx = sum(logs[1, j] - 2 * logs[0, j] + logs[-1, j] for j in (-1, 0, 1)) / 3
    hyy = sum(logs[i, 1] - 2 * logs[i, 0] + logs[i, -1] for i in (-1, 0, 1)) / 3
    hxy = (logs[1, 1] - logs[-1, 1] - logs[1, -1] + logs[-1, -1]) / 4
    det = hxx * hyy - hxy**2
    det = np.where(det > 1e-12, det, np.inf)  # no maximum: stays where it is
    dx, dy = -(hyy * gx - hxy * gy) / det, -(hxx * gy - hxy * gx) / det
    return np.clip(dx, -1, 1), np.clip(dy, -1, 1)


def _grow_indices(
    points: F64, start: HexLattice, middle: tuple[float, float]
) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Axial lens indices int64 [M, 2] of the points that lie on the lattice, and which points those are.

    From the middle outwards: over a few lenses the expected pitch is good enough to count by, and every doubling of
    the radius is counted by the lattice fitted so far.
    """
    nothing = np.empty((0, 2), np.int64), np.empty(0, np.intp)
    if len(points) < MIN_LENSES:
        return nothing
    distance = np.hypot(*(points - middle).T)
    basis = start.basis
    origin = points[distance.argmin()]
    radius = FIRST_RADIUS_LENSES * start.pitch_px
    while True:
        near = np.flatnonzero(distance <= radius)
        index, kept = _indices(points[near], basis, origin, start.pitch_px)
        if len(kept) < 12:
            return nothing
        kept = near[kept]
        origin, basis = _affine_fit(points[kept], index)
        if radius >= distance.max():
            return index, kept
        radius *= 2


def _indices(points: F64, basis: F64, origin: F64, pitch_px: float) -> tuple[NDArray[np.int64], NDArray[np.intp]]:
    """Nearest axial index of each point, of those within the gate."""
    index = np.rint((points - origin) @ np.linalg.inv(basis).T)
    miss = points - origin - index @ basis.T
    kept = np.flatnonzero((miss**2).sum(1) < (GATE_PITCHES * pitch_px) ** 2)
    return index[kept].astype(np.int64), kept


def _affine_fit(points: F64, index: NDArray[np.int64]) -> tuple[F64, F64]:
    """Least squares ``point = origin + basis @ index``: origin [2], basis [2, 2]."""
    design = np.column_stack([np.ones(len(index)), index])
    solution = np.linalg.lstsq(design.T @ design, design.T @ points, rcond=None)[0]
    return solution[0], solution[1:].T


def _robust_fit(points: F64, index: NDArray[np.int64], start: HexLattice) -> HexLattice:
    """Gauss–Newton on the five parameters over all lenses, outliers rejected by the median of the residuals."""
    origin, basis = _affine_fit(points, index)
    lattice = _from_basis(origin, basis, start)
    use = np.ones(len(points), bool)
    for _ in range(4):
        lattice = _least_squares_step(points[use], index[use], lattice)
        miss = np.hypot(*(points - _predict(lattice, index)).T)
        # The median of a Rayleigh distribution is 1.1774 σ.
        use = miss <= max(OUTLIER_SIGMAS * float(np.median(miss)) / 1.1774, 1e-3)
    rms = float(np.sqrt(np.mean(miss[use] ** 2)))
    return replace(lattice, residual_rms_px=rms, lenses=int(use.sum()))


def _from_basis(origin: F64, basis: F64, start: HexLattice) -> HexLattice:
    along = basis[:, 0]
    rotation = float(np.arctan2(along[1], along[0]))
    pitch = float(np.hypot(*along))
    rise = float(basis[1, 1] * np.cos(rotation) - basis[0, 1] * np.sin(rotation))
    vertical = rise / (pitch * ROW_RISE)
    return replace(start, origin=(origin[0], origin[1]), pitch_px=pitch, rotation_rad=rotation, vertical=vertical)


def _predict(lattice: HexLattice, index: NDArray[np.int64]) -> F64:
    return np.asarray(lattice.origin + index @ lattice.basis.T)


def _least_squares_step(points: F64, index: NDArray[np.int64], lattice: HexLattice) -> HexLattice:
    """One step in (x, y, pitch, pitch·rotation, pitch·vertical); the problem is all but linear."""
    along, up = lattice.axes.T
    across = index[:, 0] + 0.5 * index[:, 1]  # in pitches along the row
    rows = ROW_RISE * index[:, 1]
    local = np.column_stack([across, rows * lattice.vertical])
    turned = np.outer(local[:, 0], up) - np.outer(local[:, 1], along)
    columns = [
        np.broadcast_to([1.0, 0.0], points.shape), np.broadcast_to([0.0, 1.0], points.shape),
        local @ lattice.axes.T, turned, np.outer(rows, up),
    ]  # fmt: skip
    design = np.stack([np.ravel(column) for column in columns], -1)
    miss = (points - _predict(lattice, index)).ravel()
    step = np.linalg.lstsq(design.T @ design, design.T @ miss, rcond=None)[0]
    return replace(
        lattice,
        origin=(lattice.origin[0] + step[0], lattice.origin[1] + step[1]),
        pitch_px=lattice.pitch_px + step[2],
        rotation_rad=lattice.rotation_rad + step[3] / lattice.pitch_px,
        vertical=lattice.vertical + step[4] / lattice.pitch_px,
    )


def _check(found: HexLattice, pitch_px: float, least: float, max_residual: float) -> None:
    if found.lenses < least:
        raise _refusal(f"only {found.lenses} lenses lie on one lattice, {least:.0f} are needed")
    if found.residual_rms_px > max_residual * found.pitch_px:
        raise _refusal(
            f"lens centres are {found.residual_rms_px:.2f} px from the lattice, "
            f"at most {max_residual * found.pitch_px:.2f} px is accepted"
        )
    change = found.pitch_px / pitch_px - 1
    if abs(change) > MAX_PITCH_CHANGE:
        raise _refusal(f"the lens pitch is {found.pitch_px:.3f} px, {100 * change:+.1f} % from the metadata's")


def _recentred(lattice: HexLattice, shape: tuple[int, ...]) -> HexLattice:
    """The same lattice with its origin at the lens nearest the sensor's centre, in plain floats."""
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    axial = np.rint(np.linalg.solve(lattice.basis, middle - lattice.origin))
    x, y = lattice.origin + lattice.basis @ axial
    return HexLattice(
        (float(x), float(y)), float(lattice.pitch_px), float(lattice.rotation_rad), float(lattice.vertical),
        lattice.residual_rms_px, lattice.lenses,
    )  # fmt: skip


def _refusal(message: str) -> BadInput:
    return BadInput(
        f"no lens lattice: {message}", code="lattice-residual",
        remedy="check that the white image belongs to this camera, zoom and focus",
    )  # fmt: skip
