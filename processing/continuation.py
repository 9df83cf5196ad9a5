"""Hidden areas: what no source sees continues the planes of what they see beside it.

Behind a near object there is background that the photo shows and no source does. Evidence is silent there, and a
smoothness term that prefers equal inverse depths draws such areas frontally, although most of what is hidden is table,
floor or wall that recedes. Worse, the error begins before the silence: at the rim of such an area the surface hides
just behind the silhouette of the occluder and seems confirmed by the fattened disparities there. What gives it away is
the match of photo and source (`wide_baseline`), for the source shows something else.

So: areas that are hidden, and the rim where the match is poor, take over the plane of the trusted pixel that is
nearest along paths that avoid the photo's edges. A plane stops where it would float in front of what a source sees;
that keeps occluders from growing into what they hide.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.processing.kernels.layer_mean import layer_mean
from lfrig.processing.kernels.plane_fit import local_planes
from lfrig.processing.kernels.spread import Seeds, spread
from lfrig.processing.match_doubt import excess_cost, local_variance
from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.plane_fit import Planes
from lfrig.processing.sources import usual_noise
from lfrig.processing.visibility import Landing, Mask, count_agreeing, half_contradicted, land, way_into
from lfrig.processing.wide_baseline import WideMatch

WIDTH = 540


@dataclass(frozen=True)
class ContinuationSettings:
    """Knobs; chosen on the tuning scenes (clean views, then checked under noise). Lengths in px of the photo, disparity
    in px per view step of the source unless it says otherwise.
    """

    enabled: bool = True
    margin_px: float = 0.08
    """Slack of the visibility test: a pixel that no source sees by it is hidden."""
    agree_px: float = 0.04
    """A pixel that differs from every source by more is not trusted (0.06 costs 0.1 points of PPE(.05))."""
    enough: int = 2
    """Sources that agree so that a poor match does not count: the rim of an occluder is seen from all sides."""
    contradiction_px: float = 0.12
    """How far a continued plane may lie in front of what a source sees."""
    least_area: int = 3
    """Side of the smallest square of hidden pixels that counts: single ones are raggedness of edges."""
    rim: int = 15
    """How far from a hidden area the surface may be mistaken because of it."""
    doubt_cost: float = 0.5
    """Match cost, mean over ``window``, above which the rim is doubted; beyond what noise explains, as the next."""
    trust_cost: float = 0.4
    """Match cost, mean over ``window``, above which nothing is continued from a pixel."""
    window: int = 9
    layer_px: float = 0.05
    """Such means are over neighbours of the same inverse depth [px per view step of the request], or the rim of the
    occluder, which is right, would share the doubt about what lies behind it."""
    clearance: int = 6
    """Distance that the fitted pixels keep: the error of the rim fades out. With 0 slopes are five times worse."""
    seeds: int = 3
    """Width of the band of pixels from which planes are continued."""
    radius: int = 18
    stride: int = 3
    """Of the plane fits: small ones are good values, but no slopes to follow over 40 px."""
    sigma_px: float = 0.08
    """Residual that still belongs to a plane [px per view step of the request]."""
    sigma_grey: float = 40.0
    ridge: float = 0.1
    least_support: float = 4.0
    step_grey: float = 30.0
    """Sum of the absolute RGB differences that makes a step twice as long."""
    slope_reach: float = 40.0
    """Distance up to which a slope is followed; beyond it the surface goes on frontally."""
    nearer_px: float = 0.3
    farther_px: float = 0.07
    """How far a pixel may be moved [px per view step of the request, at `WIDTH`]. Planes that come
    nearer end where they would hide what a source sees; nothing ends those that recede (without a bound: MSE +6 %,
    *colonnade* +24 %)."""
    longest: int = 150
    """Steps after which what has not been reached stays as it was."""


DEFAULT_CONTINUATION = ContinuationSettings()


@dataclass(frozen=True)
class _Areas:
    """bool [H, W] each: ``mistaken`` what is to be filled (areas hidden from all sources and their doubtful rims),
    ``trusted`` what may be continued.
    """

    mistaken: Mask
    trusted: Mask


def continue_hidden(
    match: WideMatch,
    planes: Planes,
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    photo: U8,
    px_per_inverse: float,
    settings: ContinuationSettings = DEFAULT_CONTINUATION,
    *,
    threads: int = 0,
) -> tuple[F32, int]:
    """Fill what no source sees.

    Parameters
    ----------
    match : WideMatch
        The surface [1/m] and how well photo and sources match on it.
    planes : Planes
        The slopes of that surface [1/m per px].
    photo : uint8 [H, W, 3]
    px_per_inverse : float
        b·F of the requested light field [px·m].

    Returns
    -------
    inverse_depth : float32 [H, W]
    filled : int
        Pixels that took over a plane.
    """
    surface = match.inverse_depth
    landings = [land(surface, source, camera, pose, threads=threads) for source in sources]
    noise_sigma = usual_noise(sources)
    areas = _find_areas(match, landings, photo, noise_sigma, px_per_inverse, settings, threads)
    if not areas.mistaken.any():
        return surface, 0
    # Planes are fitted at a distance and travel across the strip between.
    crossed = _grown(areas.mistaken, settings.clearance) & (areas.mistaken | areas.trusted)
    trusted = areas.trusted & ~crossed
    seeds = _fit_seeds(
        surface, planes, trusted, _grown(crossed, settings.seeds), photo, px_per_inverse, settings, threads
    )
    seed = spread(
        seeds, crossed, photo, [way_into(source, camera, pose) for source in sources], step_grey=settings.step_grey,
        reach=settings.slope_reach, most_ahead=half_contradicted(settings.contradiction_px), longest=settings.longest,
    )  # fmt: skip
    ys, xs = np.nonzero(areas.mistaken & (seed >= 0))
    out = surface.copy()
    out[ys, xs] = seeds.at(seed[ys, xs], xs, ys, settings.slope_reach)
    # Doubt about a pixel that a source sees is settled only by a place where none does.
    seen = _most(landings, settings.margin_px) > 0.5
    still_seen = (
        _most([land(out, source, camera, pose, threads=threads) for source in sources], settings.margin_px) > 0.5
    )
    out = np.where(seen & still_seen, surface, out)
    px = px_per_inverse * max(1.0, WIDTH / photo.shape[1])
    out = surface + np.clip(out - surface, -settings.farther_px / px, settings.nearer_px / px, dtype=np.float32)
    return out, int((out != surface).sum())


def _find_areas(
    match: WideMatch,
    landings: Sequence[Landing],
    photo: U8,
    noise_sigma: float,
    px_per_inverse: float,
    settings: ContinuationSettings,
    threads: int,
) -> _Areas:
    import cv2

    hidden = _most(landings, settings.margin_px) < 0.5
    agreeing = count_agreeing(landings, settings.agree_px)
    square = np.ones((settings.least_area, settings.least_area), np.uint8)
    core = cv2.morphologyEx(hidden.astype(np.uint8), cv2.MORPH_OPEN, square) > 0
    if not core.any():
        return _Areas(np.zeros_like(hidden), agreeing > 0)
    # What floats before a source's surface is mistaken, but not because it is hidden.
    floating = np.zeros_like(hidden)
    for landing in landings:
        floating |= landing.inside & (landing.contradicted(settings.contradiction_px) > 0.5)
    sigma = settings.layer_px / px_per_inverse
    cost = layer_mean(match.cost, match.inverse_depth, sigma=sigma, window=settings.window, threads=threads)
    cost = excess_cost(cost, local_variance(photo, settings.window), noise_sigma)
    doubtful = (cost > settings.doubt_cost) & (agreeing < settings.enough)
    mistaken = ((agreeing == 0) | doubtful) & ~floating
    distance = cv2.distanceTransform((~core).astype(np.uint8), cv2.DIST_L2, 5)
    joined = _joined(mistaken | core, core) & (distance < settings.rim)
    return _Areas(joined, (agreeing > 0) & (cost <= settings.trust_cost))


def _fit_seeds(
    surface: F32,
    planes: Planes,
    trusted: Mask,
    near: Mask,
    photo: U8,
    px_per_inverse: float,
    settings: ContinuationSettings,
    threads: int,
) -> Seeds:
    """Planes through the trusted pixels of ``near``, from trusted pixels alone."""
    at = trusted & near
    value, slope_x, slope_y, support = local_planes(
        surface, trusted.astype(np.float32), photo, at, radius=settings.radius, stride=settings.stride,
        sigma_value=settings.sigma_px / px_per_inverse, sigma_grey=settings.sigma_grey, ridge=settings.ridge,
        slopes=(planes.slope_x, planes.slope_y), threads=threads,
    )  # fmt: skip
    ys, xs = np.nonzero(at)
    good = support > settings.least_support
    return Seeds(xs[good], ys[good], value[good], slope_x[good], slope_y[good])


def _most(landings: Sequence[Landing], margin_px: float) -> F32:
    """How far the source that sees it best sees each point, float32 [H, W]."""
    return np.asarray(np.max([landing.visible(margin_px) for landing in landings], axis=0), np.float32)


def _joined(area: Mask, core: Mask) -> Mask:
    """The connected parts of an area that contain some of its core, bool [H, W]."""
    import cv2

    count, labels = cv2.connectedComponents(area.astype(np.uint8), connectivity=8)
    keep = np.zeros(count, bool)
    keep[np.unique(labels[core])] = True
    keep[0] = False
    return np.asarray(keep[labels])


def _grown(area: Mask, reach: int) -> Mask:
    import cv2

    return np.asarray(cv2.dilate(area.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0)
