"""δ ↔ inverse depth per capture (SCVR): the line ``1/z = a·δ + c`` through a capture's anchors.

The thin-lens model makes disparity affine in inverse depth, ``a = 1/(bF)`` and ``c = 1/z_f``. The paper fits depth,
``z = α/δ + β``, which has a pole at the focal plane; its form is kept for the ablation (``fit_paper``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lfrig.contracts.errors import GeometryRefused
from lfrig.contracts.progress import Monitor
from lfrig.processing.kernels.line_fit import TUKEY, LinePrior, biweight_line, least_median_line
from lfrig.processing.model import F64, Anchors, Camera, Evidence, LightField, ScaleFit

MIN_ANCHORS = 8
EFFECTIVE_ANCHORS = 60
DISPARITY_SIGMA_PX = 0.01
"""Standard deviation of an anchor's disparity that need not be explained: where most anchors lie on one frontal plane,
a line without slope explains these best and takes all others for outliers."""
SETTLED = 1e-4
"""A fit that moves by less than this share of its scatter stands still."""
MIN_OPTICS_SIGMA = 0.005
PRIOR_LIMIT = 4.0
"""Standard deviations beyond which anchors and recorded optics contradict each other."""


@dataclass(frozen=True)
class ScaleFitSettings:
    """Knobs of the fit."""

    form: str = "affine"
    """``affine`` (robust, in inverse depth) or ``paper`` (least squares in depth)."""
    min_confidence: float = 0.5
    """Anchors at pixels whose disparity peak holds less mass are not used."""
    border_px: int = 3
    min_spread_px: float = 0.05
    """Refuse when the anchors' disparities spread less than this (10th to 90th percentile)."""
    min_inliers: float = 0.3
    use_optics: bool = True
    """Recorded baseline, focal length and focus distance support the fit, by their sigmas."""
    min_trusted_anchors: int = 60
    """This many anchors that contradict the recorded optics are believed."""


DEFAULT_SCALE_FIT = ScaleFitSettings()


@dataclass(frozen=True)
class ScalePrior:
    """What the recorded optics say of the line, with standard deviations: a in 1/(px·m), c in 1/m."""

    a: float
    c: float
    sigma_a: float
    sigma_c: float

    def excess(self, fit: ScaleFit) -> float:
        """How far a fit lies from the prior, in standard deviations of the worse parameter."""
        return max(abs(fit.a - self.a) / self.sigma_a, abs(fit.c - self.c) / self.sigma_c)


def fit_affine(
    disparity: F64, inverse_depth: F64, prior: ScalePrior | None = None, *, iterations: int = 50
) -> ScaleFit:
    """Robust line ``1/z = a δ + c``.

    A least-median-of-squares start over point pairs (deterministic), then Tukey's biweight with a MAD scale and δ
    centred at each step (cond([δ, 1]) goes from 1 to 42 when δ is not centred at a zero crossing). Holds at 30 %
    outliers.

    Parameters
    ----------
    disparity, inverse_depth : float64 [N]
        Finite; px per view step and 1/m.
    prior : ScalePrior, optional
        Gaussian prior of (a, c). The anchors count as at most `EFFECTIVE_ANCHORS` independent ones against it: their
        disparities share the light field's systematic errors.

    Raises
    ------
    GeometryRefused
        Fewer than two distinct disparities.
    """
    if len(disparity) < 2 or np.ptp(disparity) <= 0:
        raise _refusal("flat-anchors", "all anchors have the same disparity", "")
    start = _least_median_start(disparity, inverse_depth, prior)
    found = biweight_line(
        disparity, inverse_depth, start, share=min(1.0, EFFECTIVE_ANCHORS / len(disparity)) if prior else 1.0,
        floor=1e-9 * float(np.abs(inverse_depth).max() + 1e-12), settled=SETTLED, iterations=iterations,
        prior=None if prior is None else LinePrior(prior.a, prior.c, 1 / prior.sigma_a**2, 1 / prior.sigma_c**2),
    )  # fmt: skip
    slope, offset, scale = found.tolist()
    inlier = np.abs(inverse_depth - (slope * disparity + offset)) < TUKEY * scale
    return ScaleFit(slope, offset, scale, float(inlier.mean()), len(disparity), "affine")


