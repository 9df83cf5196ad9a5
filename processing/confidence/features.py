"""The clues as numbers: one float32 map per feature, mostly logarithms, because errors go over four decades.

Lengths of disparity are in px per view step of the sources, distances in px of the photo.
"""

from __future__ import annotations

import numpy as np

from lfrig.processing.confidence.clues import Clues
from lfrig.processing.model import F32
from lfrig.processing.nearest import Nearest
from lfrig.processing.patch import slopes
from lfrig.processing.tone import blurred, luma

LEAST_REST = 1e-7
"""Evidence beside the peak below which float32 does not tell."""
MARGIN_PX = 0.08
AGREE_PX = 0.06
SURE_REST = 0.05
STEP_PX = 0.06
STEP_REACH = 12.0
WINDOWS = (5, 13, 25)


def feature_maps(clues: Clues) -> dict[str, F32]:
    """The model's inputs, float32 [H, W] each, finite, in a fixed order."""
    to_px = np.float32(1 / clues.unit)
    surface = np.asarray(clues.surface * to_px, np.float32)
    maps = _of_evidence(clues, to_px)
    maps |= _of_sources(clues)
    maps |= _of_steps(surface)
    maps |= _of_texture(clues)
    maps |= _of_support(clues, surface, maps["agreeing"])
    for name, size in (("rest", 9), ("match_cost", 9), ("visible", 9), ("ahead", 9), ("moved", 9),
                       ("rest", 25), ("match_cost", 25), ("moved", 25)):  # fmt: skip
        maps[f"{name}_{size}"] = _box(maps[name], size)
    return {name: np.asarray(values, np.float32) for name, values in maps.items()}


def _of_evidence(clues: Clues, to_px: np.float32) -> dict[str, F32]:
    """Evidence that speaks for another depth, the match of photo and sources, and how far each stage moved a pixel."""
    match = clues.match

    def moved(before: F32, after: F32, least: float) -> F32:
        return _log(np.abs(after - before) * to_px, least)

    return {
        "rest": _log(1 - clues.peak, LEAST_REST),
        "match_seen": np.minimum(match.seen, 2),
        "match_cost": match.cost,
        "match_accepted": match.accepted.astype(np.float32),
        "match_margin": _log(match.margin, 1e-3),
        "match_curvature": _log(match.curvature, 1e-3),
        "moved": moved(clues.planes.value, match.inverse_depth, 1e-4),
        "smoothed": moved(clues.fused, clues.planes.value, 1e-3),
        "decided": moved(match.inverse_depth, clues.decided, 1e-2),
        "snapped": moved(clues.decided, clues.surface, 1e-3),
        "slope": _log(np.hypot(clues.planes.slope_x, clues.planes.slope_y) * to_px, 1e-4),
    }


def _of_sources(clues: Clues) -> dict[str, F32]:
    """Who sees the surface, and how far the disparity that a source found by itself is from it."""
    import cv2

    shape = clues.surface.shape
    visible, inside, agreeing, weighted, total, floats = (np.zeros(shape, np.float32) for _ in range(6))
    for source, landing in zip(clues.sources, clues.landings, strict=True):
        seen = landing.visible(MARGIN_PX)
        own = cv2.remap(
            source.evidence.confidence, landing.u, landing.v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        away = np.where(landing.inside, np.abs(landing.ahead), np.float32(1))
        visible += seen
        inside += landing.inside
        agreeing += away < AGREE_PX
        weight = seen * own
        total += weight
        weighted += weight * away
        # A point before what the source sees through it: it floats in the air.
        np.maximum(floats, np.clip(-landing.ahead, 0, 1) * landing.inside * own, out=floats)
    sure = total / np.maximum(visible, np.float32(0.3))
    ahead = weighted / np.maximum(total, np.float32(0.05)) + (1 - np.minimum(visible, 1))
    return {
        "visible": np.minimum(visible, 2),
        "inside": inside / np.float32(len(clues.sources)),
        "agreeing": np.minimum(agreeing, 2),
        "sure": sure,
        "ahead": _log(ahead, 1e-3),
        "floats": _log(floats, 1e-2),
    }


def _of_steps(surface: F32) -> dict[str, F32]:
    """Distance to the nearest depth step, its height, the side that a pixel is on, and the relief around it."""
    maps: dict[str, F32] = {}
    high, low = _extremes(surface, 3)
    step = high - low > STEP_PX
    nearest = Nearest.of(step)
    within = nearest.distance < STEP_REACH
    maps["step_distance"] = _log(np.minimum(nearest.distance, 60) + np.float32(0.5), 0.5)
    maps["step_height"] = _log(nearest.look_up(high - low) * within, 1e-2)
    maps["step_side"] = np.clip(surface - nearest.look_up(0.5 * (high + low)), -0.5, 0.5) * within
    for size in WINDOWS:
        high, low = _extremes(surface, size)
        maps[f"relief_{size}"] = _log(high - low, 1e-3)
    relief = high - low
    rank = np.where(relief > STEP_PX, (surface - low) / np.maximum(relief, np.float32(1e-6)) - np.float32(0.5), 0)
    maps["relief_rank"] = rank * np.minimum(relief / np.float32(0.1), 1)
    return maps


def _of_texture(clues: Clues) -> dict[str, F32]:
    """Root mean square gradient of the photo's luma over 9×9 px [grey levels per px]."""
    gx, gy = slopes(blurred(luma(clues.photo), 1.0))
    return {"texture": _log(np.sqrt(np.maximum(_box(gx * gx + gy * gy, 9), 0)), 0.1)}


def _of_support(clues: Clues, surface: F32, agreeing: F32) -> dict[str, F32]:
    """How far the nearest pixel is that everything speaks for, and how much deeper or nearer it lies."""
    match = clues.match
    good = (agreeing >= 1) & match.accepted & (1 - clues.peak < SURE_REST)
    nearest = Nearest.of(good)
    return {
        "support_distance": _log(np.minimum(nearest.distance, 80) + np.float32(0.5), 0.5),
        "support_gap": _log(np.abs(surface - nearest.look_up(surface)), 1e-3),
        "support_share": _box(good.astype(np.float32), 15),
    }


def _log(values: F32, least: float) -> F32:
    held: F32 = np.asarray(np.maximum(values, np.float32(least)), np.float32)
    return np.log10(held, out=held)


def _box(values: F32, size: int) -> F32:
    import cv2

    return np.asarray(cv2.blur(values, (size, size)), np.float32)


def _extremes(values: F32, size: int) -> tuple[F32, F32]:
    import cv2

    window = np.ones((size, size), np.uint8)
    return cv2.dilate(values, window), cv2.erode(values, window)
