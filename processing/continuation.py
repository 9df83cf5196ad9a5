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

from lfrig.processing.geometry import projection
from lfrig.processing.kernels.plane_fit import local_planes
from lfrig.processing.match_doubt import excess_cost, layer_mean, local_variance
from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.plane_fit import Planes
from lfrig.processing.sources import usual_noise
from lfrig.processing.visibility import Landing, Mask, contradiction, count_agreeing, land, place
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


@dataclass(frozen=True)
class _Seeds:
    """Planes of M pixels (``x``, ``y``): ``value``, ``slope_x``, ``slope_y`` float32 [M]."""

    x: np.ndarray
    y: np.ndarray
    value: F32
    slope_x: F32
    slope_y: F32

    def at(self, seed: np.ndarray, x: np.ndarray, y: np.ndarray, reach: float) -> F32:
        """Values of the planes number ``seed`` at (x, y); slopes are followed up to ``reach`` px."""
        dx, dy = (x - self.x[seed]).astype(np.float32), (y - self.y[seed]).astype(np.float32)
        rise = self.slope_x[seed] * dx + self.slope_y[seed] * dy
        rise *= np.minimum(1, np.float32(reach) / np.maximum(np.hypot(dx, dy), 1))
        return np.asarray(self.value[seed] + rise, np.float32)


def continue_hidden(
    match: WideMatch,
    planes: Planes,
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    photo: U8,
    px_per_inverse: float,
    settings: ContinuationSettings = DEFAULT_CONTINUATION,
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
    landings = [land(surface, source, camera, pose) for source in sources]
    noise_sigma = usual_noise(sources)
    areas = _find_areas(match, landings, photo, noise_sigma, px_per_inverse, settings)
    if not areas.mistaken.any():
        return surface, 0
    # Planes are fitted at a distance and travel across the strip between.
    crossed = _grown(areas.mistaken, settings.clearance) & (areas.mistaken | areas.trusted)
    trusted = areas.trusted & ~crossed
    seeds = _fit_seeds(surface, planes, trusted, _grown(crossed, settings.seeds), photo, px_per_inverse, settings)
    seed = _spread(seeds, crossed, sources, camera, pose, photo, settings)
    ys, xs = np.nonzero(areas.mistaken & (seed >= 0))
    out = surface.copy()
    out[ys, xs] = seeds.at(seed[ys, xs], xs, ys, settings.slope_reach)
    # Doubt about a pixel that a source sees is settled only by a place where none does.
    seen = _most(landings, settings.margin_px) > 0.5
    still_seen = _most([land(out, source, camera, pose) for source in sources], settings.margin_px) > 0.5
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
) -> _Areas:
    import cv2

    hidden = _most(landings, settings.margin_px) < 0.5
    agreeing = count_agreeing(landings, settings.agree_px)
    # What floats before a source's surface is mistaken, but not because it is hidden.
    floating = np.zeros_like(hidden)
    for landing in landings:
        floating |= landing.inside & (landing.contradicted(settings.contradiction_px) > 0.5)
    cost = layer_mean(match.cost, match.inverse_depth, settings.layer_px / px_per_inverse, settings.window)
    cost = excess_cost(cost, local_variance(photo, settings.window), noise_sigma)
    doubtful = (cost > settings.doubt_cost) & (agreeing < settings.enough)
    mistaken = ((agreeing == 0) | doubtful) & ~floating
    square = np.ones((settings.least_area, settings.least_area), np.uint8)
    core = cv2.morphologyEx(hidden.astype(np.uint8), cv2.MORPH_OPEN, square) > 0
    if not core.any():
        return _Areas(np.zeros_like(hidden), agreeing > 0)
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
) -> _Seeds:
    """Planes through the trusted pixels of ``near``, from trusted pixels alone."""
    at = trusted & near
    value, slope_x, slope_y, support = local_planes(
        surface, trusted.astype(np.float32), photo, at, radius=settings.radius, stride=settings.stride,
        sigma_value=settings.sigma_px / px_per_inverse, sigma_grey=settings.sigma_grey, ridge=settings.ridge,
        slopes=(planes.slope_x, planes.slope_y),
    )  # fmt: skip
    ys, xs = np.nonzero(at)
    good = support > settings.least_support
    return _Seeds(xs[good], ys[good], value[good], slope_x[good], slope_y[good])


NEIGHBOURS = ((0, 1), (1, 0), (0, -1), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1))


def _spread(
    seeds: _Seeds,
    domain: Mask,
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    photo: U8,
    settings: ContinuationSettings,
) -> np.ndarray:
    """Number of the seed that each pixel of the domain takes over, int32 [H, W]; −1 = none.

    Shortest paths from all seeds at once (Bellman–Ford over the pixels that changed last); a path ends where its
    plane floats before what a source sees.
    """
    height, width = domain.shape
    colour = photo.astype(np.float32)
    seed = np.full(domain.shape, -1, np.int32)
    length = np.full(domain.shape, np.inf, np.float32)
    seed[seeds.y, seeds.x] = np.arange(len(seeds.x))
    length[seeds.y, seeds.x] = 0
    ways = [projection(camera, pose, source.camera, source.pose) for source in sources]
    ys, xs = seeds.y, seeds.x
    for _ in range(settings.longest):
        changed = np.zeros_like(domain)
        for dy, dx in NEIGHBOURS:
            y, x = ys + dy, xs + dx
            inside = (y >= 0) & (y < height) & (x >= 0) & (x < width)
            inside[inside] = domain[y[inside], x[inside]]
            y, x, y0, x0 = y[inside], x[inside], ys[inside], xs[inside]
            rough = np.abs(colour[y, x] - colour[y0, x0]).sum(1) / np.float32(settings.step_grey)
            proposed = length[y0, x0] + np.float32(np.hypot(dy, dx)) * (1 + rough)
            better = proposed < length[y, x] - np.float32(1e-4)
            y, x, proposed, source_seed = y[better], x[better], proposed[better], seed[y0, x0][better]
            value = seeds.at(source_seed, x, y, settings.slope_reach)
            free = ~_floats(value, x, y, sources, ways, settings.contradiction_px)
            y, x = y[free], x[free]
            length[y, x], seed[y, x], changed[y, x] = proposed[free], source_seed[free], True
        ys, xs = np.nonzero(changed)
        if not len(ys):
            break
    return seed


def _floats(
    value: F32,
    x: np.ndarray,
    y: np.ndarray,
    sources: Sequence[Source],
    ways: Sequence[tuple[np.ndarray, np.ndarray]],
    margin_px: float,
) -> Mask:
    """Whether points [M] of inverse depth ``value`` lie before the surface that any source sees there."""
    floats = np.zeros(len(value), bool)
    for source, way in zip(sources, ways, strict=True):
        u, v, w, inside = place(way, source.camera, x.astype(np.float32), y.astype(np.float32), value)
        iu, iv = np.rint(u[inside]).astype(np.int64), np.rint(v[inside]).astype(np.int64)
        ahead = source.evidence.disparity[iv, iu] - source.scale.disparity(w[inside])
        floats[inside] |= contradiction(ahead, margin_px) > 0.5
    return floats


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