def _least_median_start(
    disparity: F64, inverse_depth: F64, prior: ScalePrior | None, trials: int = 500
) -> tuple[float, float]:
    """The line through two points with the least median residual (Rousseeuw 1984), seeded; near the prior, if any."""
    rng = np.random.default_rng(len(disparity))
    i, j = rng.integers(0, len(disparity), (2, trials))
    run = disparity[j] - disparity[i]
    usable = np.abs(run) > 0.1 * np.ptp(disparity)
    if not usable.any():
        i, j = np.array([int(disparity.argmin())]), np.array([int(disparity.argmax())])
        usable, run = np.array([True]), disparity[j] - disparity[i]
    slopes = (inverse_depth[j] - inverse_depth[i])[usable] / run[usable]
    offsets = inverse_depth[i][usable] - slopes * disparity[i][usable]
    if prior:
        near = (np.abs(slopes - prior.a) < 4 * prior.sigma_a) & (np.abs(offsets - prior.c) < 4 * prior.sigma_c)
        slopes, offsets = np.r_[slopes[near], prior.a], np.r_[offsets[near], prior.c]
    pick = slice(None, None, max(1, len(disparity) // 400))
    best = least_median_line(disparity[pick], inverse_depth[pick], slopes, offsets)
    return float(slopes[best]), float(offsets[best])


def fit_paper(plane_index: F64, depth_m: F64, *, iterations: int = 7) -> tuple[float, float]:
    """The paper's fit ``z = α/d + β`` in plane-index units, with its trimming; for the ablation.

    Source: Scale-Consistent Fusion, the Ψ function; index units as its figures suggest. Returns (α, β).
    """
    keep = np.ones(len(depth_m), bool)
    solution: F64 = np.zeros(2)
    for _ in range(iterations):
        design = np.c_[1 / plane_index[keep], np.ones(int(keep.sum()))]
        solution = np.asarray(np.linalg.lstsq(design, depth_m[keep], rcond=None)[0], np.float64)
        residual = np.abs(depth_m - (solution[0] / plane_index + solution[1]))
        keep = residual <= max(float(np.quantile(residual[keep], 0.98)), 1e-9)
    return float(solution[0]), float(solution[1])


def anchor_disparities(
    anchors: Anchors, evidence: Evidence, settings: ScaleFitSettings
) -> tuple[F64, NDArray[np.bool_]]:
    """Disparity of each anchor, read from the windowed peak map (bilinear), float64 [N], and which are usable.

    Anchors at the border, at unconfident pixels and across disparity steps (where bilinear mixes two surfaces) are
    not usable.
    """
    height, width = evidence.disparity.shape
    x, y = anchors.xy[:, 0], anchors.xy[:, 1]
    m = settings.border_px
    inside = (x >= m) & (y >= m) & (x <= width - 1 - m) & (y <= height - 1 - m) & np.isfinite(anchors.depth_m)
    xi = np.clip(np.where(inside, x, 0), 0, width - 1.001)
    yi = np.clip(np.where(inside, y, 0), 0, height - 1.001)
    ix, iy = np.minimum(xi.astype(np.int64), width - 2), np.minimum(yi.astype(np.int64), height - 2)
    fx, fy = xi - ix, yi - iy
    corners = np.stack([evidence.disparity[iy + dy, ix + dx].astype(np.float64) for dy in (0, 1) for dx in (0, 1)])
    weights = np.stack([(1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx])
    confidence = np.minimum(evidence.confidence[iy, ix], evidence.confidence[iy + 1, ix + 1])
    smooth = np.ptp(corners, axis=0) < 4 * evidence.planes_px[1]
    usable = inside & smooth & (confidence > settings.min_confidence) & (anchors.depth_m > 0)
    return (corners * weights).sum(0), usable


def fit_scale(
    light_field: LightField,
    camera: Camera,
    anchors: Anchors,
    evidence: Evidence,
    settings: ScaleFitSettings,
    monitor: Monitor,
    *,
    metric: bool = True,
) -> ScaleFit:
    """Scale of one capture from its anchors; from its recorded optics when they cannot carry it.

    Raises
    ------
    GeometryRefused
        ``too-few-anchors``, ``narrow-anchors``, ``wrong-sign`` or ``scattered-anchors``, when the optics are not
        recorded either; the message names the capture.
    """
    disparity, usable = anchor_disparities(anchors, evidence, settings)
    known = optics_prior(light_field, camera) if metric and settings.use_optics else None
    name = light_field.id
    try:
        return _fit_checked(name, disparity[usable], 1 / anchors.depth_m[usable], evidence, settings, known, monitor)
    except GeometryRefused as refusal:
        if known is None:
            raise
        monitor.warn(
            "scale-from-optics",
            f"capture {name}: {refusal.message.split(': ', 1)[-1]}; its scale is taken from the recorded "
            "baseline and focus distance instead",
        )
        return ScaleFit(known.a, known.c, known.sigma_c, 0.0, int(usable.sum()), "optics")


def optics_prior(light_field: LightField, camera: Camera) -> ScalePrior | None:
    """``a = 1/(bF)``, ``c = 1/z_f`` and their sigmas when baseline and focus distance are recorded, else None."""
    known = scale_from_optics(light_field, camera)
    if known is None:
        return None
    relative = max(MIN_OPTICS_SIGMA, light_field.optics.sigma_baseline)
    return ScalePrior(known.a, known.c, known.a * float(np.hypot(relative, camera.sigma_focal)), known.c * relative)


def scale_from_optics(light_field: LightField, camera: Camera) -> ScaleFit | None:
    """``a = 1/(bF)``, ``c = 1/z_f`` when baseline and focus distance are recorded, else None."""
    optics = light_field.optics
    if optics.baseline_m is None or optics.focus_distance_m is None:
        return None
    return ScaleFit(1 / (optics.baseline_m * camera.focal_px), 1 / optics.focus_distance_m, form="optics")


def _fit_checked(
    name: str,
    disparity: F64,
    inverse_depth: F64,
    evidence: Evidence,
    settings: ScaleFitSettings,
    known: ScalePrior | None,
    monitor: Monitor,
) -> ScaleFit:
    count = len(disparity)
    if count < MIN_ANCHORS:
        raise _refusal("too-few-anchors", f"only {count} usable anchors, {MIN_ANCHORS} are needed", name)
    if settings.form == "paper":
        return _paper_as_affine(disparity, inverse_depth, evidence)
    spread = float(np.subtract(*np.quantile(disparity, [0.9, 0.1])))
    if spread < settings.min_spread_px and known is None:
        raise _refusal(
            "narrow-anchors",
            f"the anchors' disparities spread only {spread:.3f} px, {settings.min_spread_px:g} px are needed",
            name,
        )
    fit = fit_affine(disparity, inverse_depth, known)
    if known is not None and spread >= settings.min_spread_px:
        free = fit_affine(disparity, inverse_depth)
        trusted = count >= settings.min_trusted_anchors and free.inliers > 0.6 and free.a > 0
        tolerance = 3 * max(free.residual, DISPARITY_SIGMA_PX * known.a)
        agree = [_agreeing(f, disparity, inverse_depth, tolerance) for f in (free, fit)]
        if trusted and known.excess(free) > PRIOR_LIMIT and agree[0] > 1.3 * agree[1]:
            monitor.warn(
                "optics-mismatch",
                f"capture {name}: {count} anchors contradict the recorded optics (baseline, focal length or focus "
                "distance are wrong by more than their sigmas); the anchors are believed",
            )
            fit = free
    if fit.a <= 0:
        raise _refusal(
            "wrong-sign", "nearer anchors have smaller disparities: the views are ordered the other way round", name
        )
    if fit.inliers < settings.min_inliers:
        raise _refusal("scattered-anchors", f"only {fit.inliers:.0%} of the anchors agree on one scale", name)
    return fit


def _agreeing(fit: ScaleFit, disparity: F64, inverse_depth: F64, tolerance: float) -> int:
    return int((np.abs(inverse_depth - (fit.a * disparity + fit.c)) < tolerance).sum())


def _paper_as_affine(disparity: F64, inverse_depth: F64, evidence: Evidence) -> ScaleFit:
    """The paper's curve, replaced by the line that best follows it over the planes of the volume.

    Fusion maps with a line in inverse depth; the curve z = α/d + β is sampled at the anchors and a plain
    least-squares line is drawn through 1/z of those samples (poles and negative depths left out).
    """
    first, step = evidence.planes_px
    index = (disparity - first) / step + 1.0
    alpha, beta = fit_paper(index, 1 / inverse_depth)
    depth = alpha / index + beta
    valid = depth > 0.05 * float(np.median(1 / inverse_depth))
    if int(valid.sum()) < 2:
        raise _refusal("paper-form", "the depth form has its pole among the anchors", "")
    design = np.c_[disparity[valid], np.ones(int(valid.sum()))]
    a, c = np.linalg.lstsq(design, 1 / depth[valid], rcond=None)[0]
    residual = inverse_depth - (a * disparity + c)
    return ScaleFit(float(a), float(c), float(np.std(residual)), 1.0, len(disparity), "paper")


def _refusal(code: str, message: str, name: str) -> GeometryRefused:
    return GeometryRefused(
        f"scale fit: {message}",
        path=f"capture {name}" if name else None,
        code=code,
        remedy="shoot it again with more texture or overlap, leave it out with --sources, or record its optics",
    )
