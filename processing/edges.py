"""The edge test: at depth steps, does a pixel belong to the near or to the far surface?

Light-field evidence alone fattens near surfaces: a ray that passes a millimetre beside an object is within the depth
error of its side. The photo decides: carried into the sources' centre views, 15–20° away, the two hypotheses land on
different places, and the right one shows the photo's colour. A guided filter over the photo makes neighbours of one
colour decide alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.tone import blurred, fit_tone
from lfrig.processing.visibility import Landing, Mask, land


@dataclass(frozen=True)
class EdgeSettings:
    """Knobs; px are px per view step of the requested light field, grey levels of 0..255."""

    enabled: bool = True
    gap_px: float = 0.10
    """A depth step this high within ``window`` asks for the test."""
    window: int = 23
    blur_px: float = 0.7
    cap_grey: float = 30.0
    inertia_grey: float = 10.0
    """What a change of side must win by."""
    contradiction_grey: float = 30.0
    """What a hypothesis is charged that floats before the surface which a source sees there."""
    contradiction_px: float = 0.12
    margin_px: float = 0.08
    """Slack of the visibility test [px per view step of the source]."""
    guide_radius: int = 3
    guide_eps: float = 40.0


DEFAULT_EDGES = EdgeSettings()


def decide_edges(
    inverse_depth: F32,
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    photo: U8,
    px_per_inverse: float,
    settings: EdgeSettings = DEFAULT_EDGES,
) -> tuple[F32, int]:
    """Decide near or far at every pixel close to a depth step.

    Parameters
    ----------
    inverse_depth : float32 [H, W], 1/m, finite
    photo : uint8 [H, W, 3]
    px_per_inverse : float
        b·F of the requested light field [px·m].

    Returns
    -------
    inverse_depth : float32 [H, W]
    changed : int
        Pixels that went over to the other side.
    """
    import cv2

    near_value, far_value, is_near, tested = _hypotheses(inverse_depth, px_per_inverse, settings)
    if not tested.any():
        return inverse_depth, 0
    own = blurred(photo, settings.blur_px)
    near_cost, far_cost = _colour_costs((near_value, far_value), inverse_depth, sources, camera, pose, own, settings)
    preference = far_cost - near_cost + settings.inertia_grey * np.where(is_near, 1, -1)
    preference = np.asarray(np.where(tested, preference, 0), np.float32)
    decided = cv2.ximgproc.guidedFilter(
        np.ascontiguousarray(photo), preference, settings.guide_radius, settings.guide_eps
    )
    to_near, to_far = tested & ~is_near & (decided > 0), tested & is_near & (decided < 0)
    out = inverse_depth.copy()
    out[to_near] = near_value[to_near]
    out[to_far] = far_value[to_far]
    return out, int(to_near.sum() + to_far.sum())


def _hypotheses(inverse_depth: F32, px_per_inverse: float, settings: EdgeSettings) -> tuple[F32, F32, Mask, Mask]:
    """(near value, far value, is near, tested): the other side's value is that of the nearest pixel on it."""
    import cv2

    window = np.ones((settings.window, settings.window), np.uint8)
    highest, lowest = cv2.dilate(inverse_depth, window), cv2.erode(inverse_depth, window)
    tested = (highest - lowest) * px_per_inverse > settings.gap_px
    is_near = inverse_depth > 0.5 * (highest + lowest)
    near = np.where(is_near, inverse_depth, _nearest_value(inverse_depth, tested & is_near))
    far = np.where(is_near, _nearest_value(inverse_depth, tested & ~is_near), inverse_depth)
    return near.astype(np.float32), far.astype(np.float32), is_near, np.asarray(tested)


def _nearest_value(values: F32, where: Mask) -> F32:
    """At every pixel the value of the nearest pixel of ``where``."""
    import cv2

    if not where.any():
        return values
    _, labels = cv2.distanceTransformWithLabels(
        (~where).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    table = np.zeros(int(labels.max()) + 1, np.float32)
    table[labels[where]] = values[where]
    return np.asarray(table[labels], np.float32)


def _colour_costs(
    hypotheses: Sequence[F32],
    current: F32,
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    photo: F32,
    settings: EdgeSettings,
) -> list[F32]:
    """For each hypothesis the mean capped colour difference [grey levels] over the sources that see it, [H, W]."""
    total = [np.zeros_like(current) for _ in hypotheses]
    mass = [np.zeros_like(current) for _ in hypotheses]
    for source in sources:
        image = blurred(source.light_field.centre_view, settings.blur_px)
        colour, seen = _look(image, land(current, source, camera, pose), settings)
        tone = fit_tone(photo, colour, seen > 0.5)
        for k, hypothesis in enumerate(hypotheses):
            landing = land(hypothesis, source, camera, pose)
            colour, seen = _look(image, landing, settings)
            difference = np.abs(photo - tone.apply(colour)).mean(2)
            difference += settings.contradiction_grey * landing.contradicted(settings.contradiction_px)
            total[k] += seen * np.minimum(difference, np.float32(settings.cap_grey))
            mass[k] += seen
    # Where nobody looks, nothing speaks for or against.
    unknown = np.float32(0.5 * settings.cap_grey)
    return [np.where(m > 0.05, t / np.maximum(m, 0.05), unknown) for t, m in zip(total, mass, strict=True)]


def _look(image: F32, landing: Landing, settings: EdgeSettings) -> tuple[F32, F32]:
    """Colour float32 [H, W, 3] that a source shows where points land, and how far it sees them there, 0..1 [H, W]."""
    import cv2

    colour = cv2.remap(image, landing.u, landing.v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(colour), landing.visible(settings.margin_px)
