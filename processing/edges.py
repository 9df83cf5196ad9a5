"""The edge test: at depth steps, does a pixel belong to the near or to the far surface?

Light-field evidence alone fattens near surfaces: a ray that passes a millimetre beside an object is within the depth
error of its side. The photo decides: carried into the sources' centre views, 15–20° away, the two hypotheses land on
different places, and the right one shows the photo's colour. A guided filter over the photo makes neighbours of one
colour decide alike.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lfrig.processing.kernels.edge_cost import EdgeRules, EdgeView, edge_cost
from lfrig.processing.kernels.landing import Way, land_points
from lfrig.processing.model import F32, U8, Camera, Pose, Source
from lfrig.processing.nearest import Nearest
from lfrig.processing.skipping import SKIP_ALL, Skips, Tally
from lfrig.processing.tone import Tone, blurred, fit_tone
from lfrig.processing.visibility import Landing, Mask, way_into

TONE_SAMPLES = 4_000
"""About how many pixels of the photo the sources' tones are fitted to."""


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

    @property
    def rules(self) -> EdgeRules:
        """As the kernel takes them."""
        return EdgeRules(self.cap_grey, self.contradiction_grey, self.contradiction_px, self.margin_px)


DEFAULT_EDGES = EdgeSettings()


def decide_edges(
    inverse_depth: F32,
    sources: Sequence[Source],
    camera: Camera,
    pose: Pose,
    photo: U8,
    px_per_inverse: float,
    settings: EdgeSettings = DEFAULT_EDGES,
    *,
    tones: Sequence[Tone] | None = None,
    skips: Skips = SKIP_ALL,
    tally: Tally | None = None,
    threads: int = 0,
) -> tuple[F32, int]:
    """Decide near or far at every pixel close to a depth step.

    Parameters
    ----------
    inverse_depth : float32 [H, W], 1/m, finite
    photo : uint8 [H, W, 3]
    px_per_inverse : float
        b·F of the requested light field [px·m].
    tones : sequence of Tone, optional
        Of the sources against the photo; fitted on the surface where they are not known.

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
    ways = [way_into(source, camera, pose) for source in sources]
    pictures = [source.light_field.centre_view for source in sources]
    if tones is None:
        tones = [_tone(inverse_depth, *both, own, settings) for both in zip(ways, pictures, strict=True)]
    views = [
        EdgeView(way, blurred(tone.apply_whole(picture), settings.blur_px))
        for way, picture, tone in zip(ways, pictures, tones, strict=True)
    ]
    start = time.process_time()
    at = tested if skips.certain else np.ones_like(tested)
    preference = edge_cost(near_value, far_value, at, own, views, settings.rules, threads=threads)
    if tally is not None:
        done = int(at.sum())
        tally.add("certain", done, at.size - done, "pixels near edges", time.process_time() - start)
    preference += np.float32(settings.inertia_grey) * np.where(is_near, np.float32(1), np.float32(-1))
    preference[~tested] = 0
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
    near = np.where(is_near, inverse_depth, Nearest.of(tested & is_near).look_up(inverse_depth))
    far = np.where(is_near, Nearest.of(tested & ~is_near).look_up(inverse_depth), inverse_depth)
    return near.astype(np.float32), far.astype(np.float32), is_near, np.asarray(tested)


def _tone(current: F32, way: Way, picture: U8, photo: F32, settings: EdgeSettings) -> Tone:
    """Of a source, from about `TONE_SAMPLES` pixels of the surface as it is."""
    import cv2

    stride = max(1, int((current.size / TONE_SAMPLES) ** 0.5))
    ys, xs = (part[::stride, ::stride].astype(np.float32) for part in np.mgrid[: current.shape[0], : current.shape[1]])
    landing = Landing(*land_points(way, xs, ys, current[::stride, ::stride]))
    soft = cv2.GaussianBlur(picture, (0, 0), settings.blur_px)
    colour = cv2.remap(soft, landing.u, landing.v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return fit_tone(photo[::stride, ::stride], colour.astype(np.float32), landing.visible(settings.margin_px) > 0.5)
